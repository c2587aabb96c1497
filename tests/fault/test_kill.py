"""`kill -9` during a run: the journal names the interrupted effect, and the run can be resumed."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

from foldcell.cell.commands.main import main
from foldcell.cell.journal.journal import Journal, performed
from foldcell.cell.simulation import Fault, FaultKind
from foldcell.robots.errors import StorageError
from tests.runs import FEW_PICTURES, PLAIN, Onlooker, fold_request, once_folded_towel

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

LONGEST_S = 240.0


def foldcell(*line: str) -> tuple[int, str, str]:
    """Run a command in this process. Returns its exit code, standard output and standard error."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as error:
        code = main([*line])
    return code, out.getvalue(), error.getvalue()


def under_way(logs: Path) -> str | None:
    """The unfinished effect of the journal's last run, read from another process."""
    with suppress(StorageError), Journal.open(logs / "journal.db", readonly=True) as journal:
        runs = journal.runs()
        begun = performed(journal.entries(runs[-1].id)) if runs else []
        return begun[-1].name if begun and begun[-1].result is None else None
    return None


def children(pid: int) -> list[int]:
    listed = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    return [int(child) for child in listed]


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A run in its own process, killed during the grasp."""
    folder = tmp_path_factory.mktemp("killed")
    settings, logs = folder / "cell.yaml", folder / "logs"
    settings.write_text(yaml.safe_dump({"recorder": dict(FEW_PICTURES), **PLAIN}), encoding="utf-8")
    line = ["fold", once_folded_towel(folder), "--seed", "1", "--cell", str(settings), "--logs", str(logs)]
    with (folder / "output").open("w") as output:
        command = [sys.executable, "-m", "foldcell.cell.commands.main", *line]
        process = subprocess.Popen(command, stdout=output, stderr=output)
    try:
        deadline = time.monotonic() + LONGEST_S
        while under_way(logs) != "grasp":
            assert process.poll() is None, f"it ended first: {(folder / 'output').read_text()}"
            assert time.monotonic() < deadline
            time.sleep(0.02)
        while_running = json.loads(foldcell("runs", "--json", "--logs", str(logs))[1])
        process.send_signal(signal.SIGSTOP)  # the process does nothing more until it is killed
        at_the_kill, helpers = under_way(logs), children(process.pid)
    finally:
        process.kill()
        process.wait()
    return {"folder": folder, "logs": logs, "pid": process.pid, "helpers": helpers, "under_way": at_the_kill,
            "while_running": while_running}  # fmt: skip


def test_a_run_is_listed_as_running_until_it_is_killed(killed: dict[str, Any]) -> None:
    (run,) = killed["while_running"]["runs"]
    assert (run["status"], run["pid"]) == ("running", killed["pid"])


def test_the_journal_is_intact_after_a_kill(killed: dict[str, Any]) -> None:
    with Journal.open(killed["logs"] / "journal.db", readonly=True) as journal:
        assert journal.check() == "ok"
        (run,) = journal.runs()
        assert (run.status, run.ended, run.result) == ("interrupted", None, None)
        entries = journal.entries(run.id)
    assert [e.sequence for e in entries] == list(range(1, len(entries) + 1))
    assert {"prepare", "look", "recognise", "plan_motion", "approach"} <= {e.name for e in entries}


def test_the_runs_command_names_the_interrupted_effect(killed: dict[str, Any]) -> None:
    code, told, _ = foldcell("runs", "--json", "--logs", str(killed["logs"]))
    assert code == 0
    (run,) = json.loads(told.splitlines()[-1])["runs"]
    assert run["status"] == "interrupted" and run["pid"] == killed["pid"]
    intent = run["last_intent"]
    if killed["under_way"] is not None:  # otherwise the process was killed between two effects
        assert (intent["name"], intent["finished"]) == (killed["under_way"], False)
        assert f"interrupted during {intent['name']}" in foldcell("runs", "--logs", str(killed["logs"]))[1]


def test_a_killed_run_leaves_no_result_and_no_report(killed: dict[str, Any]) -> None:
    (folder,) = [p for p in killed["logs"].iterdir() if p.is_dir()]
    names = {p.name for p in folder.iterdir()}
    assert "result.json" not in names and "report.html" not in names
    assert "cell.yaml" in names


def test_a_killed_run_is_replayed_up_to_the_kill(killed: dict[str, Any]) -> None:
    """The replay reaches the grasp. At most the last two seconds are missing."""
    code, told, _ = foldcell("replay", "last", "--decide", "--json", "--logs", str(killed["logs"]))
    figures = json.loads(told.splitlines()[-1])
    assert code == 0 and figures["same"], figures
    assert figures["broken_off"] == "the transcript breaks off here"
    with Journal.open(killed["logs"] / "journal.db", readonly=True) as journal:
        (run,) = journal.runs()
        entries = journal.entries(run.id)
    done = sum(1 for e in entries if e.kind == "result")
    assert done - 1 <= figures["effects"] <= done
    assert entries[-1].cell_time - figures["cell_time_s"] < 2.0


def test_child_processes_end_with_the_killed_run(killed: dict[str, Any]) -> None:
    """Otherwise every crash would leave a render process behind."""
    assert killed["helpers"]
    deadline = time.monotonic() + 10.0
    while any(alive(pid) for pid in killed["helpers"]) and time.monotonic() < deadline:
        time.sleep(0.05)
    left = [pid for pid in killed["helpers"] if alive(pid)]
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert left == []


def test_the_next_run_can_open_the_cell(killed: dict[str, Any]) -> None:
    request = fold_request(killed["folder"], {**PLAIN, "recovery": {"patience": 0.0}})
    assert request.logs == killed["logs"]
    onlooker = Onlooker()
    result = onlooker.fold(request, lambda ports: onlooker.inject(Fault(FaultKind.NO_GARMENT)))
    assert result.state == "not_folded"
    with Journal.open(killed["logs"] / "journal.db", readonly=True) as journal:
        assert [r.status for r in journal.runs()] == ["interrupted", "not_folded"]


def test_a_killed_run_is_resumed_and_folds_the_garment(killed: dict[str, Any]) -> None:
    """This process resumes from disk: it opens the hands, parks, looks again and folds the garment."""
    logs = killed["logs"]
    folder = min(p for p in logs.iterdir() if p.is_dir())
    code, told, error = foldcell("resume", folder.name, "--json", "--logs", str(logs))
    assert code == 0, error
    result = json.loads(told.splitlines()[-1])
    assert (result["result"], result["resumed_from"]) == ("folded", folder.name)
    assert [step["done"] for step in result["steps"]] == [True]
    assert result["score"]["passed"], result["score"]
    with Journal.open(logs / "journal.db", readonly=True) as journal:
        entries = journal.entries(Path(result["run_dir"]).name)
    states = [e.state for e in entries if e.kind == "event"]
    assert states[:3] == ["idle", "resuming", "looking"], (
        "the table is not photographed again, because it is no longer empty"
    )
    assert not (folder.parent / Path(result["run_dir"]).name / "world.npz").exists()
    code, _, error = foldcell("resume", folder.name, "--logs", str(logs))
    assert code == 64 and "was already resumed as" in error
