"""Which key points are sought in the picture."""

import cv2
import numpy as np

from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.details.picture_refinement import refine_by_picture
from foldcell.skills.perception.registration.register import register
from tests.builders.silhouettes import Silhouette

PIXEL = 0.004
HALF = {"bottom_right": (0.2, 0.05), "armpit_right": (0.2, 0.35), "cuff_lower_right": (0.35, 0.3),
        "cuff_upper_right": (0.38, 0.42), "shoulder_right": (0.15, 0.55)}  # fmt: skip


def test_a_garment_file_may_name_the_corners_of_a_shirt_as_it_likes() -> None:
    names = (*HALF, *(name.replace("right", "left") for name in reversed(HALF)))
    right = np.array(list(HALF.values()))
    corners = np.concatenate([right, right[::-1] * (-1, 1)]) + np.array([0.4, 0.0])
    mask = np.zeros((160, 200), np.uint8)
    cv2.fillPoly(mask, [np.round(corners / PIXEL).astype(np.int32)], 1)
    contour = max(cv2.findContours(mask, 0, cv2.CHAIN_APPROX_NONE)[0], key=len).reshape(-1, 2) * PIXEL
    rgb = np.where(mask[..., None] > 0, np.uint8(60), np.uint8(150)).repeat(3, axis=2)
    picture = ClothPicture(rgb, mask > 0, lambda p: p / PIXEL, rgb, lambda p: p / PIXEL)
    blouse = Silhouette("blouse", "blouse", names, corners)
    by_outline = register(contour, blouse)
    refined = refine_by_picture(by_outline, blouse, contour, picture)
    assert np.array_equal(refined.keypoints["shoulder_right"], by_outline.keypoints["shoulder_right"])
