"""The verdict on a fold from its figures: limits, defect and confidence."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.skills.perception.inspection.diagnosis import (
    EDGE_CORNER,
    EDGE_SAG,
    LASTING_DEVIATION,
    MAX_LAG_THIN,
    MAX_LEFT_BEHIND,
    MAX_MISSING,
    MAX_SAG,
    MOST_DOUBT,
    beyond_limits,
    diagnose,
    diagnosed_by_height,
    lasting_defect,
)
from foldcell.skills.perception.inspection.moved_edge import MovedEdge
from foldcell.skills.perception.inspection.result import MAX_PILED_AREA
from foldcell.skills.vocabulary import FoldLine, FoldStep, GraspId
from tests.builders.shipped_settings import INSPECTION
from tests.inspections import inspection

S, K = INSPECTION, FailureKind
LEFT, RIGHT = np.array([0.6, 0.2]), np.array([0.6, -0.2])
STEP = FoldStep(
    "half", 0, FoldLine(np.array([0.6, 0.0]), np.array([0.0, 1.0])), (), {},
    {GraspId.LEFT: np.r_[LEFT, 0.006], GraspId.RIGHT: np.r_[RIGHT, 0.006]},
)  # fmt: skip


def edge(corner=0.0, sag=0.0, unseen=slice(0, 0)):
    """A moved edge of nine strips, with one corner behind, or with a half-sine sag."""
    t = (np.arange(9) + 0.5) / 9
    lag = sag * np.sin(np.pi * t)
    lag[:2] += corner
    lag[unseen] = np.nan
    return MovedEdge(lag, 0.003)


def behind(left=0.0, right=0.0, middle=0.0):
    return {"left": left, "right": right, "middle": middle}


def verdict(step=STEP, **figures):
    return diagnose(inspection(**figures), step, S)


LIMITS = [
    (lambda x: {"edge_deviation_m": x * S.deviation}, K.OFF_TARGET),
    (lambda x: {"edge_deviation_m": -x * S.deviation}, K.OFF_TARGET),
    (lambda x: {"iou_aligned": 1.0 - x * (1.0 - S.iou)}, K.OFF_TARGET),
    (lambda x: {"piled_area_m2": x * MAX_PILED_AREA}, K.PILING),
    (lambda x: {"drift_m": x * S.drift}, K.DRIFT),
    (lambda x: {"drift_rad": x * S.drift_angle}, K.DRIFT),
    (lambda x: {"drift_rad": -x * S.drift_angle}, K.DRIFT),
    (lambda x: {"edge": edge(corner=x * EDGE_CORNER)}, K.DROPPED_CORNER),
    (lambda x: {"edge": edge(sag=x * EDGE_SAG)}, K.SAG),
]  # fmt: skip
"""Each figure as a multiple of its limit, and the defect beyond the limit."""


@pytest.mark.parametrize(("figure", "kind"), LIMITS)
def test_each_single_figure_is_refused_only_beyond_its_limit(figure, kind):
    """The confidence is 0.5 at the limit and 1 from twice the limit on. The confidence of a good fold is at least
    0.5."""
    within, sure = verdict(**figure(0.98))
    assert within is None and 0.5 <= sure <= 1.0
    sureness = [verdict(**figure(x)) for x in (1.02, 1.3, 1.6, 1.9, 2.5)]
    assert {named for named, _ in sureness} == {kind}
    told = [sure for _, sure in sureness]
    assert told[:4] == pytest.approx([0.51, 0.65, 0.80, 0.95], abs=0.02) and told[4] == 1.0


@pytest.mark.parametrize(("figure", "kind"), [*LIMITS[:3], LIMITS[4]])
def test_the_confidence_of_a_good_fold_falls_towards_a_limit(figure, kind):
    assert [verdict(**figure(x))[1] for x in (0.4, 0.7, 0.98)] == pytest.approx([0.80, 0.65, 0.51], abs=0.01)


@pytest.mark.parametrize("share", [0.98, 1.02])
@pytest.mark.parametrize(
    ("seen", "whole"),
    [(None, False), (edge(unseen=slice(0, 3)), False), (edge(unseen=slice(6, 9)), False), (edge(), True)],
)
def test_a_missing_layer_counts_only_if_the_edge_is_not_fully_seen(share, seen, whole):
    """The confidence stays low, because heights are uncertain."""
    named, _ = verdict(missing_layer=share * MAX_MISSING, edge=seen)
    assert named is (K.DROPPED_CORNER if share > 1.0 and not whole else None)
    sureness = [verdict(missing_layer=x * MAX_MISSING, edge=None)[1] for x in (1.02, 1.6, 2.2)]
    assert 0.4 < sureness[0] < sureness[1] < sureness[2] < 0.75


@pytest.mark.parametrize(("share", "refused"), [(0.98, K.OFF_TARGET), (1.02, None)])
def test_cloth_left_behind_determines_the_defect_of_a_bad_outline(share, refused):
    left = share * MAX_LEFT_BEHIND
    bad = {"iou_aligned": 0.8, "edge_place": np.array([0.9, 0.0])}
    assert verdict(**bad, left_behind=behind(left, left, left))[0] is (refused or K.MISSED_LAYER)
    for one in (behind(left=left), behind(right=left)):
        assert verdict(**bad, left_behind={**one, "middle": 0.5 * left})[0] is (refused or K.DROPPED_CORNER)
        assert verdict(left_behind=one)[0] is None, "a good outline is accepted"
    assert verdict(**bad, left_behind={"left": left})[0] is (refused or K.MISSED_LAYER), (
        "a fold with one arm has only one corner"
    )


@pytest.mark.parametrize(("share", "kind"), [(0.98, K.OFF_TARGET), (1.02, K.SAG)])
def test_a_middle_that_lies_behind_both_ends_is_a_sag(share, kind):
    ends = {"left": 0.010, "right": 0.004}
    left = {**ends, "middle": 0.010 + share * MAX_SAG}
    assert verdict(iou_aligned=0.8, edge_place=np.array([0.9, 0.0]), left_behind=left)[0] is kind


@pytest.mark.parametrize(
    ("place", "kind"),
    [
        (LEFT + np.array([0.0, 0.06]), K.DROPPED_CORNER),
        (RIGHT - (0.06, 0.0), K.DROPPED_CORNER),
        (0.5 * (LEFT + RIGHT), K.SAG),
        (0.5 * (LEFT + RIGHT) + (0.13, 0.0), K.SAG),
        (0.5 * (LEFT + RIGHT) + (0.15, 0.0), K.OFF_TARGET),
        (LEFT + np.array([0.0, 0.08]), K.OFF_TARGET),
        (RIGHT - (0.08, 0.0), K.OFF_TARGET),
    ],
)
def test_the_place_of_a_bad_edge_determines_the_defect(place, kind):
    """A deviation near a target is a dropped corner, one between the targets is a sag, and any other is off
    target."""
    figures = {"edge_deviation_m": 0.03, "edge_place": place}
    assert verdict(**figures)[0] is kind
    assert verdict(None, **figures)[0] is K.OFF_TARGET
    assert verdict(FoldStep("half", 0, STEP.line, (), {}, {}), **figures)[0] is K.OFF_TARGET


def test_the_larger_of_two_defects_of_the_moved_edge_is_reported():
    assert verdict(edge=edge(corner=2.0 * EDGE_CORNER, sag=1.1 * EDGE_SAG))[0] is K.DROPPED_CORNER
    assert verdict(edge=edge(corner=1.1 * EDGE_CORNER, sag=2.5 * EDGE_SAG))[0] is K.SAG


@pytest.mark.parametrize(
    ("rise", "noise", "allowed"),
    [(0.005, 1.0, EDGE_CORNER), (0.0018, 1.0, 0.0238), (0.005, 1.2, 0.0234), (0.0012, 1.0, MAX_LAG_THIN),
     (0.005, 2.0, MAX_LAG_THIN)],
)  # fmt: skip
def test_thin_layers_and_short_edges_may_lag_by_more(rise, noise, allowed):
    for lag, kind in ((0.98 * allowed, None), (1.02 * allowed, K.DROPPED_CORNER)):
        lags = np.array([lag] * 2 + [0.0] * 7)
        assert verdict(edge=MovedEdge(lags, rise, noise=noise))[0] is kind


def test_diagnoses_by_height_are_piles_and_lagging_edges_within_a_good_outline():
    """A fold that is refused only by height is pressed and inspected again."""
    for kind, outline, told in (
        (K.PILING, 0.0, True), (K.PILING, 0.03, True), (K.SAG, 0.0, True), (K.DROPPED_CORNER, 0.0, True),
        (K.SAG, 0.03, False), (K.DROPPED_CORNER, 0.03, False), (K.OFF_TARGET, 0.0, False), (K.DRIFT, 0.0, False),
        (K.MISSED_LAYER, 0.0, False), (None, 0.0, False),
    ):  # fmt: skip
        assert diagnosed_by_height(inspection(diagnosis=kind, edge_deviation_m=outline), S) is told
    elsewhere = inspection(diagnosis=K.PILING, iou_aligned=0.83)
    assert not diagnosed_by_height(elsewhere, S), "a pile in a fold of another shape: pressing does not mend it"


def test_a_fold_is_refused_exactly_if_a_figure_is_beyond_its_limit():
    rng, refused = np.random.default_rng(5), 0
    nan = float("nan")

    def about(limit):
        return float(rng.choice([rng.uniform(0.0, 1.2) * limit, nan], p=[0.9, 0.1]))

    for _ in range(600):
        seen = inspection(
            iou_aligned=1.0 - rng.uniform(0.0, 1.1) * (1.0 - S.iou),
            edge_deviation_m=rng.uniform(-1.1, 1.1) * S.deviation,
            piled_area_m2=rng.uniform(0.0, 1.1) * MAX_PILED_AREA,
            drift_m=rng.uniform(0.0, 1.1) * S.drift,
            drift_rad=rng.uniform(-1.1, 1.1) * S.drift_angle,
            missing_layer=about(MAX_MISSING),
            edge=None if rng.random() < 0.3 else edge(about(EDGE_CORNER), about(EDGE_SAG)),
            left_behind={} if rng.random() < 0.3 else behind(*(about(MAX_LEFT_BEHIND) for _ in range(3))),
            edge_place=rng.uniform((0.3, -0.5), (0.9, 0.5)),
        )
        kind, sure = diagnose(seen, STEP, S)
        assert bool(beyond_limits(seen, S)) == (kind is not None)
        assert 0.0 <= sure <= 1.0
        refused += kind is not None
    assert 100 < refused < 500


@pytest.mark.parametrize(
    ("figures", "named"),
    [
        ({"piled_area_m2": 0.0030}, "30 cm2 are more than 15 mm too high (at most 12 cm2)"),
        ({"drift_m": 0.045}, "it lies 45 mm off as a whole (at most 30 mm)"),
        ({"drift_rad": -np.deg2rad(9.0)}, "turned by 9 degrees (at most 6)"),
        ({"edge": edge(corner=0.040)}, "a corner of the moved edge lies 40 mm behind the rest of it"),
        ({"iou_aligned": 0.84}, "overlap 0.84 (at least 0.90)"),
        ({"missing_layer": 0.6}, "a target lacks 60 % of its upper layer's height (at most 45 %)"),
    ],
)
def test_figures_beyond_their_limit_are_reported_with_units(figures, named):
    (told,) = beyond_limits(inspection(**figures), S)
    assert told.startswith(named)


@pytest.mark.parametrize("order", list(itertools.permutations(("left", "right", "middle"))))
@pytest.mark.parametrize(
    ("values", "kind"),
    [
        ({"left": 0.08, "right": 0.07, "middle": 0.075}, FailureKind.MISSED_LAYER),
        ({"left": 0.08, "right": 0.07, "middle": np.nan}, FailureKind.MISSED_LAYER),
        ({"left": 0.08, "right": np.nan, "middle": 0.075}, FailureKind.OFF_TARGET),
        ({"left": np.nan, "right": np.nan, "middle": 0.08}, FailureKind.OFF_TARGET),
        ({"left": 0.08, "right": 0.0, "middle": np.nan}, FailureKind.DROPPED_CORNER),
    ],
)
def test_places_that_are_not_seen_have_the_same_effect_in_any_order(order, values, kind):
    """A missed layer needs both grasps to be seen: one of them may as well have a dropped corner beside it."""
    seen = inspection(edge_deviation_m=0.05, iou_aligned=0.7, left_behind={name: values[name] for name in order})
    assert diagnose(seen, None, INSPECTION)[0] is kind


def uneven(sag, scatter):
    """A sagging edge whose strips lie alternately before and behind it."""
    t = (np.arange(9) + 0.5) / 9
    return MovedEdge(sag * np.sin(np.pi * t) + scatter * np.resize([1.0, -1.0], 9), 0.003)


@pytest.mark.parametrize(
    ("figures", "kind"),
    [
        ({"piled_area_m2": 2.0 * MAX_PILED_AREA}, None),
        ({"drift_m": 2.0 * S.drift, "drift_rad": 2.0 * S.drift_angle}, None),
        ({"edge_deviation_m": 0.99 * LASTING_DEVIATION}, None),
        ({"edge_deviation_m": 1.01 * LASTING_DEVIATION}, K.OFF_TARGET),
        ({"piled_area_m2": 2.0 * MAX_PILED_AREA, "edge": edge(corner=0.03)}, K.DROPPED_CORNER),
        ({"drift_m": 2.0 * S.drift, "iou_aligned": 0.8, "edge_place": np.array([0.9, 0.0])}, K.OFF_TARGET),
        ({"edge": edge(sag=1.1 * EDGE_SAG)}, K.SAG),
        ({"edge": uneven(2.0 * EDGE_SAG, 0.008)}, K.SAG),
        ({"edge": uneven(1.3 * EDGE_SAG, 0.008), "missing_layer": 1.1 * MAX_MISSING}, K.DROPPED_CORNER),
    ],
)
def test_only_a_measured_defect_of_the_shape_lasts_under_the_next_fold(figures, kind):
    """The last look shows heights and place."""
    seen = inspection(**figures)
    assert diagnose(seen, STEP, S)[0] is not None, "the inspection refuses all of them"
    assert lasting_defect(seen, STEP, S) is kind


@pytest.mark.parametrize(
    ("noise", "missing", "kind"), [(2.2, 0.18, None), (2.2, 0.4, K.DROPPED_CORNER), (1.5, 0.18, K.DROPPED_CORNER)]
)
def test_a_corner_of_a_short_edge_is_dropped_only_if_its_cloth_is_missing(noise, missing, kind):
    seen = inspection(edge=replace(edge(corner=0.058), noise=noise), missing_layer=missing)
    assert diagnose(seen, STEP, S)[0] is kind


def test_a_sag_of_a_short_edge_counts_although_its_corners_do_not():
    seen = inspection(edge=replace(uneven(0.060, 0.001), noise=2.2), missing_layer=0.1)
    assert diagnose(seen, STEP, S)[0] is lasting_defect(seen, STEP, S) is K.SAG


def test_an_uneven_edge_that_sags_far_is_a_defect_however_uneven_it_is():
    seen = inspection(edge=uneven(0.075, 0.020))
    assert seen.edge.sag > EDGE_SAG + MOST_DOUBT and seen.edge.sag_error > 0.5 * seen.edge.sag
    assert diagnose(seen, STEP, S)[0] is K.SAG


def test_a_thin_edge_that_is_measured_unevenly_does_not_sag():
    """The strips of a good hem (T-shirt 7359, two layers that raise the surface by 1.24 mm). Smooth thin edges and
    uneven thick ones still sag."""
    lag = 1e-3 * np.array([-2.0, -2.0, 46.0, 54.0, -4.0, 24.0, 50.0, -4.0, -6.0])
    hem = MovedEdge(lag, 0.00124, noise=1.64)
    assert hem.sag > 0.050 and diagnose(inspection(edge=hem), STEP, S)[0] is None
    smooth = MovedEdge(0.050 * np.sin(np.pi * (np.arange(9) + 0.5) / 9), 0.00124, noise=1.64)
    for sagging in (smooth, MovedEdge(lag, 0.003)):
        assert diagnose(inspection(edge=sagging), STEP, S)[0] is K.SAG


def test_a_sag_within_its_standard_error_of_the_limit_is_no_defect():
    """Edges of thin shirts that lay well seemed to sag by 30.3 to 34.4 mm, with standard errors of 7 to 8 mm."""
    seen = inspection(edge=uneven(1.3 * EDGE_SAG, 0.008))
    assert diagnose(seen, STEP, S)[0] is None and lasting_defect(seen, STEP, S) is None
    assert not [text for text in beyond_limits(seen, S) if "middle" in text]
    clear = inspection(edge=uneven(1.3 * EDGE_SAG, 0.001))
    assert diagnose(clear, STEP, S)[0] is lasting_defect(clear, STEP, S) is K.SAG
