"""The command line: names, exit codes, messages and the last JSON line. The run itself is a fake."""

import errno
import io
import json
import os
import subprocess
import sys
import time
import types
from argparse import ArgumentParser, _SubParsersAction
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from foldcell.cell.commands.main import build_parser, main
from foldcell.cell.journal.journal import Journal
from foldcell.cell.record.run_record import FailureRecord, FoldRecord, IdealRecord, RecordingLosses, RunRecord
from foldcell.cell.states.transition_table import State
from foldcell.robots.errors import ConfigurationError, DriverError, FailureKind, InternalError, StorageError
from tests.builders.records import run_record, score_record
from tests.inspections import a_claim

HALF = FoldRecord(
    "half", done=True, accepted=True, source="library", observed_iou=0.93, observed_height_m=0.0182,
    pressed_from_m=(0.0265,), attempts=1,
)  # fmt: skip
SCORE = score_record(iou=0.95, correspondence_m=0.004, edges_m=0.01, drift_m=0.02, height_m=0.012)
FOLDED = run_record(steps=(HALF,), score=SCORE, robot_time_s=61.5, run_dir="/logs/run")


@dataclass(frozen=True)
class Request:
    garment: str
    seed: int
    driver: str
    settings: Any
    logs: Path
    live: bool
    approve: bool
    realtime: bool
    world: str
    quiet: bool
    page: bool = False
    page_port: int = 0
    page_origin: str = ""


class FakeRun:
    """Replaces foldcell.cell.runs.fold_run: records the requests and returns or raises the given answer."""

    def __init__(self) -> None:
        self.requests: list[Request] = []
        self.answer: RunRecord | BaseException = FOLDED

    def fold_once(self, request: Request) -> RunRecord:
        self.requests.append(request)
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> FakeRun:
    run = FakeRun()
    module = types.ModuleType("foldcell.cell.runs.fold_run")
    module.FoldRequest = Request  # type: ignore[attr-defined]
    module.fold_once = run.fold_once  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "foldcell.cell.runs.fold_run", module)
    monkeypatch.setenv("FOLDCELL_LOGS", str(tmp_path / "logs"))
    return run


def last_json(text: str) -> dict[str, Any]:
    value = json.loads(text.rstrip("\n").split("\n")[-1])
    assert isinstance(value, dict)
    return value


# the command line itself


def nested(parser: ArgumentParser) -> dict[str, ArgumentParser]:
    """The parsers of a command's subcommands, by name."""
    groups = [a.choices for a in parser._actions if isinstance(a, _SubParsersAction)]
    return dict(groups[0]) if groups else {}


def test_help_names_every_command() -> None:
    answer = subprocess.run(
        [sys.executable, "-m", "foldcell.cell.commands.main", "--help"], capture_output=True, text=True
    )
    assert answer.returncode == 0
    commands = nested(build_parser())
    assert {"fold", "supervise", "doctor"} <= commands.keys()
    for name in commands:
        assert f"\n    {name}" in answer.stdout


def test_help_imports_nothing_heavy() -> None:
    script = (
        "from foldcell.cell.commands.main import main; main(['--help']); "
        "import sys; print(*sys.modules, file=sys.stderr)"
    )
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True).stderr.split()
    assert {"numpy", "pydantic", "cv2", "numba", "rerun", "sqlite3"}.isdisjoint(loaded)


@pytest.mark.parametrize(
    "line",
    ["garment list", "runs", "report last", "fold --help", "supervise --help", "resume --help", "doctor --help"],
)
def test_commands_that_only_read_load_no_numerical_package(line: str, journal_file: Path) -> None:
    """They answer at once. Loading one of these packages takes longer than all the rest of such a command."""
    script = (
        "import sys; from foldcell.cell.commands.main import main; "
        "main(sys.argv[1:]); print(*sys.modules, file=sys.stderr)"
    )
    logs = [] if "--help" in line or line.startswith("garment") else ["--logs", str(journal_file)]
    answer = subprocess.run([sys.executable, "-c", script, *line.split(), *logs], capture_output=True, text=True)
    loaded = answer.stderr.split()
    assert "argparse" in loaded and answer.stdout
    assert {"cv2", "scipy", "numba", "pinocchio", "coal", "pybullet", "rerun", "toppra"}.isdisjoint(loaded)


@pytest.mark.parametrize(
    "line",
    [
        "",
        "dance",
        "fold",
        "fold medium_towel --sed 3",
        "fold medium_towel --seed -1",
        "fold medium_towel --seed three",
        "fold medium_towel --seed 99999999999",
        "fold medium_towel --logs=",
        "fold medium_towel --driver pr2",
        "fold medium_towel large_towel",
        "trials --n 0",
        "garment",
        "garment check",
        "report",
        "runs --last none",
    ],
)
def test_a_bad_command_line_is_a_usage_error(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 64
    captured = capsys.readouterr()
    assert "foldcell" in captured.err and "Traceback" not in captured.err


def test_a_bad_command_line_with_json_still_ends_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fold", "--json"]) == 64
    assert last_json(capsys.readouterr().out)["exit_code"] == 64


def test_every_command_and_subcommand_can_be_called() -> None:
    parsers = list(nested(build_parser()).values())
    while parsers:
        parser = parsers.pop()
        parsers.extend(nested(parser).values())
        assert nested(parser) or callable(parser.get_default("run")), parser.prog


# fold and supervise


def test_fold_passes_its_options_to_the_run(fake: FakeRun, tmp_path: Path) -> None:
    settings = tmp_path / "cell.yaml"
    settings.write_text("motion: {velocity_scale: 0.5}")
    line = f"fold medium_towel --seed 7 --cell {settings} --logs {tmp_path / 'here'} --live --realtime --json"
    assert main(line.split()) == 0
    (request,) = fake.requests
    assert (request.garment, request.seed, request.driver, request.world) == ("medium_towel", 7, "sim", "xpbd")
    assert request.settings.motion.velocity_scale == 0.5
    assert request.logs == tmp_path / "here" and request.logs.is_dir()
    assert request.live and request.realtime and not request.approve and request.quiet


def test_supervise_is_fold_with_approval_in_real_time(fake: FakeRun) -> None:
    assert main(["supervise", "medium_towel"]) == 0
    (request,) = fake.requests
    assert request.approve and request.realtime and request.page and not request.quiet
    main(["fold", "medium_towel", "--approve", "--realtime"])
    main(["supervise", "medium_towel", "--no-page"])
    for other in fake.requests[1:]:
        assert other == replace(request, settings=other.settings, page=False)
    main(["supervise", "medium_towel", "--page-port", "8080"])
    assert fake.requests[-1].page_port == 8080
    assert main(["supervise", "medium_towel", "--page-port", "80"]) == 64


def test_json_is_the_last_line(fake: FakeRun, capsys: pytest.CaptureFixture[str]) -> None:
    main(["fold", "medium_towel", "--json"])
    assert last_json(capsys.readouterr().out) == FOLDED.as_json()


def test_the_summary_names_the_run_folder(fake: FakeRun, capsys: pytest.CaptureFixture[str]) -> None:
    main(["fold", "medium_towel"])
    text = capsys.readouterr().out
    for part in ("folded", "simulated", "0.950", "61.5 s", "/logs/run/report.html", "/logs/run/run.rrd"):
        assert part in text
    assert "half: library, observed overlap 0.930, 18 mm high, pressed from 26 mm" in text


@pytest.mark.parametrize("there", [True, False])
def test_the_summary_names_gaps_of_the_recording(
    fake: FakeRun, capsys: pytest.CaptureFixture[str], tmp_path: Path, there: bool
) -> None:
    """The recording's place is printed only if the recording exists."""
    if there:
        (tmp_path / "run.rrd").touch()
    lost = RecordingLosses(dropped=7, errors=("the transcript ends early: disk full",))
    fake.answer = replace(FOLDED, recording=lost, run_dir=str(tmp_path))
    main(["fold", "medium_towel"])
    text = capsys.readouterr().out
    assert "not kept   the transcript ends early: disk full" in text
    assert "not kept   7 entries of the recording" in text
    assert ("run.rrd   (incomplete; foldcell replay last --logs" in text) is there and ("run.rrd" in text) is there


def test_the_summary_names_the_figure_beyond_its_limit(fake: FakeRun, capsys: pytest.CaptureFixture[str]) -> None:
    limits = {"iou": 0.9, "edges_m": 0.03, "height_m": 0.0195, "drift_rad": 0.1745}
    score = score_record(limits, passed=False, iou=0.95, edges_m=0.01, height_m=0.0241, drift_rad=0.2)
    fake.answer = replace(FOLDED, score=score)
    main(["fold", "vest"])
    missed = "not passed (height 24.1 mm, limit 19.5 mm; turn 11.5°, limit 10.0°), IoU 0.950"
    assert missed in capsys.readouterr().out


def test_the_score_of_an_unfinished_garment_says_which_folds_are_missing(
    fake: FakeRun, capsys: pytest.CaptureFixture[str]
) -> None:
    steps = (FOLDED.steps[0], replace(FOLDED.steps[0], name="quarter", done=False))
    fake.answer = replace(FOLDED, result="not_folded", steps=steps, score=score_record(passed=False, iou=0.49))
    main(["fold", "vest"])
    assert "not passed (not completed: quarter), IoU 0.490" in capsys.readouterr().out


def test_the_summary_says_why_the_heights_are_not_judged(
    fake: FakeRun, capsys: pytest.CaptureFixture[str]
) -> None:
    ideal = IdealRecord(valid=False, reason="it does not come to rest")
    score = score_record(passed=False, flat=None, ideal_height_m=0.0127, ideal=ideal)
    fake.answer = replace(FOLDED, score=score)
    main(["fold", "vest"])
    text = capsys.readouterr().out
    assert "the ideal fold is not valid: it does not come to rest" in text and "ideal fold: 12.7 mm" in text


def test_the_summary_shows_both_parts_of_the_claim(fake: FakeRun, capsys: pytest.CaptureFixture[str]) -> None:
    claim = a_claim(
        flat=False, reliability=0.93, height_m=0.031, height_limit_m=0.025, crease_height_m=float("nan"),
        crease_height_limit_m=0.035, says="folded, but stands 31 mm high",
    )  # fmt: skip
    fake.answer = replace(FOLDED, claim=claim)
    main(["fold", "vest"])
    text = capsys.readouterr().out
    assert "claim (camera): shape yes, flat no, reliability 93 %, height 31 mm (at most 25 mm), creases –" in text


def test_the_summary_names_the_reason_why_a_run_is_not_folded(
    fake: FakeRun, capsys: pytest.CaptureFixture[str]
) -> None:
    failure = FailureRecord(FailureKind.NO_GARMENT, "nothing lies on the table", "lay the garment")
    fake.answer = replace(FOLDED, result="not_folded", score=None, failure=failure)
    assert main(["fold", "vest"]) == 2
    assert "nothing lies on the table (lay the garment)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"done": False, "accepted": False}, "half: not accepted, observed overlap 0.930, 18 mm high"),
        ({"done": False, "accepted": None, "observed_iou": None}, "half: not finished, 18 mm high"),
        ({"done": False, "accepted": None, "source": None, "attempts": 0}, "half: not made"),
        ({"done": False, "accepted": None, "observed_iou": None, "attempts": 0}, "half: not made"),
    ],
)
def test_the_summary_shows_the_outcome_of_each_fold(
    fake: FakeRun, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], told: str
) -> None:
    fake.answer = replace(FOLDED, result="not_folded", steps=(replace(HALF, **changes),))
    main(["fold", "vest"])
    assert told in capsys.readouterr().out


def test_a_run_without_observations_has_a_summary(fake: FakeRun, capsys: pytest.CaptureFixture[str]) -> None:
    fake.answer = replace(FOLDED, result="not_folded", score=None, steps=())
    assert main(["fold", "auto"]) == 2
    assert "NOT FOLDED" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({}, 0),
        ({"result": "not_folded"}, 2),
        ({"result": "fault"}, 3),
        ({"signal": 2}, 130),
        ({"signal": 15}, 143),
    ],
)
def test_the_command_exits_with_the_runs_exit_code(fake: FakeRun, changes: dict[str, Any], code: int) -> None:
    fake.answer = replace(FOLDED, **changes)
    assert main(["fold", "medium_towel", "--json"]) == code


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ConfigurationError("a bad file", "mend it"), 64),
        (StorageError("a full disk", "free some space"), 64),
        (DriverError(FailureKind.CAMERA_FAULT, "no camera", "plug it in"), 3),
        (InternalError("a broken rule", "report it"), 3),
        (KeyboardInterrupt(), 130),
    ],
)
def test_known_errors_are_printed_as_messages(
    fake: FakeRun, capsys: pytest.CaptureFixture[str], error: BaseException, code: int
) -> None:
    fake.answer = error
    assert main(["fold", "medium_towel", "--json"]) == code
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err + captured.out
    answer = last_json(captured.out)
    assert answer["exit_code"] == code
    if not isinstance(error, KeyboardInterrupt):
        assert error.what in captured.err and error.hint in captured.err  # type: ignore[attr-defined]
        assert answer["error"] == error.what  # type: ignore[attr-defined]


def test_an_unknown_error_leaves_its_traceback_in_a_file(
    fake: FakeRun, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    fake.answer = ZeroDivisionError("of course")
    assert main(["fold", "medium_towel"]) == 3
    captured = capsys.readouterr()
    assert "this is a bug in foldcell: ZeroDivisionError: of course" in captured.err
    assert "Traceback" not in captured.err
    (kept,) = (tmp_path / "logs").glob("crash-*.txt")
    assert str(kept) in captured.err
    assert "Traceback" in kept.read_text() and "fold_once" in kept.read_text()


# bad input: a clear message, exit code 64, no motion, no files


def bad_input(capsys: pytest.CaptureFixture[str], fake: FakeRun, line: list[str], *parts: str) -> None:
    assert main(line) == 64
    message = capsys.readouterr().err
    for part in parts:
        assert part in message
    assert "Traceback" not in message
    assert fake.requests == []


def test_an_unknown_garment_is_refused(fake: FakeRun, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bad_input(capsys, fake, ["fold", "medium_towl"], "medium_towl", "did you mean 'medium_towel'")
    assert not (tmp_path / "logs").exists()


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("tabel: {height: 0}", "unknown key 'tabel'"),
        ("table: {height: 820}", "looks like millimetres"),
        ("camera: {calibration: broken.yaml}", "broken.yaml"),
        ("camera: {calibration: none.yaml}", "none.yaml"),
    ],
)
def test_invalid_settings_are_a_usage_error(
    fake: FakeRun, capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, part: str
) -> None:
    (tmp_path / "broken.yaml").write_bytes(b"\xff\x00\xfe")
    (tmp_path / "cell.yaml").write_text(text)
    bad_input(capsys, fake, ["fold", "medium_towel", "--cell", str(tmp_path / "cell.yaml")], "cell.yaml", part)
    assert not (tmp_path / "logs").exists()


def test_read_only_logs_are_a_usage_error(
    fake: FakeRun, capsys: pytest.CaptureFixture[str], lockable: Any
) -> None:
    with lockable.read_only():
        for logs in (lockable.folder, lockable.folder / "new"):
            bad_input(capsys, fake, ["fold", "medium_towel", "--logs", str(logs)], str(logs), "--logs DIR")
    assert list(lockable.folder.iterdir()) == []


# runs, report, replay


@pytest.fixture
def journal_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three runs: one folded, one was killed during a grasp, one is running (its lock is held)."""
    monkeypatch.setenv("FOLDCELL_LOGS", str(tmp_path))
    journal = Journal.open(tmp_path / "journal.db")
    first = journal.begin_run(garment="medium_towel", seed=1, driver="sim", wall_clock=lambda: 1e9)
    look = first.intent(0.0, "looking", "look")
    first.result(look, 0.5, {"event": "done"})
    grasp = first.intent(0.5, "grasping", "grasp")
    first.result(grasp, 2.0, {"event": "failed", "kind": "missed_grasp", "what": "nothing between the pads"})
    first.end("folded", run_record(robot_time_s=61.5, wall_time_s=20.25).as_json())
    (first.directory / "report.html").write_text("<html></html>")
    (first.directory / "run.rrd").write_bytes(b"RRF2")
    second = journal.begin_run(garment="large_towel", seed=2, driver="sim", wall_clock=lambda: 1.1e9)
    second.intent(12.5, "grasping", "grasp")
    second.abandon()
    third = journal.begin_run(garment="small_towel", seed=3, driver="sim", wall_clock=lambda: 1.2e9)
    monkeypatch.setattr(sys.modules[__name__], "_kept_alive", (journal, third), raising=False)
    return tmp_path


def test_runs_lists_how_each_run_ended(journal_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert "medium_towel" in lines[1] and lines[1].endswith("folded") and "61.5" in lines[1]
    assert lines[2].endswith("interrupted during grasp at 12.5 s")
    assert lines[3].endswith("running")


def test_runs_lists_the_failure_that_ended_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Journal.open(tmp_path / "journal.db") as journal:
        run = journal.begin_run(garment="vest", seed=1, driver="sim")
        failure = FailureRecord(FailureKind.NO_GARMENT, "nothing there", "")
        run.end("not_folded", run_record(result="not_folded", state=State.NOT_FOLDED, failure=failure).as_json())
    assert main(["runs", "--logs", str(tmp_path)]) == 0
    assert capsys.readouterr().out.rstrip().endswith("not_folded: no garment")
    main(["runs", "--logs", str(tmp_path), "--json"])
    assert last_json(capsys.readouterr().out)["runs"][0]["failure"] == "no_garment"


def test_runs_can_be_listed_as_json(journal_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["runs", "--json", "--last", "2"])
    runs = last_json(capsys.readouterr().out)["runs"]
    assert [r["status"] for r in runs] == ["interrupted", "running"]
    assert runs[0]["last_intent"] == {"name": "grasp", "state": "grasping", "cell_time_s": 12.5, "finished": False}
    assert runs[1]["pid"] == os.getpid()


def test_an_empty_list_of_runs_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs", "--logs", str(tmp_path / "none")]) == 0
    assert "no runs yet" in capsys.readouterr().out
    assert not (tmp_path / "none").exists()


def test_report_summarises_a_finished_run(journal_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "2001"]) == 0
    text = capsys.readouterr().out
    assert "folded" in text and "report.html" in text
    assert "missed_grasp: nothing between the pads" in text


def test_report_of_an_interrupted_run_has_an_unfinished_effect_and_no_page(
    journal_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", "2004", "--json"]) == 0
    answer = last_json(capsys.readouterr().out)
    assert answer["status"] == "interrupted" and answer["report"] is None
    assert answer["effects"][-1]["ended_s"] is None


def test_a_run_is_found_by_its_folder_in_any_logs(
    journal_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (run,) = journal_file.glob("2004*")
    monkeypatch.setenv("FOLDCELL_LOGS", str(tmp_path / "others"))
    assert main(["report", str(run), "--json"]) == 0
    assert last_json(capsys.readouterr().out)["run_dir"] == str(run)
    assert main(["replay", str(run)]) == 64 and "has no recording" in capsys.readouterr().err
    assert main(["report", run.name]) == 64
    assert main(["resume", str(run)]) == 64 and "has no checkpoint" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["report", "replay", "resume"])
def test_the_logs_that_are_named_win_over_a_runs_folder(
    command: str,
    journal_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A run's bare id is also the name of its folder in the present one."""
    others = tmp_path / "others"
    others.mkdir()
    Journal.open(others / "journal.db").close()
    monkeypatch.chdir(journal_file)
    run = min(journal_file.glob("20*")).name
    assert main([command, run, "--logs", str(others)]) == 64
    assert f"there are no runs yet in {others}" in capsys.readouterr().err


def test_a_run_is_compared_with_a_folder_in_other_logs(
    journal_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "others").mkdir()
    with Journal.open(tmp_path / "others" / "journal.db") as journal:
        own = journal.begin_run(garment="vest", seed=1, driver="sim")
        own.end("folded", {})
    (run,) = journal_file.glob("2001*")
    assert main(["compare", str(run), own.id, "--logs", str(tmp_path / "others"), "--json"]) == 0


@pytest.mark.parametrize(
    ("name", "says", "not_says"),
    [("2008", ["none yet", "has not ended", f"pid {os.getpid()}", "--live", "replay 2008"], "was interrupted"),
     ("2004", ["none: the run was interrupted", "without ending the run", "replay 2004"], "has not ended")],
)  # fmt: skip
def test_report_says_why_a_run_has_no_page(
    journal_file: Path, capsys: pytest.CaptureFixture[str], name: str, says: list[str], not_says: str
) -> None:
    (run,) = journal_file.glob(f"{name}*")
    (run / "run.rrd").write_bytes(b"RRF2")
    assert main(["report", name]) == 0
    text = capsys.readouterr().out
    assert all(part in text for part in says) and not_says not in text


def test_replay_prints_the_path_of_the_recording(
    journal_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["replay", "2001"]) == 0
    text = capsys.readouterr().out
    assert "run.rrd" in text and "no display" in text


def test_replay_of_a_run_without_a_recording_is_refused(
    journal_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", "2004"]) == 64
    assert "has no recording" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "says"), [("2001", "has no transcript"), ("2008", "has not ended")])
def test_a_run_that_cannot_be_replayed_is_refused_with_its_reason(
    journal_file: Path, capsys: pytest.CaptureFixture[str], name: str, says: str
) -> None:
    assert main(["replay", name, "--decide", "--json"]) == 64
    told = capsys.readouterr()
    assert says in told.err and "Traceback" not in told.err
    assert says in last_json(told.out)["error"] and last_json(told.out)["hint"]


@pytest.mark.parametrize("command", ["report", "replay"])
def test_an_unknown_run_is_refused(journal_file: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert main([command, "nonsense"]) == 64
    assert "there is no run 'nonsense'" in capsys.readouterr().err


def test_a_closed_output_pipe_is_no_error(journal_file: Path) -> None:
    command = (
        f"{sys.executable} -m foldcell.cell.commands.main runs --logs {journal_file} | true; "
        f"exit ${{PIPESTATUS[0]}}"
    )
    answer = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert answer.returncode == 0 and answer.stderr == ""


def test_unwritable_output_is_reported(journal_file: Path) -> None:
    """It is reported neither as a bug nor with a traceback and Python's exit code."""
    command = f"{sys.executable} -m foldcell.cell.commands.main runs --logs {journal_file} --json > /dev/full"
    answer = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert answer.returncode == 64
    assert answer.stderr.startswith("foldcell: standard output cannot be written: No space left on device")
    assert not list(journal_file.glob("crash-*"))


@pytest.mark.parametrize("closed", [">&-", ">&- 2>&- <&-", "2>/dev/full"])
def test_closed_or_full_streams_do_not_stop_a_command(journal_file: Path, closed: str) -> None:
    for line, code in (("runs", 0), ("report nonsense", 64)):
        command = f"{sys.executable} -m foldcell.cell.commands.main {line} --logs {journal_file} {closed}"
        assert subprocess.run(["bash", "-c", command], capture_output=True).returncode == code
    assert not list(journal_file.glob("crash-*"))


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("line", ["runs --help", "garment list"])
def test_a_command_blocked_by_a_full_pipe_can_be_terminated(line: str, unbuffered: str) -> None:
    """The reader is a pager that does not read. The command ends by the signal, without a traceback, and does not
    wait again for buffered output."""
    reader, full = os.pipe()
    try:
        os.set_blocking(full, False)
        with suppress(BlockingIOError):
            while True:
                os.write(full, bytes(4096))
        os.set_blocking(full, True)
        command = [sys.executable, "-m", "foldcell.cell.commands.main", *line.split()]
        environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
        waiting = subprocess.Popen(command, stdout=full, stderr=subprocess.PIPE, text=True, env=environment)
        try:
            until = time.monotonic() + 30.0
            while "pipe_write" not in Path(f"/proc/{waiting.pid}/wchan").read_text() and time.monotonic() < until:
                time.sleep(0.05)
            waiting.terminate()
            assert waiting.communicate(timeout=20.0)[1] == "foldcell: ended by SIGTERM\n"
            assert waiting.returncode == 143
        finally:
            waiting.kill()
            waiting.communicate()
    finally:
        os.close(reader)
        os.close(full)


def test_a_child_process_can_write_to_closed_streams() -> None:
    child = "import os; os.write(1, b'into the first file that is opened')"
    script = f"""
import subprocess, sys
from foldcell.cell.support.process.standard_streams import lasting_streams
with lasting_streams():
    sys.exit(subprocess.run([sys.executable, "-c", {child!r}]).returncode)
"""
    command = ["bash", "-c", '"$0" -c "$1" >&- 2>&- <&-', sys.executable, script]
    assert subprocess.run(command).returncode == 0


def test_a_stream_with_a_small_encoding_does_not_stop_a_command(tmp_path: Path) -> None:
    """Before, a name with an umlaut on an ASCII terminal was reported as a bug, and the result was lost."""
    script = "import sys; from foldcell.cell.commands.main import main; sys.exit(main(sys.argv[1:]))"
    folder = tmp_path / "Wäsche"
    folder.mkdir()
    with Journal.open(folder / "journal.db") as journal:
        journal.begin_run(garment="./Größe.yaml", seed=1, driver="sim").end("not_folded")
    for how in ([], ["--json"]):
        command = [sys.executable, "-c", script, "runs", "--logs", str(folder), *how]
        ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii"}
        told = subprocess.run(command, env=ascii_only, capture_output=True, text=True)
        assert (told.returncode, told.stderr) == (0, "")
        if how:
            assert json.loads(told.stdout)["logs"] == str(folder)
        else:
            assert r"./Gr\xf6\xdfe.yaml" in told.stdout


@pytest.mark.parametrize("error", [errno.EPIPE, errno.ENOSPC])
def test_a_run_keeps_its_exit_code_if_its_output_is_closed(
    fake: FakeRun, monkeypatch: pytest.MonkeyPatch, error: int
) -> None:
    """`foldcell fold vest | head` must report a garment that was not folded."""
    gone = io.StringIO()
    monkeypatch.setattr(gone, "write", Mock(side_effect=OSError(error, "gone")))
    monkeypatch.setattr(sys, "stdout", gone)
    fake.answer = replace(FOLDED, result="not_folded")
    assert main(["fold", "vest"]) == 2
    assert main(["fold", "vest", "--json"]) == 2


# garments


def test_garment_list_names_the_shipped_garments(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["garment", "list", "--json"]) == 0
    names = [g["name"] for g in last_json(capsys.readouterr().out)["garments"]]
    assert "medium_towel" in names


def test_garment_check_draws_valid_plans_and_names_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text("title: 3\n")
    line = ["garment", "check", "medium_towel", str(bad), "--draw", str(tmp_path), "--no-predictions"]
    assert main(line) == 64
    text = capsys.readouterr().out
    assert "medium_towel: good" in text and text.count("bad.yaml:1: ") == 1
    picture = cv2.imread(str(tmp_path / "medium_towel-drawing.png"))
    assert picture is not None and picture.shape[1] == 2 * picture.shape[0]  # one panel per fold
    colours = {tuple(c) for c in picture.reshape(-1, 3)}
    assert {(240, 226, 214), (44, 52, 208)} <= colours  # cloth and fold line (BGR)


def test_garment_show_prints_the_garment(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["garment", "show", "medium_towel"]) == 0
    text = capsys.readouterr().out
    assert "near_left" in text and "bare_table" in text and "assumed" in text


# perceive


def picture(path: Path, garment: bool) -> Path:
    """A table seen by the nominal camera: uniform grey, with the medium towel as a uniform dark rectangle."""
    from foldcell.cell.config.cell_settings import load_settings
    from foldcell.cell.config.garments.garment_file import load_garment
    from foldcell.cell.hardware.camera import camera_calibration

    calibration = camera_calibration(load_settings())
    rng = np.random.default_rng(0)
    image = np.clip(rng.normal(170, 2, (480, 640, 3)), 0, 255).astype(np.uint8)
    if garment:
        corners = load_garment("medium_towel").place(0.58, 0.0)
        T = np.linalg.inv(calibration.T_table_camera)
        p = np.column_stack([corners, np.zeros(len(corners)), np.ones(len(corners))]) @ T.T
        uv = p[:, :3] @ calibration.intrinsics.matrix.T
        cv2.fillPoly(image, [np.round(uv[:, :2] / uv[:, 2:]).astype(np.int32)], (60, 90, 150), cv2.LINE_AA)
    cv2.imwrite(str(path), image)
    return path


def test_perceive_finds_the_key_points_of_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, empty = picture(tmp_path / "towel.png", True), picture(tmp_path / "empty.png", False)
    assert main(["perceive", str(image), "--reference", str(empty), "--garment", "medium_towel", "--json"]) == 0
    answer = last_json(capsys.readouterr().out)
    found = {name: np.array(p) for name, p in answer["keypoints_m"].items()}
    expected = np.array([[0.38, -0.3], [0.78, -0.3], [0.78, 0.3], [0.38, 0.3]])
    points = np.array(list(found.values()))
    nearest = [np.linalg.norm(points - e, axis=1).min() for e in expected]
    assert max(nearest) < 0.01
    assert cv2.imread(answer["overlay"]).shape == (480, 640, 3)
    assert Path(answer["overlay"]).parent == tmp_path


def test_perceive_reports_a_picture_without_a_garment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = picture(tmp_path / "empty.png", False)
    assert main(["perceive", str(empty), "--reference", str(empty), "--json"]) == 2
    assert last_json(capsys.readouterr().out)["recognised"] is False
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty-perceived.png", "empty.png"]


@pytest.mark.parametrize("content", [None, b"", b"no picture", b"\x89PNG\r\n\x1a\n broken"])
def test_perceive_refuses_a_file_that_is_no_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None
) -> None:
    if content is not None:
        (tmp_path / "image.png").write_bytes(content)
    assert main(["perceive", str(tmp_path / "image.png")]) == 64
    assert "image.png" in capsys.readouterr().err


def test_perceive_refuses_a_picture_of_another_size(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((48, 64, 3), np.uint8))
    assert main(["perceive", str(tmp_path / "small.png")]) == 64
    assert "64 x 48" in capsys.readouterr().err


def test_depth_files_are_read_in_metres_and_other_arrays_are_refused(tmp_path: Path) -> None:
    from foldcell.cell.support.files.picture_file import read_depth

    cv2.imwrite(str(tmp_path / "d.png"), np.array([[1100, 0]], np.uint16))
    np.save(tmp_path / "d.npy", np.array([[1.1, 0.0]]))
    for name in ("d.png", "d.npy"):
        depth = read_depth(tmp_path / name)
        assert depth[0, 0] == pytest.approx(1.1) and np.isnan(depth[0, 1])
    cv2.imwrite(str(tmp_path / "rgb.png"), np.zeros((2, 2, 3), np.uint8))
    np.save(tmp_path / "int.npy", np.array([[1100]]))
    for name in ("rgb.png", "int.npy"):
        with pytest.raises(ConfigurationError, match="16-bit millimetres"):
            read_depth(tmp_path / name)


# optimise's export


@pytest.mark.parametrize("line", ["--export out.txt", "--export none/out.csv", "--step 9"])
def test_optimise_checks_its_arguments_first(
    line: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["optimise", "medium_towel", *line.split()]) == 64
    assert "foldcell: " in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


# trials


def test_trials_report_runs_successes_and_interval(
    fake: FakeRun, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:

    monkeypatch.setattr("foldcell.cell.campaigns.executors.worker_pool", ThreadPoolExecutor)
    assert main(["trials", "--garments", "medium_towel", "--n", "3", "--json"]) == 0
    answer = last_json(capsys.readouterr().out)
    (row,) = answer["garments"]
    assert (row["runs"], row["folded"]) == (3, 3)
    assert row["interval"] == pytest.approx([0.4385, 1.0], abs=1e-4)
    assert sorted(r.seed for r in fake.requests) == [1, 2, 3]
    assert json.loads((Path(answer["directory"]) / "trials.json").read_text())["garments"] == answer["garments"]


def test_a_garment_that_is_named_twice_counts_once(fake: FakeRun, monkeypatch: pytest.MonkeyPatch) -> None:
    """Repeated seeds are no further evidence, and the interval would be too narrow."""
    monkeypatch.setattr("foldcell.cell.campaigns.executors.worker_pool", ThreadPoolExecutor)
    assert main(["trials", "--garments", "medium_towel, small_towel,medium_towel", "--n", "2"]) == 0
    runs = sorted((r.garment, r.seed) for r in fake.requests)
    assert runs == [("medium_towel", 1), ("medium_towel", 2), ("small_towel", 1), ("small_towel", 2)]


def test_runs_of_a_campaign_share_the_user_library_but_not_their_own_entries(
    fake: FakeRun, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("foldcell.cell.campaigns.executors.worker_pool", ThreadPoolExecutor)
    (tmp_path / "library.json").write_text("the user's")
    assert main(["trials", "--garments", "medium_towel", "--n", "3", "--logs", str(tmp_path)]) == 0
    logs = [r.logs for r in fake.requests]
    assert len(set(logs)) == 3 and tmp_path not in logs
    assert [(folder / "library.json").read_text() for folder in logs] == ["the user's"] * 3


def test_an_interrupted_campaign_keeps_the_finished_runs(
    fake: FakeRun, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("foldcell.cell.campaigns.executors.worker_pool", ThreadPoolExecutor)

    class InterruptedOutput(io.StringIO):
        """The operator presses Ctrl-C when the second run is reported."""

        def write(self, text: str) -> int:
            if "2/9" in text:
                raise KeyboardInterrupt
            return super().write(text)

    monkeypatch.setattr(sys, "stdout", InterruptedOutput())
    assert main(["trials", "--garments", "medium_towel", "--n", "9", "--workers", "1"]) == 130
    (file,) = tmp_path.rglob("trials.json")
    kept = json.loads(file.read_text())
    assert len(kept["runs"]) == 2 and kept["garments"][0]["folded"] == 2
    assert len(kept["not_performed"]) == 7


def test_a_dead_worker_is_reported_with_the_table(
    fake: FakeRun, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class DyingPool(ThreadPoolExecutor):
        def submit(self, *task: Any, **options: Any) -> Any:
            return super().submit(self.die)

        def die(self) -> None:
            raise BrokenExecutor("a worker was killed")

    monkeypatch.setattr("foldcell.cell.campaigns.executors.worker_pool", DyingPool)
    assert main(["trials", "--garments", "medium_towel", "--n", "2"]) == 3
    assert "2 runs were not performed" in capsys.readouterr().out


def test_an_interrupted_campaign_is_continued_with_its_missing_runs_only(
    fake: FakeRun, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("foldcell.cell.campaigns.executors.worker_pool", ThreadPoolExecutor)
    assert main(["trials", "--garments", "medium_towel", "--n", "4", "--json"]) == 0
    answer = last_json(capsys.readouterr().out)
    folder = Path(answer["directory"])
    (folder / "medium_towel-seed3" / "trial.json").unlink()
    fake.requests.clear()
    assert main(["trials", "--resume", str(folder), "--json"]) == 0
    assert [r.seed for r in fake.requests] == [3]
    assert last_json(capsys.readouterr().out)["runs"] == answer["runs"]


def test_campaign_files_are_performed_compared_and_listed(
    fake: FakeRun, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("foldcell.cell.campaigns.executors.worker_pool", ThreadPoolExecutor)
    path = tmp_path / "campaign.yaml"
    path.write_text(
        "about: a question\ngarments: [small_towel]\nseeds: [4, 5]\n"
        "variants: {shipped: {}, quick: {cell: {optimiser: {method: initial}}}}\n"
    )
    folders = []
    for _ in range(2):
        assert main(["trials", str(path), "--json"]) == 0
        answer = last_json(capsys.readouterr().out)
        folders.append(answer["directory"])
        assert [(r["variant"], r["runs"]) for r in answer["garments"]] == [("shipped", 2), ("quick", 2)]
        assert answer["comparisons"][0]["pairs"] == 2
    assert {r.settings.optimiser.method for r in fake.requests} == {"initial", "default"}
    assert main(["compare", *folders, "--json"]) == 0
    variants = last_json(capsys.readouterr().out)["variants"]
    assert {name: c["pairs"] for name, c in variants.items()} == {"shipped": 2, "quick": 2}
    assert main(["runs", "--json"]) == 0
    campaigns = last_json(capsys.readouterr().out)["campaigns"]
    assert [(c["runs"], c["finished"], c["about"]) for c in campaigns] == [(4, 4, "a question")] * 2
    assert main(["runs"]) == 0
    assert "4 of 4" in capsys.readouterr().out


@pytest.mark.parametrize(
    "line",
    ["--resume none", "--hours 1 --n 3", "--renew 2", "none.yaml", "--cluster tcp://x:1 --workers 2", "--hours 0"],
)
def test_contradicting_options_of_trials_are_refused(line: str, fake: FakeRun, tmp_path: Path) -> None:
    assert main(["trials", *line.split()]) == 64
    assert fake.requests == [] and not list(tmp_path.rglob("*.json")), "no campaign is left that never began"


def test_trials_of_an_unknown_garment_are_refused(fake: FakeRun, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trials", "--garments", "medium_towel,sock"]) == 64
    assert fake.requests == []


# the library


def test_library_show_reports_a_damaged_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "library.json").write_text("{broken")
    assert main(["library", "show", "--logs", str(tmp_path), "--json"]) == 0
    answer = last_json(capsys.readouterr().out)
    assert any("library.json" in line for line in answer["refused"])
