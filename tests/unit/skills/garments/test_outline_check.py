"""One set of rules for outlines: a garment file and key points placed in a picture are refused alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from foldcell.cell.config.garments.garment_file import load_garment, shipped_garment_path
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.garments.key_point_check import check_key_points
from foldcell.skills.garments.outline_check import crosses_itself, impossible_size, runs_clockwise, same_places
from foldcell.skills.garments.picture_measure import PictureMeasure

SHIRT = load_garment("t_shirt")
NAMES = SHIRT.keypoints


def file_error(folder: Path, template: np.ndarray) -> str:
    data = yaml.safe_load(shipped_garment_path("t_shirt").read_text(encoding="utf-8"))
    middle = (template.min(axis=0) + template.max(axis=0)) / 2
    data["keypoints"] = {
        n: [float(v) for v in p] for n, p in zip(NAMES, template - middle, strict=True)
    }  # fmt: skip
    file = folder / "mine.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    try:
        load_garment(str(file))
    except ConfigurationError as e:
        return e.what
    return ""


def picture_errors(template: np.ndarray) -> list[str]:
    pixels = dict(zip(NAMES, np.array([900.0, 900.0]) - 500.0 * template[:, ::-1], strict=True))
    length = float(np.linalg.norm(template[0] - template[1]))
    found = check_key_points(pixels, SHIRT, PictureMeasure(1800, 1800, (0, 1), length))
    return [finding.what for finding in found if finding.refused]


@pytest.mark.parametrize("near", [0.0, 5e-4])
def test_a_key_point_given_twice_is_refused_by_both(tmp_path: Path, near: float) -> None:
    """A ZeroDivisionError in the middle of a fold was the first to notice it."""
    twice = np.array(SHIRT.template)
    twice[3] = twice[2] + near
    words = f"{NAMES[2]} and {NAMES[3]} lie at the same place"
    assert words in file_error(tmp_path, twice)
    assert picture_errors(twice) == [words]


@pytest.mark.parametrize("factor", [0.04, 8.0])
def test_an_impossible_size_is_refused_by_both(tmp_path: Path, factor: float) -> None:
    template = np.array(SHIRT.template) * factor
    assert "possible" in file_error(tmp_path, template) or "allowed" in file_error(tmp_path, template)
    pixels = dict(zip(NAMES, np.array([900.0, 900.0]) - 500.0 * np.array(SHIRT.template)[:, ::-1], strict=True))
    length = float(np.linalg.norm(template[0] - template[1]))
    (found,) = check_key_points(pixels, SHIRT, PictureMeasure(1800, 1800, (0, 1), length))
    assert found.refused and "possible" in found.what


@given(st.lists(st.tuples(*[st.integers(-3, 3)] * 2), min_size=3, max_size=7))
def test_what_passes_is_a_simple_polygon_without_edges_of_no_length(corners: list[tuple[int, int]]) -> None:
    points = 0.1 * np.array(corners, dtype=float)
    names = [f"p{i}" for i in range(len(points))]
    refused = (
        same_places(points, names) or crosses_itself(points) or runs_clockwise(points) or impossible_size(points)
    )
    if not refused:
        after = np.roll(points, -1, axis=0)
        assert np.linalg.norm(after - points, axis=1).min() > 0.0
        assert 0.5 * np.sum(points[:, 0] * after[:, 1] - after[:, 0] * points[:, 1]) >= 1e-3


def test_a_place_that_is_shared_is_found_wherever_it_stands_in_the_list() -> None:
    points = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.4], [0.0, 0.4]])
    points[2] = points[0]
    assert same_places(points, ["a", "b", "c", "d"]) == [("a", "c")]
