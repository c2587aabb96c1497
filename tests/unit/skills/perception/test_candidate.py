"""Whether a member of a family that fits an outline is a plausible garment."""

from dataclasses import replace

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.perception.candidate import flatness, misfit
from foldcell.skills.perception.family import best_members
from foldcell.skills.perception.outline import MemberOutline, resample_closed
from foldcell.skills.perception.registration.register import register
from foldcell.skills.perception.segmentation.mask import Segmentation
from foldcell.skills.vocabulary import Failure, FailureKind
from tests.builders.shipped_settings import PERCEPTION


@pytest.fixture(scope="module")
def drooping():
    """A T-shirt with drooping sleeves: its outline, and the member of the family that fits it."""
    shirt = load_garment("t_shirt")
    points = {name: np.array(p) for name, p in zip(shirt.keypoints, shirt.template, strict=True)}
    for side, sign in (("right", -1), ("left", 1)):
        points[f"cuff_upper_{side}"] = np.array([0.08, sign * 0.36])
        points[f"cuff_lower_{side}"] = np.array([0.01, sign * 0.27])
    outline = resample_closed(np.array(list(points.values())), 0.003)
    (member,) = best_members(outline, [shirt])
    assert isinstance(member, MemberOutline)
    return outline, member


def test_a_member_with_usual_figures_is_accepted(drooping):
    outline, member = drooping
    assert misfit(register(outline, member), member, outline, free=True, named=True) is None


def test_a_member_with_impossible_figures_is_refused_although_it_overlaps(drooping):
    outline, member = drooping
    strange = replace(member, unusual=2.0)
    failure = misfit(register(outline, strange), strange, outline, free=True, named=True)
    assert failure is not None and failure.kind is FailureKind.UNKNOWN_GARMENT
    assert "proportions that no such garment has" in failure.what


def test_the_refusal_of_a_missing_corner_names_its_key_point(drooping):
    outline, member = drooping
    straight = replace(register(outline, member), least_turn=0.1, straightest="cuff_lower_left")
    failure = misfit(straight, member, outline, free=True, named=True)
    assert failure is not None and failure.values["keypoint"] == "cuff_lower_left"
    assert "corner at the cuff_lower_left of t_shirt" in failure.what


@pytest.mark.parametrize(("share", "kind"), [(0.25, FailureKind.NOT_FLAT), (0.85, None)])
def test_a_sleeve_much_smaller_than_the_other_is_folded_over(drooping, share, kind):
    outline, member = drooping
    whole = register(outline, member)
    root = 0.5 * (whole.keypoints["shoulder_left"] + whole.keypoints["armpit_left"])
    cuff = {n: root + share * (whole.keypoints[n] - root) for n in ("cuff_upper_left", "cuff_lower_left")}
    folded = replace(whole, keypoints={**whole.keypoints, **cuff})
    failure = misfit(folded, member, outline, free=True, named=True)
    assert (failure and failure.kind) is kind
    if failure is not None:
        assert failure.what.startswith("the left sleeve is only ")


def test_four_corners_are_no_towel_unless_one_was_named():
    """A barrel has the corners of a towel and bulging sides."""
    towel = load_garment("medium_towel")
    u = np.linspace(-1.0, 1.0, 40)[:, None]
    size = 0.5 * np.ptp(towel.template, axis=0)
    sides = [np.hstack([u, -1.0 - 0.14 * (1 - u**2)]), np.hstack([1.0 + 0.0 * u, u])]
    outline = resample_closed(np.vstack([*sides, *(-side for side in sides)]) * size, 0.003)
    found = register(outline, towel)
    assert misfit(found, towel, outline, free=True, named=True) is None
    failure = misfit(found, towel, outline, free=True, named=False)
    assert failure is not None and failure.kind is FailureKind.UNKNOWN_GARMENT


@pytest.mark.parametrize(
    ("size_known", "clear", "kind"),
    [(False, 1.0, FailureKind.NOT_FLAT), (False, 0.7, FailureKind.UNKNOWN_GARMENT),
     (True, 1.0, FailureKind.UNKNOWN_GARMENT)],
)  # fmt: skip
def test_a_clear_outline_of_no_flat_garment_is_not_flat_where_there_is_no_depth(size_known, clear, kind):
    region = Segmentation(np.ones((4, 4), bool), np.zeros((8, 2)), clear, np.zeros((4, 4), bool))
    failure = Failure(FailureKind.UNKNOWN_GARMENT, "the silhouette is not that of t_shirt")
    judged = flatness(failure, region, replace(PERCEPTION, size_known=size_known))
    assert judged.kind is kind and failure.what in judged.what
