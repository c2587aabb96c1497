import numpy as np
import pytest
from shapely import Polygon, box

from foldcell.skills.perception.classify import classify, polygon_iou
from foldcell.skills.perception.outline import resample_closed
from tests.builders.silhouettes import Silhouette
from tests.scenes import TOWEL, TOWEL_NAMES, place, shirt, trousers


def template(name, polygon, names=None):
    return Silhouette(name, name, names or tuple(f"p{i}" for i in range(len(polygon))), polygon)


ALL = [template("towel", TOWEL, TOWEL_NAMES), template("shirt", shirt()), template("trousers", trousers())]


@pytest.mark.parametrize("wanted", ALL, ids=lambda t: t.name)
@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi])
def test_each_outline_is_recognised_in_any_orientation(wanted, angle):
    seen = resample_closed(place(wanted.template * (1.04, 0.97), 0.6, 0.0, angle), 0.003)
    ranked = classify(seen, ALL)
    assert ranked[0].garment.name == wanted.name
    assert ranked[0].iou > 0.93 and ranked[1].iou < ranked[0].iou - 0.05


def test_towels_are_distinguished_by_their_size(towels):
    ranked = classify(resample_closed(place(TOWEL * 0.71, 0.6, 0.0, 0.1), 0.003), towels)
    assert ranked[0].garment.name == "small_towel"
    assert ranked[0].scale == pytest.approx(1.0, abs=0.03)


def test_an_unknown_silhouette_matches_no_garment_well():
    star = np.array(
        [
            (r * np.cos(a), r * np.sin(a))
            for a, r in zip(np.arange(10) * np.pi / 5, np.tile([0.35, 0.13], 5), strict=True)
        ]
    )
    assert classify(resample_closed(star, 0.003), ALL)[0].iou < 0.8


def test_the_overlap_agrees_with_exact_geometry():
    a, b = place(TOWEL, 0.0, 0.0, 0.3), np.array(box(-0.1, -0.2, 0.3, 0.25).exterior.coords)[:-1]
    exact = Polygon(a).intersection(Polygon(b)).area / Polygon(a).union(Polygon(b)).area
    assert polygon_iou(a, b) == pytest.approx(exact, abs=0.02)
    assert polygon_iou(a, a) == 1.0


def test_without_templates_there_are_no_matches():
    assert classify(TOWEL, []) == ()
