"""The scripts of tests/hil, which `make hil` and README show: each ends as it expects in the simulated cell. What
else is asked of a run is in ALSO."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import foldcell
from foldcell.cell.commands.main import main
from tests.runs import decided_again

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

SCRIPTS = Path(__file__).parents[1] / "hil"
IN_THE_TEST_OF_THE_COMMAND = {"no_garment", "abort_with_cloth_in_the_hands"}
"""Performed by test_hil_command.py."""


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


@pytest.mark.parametrize(
    "name", sorted({path.stem for path in SCRIPTS.glob("*.yaml")} - IN_THE_TEST_OF_THE_COMMAND)
)
def test_a_shipped_script_ends_as_it_expects(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["hil", str(SCRIPTS / f"{name}.yaml"), "--logs", str(tmp_path), "--json"])
    told = capsys.readouterr().out
    assert code == 0, told
    if name in ALSO:
        ALSO[name](foldcell.load_run(json.loads(told.splitlines()[-1])["scripts"][0]["run_dir"]))
