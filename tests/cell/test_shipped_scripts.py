"""The scripts of tests/hil and tests/hil/faults: each ends as it expects in the simulated cell. What else is asked
of a run is in ALSO.

`make hil` performs all of them. The suite performs PART, a minute of processor time at most; the others are
marked `hil`: `pytest -m hil` performs them.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import foldcell
from foldcell.cell.campaigns.hil.script import Script, read_script
from foldcell.cell.campaigns.hil.script_run import ScriptResult, broken_expectations, check_script, fold_scripted
from foldcell.cell.commands.main import main
from tests.runs import decided_again, fold_request

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "tests" / "hil"
IN_THE_TEST_OF_THE_COMMAND = {"no_garment", "abort_with_cloth_in_the_hands"}
"""Performed by test_hil_command.py: a question that a person has to answer, and an abort."""
PART = {"stop_in_mid_fold", "missed_grasp", "camera_black", "faults/joint_state_nan_for_good"}
"""One script of each other kind of ending: a stop, a recovery to the end, an answer of the cell before anything
moves, and a fault after which nothing may move. A fold that is paused and goes on is in test_supervised_run.py."""
ALL = sorted(
    str(path.relative_to(SCRIPTS).with_suffix(""))
    for path in SCRIPTS.rglob("*.yaml")
    if path.stem not in IN_THE_TEST_OF_THE_COMMAND
)


def performed(script: Script, folder: Path, settings: Mapping[str, Any]) -> foldcell.Run:
    """The run of a script, which ended as the script expects: recorded, and scored only if the script asks."""
    scored = script.expect.passed is not None
    asked = fold_request(
        folder, settings, garment=script.garment_named, seed=script.seed, approve=script.attended,
        terminal=False, record=True, record_truth=scored,
    )  # fmt: skip
    request = replace(asked, settings=check_script(script, asked.settings, "sim"))
    result, seen = fold_scripted(request, script.do, print, script.limit_s)
    assert broken_expectations(script, result, seen) == ()
    return foldcell.load_run(result.run_dir)


def a_missed_grasp_is_made_again_lower(run: foldcell.Run) -> None:
    (missed, held, *_) = [n for n, e in enumerate(run.effects) if e.name == "grasp"]
    between = [effect.name for effect in run.effects[missed + 1 : held]]
    assert between == ["clear", "plan_motion", "check_place", "approach"]
    first = run.folds[0]
    assert (first.recoveries, first.attempts) == (("missed_grasp -> grasp_again (lower)",), 2)
    again = decided_again(run.folder.parent, run.folder.name)
    assert again.same and again.broken_off is None, "the replay repeats the recovery"


def a_stop_holds_the_arms(run: foldcell.Run) -> None:
    sent = run.set_points()
    assert sent is not None
    fold, hold = run.effects[-2:]
    assert (fold.name, hold.name) == ("fold", "hold")
    assert sent.t[-1] - fold.begun_s < 1.0 + 0.05, "the stop came after 1 s, and no set-point follows it"
    assert fold.ended_s - sent.t[-1] < 0.05 and hold.ended_s - sent.t[-1] < 1.0, "the run ends when the arms rest"
    assert all(commands[-1, 1] < 0.02 for commands in sent.grippers.values()), "the stop does not open the hands"
    (ended,) = [e for e in run.entries if e.kind == "result" and e.name == "fold"]
    assert ended.payload["kind"] == "stopped" and "the button" in run.record.failure.what
    again = decided_again(run.folder.parent, run.folder.name)
    assert again.same and again.broken_off is None and again.set_points == len(sent.t)


ALSO = {"missed_grasp": a_missed_grasp_is_made_again_lower, "stop_in_mid_fold": a_stop_holds_the_arms}


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in PART else pytest.mark.hil) for n in ALL])
def test_a_shipped_script_ends_as_it_expects(name: str, tmp_path: Path) -> None:
    run = performed(read_script(SCRIPTS / f"{name}.yaml"), tmp_path, {})
    if name in ALSO:
        ALSO[name](run)


def test_make_hil_performs_every_script(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = subprocess.run(
        ["make", "--dry-run", "hil"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    (words,) = [line.split()[1:] for line in said.splitlines() if line.startswith(".venv/bin/foldcell hil ")]
    performed: list[Path] = []

    def perform(script: Script, *_: Any, **__: Any) -> ScriptResult:
        performed.append(script.path)
        return ScriptResult(script, (), None, 1.0)

    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("foldcell.cell.commands.run.hil.run_script", perform)
    main([*words, "--logs", str(tmp_path), "--json"])
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["not_performed"] == []
    assert {path.resolve() for path in performed} == set(SCRIPTS.rglob("*.yaml"))
    assert {*ALL} >= PART
