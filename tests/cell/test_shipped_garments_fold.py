"""Runs with the shipped settings and trajectories, but few pictures of each fold, and few simulations where the
library has no arc, of garments of benchmarks/regression_runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from foldcell.cell.campaigns.hil.script import read_script
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.transition_table import Effect, Event
from tests.runs import Onlooker, fold_request

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

FEW_SIMULATIONS = {"optimiser": {"simulations": 1}}
RUNS = Path(__file__).parents[2] / "benchmarks" / "regression_runs"


def shipped_run(name: str, folder: Path) -> FoldRequest:
    script = read_script(RUNS / f"{name}.yaml")
    return fold_request(folder, FEW_SIMULATIONS, garment=script.garment_named, seed=script.seed)


# the medium towel: tests/cell/test_readme_commands.py; a long-sleeve shirt is folded as the T-shirt
def test_a_t_shirt_ends_folded(tmp_path: Path) -> None:
    result = Onlooker().fold(shipped_run("t_shirt", tmp_path))
    assert (result.result, result.state, result.exit_code) == ("folded", "folded", 0), result.failure
    assert result.failure is None
    assert all(step.done for step in result.steps)


def test_the_first_fold_of_pants_is_planned_with_an_arc_of_the_library(tmp_path: Path) -> None:
    """From the picture to the approach. `python -m benchmarks.regression_record` folds them to the end."""
    run = Onlooker(before={Effect.APPROACH: lambda ports, commands, n: commands.put(Event.ABORT)})
    result = run.fold(shipped_run("pants", tmp_path))
    assert run.kinds() == ["aborted"] and run.events(Effect.PLAN_MOTION) == [Event.DONE]
    assert result.steps[0].source == "library"
