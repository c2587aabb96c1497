"""Old pictures are told by their pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foldcell.robots.errors import FailureKind
from foldcell.skills.perception.camera_fault import picture_digests, repeated
from tests.scenes import Scene, render


def test_two_pictures_of_a_still_scene_differ_and_a_copy_does_not():
    first, second = (render(Scene(seed=1), sequence=k) for k in (1, 2))
    seen = picture_digests(first)
    assert repeated(second, seen) is None
    again = repeated(replace(first, stamp=99.0, sequence=99), (*seen, *picture_digests(second)))
    assert again is not None and again.kind is FailureKind.CAMERA_FAULT and again.hint


def test_old_colours_with_a_new_depth_are_old_and_so_is_the_reverse():
    first, second = (render(Scene(seed=1), sequence=k) for k in (1, 2))
    assert repeated(replace(second, rgb=first.rgb), picture_digests(first)) is not None
    assert repeated(replace(second, depth=first.depth), picture_digests(first)) is not None


def test_pictures_without_content_are_left_to_other_checks():
    first = render(Scene(seed=1), sequence=1)
    black = replace(first, rgb=np.zeros_like(first.rgb), depth=np.full_like(first.depth, np.nan))
    assert picture_digests(black) == () and repeated(black, picture_digests(black)) is None
