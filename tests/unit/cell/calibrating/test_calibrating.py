"""Calibration commands with the simulated cell: results against the ground truth, files, refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from foldcell.calibration.effects import Grip, Reach, RecordTactile, Touch
from foldcell.calibration.table import calibrate_table
from foldcell.cell.calibrating import session
from foldcell.cell.calibrating.reach import holding_board
from foldcell.cell.calibrating.session import CalibrationRequest, calibrate
from foldcell.cell.commands.main import main
from foldcell.cell.config.calibration_file import (
    calibration_text,
    load_camera_calibration,
    read_camera_file,
    table_text,
    tactile_text,
)
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.hardware.assembly import assemble
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.journal.journal import Journal, RunJournal, performed
from foldcell.cell.support.files.paths import journal_path
from foldcell.robots.errors import ConfigurationError, FailureKind
from foldcell.robots.ports import Arms, JointSetpoint, JointState, Ports, Side, arm_slice
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.vocabulary import Table

SetPoint = tuple[np.ndarray, np.ndarray]
"""Joint positions (14,) [rad] and velocities (14,) [rad/s]."""


class ObservedArms:
    """Arms that note every set-point before they pass it on."""

    def __init__(self, arms: Arms, noted: list[SetPoint]) -> None:
        self._arms, self._noted = arms, noted
        self.command_timeout = arms.command_timeout

    def state(self) -> JointState:
        return self._arms.state()

    def enable(self) -> None:
        self._arms.enable()

    def command(self, q: np.ndarray, qd: np.ndarray) -> JointSetpoint:
        self._noted.append((np.array(q), np.array(qd)))
        return self._arms.command(q, qd)


@pytest.fixture
def set_points(monkeypatch: pytest.MonkeyPatch) -> list[SetPoint]:
    """All set-points that the arms get."""
    noted: list[SetPoint] = []

    def observed(request: Any, robot: Any, ports: Ports, *others: Any) -> Workcell:
        return assemble(request, robot, replace(ports, arms=ObservedArms(ports.arms, noted)), *others)

    monkeypatch.setattr(session, "assemble", observed)
    return noted


def foldcell(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any], str]:
    code = main([str(a) for a in (*arguments, "--json")])
    out, err = capsys.readouterr()
    return code, json.loads(out.splitlines()[-1]), err


def test_the_table_is_found_to_a_millimetre_and_the_settings_read_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], set_points: list[SetPoint]
) -> None:
    code, report, err = foldcell(capsys, "calibrate", "table", "--seed", 3, "--points", 3, "--logs", tmp_path)
    assert code == 0 and report["result"] == "done" and "point 3 of 3" in err
    assert abs(report["simulated_truth"]["height_error_mm"]) < 1.5 < abs(report["change_mm"])

    acceleration = np.abs(np.diff([q for q, _ in set_points], n=2, axis=0)).max(axis=0) / TICK_S**2
    assert (acceleration <= load_robot(load_settings()).planning.acceleration).all(), "no set-point jumps"

    (tmp_path / "cell.yaml").write_text(f"table: {{calibration: {report['file']}}}\n")
    settings = load_settings(tmp_path / "cell.yaml")
    assert settings.table.height == pytest.approx(report["height_m"], abs=1e-6)
    assert settings.drawn_table.height == -0.10 and settings.calibrated
    origin = yaml.safe_load(Path(report["file"]).read_text())["provenance"]["height"]
    assert origin["simulated"] is True and origin["figures"]["points"] == 3 and origin["run"] in report["run_dir"]

    with Journal.open(journal_path(tmp_path), readonly=True) as journal:
        run = journal.run("last")
        assert run.result == "done" and run.summary["points"] == 3
        effects = performed(journal.entries(run.id))
    assert [e.name for e in effects] == ["prepare", "touch", "touch", "touch", "make_safe"]
    assert all(e.result is not None for e in effects)


@pytest.mark.parametrize(("believed", "kind"), [(-0.055, "no_contact"), (-0.145, "low_confidence")])
def test_calibrating_a_missing_table_ends_safely_and_writes_nothing(
    believed: float, kind: str, tmp_path: Path, capsys
) -> None:
    (tmp_path / "table.yaml").write_text(table_text(believed))
    cell, logs, out = tmp_path / "cell.yaml", tmp_path / "logs", tmp_path / "found.yaml"
    cell.write_text("table: {calibration: table.yaml}\n")
    code, report, _ = foldcell(capsys, "calibrate", "table", "--cell", cell, "--logs", logs, "--output", out)
    assert code == 2 and report["failure"]["kind"] == kind
    assert f"correct `height: {believed}` in {tmp_path / 'table.yaml'}" in report["failure"]["hint"], "in force"
    assert not out.exists() and "file" not in report


def test_a_stop_ends_a_calibration_immediately(tmp_path: Path) -> None:
    held: list[Ports] = []

    def say(text: str) -> None:
        if "point 1" in text:
            held[0].ports.stop.trigger("a test")

    request = CalibrationRequest("table", 0, "sim", load_settings(), tmp_path, False, say)
    end = calibrate(request, lambda cell: calibrate_table(cell.table, 3), lambda c, t: {}, held.append)
    assert end.value is None and end.failure and end.failure.kind is FailureKind.STOPPED
    assert end.result == "not_done" and end.safe and end.exit_code == 2
    with Journal.open(journal_path(tmp_path), readonly=True) as journal:
        last = performed(journal.entries(journal.run("last").id))[-1]
    assert last.name == "make_safe" and last.result and last.result.payload["event"] == "held"


def test_a_procedure_gets_refused_plans_and_no_other_failures(tmp_path: Path) -> None:
    asked: list[object] = []

    def stubborn(_: object):  # type: ignore[no-untyped-def]
        far = np.eye(4)
        far[:3, 3] = 5.0, 0.0, 0.0
        asked.append((yield Reach(Side.LEFT, far)).failure.kind)
        asked.append((yield Touch(Side.LEFT, 0.55, 0.25, search=0.002)))
        asked.append((yield RecordTactile(1.0)))

    (tmp_path / "table.yaml").write_text(table_text(-0.055))
    (tmp_path / "cell.yaml").write_text("table: {calibration: table.yaml}\n")
    settings = load_settings(tmp_path / "cell.yaml")
    request = CalibrationRequest("table", 0, "sim", settings, tmp_path, False, lambda text: None)
    end = calibrate(request, stubborn, lambda c, t: {})
    assert asked == [FailureKind.UNREACHABLE] and end.failure and end.failure.kind is FailureKind.NO_CONTACT
    assert end.safe and end.exit_code == 2


def test_a_procedure_that_breaks_leaves_the_cell_safe(tmp_path: Path) -> None:
    def broken(_: object):  # type: ignore[no-untyped-def]
        yield Grip(Side.LEFT, 0.0, 5.0)
        raise ZeroDivisionError("a bug")

    request = CalibrationRequest("table", 0, "sim", load_settings(), tmp_path, False, lambda text: None)
    end = calibrate(request, broken, lambda c, t: {})
    assert end.failure and end.failure.kind is FailureKind.SKILL_CRASHED and "a bug" in end.failure.what
    assert end.result == "fault" and end.exit_code == 3 and end.safe
    with Journal.open(journal_path(tmp_path), readonly=True) as journal:
        run = journal.run("last")
        effects = performed(journal.entries(run.id))
        assert [e.name for e in effects if e.result] == ["prepare", "grip", "make_safe"]


def test_losing_the_journal_ends_a_calibration_with_the_arms_held(
    tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch, set_points: list[SetPoint]
) -> None:
    """The exit code is 3 and not 64, because the arms have moved. The journal cannot record the first touch. After
    that, the arms get only the set-point that holds them."""
    opened, write_intent, journals = Journal.open, RunJournal.intent, []

    def keep(path: Path) -> Journal:
        journals.append(opened(path))
        return journals[-1]

    def intent(run: RunJournal, t: float, state: str, effect: str, payload: Any = None) -> int:
        if effect == "touch":
            journals[0]._connection.execute("PRAGMA query_only = ON")
            set_points.clear()
        return write_intent(run, t, state, effect, payload)

    monkeypatch.setattr(RunJournal, "intent", intent)
    monkeypatch.setattr("foldcell.cell.runs.ownership.Journal.open", keep)
    code, report, err = foldcell(capsys, "calibrate", "table", "--points", 3, "--logs", tmp_path)
    assert code == 3 and "held where they are" in report["hint"] and "journal.db" in err
    assert len(set_points) == 1 and not np.any(set_points[0][1])
    monkeypatch.undo()
    with Journal.open(journal_path(tmp_path), readonly=True) as kept:
        assert kept.run("last").status == "interrupted"


def test_the_lens_is_calibrated_first_and_then_the_camera_pose(tmp_path: Path, capsys) -> None:
    """The second calibration reads the file of the first one. Both results are nearer to the truth than the
    nominal values."""
    cell, lens, eye = (tmp_path / name for name in ("cell.yaml", "lens.yaml", "eye.yaml"))
    common = ("--seed", 2, "--logs", tmp_path / "logs")
    code, report, _ = foldcell(capsys, "calibrate", "camera", "--views", 6, *common, "--output", lens)
    assert code == 0 and report["reprojection_rms_px"] < 0.3
    assert report["simulated_truth"]["corner_error_px"] < 5.0
    assert len(list(Path(report["run_dir"]).glob("board-*.png"))) >= 6

    cell.write_text("camera: {calibration: lens.yaml}\n")
    code, report, _ = foldcell(
        capsys, "calibrate", "hand-eye", "--views", 4, *common, "--cell", cell, "--output", eye
    )
    assert code == 0 and report["intrinsics_by"] == "foldcell calibrate camera" and report["views"] == 8
    assert (
        report["simulated_truth"]["camera_error_mm"] < 5.0 and report["simulated_truth"]["camera_error_deg"] < 0.25
    )
    file = read_camera_file(eye)
    before = read_camera_file(lens).calibration.intrinsics
    assert (file.calibration.intrinsics.matrix == before.matrix).all()
    assert file.provenance["pose"]["figures"]["residual_mm"] > 0 and set(file.provenance) == {"intrinsics", "pose"}


@pytest.mark.parametrize(
    ("line", "word"),
    [
        (("table", "--points", 2), "3 to"),
        (("table", "--points", 99), "3 to"),
        (("camera", "--views", 2), "views"),
        (("hand-eye", "--views", 1), "views"),
        (("tactile", "--output", "no/such/folder/file.yaml"), "no such folder"),
    ],
)
def test_bad_arguments_are_refused_before_anything_moves(line: tuple, word: str, tmp_path: Path, capsys) -> None:
    code, report, _ = foldcell(capsys, "calibrate", *line, "--logs", tmp_path / "logs")
    assert code == 64 and word in report["error"] and report["hint"]
    assert not (tmp_path / "logs").exists()


# calibration files


def test_a_camera_file_follows_the_table_to_its_new_height(tmp_path: Path) -> None:
    """In the base frame the camera's place does not change with the measured height of the table."""
    nominal = camera_calibration(load_settings())
    path = tmp_path / "camera.yaml"
    path.write_text(calibration_text(nominal, table_height=-0.10))
    low = Table(-0.13, (0.2, 1.1), (-0.75, 0.75))
    moved = load_camera_calibration(path, low)
    assert low.T_base_table @ moved.T_table_camera == pytest.approx(
        load_settings().table.T_base_table @ nominal.T_table_camera
    )
    path.write_text(calibration_text(nominal))  # an older file does not state the table's height
    assert load_camera_calibration(path, low).T_table_camera == pytest.approx(nominal.T_table_camera)


def test_tactile_thresholds_replace_those_of_the_settings(tmp_path: Path) -> None:
    (tmp_path / "tactile.yaml").write_text(tactile_text({"contact_force": 0.41, "held_force": 0.52}))
    (tmp_path / "cell.yaml").write_text("grasp: {calibration: tactile.yaml, grip_force: 12.0}\n")
    grasp = load_settings(tmp_path / "cell.yaml").grasp.calibrated()
    assert (grasp.contact_force, grasp.held_force, grasp.grip_force) == (0.41, 0.52, 12.0)


@pytest.mark.parametrize(
    ("group", "text"),
    [
        ("table", table_text(-0.1).replace("table", "tactile")),
        ("table", table_text(-0.1).replace("-0.1", "-100.0")),
        ("table", table_text(-0.1) + "tilt: 0.1\n"),
        ("grasp", tactile_text({"contact_force": 0.4, "held_force": 0.5}).replace("0.4", "-0.4")),
        ("grasp", tactile_text({"contact_force": 0.4})),
        ("camera", table_text(-0.1)),
    ],
)
def test_other_files_are_refused_as_calibrations(group: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "found.yaml").write_text(text)
    (tmp_path / "cell.yaml").write_text(f"{group}:\n  calibration: found.yaml\n")
    with pytest.raises(ConfigurationError, match=rf"cell\.yaml:2: {group}\.calibration.*found\.yaml"):
        load_settings(tmp_path / "cell.yaml")


# a board in a hand


def test_motion_plans_include_a_board_in_the_hand() -> None:
    """A pose that is free for the bare hand is refused if the card would go through the table."""
    settings = load_settings()
    robot = load_robot(settings)
    bare = CollisionChecker(robot, settings.table)
    holding = holding_board(robot, Side.LEFT)
    with_card = CollisionChecker(holding, settings.table)
    assert len(holding.collision_model.collisionPairs) > len(robot.collision_model.collisionPairs)
    T = np.eye(4)  # the hand points forwards and down, so the card reaches 0.2 m beyond the tips
    T[:3, :3] = np.column_stack(([0.0, 1.0, 0.0], [0.6, 0.0, 0.8], [0.8, 0.0, -0.6]))
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    seeds = np.random.default_rng(7).uniform(robot.planning.lower[:7], robot.planning.upper[:7], (12, 7))
    seen = set()
    for height in (0.30, 0.02):
        T[:3, 3] = 0.55, 0.25, height
        for q7 in ik.solve_seeds(robot, Side.LEFT, T, seeds):
            q = np.array(robot.q_park)
            q[arm_slice(Side.LEFT, 14)] = q7
            if bare.contact(q) is None:
                contact = with_card.contact(q)
                seen.add((height, None if contact is None else str(contact)))
    assert (0.30, None) in seen and (0.02, "board - table") in seen
