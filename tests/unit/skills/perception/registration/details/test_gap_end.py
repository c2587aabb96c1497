"""The gap between two drawn pieces of cloth, whose end is known.

The pixels are 2 mm wide, as in the table's view.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.details.gap_end import HOLLOW, NARROW, locate_gap_end
from foldcell.skills.perception.registration.details.picture_refinement import refine_by_picture
from foldcell.skills.perception.registration.register import register
from tests.builders.silhouettes import Silhouette
from tests.scenes import TROUSERS_NAMES, trousers

PIXEL, FINER = 0.002, 5
TIP = np.array([0.05, 0.003])
"""True end of the gap, which runs along x [m]."""
OPENING = np.array([0.42, 0.003])
CLOTH, TABLE = np.array([40.0, 60.0, 120.0]), np.array([150.0, 120.0, 90.0])


def legs(growth, cloth=CLOTH, table=TABLE, shade=0.0, resolved=0.008, stripes=0.0, rounded=0.0):
    """Two legs, at x from 0 to 0.4 m, with a wedge of table between them.

    growth: of the wedge's width. shade: share of light that the legs take from a narrow gap. resolved: the
    segmentation closes a gap narrower than this [m]. stripes: brightness of stripes, relative to the cloth.
    rounded: radius of the rounding of the wedge's tip [m].
    """
    rows, columns = 120 * FINER, 230 * FINER
    y, x = np.mgrid[:rows, :columns] * (PIXEL / FINER) - 0.5 * PIXEL * (1 - 1 / FINER)
    y = y - 0.12
    u = np.maximum(x - TIP[0], 0.0)
    width = growth * np.sqrt(u * (u + 2.0 * rounded))
    is_cloth = (np.abs(y - TIP[1]) >= 0.5 * width) & (x < 0.4)
    light = 1.0 - shade * np.exp(-width / 0.01)
    pattern = 1.0 + stripes * (np.sin(2 * np.pi * (x + 0.4 * y) / 0.03) > 0)
    fine = np.where(is_cloth[..., None], pattern[..., None] * cloth, light[..., None] * table)
    rgb = cv2.resize(fine, (columns // FINER, rows // FINER), interpolation=cv2.INTER_AREA)
    rgb = cv2.GaussianBlur(rgb, (0, 0), 0.8) + np.random.default_rng(0).normal(0, 2.0, rgb.shape)
    coarse = (np.abs(y - TIP[1]) >= 0.5 * np.where(width > resolved, width, 0.0)) & (x < 0.4)
    mask = coarse[FINER // 2 :: FINER, FINER // 2 :: FINER]
    shown = np.clip(rgb, 0, 255).astype(np.uint8)

    def pixels(points):
        return (points + np.array([0.0, 0.12])) / PIXEL

    return ClothPicture(shown, mask, pixels, shown, pixels)


def found(picture, guess, opening=OPENING, growth=0.12, *options):
    """The end of a gap that is seen: its distance from the tip of the wedge, and the stated error [m]."""
    end = locate_gap_end(picture, guess, opening, growth, *options)
    assert end is not None
    return np.linalg.norm(end[0] - TIP), end[1]


@pytest.mark.parametrize("guess", [-0.03, 0.0, 0.03])
@pytest.mark.parametrize("growth", [0.1, 0.2, 0.35])
def test_the_gap_ends_at_the_tip_of_the_wedge(growth, guess):
    off, sigma = found(legs(growth), TIP + np.array([guess, 0.002]))
    assert off < 0.004 and sigma < 0.010


@pytest.mark.parametrize("shade", [0.3, 0.6])
@pytest.mark.parametrize(
    ("cloth", "table"), [(CLOTH, TABLE), (np.full(3, 20.0), np.full(3, 170.0)), (TABLE, CLOTH)]
)
def test_the_shade_between_the_legs_does_not_hide_the_end(cloth, table, shade):
    assert found(legs(0.13, cloth, table, shade), TIP + np.array([0.02, 0.0]))[0] < 0.010


def test_the_gap_is_followed_in_patterned_cloth():
    assert found(legs(0.15, stripes=0.5), TIP + np.array([-0.02, 0.0]))[0] < 0.008


def test_a_narrow_gap_is_less_certain_than_a_wide_one():
    sigmas = [found(legs(growth), TIP)[1] for growth in (0.08, 0.15, 0.3)]
    assert sigmas == sorted(sigmas, reverse=True)


def test_no_end_is_found_where_no_gap_is_seen():
    assert locate_gap_end(legs(0.0), TIP, OPENING, 0.12) is None
    assert locate_gap_end(legs(0.15, CLOTH, CLOTH + 5.0), TIP, OPENING, 0.12) is None


def test_a_gap_that_is_wide_as_far_as_it_is_followed_has_no_end():
    assert locate_gap_end(legs(0.35), TIP + np.array([0.15, 0.0]), OPENING, 0.12) is None


@pytest.mark.parametrize("guess", [-0.01, 0.008, 0.018])
@pytest.mark.parametrize(("rounded", "error"), [(0.0, 0.006), (0.008, 0.003), (0.012, 0.004)])
@pytest.mark.parametrize("growth", [0.7, 1.0])
def test_the_narrow_corner_between_sleeve_and_body_is_followed_to_its_end(growth, rounded, error, guess):
    """The segmentation fills the corner up to where it is 15 mm wide. The corner is sharp, round or blunt."""
    picture = legs(growth, resolved=0.015, rounded=rounded)
    off, sigma = found(picture, TIP + np.array([guess, 0.001]), OPENING, growth, HOLLOW)
    assert off < error and sigma < 0.004


def test_the_camera_s_own_picture_is_used_where_it_is_finer():
    """In the view, whose pixels show only stripes, the gap is invisible."""
    picture = legs(0.12)
    blank = np.zeros_like(picture.rgb)
    assert locate_gap_end(replace(picture, rgb=blank, photo=blank), TIP, OPENING, 0.12) is None
    assert found(replace(picture, rgb=blank), TIP)[0] < 0.005


def test_lengths_follow_the_size_of_the_garment():
    """The same picture, at a scale where all lengths are half as long."""
    picture = legs(0.15)

    def halved(points):
        return picture.to_pixel(2.0 * points)

    half = replace(picture, to_pixel=halved, to_photo=halved)
    guess = TIP + np.array([0.02, 0.0])
    whole = locate_gap_end(picture, guess, OPENING, 0.12)
    small = locate_gap_end(half, 0.5 * guess, 0.5 * OPENING, 0.12, NARROW, 0.5)
    assert whole is not None and small is not None
    np.testing.assert_allclose(2.0 * small[0], whole[0], atol=1e-4)
    assert 2.0 * small[1] == pytest.approx(whole[1], rel=0.01)


def test_a_crotch_that_is_higher_than_the_template_s_is_found():
    """The legs of these trousers are 30 mm longer than those of the template, from the crotch down."""
    truth = trousers()
    names, k = TROUSERS_NAMES, TROUSERS_NAMES.index("crotch")
    template = truth.copy()
    waist = template[[names.index(n) for n in names if n.startswith("waist")]].mean(axis=0)
    template[k] += 0.03 * (template[k] - waist) / np.linalg.norm(waist - template[k])
    low = truth.min(axis=0) - 0.05
    size = np.ceil((np.ptp(truth, axis=0) + 0.1) / PIXEL).astype(int)

    def pixels(points):
        return (points - low) / PIXEL

    fine = np.zeros((size[1] * FINER, size[0] * FINER), np.uint8)
    cv2.fillPoly(fine, [np.round(((pixels(truth) + 0.5) * FINER - 0.5) * 16).astype(np.int32)], 255, cv2.LINE_8, 4)
    cover = cv2.resize(fine, (int(size[0]), int(size[1])), interpolation=cv2.INTER_AREA) / 255.0
    rgb = cv2.GaussianBlur(cover[..., None] * CLOTH + (1 - cover[..., None]) * TABLE, (0, 0), 0.8)
    mask = cv2.morphologyEx((cover > 0.5).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)) > 0
    contour = max(cv2.findContours(mask.astype(np.uint8), 0, cv2.CHAIN_APPROX_NONE)[0], key=len).reshape(-1, 2)
    garment = Silhouette("pants", "pants", names, template)
    by_outline = register(contour * PIXEL + low, garment)
    shown = rgb.astype(np.uint8)
    picture = ClothPicture(shown, mask, pixels, shown, pixels)
    refined = refine_by_picture(by_outline, garment, contour * PIXEL + low, picture)
    assert np.linalg.norm(refined.keypoints["crotch"] - truth[k]) < 0.008
    assert np.any(np.all(refined.contour == refined.keypoints["crotch"], axis=1))
    assert {n: p for n, p in refined.keypoints.items() if n != "crotch"} == {
        n: p for n, p in by_outline.keypoints.items() if n != "crotch"
    }
