"""What is said of a predicted fold that will not go, on shapes that are made by geometry."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.planning.fold_judgement import Reason, claim_limits, judge_edges, judge_fold, judge_hands
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.pinch import PinchReport
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.scoring.alignment import FinalGarment
from foldcell.skills.scoring.score import keypoint_offsets, named_edge_pairs, score
from foldcell.skills.scoring.verdict import IdealHeights
from foldcell.skills.vocabulary import GraspId

TOWEL = load_garment("small_towel")
STATE = TOWEL.flat_state(*TOWEL.poses.middle)
HALF, QUARTER = plan_folds(STATE, TOWEL).unwrap()
MESH = mesh_from_contour(STATE.contour, 0.03, TOWEL.layers)
FLAT = MESH.lay_flat(TOWEL.material.thickness)
LIMITS = claim_limits(load_settings().inspection.claim_settings())
LIMIT = 0.025


def folded(short: float = 0.0, along: float = 0.0) -> Array:
    """The towel after its first fold, with its moved part `short` of its place and shifted along the line [m]."""
    x = np.array(target_vertices(MESH, HALF.lines, TOWEL.material))
    moved = HALF.line.signed_distance(MESH.rest) > 1e-6
    reach = HALF.line.signed_distance(MESH.rest).max()
    share = HALF.line.signed_distance(MESH.rest)[moved, None] / reach
    x[moved, :2] += share * (short * HALF.line.normal + along * HALF.line.direction)
    return x


def judged(vertices: Array, dissimilarity: float = 0.002, ideal: IdealHeights | None = None) -> tuple[Reason, ...]:
    final = FinalGarment(
        vertices, MESH.triangles, MESH.rest, HALF.lines, TOWEL.material.thickness,
        named_edge_pairs((), STATE.keypoints), STATE.keypoints, ideal,
    )  # fmt: skip
    offsets = keypoint_offsets(final)
    return judge_fold(TOWEL, HALF, STATE.keypoints, offsets, dissimilarity, LIMIT, score(final, LIMITS))


def test_the_ideal_fold_is_good() -> None:
    assert judged(folded()) == ()


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ({"short": 0.060}, ["mm short of its place (limit 30 mm)"]),
        ({"short": -0.060}, ["mm beyond its place (limit 30 mm)"]),
        ({"along": 0.060}, ["mm beside its place (limit 30 mm)"]),
    ],
)
def test_a_corner_off_its_place_is_named_with_figure_and_limit(shape: dict[str, float], words: list[str]) -> None:
    first, *_ = judged(folded(**shape))
    assert all(word in first.what for word in words), first.what
    assert any(name in first.what for name in ("near_left", "far_left")), "these corners were moved"


def test_cloth_that_is_a_little_short_is_to_be_released_farther_out() -> None:
    """The farther corner lies less than its full displacement off, because the garment is aligned first."""
    first, *_ = judged(folded(short=0.055))
    offered = float(first.hint.split("try ")[1].split(" mm")[0])
    assert "tension" in first.hint and 30.0 < offered < 55.0


def test_a_garment_that_was_dragged_as_a_whole_says_so() -> None:
    (reason,) = judged(folded() + np.array([0.07, 0.0, 0.0]))
    assert "dragged 70 mm away (limit 50 mm)" in reason.what


def test_a_poor_dissimilarity_is_told_with_the_limit_of_a_run() -> None:
    (reason,) = judged(folded(), dissimilarity=0.031)
    assert reason.what == "it misses its target by 31 mm on average (limit 25 mm)"


def test_heights_are_judged_against_the_ideal_fold_alone() -> None:
    high = folded()
    high[:, 2] += 0.030
    assert judged(high) == ()
    reasons = judged(high, ideal=IdealHeights(0.006, 0.010))
    assert [reason.what.split(" 3")[0] for reason in reasons] == ["it stands", "its creases stand"]
    assert judged(high, ideal=IdealHeights(0.033, 0.033)) == (), "such a fabric stands as high when folded ideally"


def test_edges_that_do_not_match_are_told_of_the_plan_and_not_of_the_simulation() -> None:
    """A key point that lies 50 mm off spoils the fold, however well it is made."""
    assert judge_edges(TOWEL, QUARTER.lines, STATE.keypoints, LIMITS.edges) == ()
    wrong = {**STATE.keypoints, "far_left": STATE.keypoints["far_left"] + np.array([0.0, 0.05])}
    reasons = judge_edges(TOWEL, QUARTER.lines, wrong, LIMITS.edges)
    assert reasons and all("far_left" in reason.what and "50 mm apart" in reason.what for reason in reasons)
    assert not any(reason.arc for reason in reasons)


def hands(dropped: tuple[GraspId, ...] = (), **pinches: tuple[int, int]) -> Any:
    reports = {GraspId(name): PinchReport(points, layers) for name, (points, layers) in pinches.items()}
    return SimpleNamespace(pinches=reports, dropped=dropped)


def test_the_hands_that_do_not_hold_what_the_plan_says_are_named() -> None:
    assert judge_hands(QUARTER, hands(left=(10, 2), right=(10, 2))) == ()
    empty, fewer = judge_hands(QUARTER, hands(left=(0, 0), right=(5, 1)))
    assert "closes on no cloth" in empty.what and "takes 1 of 2 layers" in fewer.what
    assert not empty.arc and not fewer.arc, "no other arc helps a grasp"
    (lost,) = judge_hands(QUARTER, hands((GraspId.LEFT,), left=(10, 2), right=(10, 2)))
    assert "loses its cloth" in lost.what and lost.arc
