"""`foldcell calibrate shear|friction|bending|paper`: what a fabric is, from what an operator measures."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from calibration.bending import calibrate_bending
from calibration.friction import FrictionCalibration, calibrate_friction
from calibration.shear import ShearCalibration, calibrate_shear, clip_and_lowest
from cell.commands.options import Commands, add_command, cell_option, json_option, logs_option
from cell.commands.output import print_json, print_table, progress_stream
from cell.config.cell_settings import load_settings
from cell.config.garments.garment_file import garment_path, load_garment, shipped_garment_path
from cell.config.garments.material_file import with_material
from cell.config.yaml_file import read_yaml
from cell.operator.progress.compiling import compiling_told
from cell.support.files.paths import logs_directory, prepare_logs
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError
from skills.cloth.elasticity import flexural_rigidity, membrane_modulus
from skills.garments.garment import Garment
from skills.vocabulary import REFERENCE_DROP, Array

__all__ = ["PAPER", "add_actions", "run"]

PAPER = {
    "long_sleeve_shirt_large": (2.9, 24.3, 200, 0.7),
    "long_sleeve_shirt_small": (2.9, 24.7, 200, 0.7),
    "jeans": (2.9, 19.1, 200, 0.5),
    "pants": (1.7, 21.9, 340, 0.6),
    "large_towel": (2.2, 18.7, 260, 0.5),
    "medium_towel": (3.1, 22.3, 190, 0.6),
    "small_towel": (1.1, 24.3, 530, 0.7),
}
"""Li et al. 2015, its table of garments: stretch [%], friction angle [degrees], Maya's shear resistance, Maya's
friction."""

Tell = Callable[[str], None]


@dataclass(frozen=True)
class _Result:
    """values: for the file's `material`; measured: where they come from; fields: no longer assumed; figures: for
    the report; agrees: whether the simulated test does; record: writes the recording to a path."""

    values: Mapping[str, Any]
    measured: Mapping[str, str]
    fields: tuple[str, ...]
    figures: Mapping[str, Any]
    agrees: bool
    record: Callable[[Path], None]


def add_actions(actions: Commands) -> None:
    """What an operator measures of a fabric. The garment file that comes of it names where each value is from."""

    def add(name: str, about: str) -> argparse.ArgumentParser:
        action = add_command(actions, name, about, run)
        action.set_defaults(action=name)
        cell_option(action)
        logs_option(action)
        json_option(action)
        return action

    for name, about, lengths in (
        ("shear", "a garment's stretch, from its length hung and laid", (
            ("--l1", "of the hung garment, from the clip to the lowest point"),
            ("--l2", "of the same two points on the laid garment, spread"))),
        ("friction", "a garment's friction with the table, from the slope on which it slides", (
            ("--height", "by which one side of the table is lifted when the garment begins to slide"),
            ("--length", "of the table"))),
        ("bending", "a fabric's bending length, from a strip that hangs over an edge (ASTM D1388)", (
            ("--overhang", "at which the strip's tip touches the plane of 41.5 degrees"),)),
    ):  # fmt: skip
        action = add(name, about)
        action.add_argument("garment", metavar="GARMENT", help="name or file")
        for option, help_text in lengths:
            action.add_argument(option, type=float, required=True, metavar="M", help=f"metres {help_text}")
        if name == "shear":
            action.add_argument("--held", metavar="KEYPOINT", help="by which it hung (an end of its longest line)")
        action.add_argument("--output", type=Path, metavar="FILE", help="garment file to write (among the logs)")
        action.add_argument("--replace", action="store_true", help="write over a file that exists")
    paper = add("paper", "the paper's table of garments, calibrated here and printed beside the paper's")
    paper.add_argument("garments", nargs="*", metavar="GARMENT", help="names (all seven)")
    paper.add_argument("--output", type=Path, metavar="DIR", help="write their garment files, calibrated, there")
    paper.add_argument("--replace", action="store_true", help="write over files that exist")


def run(options: argparse.Namespace) -> int:
    surface = load_settings(options.cell).surface
    stream = progress_stream(options.json)

    def tell(line: str) -> None:
        print(line, file=stream, flush=True)

    if options.action == "paper":
        with compiling_told(tell):
            return _paper(options, surface, tell)
    source = garment_path(options.garment)
    garment = load_garment(source, _known_surface(source, surface, options))
    _check_output(options.output, options.replace)
    folder = _folder(options, garment)
    with compiling_told(tell):
        result = MEASURE[options.action](garment, options, surface, tell)
    text = with_material(
        source.read_text(encoding="utf-8"), garment.name, result.values, result.measured, result.fields, surface
    )
    folder.mkdir(parents=True)
    recording, file = folder / "test.rrd", options.output or folder / f"{garment.name}.yaml"
    result.record(recording)
    write_whole(file, text.encode())
    report = {
        "calibration": options.action, "garment": garment.name, "surface": surface, **result.figures,
        "agrees": result.agrees, "file": str(file.absolute()), "recording": str(recording), "simulated": True,
    }  # fmt: skip
    if options.json:
        print_json(report)
        return 0
    for name, value in report.items():
        print(f"  {name:<28} {f'{value:.5g}' if isinstance(value, float) else value}")
    if not result.agrees:
        print("  the simulated test does not agree with the measured value: predictions are off by as much")
    return 0


def _known_surface(source: Path, surface: str, options: argparse.Namespace) -> str:
    """The surface to load the garment for: friction may be measured on one that the file does not have yet."""
    if options.action != "friction":
        return surface
    material = read_yaml(source, "garment file").data.get("material")
    angles = material.get("friction_angle_deg") if isinstance(material, dict) else None
    if not isinstance(angles, dict) or not angles or surface in angles:  # what else it is, loading it says
        return surface
    return str(next(iter(angles)))


def _check_output(path: Path | None, replace: bool) -> None:
    """Before anything is computed."""
    if path is None:
        return
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise ConfigurationError(
            f"cannot write {path}: no such folder", "give --output a file in a folder that exists"
        )
    if path.suffix not in (".yaml", ".yml"):
        raise ConfigurationError(f"--output {path}: a garment file ends in .yaml")
    if path.exists() and not replace:
        shipped = path.resolve().parent == shipped_garment_path("").resolve().parent
        what = "is a shipped garment file" if shipped else "exists already"
        raise ConfigurationError(f"--output {path} {what}", "give another file, or --replace to write over it")


def _folder(options: argparse.Namespace, garment: Garment) -> Path:
    logs = prepare_logs(logs_directory(options.logs))
    stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
    base = logs / f"{stamp}-calibrate-{options.action}-{garment.name}"
    return next(p for p in (base, *(base.with_name(f"{base.name}-{k}") for k in range(2, 100))) if not p.exists())


def _provenance(text: str) -> str:
    return f"{text} ({time.strftime('%Y-%m-%d', time.gmtime())}, foldcell {version('foldcell')})"


# the measurements


def _shear(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> _Result:
    test = _hang_test(garment, options.l1, options.l2, options.held, tell)
    l1, l2 = options.l1, options.l2

    def record(path: Path) -> None:
        from cell.recording.rerun.material import record_shear

        record_shear(path, test)

    return _Result(
        values={"stretch_fraction": round(test.stretch_fraction, 5), "hang_drop": round(test.hang_drop, 4)},
        measured={"stretch_fraction": _provenance(f"L1 {l1:g} m, L2 {l2:g} m, hung by {_held(garment, options)}")},
        fields=("stretch_fraction",),
        figures={
            "l1_m": l1, "l2_m": l2, "stretch_fraction": test.stretch_fraction,
            "simulated_stretch_fraction": test.simulated, "simulated_spread": test.spread,
            "hang_drop_m": test.hang_drop,
            "strip_stretch_fraction": test.strip_stretch, "membrane_modulus_N_per_m": _modulus(garment, test),
            "hung_by": _held(garment, options), "simulations": test.simulations,
        },
        agrees=abs(test.simulated - test.stretch_fraction) <= 1e-3,
        record=record,
    )  # fmt: skip


def _hang_test(garment: Garment, l1: float, l2: float, held: str | None, tell: Tell) -> ShearCalibration:
    return calibrate_shear(
        garment.template,
        garment.keypoints,
        garment.layers,
        garment.material,
        l1,
        l2,
        held,
        garment.size_range,
        tell,
        garment.mesh_edge_m,
    )


def _held(garment: Garment, options: argparse.Namespace) -> str:
    return garment.keypoints[clip_and_lowest(garment.template, garment.keypoints, options.held)[0]]


def _modulus(garment: Garment, test: ShearCalibration) -> float:
    return membrane_modulus(replace(garment.material, stretch_fraction=test.strip_stretch), REFERENCE_DROP)


def _friction(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> _Result:
    height, length = options.height, options.length
    test = _tilt_test(garment, height, length, tell)
    degrees = math.degrees(test.angle)

    def record(path: Path) -> None:
        from cell.recording.rerun.material import record_friction

        record_friction(path, test)

    return _Result(
        values={"friction_angle_deg": {surface: round(degrees, 3)}},
        measured={f"friction_{surface}": _provenance(f"table {length:g} m long lifted by {height:g} m")},
        fields=("friction_static",),
        figures={
            "height_m": height, "length_m": length, "friction_angle_deg": degrees, "friction": test.coefficient,
            "simulated_friction": test.simulated, "simulated_error_rel": test.error,
        },
        agrees=test.agrees,
        record=record,
    )  # fmt: skip


def _tilt_test(garment: Garment, height: float, length: float, tell: Tell) -> FrictionCalibration:
    return calibrate_friction(garment.template, garment.layers, garment.material, height, length, tell)


def _bending(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> _Result:
    test = calibrate_bending(garment.material, options.overhang)

    def record(path: Path) -> None:
        from cell.recording.rerun.material import record_bending

        record_bending(path, test)

    fabric = replace(garment.material, bending_length=test.bending_length)
    return _Result(
        values={"bending_length": round(test.bending_length, 5)},
        measured={"bending_length": _provenance(f"overhang {options.overhang:g} m at 41.5 degrees")},
        fields=("bending_length",),
        figures={
            "overhang_m": options.overhang, "bending_length_m": test.bending_length,
            "flexural_rigidity_N_m": flexural_rigidity(fabric), "simulated_bending_length_m": test.simulated,
            "simulated_error_rel": test.error, "simulated_tip_angle_deg": math.degrees(test.angle),
        },
        agrees=test.agrees,
        record=record,
    )  # fmt: skip


MEASURE: Mapping[str, Callable[[Garment, argparse.Namespace, str, Tell], _Result]] = {
    "shear": _shear,
    "friction": _friction,
    "bending": _bending,
}


# the paper's table


def _paper(options: argparse.Namespace, surface: str, tell: Tell) -> int:
    """The paper's measurements, calibrated here: ours beside the paper's; with --output the garment files too."""
    names = options.garments or list(PAPER)
    if options.output is not None and not options.output.is_dir():
        raise ConfigurationError(f"cannot write into {options.output}: no such folder", "make it, or give another")
    for name in names:
        if name not in PAPER:
            raise ConfigurationError(f"the paper's table has no {name!r}", f"it has {', '.join(PAPER)}")
        if options.output is not None:
            _check_output(options.output / f"{name}.yaml", options.replace)
    rows = []
    for name in names:
        stretch, degrees, maya_shear, maya_friction = PAPER[name]
        garment = load_garment(name, surface)
        l2 = _laid_length(garment.template, clip_and_lowest(garment.template, garment.keypoints))
        hung = _hang_test(garment, l2 * (1.0 + 0.01 * stretch), l2, None, tell)
        tilt = _tilt_test(garment, math.sin(math.radians(degrees)), 1.0, tell)
        rows.append({
            "garment": name, "paper_stretch_percent": stretch, "simulated_stretch_percent": 100.0 * hung.simulated,
            "simulated_spread_percent": 100.0 * hung.spread,
            "hang_drop_m": hung.hang_drop, "membrane_modulus_N_per_m": _modulus(garment, hung),
            "paper_maya_shear_resistance": maya_shear, "paper_friction_angle_deg": degrees,
            "friction": tilt.coefficient, "simulated_friction": tilt.simulated,
            "paper_maya_friction": maya_friction,
        })  # fmt: skip
        if options.output is not None:
            _write_paper(options.output / f"{name}.yaml", name, surface, hung)
        tell(f"{name} done")
    if options.json:
        print_json({"calibration": "paper", "simulated": True, "garments": rows})
        return 0
    print_table(
        ("garment", "stretch %: paper", "simulated", "spread", "hang drop m", "membrane N/m", "Maya shear",
         "angle deg: paper", "friction tan", "simulated", "Maya"),
        [tuple(v if isinstance(v, str) else f"{v:.3g}" for v in row.values()) for row in rows],
    )  # fmt: skip
    return 0


def _write_paper(path: Path, name: str, surface: str, hung: ShearCalibration) -> None:
    text = shipped_garment_path(name).read_text(encoding="utf-8")
    values = {"hang_drop": round(hung.hang_drop, 3)}
    source = {"stretch_fraction": _provenance("Li et al. 2015, table of garments")}
    write_whole(path, with_material(text, name, values, source, (), surface).encode())


def _laid_length(template: Array, pair: tuple[int, int]) -> float:
    return math.dist(template[pair[0]], template[pair[1]])
