"""Rendered pictures, shared by the tests of this folder."""

import functools

import pytest

from tests.builders.silhouettes import Silhouette
from tests.scenes import TOWEL, TOWEL_NAMES, Scene, camera, empty, render, towel_scene


@functools.cache
def _towel(seed):
    scene, truth = towel_scene(seed)
    return scene, truth, render(scene), empty(scene)


@functools.cache
def _bare():
    return empty(Scene(seed=0))


@pytest.fixture
def towel_picture():
    """For a seed: (scene, true key points, picture, picture of the empty table)."""
    return _towel


@pytest.fixture
def bare_table():
    """A picture of an empty table."""
    return _bare()


@pytest.fixture(scope="session")
def calibration():
    return camera()


@pytest.fixture(scope="session")
def towels():
    sizes = {"medium_towel": (0.40, 0.60), "large_towel": (0.50, 0.80), "small_towel": (0.30, 0.42)}
    return [Silhouette(name, "towel", TOWEL_NAMES, TOWEL * (x / 0.40, y / 0.60)) for name, (x, y) in sizes.items()]
