"""Families of shapes: the shipped templates are members, and a member is found again, also one of a real
garment."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.photographs.real.outlines import bases, flat, warped
from benchmarks.real_outlines import RealGarment, real_garments
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.hardware.photograph import Photograph, in_unit, perceive_photograph
from foldcell.skills.perception.candidate import MOST_UNUSUAL
from foldcell.skills.perception.classify import classify, polygon_iou
from foldcell.skills.perception.family import FAMILIES, best_members
from foldcell.skills.perception.outline import MemberOutline, resample_closed
from foldcell.skills.perception.registration.details.upper_edge import locate_upper_edge
from foldcell.skills.perception.registration.register import register
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
    assert member.unusual < 0.8 * MOST_UNUSUAL


@pytest.mark.parametrize("name", ["t_shirt_round_hem", "shirt_tails", "vest_round_hem", "skirt_wide"])
def test_the_ends_of_a_rounded_hem_are_found(name: str) -> None:
    whole = flat(bases()[name], 0.004)
    like = {"long_sleeve_shirt": "long_sleeve_shirt_small"}.get(whole.category, whole.category)
    (member,) = best_members(whole.outline, [load_garment(like)])
    assert isinstance(member, MemberOutline)
    for side in ("left", "right"):
        placed = member.placed[member.feature == member.keypoints.index(f"hem_{side}")]
        assert np.linalg.norm(placed - whole.keypoints[f"hem_{side}"]) < 0.035 * whole.diagonal_m


def test_a_shirt_that_is_about_as_wide_as_long_is_fitted_upright() -> None:
    """Its moments and its enclosing rectangle do not show how it lies, but its hem and sides do."""
    polo = warped(np.random.default_rng(22), flat(bases()["polo"], 0.004))
    (member,) = best_members(polo.outline, [load_garment("t_shirt")])
    assert isinstance(member, MemberOutline) and polygon_iou(member.placed, polo.outline) > 0.93


def flares() -> np.ndarray:
    """Trousers with wide hips and hems, and a narrow gap with a round end."""
    down = np.linspace(0.0, 1.0, 80)[:, None]
    gap = 0.018 * np.sqrt(np.minimum(down * 0.62 / 0.03, 1.0)) - 0.0108 * down
    half = np.vstack([np.hstack([gap, 0.12 - 0.62 * down]), [[0.2, -0.5], [0.17, 0.0], [0.23, 0.3], [0.17, 0.5]]])
    return np.vstack([half, (half * (-1, 1))[::-1]])


def test_wide_flares_are_usual_proportions() -> None:
    """Bends at hip and knee are no proportions."""
    (member,) = best_members(flares(), [load_garment("pants")])
    assert isinstance(member, MemberOutline) and member.unusual < 0.8 * MOST_UNUSUAL


def test_a_crotch_is_not_below_the_end_of_the_gap_that_is_seen() -> None:
    (member,) = best_members(flares(), [load_garment("pants")])
    assert isinstance(member, MemberOutline)
    low = member.template.copy()
    low[member.keypoints.index("crotch")] -= (0.0, 0.1)
    assert register(flares(), replace(member, template=low)).keypoints["crotch"][1] > 0.115


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_a_skirt_lies_either_way_round(turn: float) -> None:
    whole = flat(bases()["skirt_narrow"], 0.004)
    outline = whole.outline @ rotation(turn).T
    (member,) = best_members(outline, [load_garment("skirt")])
    assert isinstance(member, MemberOutline) and member.turned < 0.3
    waist = member.placed[member.feature == member.keypoints.index("waist_left")]
    assert np.linalg.norm(waist - rotation(turn) @ whole.keypoints["waist_left"]) < 0.05 * whole.diagonal_m


def test_it_is_doubtful_which_end_of_a_skirt_with_two_like_ends_is_the_waist() -> None:
    u = np.linspace(-1.0, 1.0, 60)[:, None]
    side = np.hstack([0.35 * u, 0.22 + 0.02 * (1.0 - u**2)])
    (member,) = best_members(np.vstack([side, -side]), [load_garment("skirt")])
    assert isinstance(member, MemberOutline) and member.turned > 0.35


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


def test_the_deep_neck_of_a_vest_is_where_the_outline_ends() -> None:
    """It is no gap that goes on between two pieces of cloth, although its sides are steep."""
    whole = flat(bases()["vest_round_hem"], 0.004)
    outline = whole.outline * (1.1, 0.8)
    (member,) = best_members(outline, [load_garment("vest")])
    found = register(outline, member).keypoints["neck"]
    assert np.linalg.norm(found - whole.keypoints["neck"] * (1.1, 0.8)) < 0.02 * whole.diagonal_m
