"""The arcs that carry cloth back: their ends, their shape, and the turn of the hand."""

from __future__ import annotations

import numpy as np
import pytest

from skills.trajectory.bezier import initial_controls
from skills.trajectory.paths import fold_paths
from skills.trajectory.return_arcs import return_arcs, turned_paths
from skills.vocabulary import FoldLine, FoldStep, Grasp, GraspId

THICKNESS = 0.002
GRASP = GraspId.LEFT


def way_back(start: tuple[float, float], end: tuple[float, float]) -> FoldStep:
    grasp = Grasp(np.array(start), 0.3, 1, 2 * THICKNESS)
    line = FoldLine(np.array([0.6, 0.0]), np.array([0.0, 1.0]))
    return FoldStep("undo half", 0, line, (), {GRASP: grasp}, {GRASP: np.array([*end, 0.005])})


def test_the_arcs_begin_in_the_grasped_layer_and_end_where_the_cloth_lay() -> None:
    fold = {GRASP: initial_controls(np.array([0.74, 0.1, 0.0]), np.array([0.46, 0.1, 0.007]))}
    for arcs in return_arcs(fold, way_back((0.6, 0.08), (0.74, 0.1)), THICKNESS):
        assert arcs[GRASP][0] == pytest.approx([0.6, 0.08, 1.5 * THICKNESS]), "the middle of the upper layer"
        assert arcs[GRASP][-1] == pytest.approx([0.74, 0.1, 0.005])
        assert arcs[GRASP][1:-1, 2].min() > 0.03


def test_the_way_back_from_the_target_is_the_arc_of_the_fold_reversed() -> None:
    start, end = np.array([0.74, 0.1, 0.005]), np.array([0.46, 0.1, 1.5 * THICKNESS])
    inner = np.array([[0.70, 0.1, 0.08], [0.52, 0.1, 0.12]])  # not symmetric
    fold = np.vstack([start, inner, end])
    reverse, _ = return_arcs({GRASP: fold}, way_back((0.46, 0.1), (0.74, 0.1)), THICKNESS)
    assert reverse[GRASP] == pytest.approx(fold[::-1])


def test_the_hand_turns_smoothly_from_the_heading_of_the_grasp_to_that_of_the_release() -> None:
    controls = {GRASP: initial_controls(np.array([0.5, 0.0, 0.0]), np.array([0.7, 0.0, 0.0]))}
    paths = fold_paths(controls, {GRASP: 0.2}, 2.0)
    heading = turned_paths(paths, {GRASP: (0.2, 1.0)})[GRASP].heading
    assert heading[[0, -1]] == pytest.approx([0.2, 1.0]) and (np.diff(heading) >= 0.0).all()
    assert np.interp(0.5, np.linspace(0, 1, len(heading)), heading) == pytest.approx(0.6, abs=0.01)
    assert abs(np.diff(heading)[[0, -1]]).max() < 0.1 * np.diff(heading).max(), "at rest at both ends"
