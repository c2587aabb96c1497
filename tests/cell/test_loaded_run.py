"""`foldcell.load_run` reads a whole run of the simulated cell."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import foldcell

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def test_load_run_returns_the_result_of_a_run(seen: Any) -> None:
    run = foldcell.load_run(seen.folder)
    assert isinstance(seen.result, foldcell.RunRecord)
    assert run.status == seen.result.result == "folded"
    assert run.record == seen.result and run.folds == seen.result.steps
    assert all(effect.ended_s >= effect.begun_s for effect in run.effects)


def test_load_run_returns_the_set_points_of_a_run(seen: Any) -> None:
    """The set-points are compared with the commands at the arms' port."""
    sent, passed = foldcell.load_run(seen.folder).set_points(), seen.onlooker.set_points
    assert isinstance(sent, foldcell.SetPoints)
    assert np.allclose(sent.t, [s.t for s in passed], rtol=0.0, atol=1e-9) and np.all(np.diff(sent.t) >= 0)
    assert np.array_equal(sent.q, [s.q for s in passed]) and np.array_equal(sent.qd, [s.qd for s in passed])
    assert np.array_equal(sent.clipped, [s.sent.clipped for s in passed])
    assert set(sent.grippers) == {"left", "right"}
    for rows in sent.grippers.values():
        assert rows.shape[1] == 3 and len(rows) > 0
        assert np.all(np.diff(rows[:, 0]) >= 0) and np.all((rows[:, 1] >= 0) & (rows[:, 1] < 0.2))
    assert sent.head.ndim == 2 and sent.head.shape[1] == 2
