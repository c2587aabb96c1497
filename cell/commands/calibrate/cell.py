"""`foldcell calibrate table|camera|hand-eye|tactile`: measure what the cell has to know of itself."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from calibration.camera import CameraSettings, IntrinsicsCalibration, calibrate_camera
from calibration.effects import Procedure
from calibration.hand_eye import HandEyeCalibration, HandEyeSettings, calibrate_hand_eye
from calibration.table import TableCalibration, TableSettings, calibrate_table
from calibration.tactile import TactileCalibration, calibrate_tactile
from cell.calibrating.score import hand_eye_error, intrinsics_error, table_error, tactile_error
from cell.calibrating.session import CalibrationEnd, CalibrationRequest, calibrate
from cell.commands.options import (
    Commands,
    add_command,
    cell_option,
    count,
    driver_option,
    json_option,
    logs_option,
    seed,
)
from cell.commands.output import print_json, progress_stream
from cell.config.calibration_file import calibration_text, read_camera_file, table_text, tactile_text
from cell.config.cell_settings import CellSettings, load_settings
from cell.hardware.camera import camera_calibration
from cell.hardware.workcell import Workcell
from cell.simulation import Truth
from cell.support.files.paths import logs_directory, prepare_logs
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError
from skills.vocabulary import Array

__all__ = ["add_actions", "run"]

Provenance = dict[str, dict[str, Any]]
DATA_SHEET = "data sheet"
DOUBTFUL_LENS = (
    "the lens is the data sheet's and the pose takes up its error. For a sure one run foldcell calibrate camera,"
    " name its file in cell.yaml, and run this again"
)
S = TypeVar("S")


@dataclass(frozen=True)
class _Calibration:
    """procedure: for a cell. figures: what is reported of its value. error: against the simulated truth, for
    the record only. text: of the file, with its provenance. setting: the key of cell.yaml that names the file."""

    part: str
    setting: str
    procedure: Callable[[Workcell], Procedure[Any]]
    figures: Callable[[Any], dict[str, Any]]
    error: Callable[[Any, Truth], dict[str, float]]
    text: Callable[[Any, Provenance], str]
    warning: str = ""


def add_actions(actions: Commands) -> None:
    def add(name: str, about: str) -> argparse.ArgumentParser:
        action = add_command(actions, name, about, run)
        action.set_defaults(action=name)
        action.add_argument("--seed", type=seed, default=0, metavar="N", help="of the simulated cell (0)")
        action.add_argument("--output", type=Path, metavar="FILE", help="where to write (in the run's folder)")
        cell_option(action)
        logs_option(action)
        json_option(action)
        return action

    def of_cell(name: str, about: str) -> argparse.ArgumentParser:
        action = add(name, about)
        driver_option(action)
        action.add_argument(
            "--realtime", action="store_true", help="simulated time passes no faster than the clock"
        )
        return action

    table = of_cell("table", "the table's height, touched off by both hands")
    table.add_argument("--points", type=count, default=8, metavar="N", help="where it is touched, 3 to 10 (8)")
    camera = of_cell("camera", "the camera's focal lengths and centre, from views of the calibration board")
    camera.add_argument("--views", type=count, default=20, metavar="N", help="pictures that show the board (20)")
    eye = of_cell("hand-eye", "where the camera hangs, from views of the calibration board in each hand")
    eye.add_argument(
        "--views", type=count, default=12, metavar="N", help="pictures with the board in each hand (12)"
    )
    of_cell("tactile", "the fingers' noise, drift and thresholds")


def run(options: argparse.Namespace) -> int:
    settings = load_settings(options.cell)
    chosen = CALIBRATIONS[options.action](options, settings)
    if options.output is not None:
        _check_output(options.output)
    stream = progress_stream(options.json)
    request = CalibrationRequest(
        name=options.action,
        seed=options.seed,
        driver=options.driver,
        settings=settings,
        logs=prepare_logs(logs_directory(options.logs)),
        realtime=options.realtime,
        say=lambda text: print(text, file=stream, flush=True),
    )

    def figures(value: Any, truth: Truth | None) -> dict[str, Any]:
        error = {} if truth is None else chosen.error(value, truth)
        return {**chosen.figures(value), "simulated_truth": error or None}

    end = calibrate(request, chosen.procedure, figures)
    report: dict[str, Any] = {"calibration": options.action, "seed": options.seed, "driver": options.driver}
    report |= end.as_json()
    if end.value is not None:
        report |= figures(end.value, end.truth) | {"warning": chosen.warning or None}
        report["file"] = str(_write(options, chosen, end, report))
    if options.json:
        print_json(report)
    else:
        _summary(chosen, end, report)
    return end.exit_code


def _check_output(path: Path) -> None:
    """Before anything moves."""
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise ConfigurationError(
            f"cannot write {path}: no such folder", "give --output a file in a folder that exists"
        )


def _write(
    options: argparse.Namespace, chosen: _Calibration, end: CalibrationEnd[Any], report: Mapping[str, Any]
) -> Path:
    path = options.output or end.run_dir / f"{options.action}.yaml"
    told = {
        "made": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "by": f"foldcell calibrate {options.action}",
        "run": end.run_id,
        "driver": options.driver,
        "simulated": end.simulated,
        "figures": chosen.figures(end.value),
    }
    write_whole(path, chosen.text(end.value, {chosen.part: told}).encode())
    return path.absolute()


def _summary(chosen: _Calibration, end: CalibrationEnd[Any], report: Mapping[str, Any]) -> None:
    words = {"done": "done", "not_done": "NOT DONE (the cell is safe)", "fault": "FAULT"}
    print(f"\ncalibrate {report['calibration']}, seed {report['seed']}: {words[end.result]}")
    if end.failure:
        print(f"  {end.failure.what}\n  {end.failure.hint}")
    if end.value is not None:
        for name, value in chosen.figures(end.value).items():
            print(f"  {name:<28} {_shown(value)}")
        for name, value in (report["simulated_truth"] or {}).items():
            print(f"  simulated truth: {name:<11} {_shown(value)}")
        print(f"  file  {report['file']}")
        print(f"  next: in cell.yaml, {_named(chosen.setting, report['file'])}")
        if chosen.warning:
            print(f"  mind: {chosen.warning}")
    print(f"  robot time {end.robot_time_s:.1f} s, wall time {end.wall_time_s:.1f} s")
    print(f"  run   {end.run_dir}")


def _named(setting: str, path: str) -> str:
    """A file as it stands in cell.yaml."""
    group, key = setting.split(".")
    return f"{group}: {{{key}: {path}}}"


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value + 0.0:.6g}"  # no -0
    if isinstance(value, list | tuple):
        return ", ".join(_shown(v) for v in value)
    return str(value)


# what each of them measures


def _table(options: argparse.Namespace, settings: CellSettings) -> _Calibration:
    wanted = _settings(TableSettings, points=options.points)

    def figures(c: TableCalibration) -> dict[str, Any]:
        rms, differ = c.residual_rms, c.arms_differ
        return {
            "height_m": round(c.height, 6),
            "change_mm": _mm(c.height - settings.table.height),
            "tilt_x_deg": round(float(np.rad2deg(c.tilt_x)), 4),
            "tilt_y_deg": round(float(np.rad2deg(c.tilt_y)), 4),
            "points": len(c.points),
            "residual_rms_mm": None if rms is None else _mm(rms),
            "residual_max_mm": _mm(float(np.abs(c.residual).max())),
            "arms_differ_mm": None if differ is None else _mm(differ),
        }

    return _Calibration(
        part="height",
        setting="table.calibration",
        procedure=lambda cell: calibrate_table(cell.table, wanted),
        figures=figures,
        error=table_error,
        text=lambda c, provenance: table_text(c.height, provenance),
    )


def _mm(metres: float) -> float:
    return round(1e3 * metres, 4)


def _deg(radians: float) -> float:
    return round(float(np.rad2deg(radians)), 4)


def _camera(options: argparse.Namespace, settings: CellSettings) -> _Calibration:
    wanted = _settings(CameraSettings, views=options.views)
    believed, told = camera_calibration(settings), _camera_provenance(settings)

    def figures(c: IntrinsicsCalibration) -> dict[str, Any]:
        i, before = c.intrinsics, believed.intrinsics
        names = ("fx", "fy", "cx", "cy")
        return {
            **{f"{name}_px": round(getattr(i, name), 4) for name in names},
            **{f"{name}_sigma_px": round(s, 4) for name, s in zip(names, c.sigma, strict=True)},
            **{f"{name}_change_px": round(getattr(i, name) - getattr(before, name), 4) for name in names},
            "reprojection_rms_px": round(c.rms, 4),
            "reprojection_worst_view_px": round(c.worst_view, 4),
            "distortion_px": round(c.distortion, 4),
            "views": c.views,
            "corners": c.corners,
            "coverage": round(c.coverage, 3),
        }

    def text(c: IntrinsicsCalibration, provenance: Provenance) -> str:
        """The pose stays as it was believed to be: hand-eye measures it."""
        pose = replace(believed, intrinsics=c.intrinsics)
        return calibration_text(pose, settings.table.height, told | provenance)

    return _Calibration(
        part="intrinsics",
        setting="camera.calibration",
        procedure=lambda cell: calibrate_camera(wanted),
        figures=figures,
        error=intrinsics_error,
        text=text,
    )


def _hand_eye(options: argparse.Namespace, settings: CellSettings) -> _Calibration:
    believed, table, told = camera_calibration(settings), settings.table, _camera_provenance(settings)
    measured = told.get("intrinsics", {}).get("by") != DATA_SHEET
    kind = HandEyeSettings if measured else HandEyeSettings.with_lens_of_data_sheet
    wanted = _settings(kind, views=options.views)

    def pose(c: HandEyeCalibration) -> Array:
        return np.asarray(np.linalg.inv(table.T_base_table) @ c.T_base_camera)

    def figures(c: HandEyeCalibration) -> dict[str, Any]:
        change = np.linalg.inv(believed.T_table_camera) @ pose(c)
        return {
            "position_m": [round(float(v), 5) for v in c.T_base_camera[:3, 3]],
            "change_mm": _mm(float(np.linalg.norm(change[:3, 3]))),
            "change_deg": _deg(float(np.arccos(np.clip(0.5 * (np.trace(change[:3, :3]) - 1.0), -1.0, 1.0)))),
            "reprojection_rms_px": round(c.rms, 4),
            "residual_mm": _mm(c.position),
            "residual_deg": _deg(c.angle),
            "position_sigma_mm": _mm(c.position_sigma),
            "angle_sigma_deg": _deg(c.angle_sigma),
            "views": c.views,
            "intrinsics_by": told.get("intrinsics", {}).get("by", "a file that does not say"),
        }

    return _Calibration(
        part="pose",
        setting="camera.calibration",
        procedure=lambda cell: calibrate_hand_eye(cell.robot, cell.calibration, cell.table, wanted),
        figures=figures,
        error=lambda c, truth: hand_eye_error(c, believed.intrinsics, table, truth),
        text=lambda c, provenance: calibration_text(
            replace(believed, T_table_camera=pose(c)), table.height, told | provenance
        ),
        warning="" if measured else DOUBTFUL_LENS,
    )


def _tactile(options: argparse.Namespace, settings: CellSettings) -> _Calibration:
    def figures(c: TactileCalibration) -> dict[str, Any]:
        out: dict[str, Any] = {"contact_force_n": c.contact_force, "held_force_n": c.held_force}
        for side, f in c.figures.items():
            for name in ("cell_noise", "pad_noise", "tip_noise", "pad_drift", "tip_drift"):
                out[f"{side}_{name}_n"] = round(getattr(f, name), 4)
            out[f"{side}_rate_hz"] = round(f.rate, 2)
            out[f"{side}_stiffness_n_per_m"] = round(c.stiffness[side], 1)
            out[f"{side}_noticed_mm"] = _mm(c.noticed[side])
        return out | {"false_contacts": c.false_contacts, "zeros": c.zeros}

    return _Calibration(
        part="thresholds",
        setting="grasp.calibration",
        procedure=lambda cell: calibrate_tactile(cell.table, cell.grasp),
        figures=figures,
        error=tactile_error,
        text=lambda c, provenance: tactile_text(
            {"contact_force": c.contact_force, "held_force": c.held_force}, provenance
        ),
    )


def _camera_provenance(settings: CellSettings) -> Provenance:
    """Of the parts of the camera's calibration as they are believed now."""
    told: Provenance = {"intrinsics": {"by": DATA_SHEET}, "pose": {"by": "drawing of the bracket"}}
    if settings.camera.calibration is None:
        return told
    kept = read_camera_file(settings.camera.calibration).provenance
    return told | {part: dict(notes) for part, notes in kept.items()} if kept else {}


def _settings(kind: Callable[..., S], **values: Any) -> S:
    """A procedure's settings; what it refuses is a wrong argument."""
    try:
        return kind(**values)
    except ValueError as e:
        raise ConfigurationError(str(e), "see foldcell calibrate --help") from e


CALIBRATIONS: Mapping[str, Callable[[argparse.Namespace, CellSettings], _Calibration]] = {
    "table": _table,
    "camera": _camera,
    "hand-eye": _hand_eye,
    "tactile": _tactile,
}
