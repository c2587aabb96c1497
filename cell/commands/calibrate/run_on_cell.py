"""Common parts of the calibrations of the cell (table, camera, hand-eye, tactile): flags, the run, the file."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foldcell.calibration.effects import Procedure
from foldcell.cell.calibrating.session import CalibrationEnd, CalibrationRequest, calibrate
from foldcell.cell.commands.shared import (
    Commands,
    add_command,
    answer,
    cell_option,
    driver_option,
    logs_option,
    seed,
    teller,
)
from foldcell.cell.config.calibration_file import read_camera_file
from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.hardware.cell_check import refuse_unfit_cell
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.simulation import Truth
from foldcell.cell.support.files.paths import logs_directory, prepare_logs
from foldcell.cell.support.files.whole_file import refuse_foreign, write_whole
from foldcell.robots.errors import ConfigurationError

Provenance = dict[str, dict[str, Any]]
DATA_SHEET = "data sheet"


@dataclass(frozen=True)
class CellCalibration:
    """Describes one calibration of the cell.

    part: part of the calibration file that is measured. setting: key of cell.yaml that names the file. procedure:
    makes the procedure for a cell. figures: returns the reported figures of a result. error: returns the error of
    a result against the simulated truth, for the report only. text: returns the content of the file, with its
    provenance. warning: printed after the result.
    """

    part: str
    setting: str
    procedure: Callable[[Workcell], Procedure[Any]]
    figures: Callable[[Any], dict[str, Any]]
    error: Callable[[Any, Truth], dict[str, float]]
    text: Callable[[Any, Provenance], str]
    warning: str = ""


Choose = Callable[[argparse.Namespace, CellSettings], CellCalibration]


def add_action(actions: Commands, name: str, about: str, choose: Choose) -> argparse.ArgumentParser:
    """Add the command, with the flags that all calibrations of the cell have."""
    action = add_command(actions, name, about, lambda options: _run(options, name, choose))
    action.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of the simulated cell (0)")
    action.add_argument("--output", type=Path, metavar="FILE", help="file to write (in the run's folder)")
    cell_option(action)
    logs_option(action)
    driver_option(action)
    action.add_argument("--realtime", action="store_true", help="simulated time passes no faster than the clock")
    return action


def _run(options: argparse.Namespace, name: str, choose: Choose) -> int:
    settings = load_settings(options.cell)
    chosen = choose(options, settings)
    if options.output is not None:
        refuse_foreign(options.output, b"by: foldcell calibrate ")
    request = CalibrationRequest(
        name=f"calibrate-{name}",
        seed=options.seed,
        driver=options.driver,
        settings=settings,
        logs=prepare_logs(logs_directory(options.logs)),
        realtime=options.realtime,
        say=teller(options.json),
    )

    def figures(value: Any, truth: Truth | None) -> dict[str, Any]:
        error = {} if truth is None else chosen.error(value, truth)
        return {**chosen.figures(value), "simulated_truth": error or None}

    end = calibrate(request, chosen.procedure, figures)
    report: dict[str, Any] = {"calibration": name, "seed": options.seed, "driver": options.driver}
    report |= end.as_json()
    if end.value is not None:
        file = _write(options, name, chosen, end)
        warnings = filter(None, (chosen.warning, unfit_with(settings, chosen.setting, file)))
        report |= figures(end.value, end.truth) | {"warning": "; ".join(warnings) or None, "file": str(file)}
    return answer(options, report, _lines(chosen, end, report), end.exit_code)


def _write(options: argparse.Namespace, name: str, chosen: CellCalibration, end: CalibrationEnd[Any]) -> Path:
    path = options.output or end.run_dir / f"{name}.yaml"
    provenance = {
        "made": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "by": f"foldcell calibrate {name}",
        "run": end.run_id,
        "driver": options.driver,
        "simulated": end.simulated,
        "figures": chosen.figures(end.value),
    }
    write_whole(path, chosen.text(end.value, {chosen.part: provenance}).encode())
    return path.absolute()


def unfit_with(settings: CellSettings, setting: str, file: Path) -> str:
    """Return why every run would refuse the cell with this calibration file; empty if none would. setting: key of
    cell.yaml that names the file."""
    group, key = setting.split(".")
    field = "table_" if group == "table" else group
    changed = getattr(settings, field).model_copy(update={key: file})
    try:
        refuse_unfit_cell(settings.model_copy(update={field: changed}))
    except ConfigurationError as e:
        return f"with this file the cell is refused: {e.what}"
    return ""


def _lines(chosen: CellCalibration, end: CalibrationEnd[Any], report: Mapping[str, Any]) -> Iterator[str]:
    words = {"done": "done", "not_done": "NOT DONE (the cell is safe)", "fault": "FAULT"}
    yield f"\ncalibrate {report['calibration']}, seed {report['seed']}: {words[end.result]}"
    if end.failure:
        yield f"  {end.failure.what}\n  {end.failure.hint}"
    if end.value is not None:
        for name, value in chosen.figures(end.value).items():
            yield f"  {name:<28} {_shown(value)}"
        for name, value in (report["simulated_truth"] or {}).items():
            yield f"  simulated truth: {name:<11} {_shown(value)}"
        yield f"  file  {report['file']}"
        group, key = chosen.setting.split(".")
        yield f"  next: in cell.yaml, {group}: {{{key}: {report['file']}}}"
        if report["warning"]:
            yield f"  warning: {report['warning']}"
    yield f"  robot time {end.robot_time_s:.1f} s, wall time {end.wall_time_s:.1f} s"
    yield f"  run   {end.run_dir}"


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value + 0.0:.6g}"  # avoids -0
    if isinstance(value, list | tuple):
        return ", ".join(_shown(v) for v in value)
    return str(value)


def camera_provenance(settings: CellSettings) -> Provenance:
    """Return the provenance of each part of the present camera calibration; empty for a file without
    provenance."""
    shipped: Provenance = {"intrinsics": {"by": DATA_SHEET}, "pose": {"by": "drawing of the bracket"}}
    if settings.camera.calibration is None:
        return shipped
    from_file = read_camera_file(settings.camera.calibration).provenance
    return shipped | {part: dict(notes) for part, notes in from_file.items()} if from_file else {}


def mm(metres: float) -> float:
    return round(1e3 * metres, 4)
