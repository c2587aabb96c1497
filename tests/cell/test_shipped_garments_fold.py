"""Whole runs with the shipped settings and trajectories, but few pictures of each fold, and few simulations where
the library has no arc: the garments of benchmarks/regression_runs end folded."""

from __future__ import annotations

from pathlib import Path

import pytest

from foldcell.cell.campaigns.hil.script import read_script
from foldcell.cell.runs.fold_run import fold_once
from tests.runs import fold_request

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

FEW_SIMULATIONS = {"optimiser": {"simulations": 1}}
RUNS = Path(__file__).parents[2] / "benchmarks" / "regression_runs"


# the medium towel: tests/cell/test_readme_commands.py; a long-sleeve shirt is folded as the T-shirt
@pytest.mark.parametrize("name", ["t_shirt", "pants"])
def test_a_shipped_garment_ends_folded(name: str, tmp_path: Path) -> None:
    script = read_script(RUNS / f"{name}.yaml")
    result = fold_once(fold_request(tmp_path, FEW_SIMULATIONS, garment=script.garment_named, seed=script.seed))
    assert (result.result, result.state, result.exit_code) == ("folded", "folded", 0), result.failure
    assert result.failure is None
    assert all(step.done for step in result.steps)
