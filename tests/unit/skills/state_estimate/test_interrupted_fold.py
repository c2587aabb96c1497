"""Properties of simulated folds that end early."""

import numpy as np
import pytest

from foldcell.robots.errors import DriverError, FailureKind
from foldcell.skills.cloth.predict import HANDS, predict_fold, sample_paths
from foldcell.skills.state_estimate.hand_course import HandCourse
from foldcell.skills.state_estimate.hypothesis import Interruption
from foldcell.skills.state_estimate.interrupted_fold import simulate_interruptions
from foldcell.skills.vocabulary import GraspId

LEFT, RIGHT = GraspId.LEFT, GraspId.RIGHT


def simulated(fold, *ways, **options):
    material = fold.garment.material
    return simulate_interruptions(fold.mesh, fold.before.vertices, material, fold.paths, ways, **options)


def farthest(a, b):
    return np.linalg.norm(a - b, axis=1).max()


def test_a_fold_without_interruption_is_the_predicted_fold(fold):
    (complete,) = simulated(fold, Interruption())
    predicted = predict_fold(fold.mesh, fold.before.vertices, fold.garment.material, fold.paths).vertices
    assert farthest(complete, predicted) < 0.003


def test_interruptions_do_not_influence_each_other(fold):
    ways = (
        Interruption(end=0.6),
        Interruption({LEFT: 0.3}),
        Interruption(missed_layer=True),
        Interruption(end=0.3),
    )
    together = simulated(fold, *ways)
    for way, positions in zip(ways, together, strict=True):
        np.testing.assert_array_equal(positions, simulated(fold, way)[0])


def test_the_later_the_hands_open_the_nearer_the_cloth_is_to_the_completed_fold(fold):
    left = [
        farthest(x, fold.after.vertices) for x in simulated(fold, *(Interruption(end=s) for s in (0.1, 0.5, 0.9)))
    ]
    assert left[0] > left[1] > left[2]
    (early,) = simulated(fold, Interruption(end=0.1))
    assert farthest(early, fold.before.vertices) < 0.03


def test_only_the_corner_that_slipped_out_stays_behind(fold):
    (slipped,) = simulated(fold, Interruption({LEFT: 0.3}))
    lag = {}
    for grasp_id, grasp in fold.step.grasps.items():
        corner = np.linalg.norm(fold.mesh.rest - grasp.point, axis=1).argmin()
        lag[grasp_id] = np.linalg.norm(slipped[corner] - fold.after.vertices[corner])
    assert lag[LEFT] > 0.05 > 0.02 > lag[RIGHT]


def test_cloth_that_is_laid_back_lies_nearly_as_before_the_fold(fold):
    back, dropped = simulated(fold, Interruption(end=0.6, laid_back=True), Interruption(end=0.6))
    assert farthest(back, fold.before.vertices) < 0.02
    assert farthest(dropped, fold.before.vertices) > 0.1


def test_hands_that_were_measured_on_their_planned_path_make_the_planned_fold(fold):
    """Measured heights have an error that does not change; times do not begin at zero."""
    p, r = sample_paths(fold.paths, frames := round(max(path.t[-1] for path in fold.paths.values()) * 60), 1 / 60)
    hands, t = {g: HANDS.index(g) for g in fold.paths}, np.arange(frames + 1) / 60
    course = HandCourse(
        t, {g: p[:, h] - (0.0, 0.0, 0.004) for g, h in hands.items()}, {g: r[:, h] for g, h in hands.items()},
        dict.fromkeys(hands, float(t[-1])),
    )  # fmt: skip
    complete, measured = simulated(fold, Interruption(), Interruption(measured=True), course=course)
    assert farthest(complete, measured) < 0.003


def test_a_hand_that_was_measured_to_lose_its_cloth_leaves_it_behind(fold):
    p, r = sample_paths(fold.paths, 60, 1 / 60)
    hands, t = {g: HANDS.index(g) for g in fold.paths}, np.arange(61) / 60
    where = {g: p[:, h] for g, h in hands.items()}
    course = HandCourse(t, where, {g: r[:, h] for g, h in hands.items()}, {LEFT: 0.25, RIGHT: 1.0})
    (measured,) = simulated(fold, Interruption(measured=True), course=course)
    moved = np.linalg.norm(measured - fold.before.vertices, axis=1)
    left, right = (
        moved[np.linalg.norm(fold.before.vertices - where[g][0], axis=1).argmin()] for g in (LEFT, RIGHT)
    )
    assert left < 0.5 * right


def test_the_computation_can_be_ended_between_two_simulations(fold):
    left = [2]

    def proceed():
        left[0] -= 1
        if not left[0]:
            raise DriverError(FailureKind.STOPPED, "the stop was triggered")

    with pytest.raises(DriverError):
        simulated(fold, Interruption(end=0.2), Interruption(end=0.4), Interruption(end=0.6), proceed=proceed)
    assert left == [0]
