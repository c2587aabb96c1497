"""Families of shapes: the shipped templates are members, and a member is found again, also one of a real
garment."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.real_outlines import RealGarment, real_garments
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.hardware.photograph import Photograph, in_unit, perceive_photograph
from foldcell.skills.perception.candidate import MOST_STRAIN
from foldcell.skills.perception.classify import classify, polygon_iou
from foldcell.skills.perception.family import FAMILIES, best_members
from foldcell.skills.perception.outline import MemberOutline, resample_closed
from foldcell.skills.perception.registration.details.upper_edge import locate_upper_edge
from foldcell.skills.plane import rotation
from tests.scenes import place

FAMILY_GARMENTS = [name for name in list_garments() if load_garment(name).category in FAMILIES]
REAL = {garment.name: garment for garment in real_garments()}


@pytest.mark.parametrize("name", list_garments())
def test_a_shipped_template_is_kept_where_it_fits(name: str) -> None:
    garment = load_garment(name)
    seen = resample_closed(place(garment.template, 0.1, 0.2, 0.7), 0.004)
    assert best_members(seen, [garment]) == [garment]


@pytest.mark.parametrize("swing", [0.35, -0.15])
def test_swung_legs_are_found_again(swing: float) -> None:
    pants = load_garment("pants")
    legs = np.array(pants.template)
    for name, sign in (("near", -1.0), ("far", 1.0)):
        foot = [pants.keypoints.index(f"ankle_{part}_{name}") for part in ("outer", "inner")]
        root = legs[pants.keypoints.index("crotch")]
        legs[foot] = root + (legs[foot] - root) @ rotation(sign * max(swing, -0.05)).T
    seen = resample_closed(place(legs, 0.1, 0.2, 0.7), 0.004)
    (member,) = best_members(seen, [pants])
    assert classify(seen, [member])[0].iou > 0.95 and member.keypoints == pants.keypoints


def laid(garment: RealGarment, points: np.ndarray) -> np.ndarray:
    """Turn places in a garment's picture into the laid pose [m]."""
    turned = points if garment.category == "pants" else np.column_stack([points[:, 1], -points[:, 0]])
    return turned * (0.95 if garment.category == "pants" else 0.66)


@pytest.mark.parametrize("askew", [0.0, 0.1])
@pytest.mark.parametrize("name", REAL)
def test_a_member_fits_a_real_outline_where_the_template_does_not(name: str, askew: float) -> None:
    garment = REAL[name]
    shear = np.array([[1.0, askew], [0.0, 1.0]] if garment.category == "pants" else [[1.0, 0.0], [askew, 1.0]])
    outline, like = laid(garment, garment.outline) @ shear.T, load_garment(garment.like)
    (member,) = best_members(outline, [like])
    assert isinstance(member, MemberOutline)
    assert polygon_iou(member.placed, outline) > 0.93
    marked = laid(garment, np.array(list(garment.keypoints.values()))) @ shear.T
    found = dict(zip(member.keypoints, member.placed[member.feature >= 0], strict=True))
    if garment.category != "pants":
        edge = locate_upper_edge(found, outline, ("right", "left"))
        assert set(edge) == {"shoulder_right", "shoulder_left", "collar_right", "collar_left"}
        found |= {name: place for name, (place, _) in edge.items()}
    diagonal = np.linalg.norm(np.ptp(marked, axis=0))
    errors = {name: np.linalg.norm(found[name] - marked[k]) for k, name in enumerate(garment.keypoints)}
    assert max(errors.values()) < (0.06 if garment.category == "pants" else 0.03) * diagonal


def test_one_unusual_figure_does_not_make_a_real_garment_impossible() -> None:
    """The sleeves of this slim shirt lie beside its body, with round tops far from any straight edge."""
    garment = REAL["long_sleeve_shirt_1"]
    outline = laid(garment, garment.outline) * (0.87, 1.10)
    (member,) = best_members(outline, [load_garment(garment.like)])
    assert isinstance(member, MemberOutline) and polygon_iou(member.placed, outline) > 0.95
    assert member.strain < 0.8 * MOST_STRAIN


@pytest.mark.parametrize("name", ["t_shirt_1", "t_shirt_3", "pants_1"])
def test_a_real_garment_is_recognised_in_a_photograph(name: str) -> None:
    garment = REAL[name]
    pixels = lambda points: np.array([640.0, 830.0]) + 700.0 * points * (1, -1)  # noqa: E731
    mask = np.zeros((960, 1280), np.uint8)
    cv2.fillPoly(mask, [np.round(16 * pixels(garment.outline)).astype(np.int32)], 255, cv2.LINE_AA, 4)
    cover = mask[..., None] / 255.0
    picture = 180.0 * (1.0 - cover) + np.array([60.0, 90.0, 150.0]) * cover
    picture += np.random.default_rng(0).normal(0.0, 2.0, picture.shape)
    photograph = Photograph(np.clip(picture, 0, 255).astype(np.uint8), None, name, "")
    outcome, _ = perceive_photograph(photograph, None, garment.like, "px", load_settings(None))
    seen = outcome.unwrap()
    marked = np.array([pixels(place) for place in garment.keypoints.values()])
    found = np.array([in_unit(seen, seen.state.keypoints[point], "px") for point in garment.keypoints])
    assert np.linalg.norm(found - marked, axis=1).max() < 0.06 * np.linalg.norm(np.ptp(marked, axis=0))
