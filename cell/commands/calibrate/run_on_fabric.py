"""Common parts of the calibrations of a fabric (shear, friction, bending, crease): flags, test, garment file."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from foldcell.cell.commands.shared import (
    Commands,
    add_command,
    answer,
    cell_option,
    check_garment_output,
    logs_option,
    teller,
)
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import garment_path, load_garment
from foldcell.cell.config.garments.material_file import with_material
from foldcell.cell.config.yaml_file import read_yaml
from foldcell.cell.operator.progress.compiling import report_compilation
from foldcell.cell.support.files.paths import logs_directory, prepare_logs
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.skills.garments.garment import Garment

Tell = Callable[[str], None]


@dataclass(frozen=True)
class FabricTest:
    """The result of a fabric test.

    values: new values for `material` in the garment file. measured: sources of these values. fields: names of the
    properties that are now measured and no longer assumed. figures: figures for the report. agrees: whether the
    simulated test agrees with the measurement. record: writes the recording to a path, by the module
    `foldcell.cell.view.material`.
    """

    values: Mapping[str, Any]
    measured: Mapping[str, str]
    fields: tuple[str, ...]
    figures: Mapping[str, Any]
    agrees: bool
    record: Callable[[Any, Path], None]


Measure = Callable[[Garment, argparse.Namespace, str, Tell], FabricTest]


def add_garment_action(
    actions: Commands,
    name: str,
    about: str,
    measure: Measure,
    quantities: Mapping[str, tuple[str, str]],
    any_surface: bool = False,
) -> argparse.ArgumentParser:
    """Add a command that calibrates the fabric of one garment.

    quantities: flag -> (placeholder, help text) of each quantity that the operator measures. any_surface: whether
    the garment file may lack the table's surface.
    """
    action = add_command(actions, name, about, lambda options: _run(options, name, measure, any_surface))
    cell_option(action)
    logs_option(action)
    action.add_argument("garment", metavar="GARMENT", help="name or file")
    for option, (metavar, help_text) in quantities.items():
        action.add_argument(option, type=float, required=True, metavar=metavar, help=help_text)
    action.add_argument("--output", type=Path, metavar="FILE", help="garment file to write (among the logs)")
    action.add_argument("--replace", action="store_true", help="write over a file that exists")
    return action


def _run(options: argparse.Namespace, name: str, measure: Measure, any_surface: bool) -> int:
    surface = load_settings(options.cell).surface
    tell = teller(options.json)
    source = garment_path(options.garment)
    garment = load_garment(source, _known_surface(source, surface) if any_surface else surface)
    check_garment_output(options.output, options.replace)
    folder = _folder(options, name, garment)
    with report_compilation(tell):
        result = measure(garment, options, surface, tell)
    from foldcell.cell.view import material

    text = with_material(
        source.read_text(encoding="utf-8"), garment.name, result.values, result.measured, result.fields, surface
    )
    folder.mkdir(parents=True)
    recording, file = folder / "test.rrd", options.output or folder / f"{garment.name}.yaml"
    result.record(material, recording)
    write_whole(file, text.encode())
    report = {
        "calibration": name, "garment": garment.name, "surface": surface, **result.figures,
        "agrees": result.agrees, "file": str(file.absolute()), "recording": str(recording), "simulated": True,
    }  # fmt: skip
    lines = [f"  {key:<28} {f'{v:.5g}' if isinstance(v, float) else v}" for key, v in report.items()]
    if not result.agrees:
        lines.append(
            "  the simulated test does not agree with the measured value; predictions have the same error"
        )
    return answer(options, report, lines)


def _known_surface(source: Path, surface: str) -> str:
    """Return the surface for which the garment is loaded: `surface`, or another surface of the file if the file
    has no friction for `surface`."""
    material = read_yaml(source, "garment file").data.get("material")
    angles = material.get("friction_angle_deg") if isinstance(material, dict) else None
    if not isinstance(angles, dict) or not angles or surface in angles:  # loading reports any other error
        return surface
    return str(next(iter(angles)))


def _folder(options: argparse.Namespace, name: str, garment: Garment) -> Path:
    logs = prepare_logs(logs_directory(options.logs))
    stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
    base = logs / f"{stamp}-calibrate-{name}-{garment.name}"
    return next(p for p in (base, *(base.with_name(f"{base.name}-{k}") for k in range(2, 100))) if not p.exists())


def provenance(text: str) -> str:
    return f"{text} ({time.strftime('%Y-%m-%d', time.gmtime())}, foldcell {version('foldcell')})"
