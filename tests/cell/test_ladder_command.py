"""The ladder at the simulated cell, with its dynamics and noise: the steps up to the scripted runs, and the
journal."""

from __future__ import annotations

from pathlib import Path

import pytest

from foldcell.cell.calibrating.session import CalibrationRequest
from foldcell.cell.campaigns.ladder.climb import Passes, climb
from foldcell.cell.campaigns.ladder.steps import STEPS
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.journal.journal import Journal, performed
from foldcell.cell.support.files.paths import journal_path

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def test_the_simulated_cell_passes_the_steps_of_the_ladder(tmp_path: Path) -> None:
    steps = [step for step in STEPS if step.check is not None]
    request = CalibrationRequest("ladder", 0, "sim", load_settings(), tmp_path, False, lambda text: None)
    end = climb(request, steps[0].name, Passes(tmp_path / "passes.json"), lambda question: True, steps)
    assert [(r.of.name, r.reason) for r in end.results if not r.passed] == [] and len(end.results) == len(steps)
    assert end.safe and end.signal is None and end.run_dir is not None
    assert Passes(tmp_path / "passes.json").missing(steps) is None
    with Journal.open(journal_path(tmp_path), readonly=True) as journal:
        run = journal.run("last")
        assert (run.garment, run.result) == ("ladder", "done")
        effects = performed(journal.entries(run.id))
        assert [effect.name for effect in effects] == [step.name for step in steps]
        assert {effect.result and effect.result.payload["event"] for effect in effects} == {"done"}
