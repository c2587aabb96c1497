"""`foldcell perceive` on photographs of an unknown camera, and the keys of its JSON result."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.photographs.judge import judge
from benchmarks.photographs.real.photograph import draw
from foldcell.cell.commands.main import main
from foldcell.cell.commands.skill.perceive import SURE, doubts
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.hardware.photograph import perceive_photograph, read_photograph

KEYS = {"category", "confidence", "keypoints", "unit", "accepted", "reason", "contour"}


def photograph(path: Path, size: tuple[int, int], garment: bool = True) -> np.ndarray:
    """A uniform table with a uniform towel, and the towel's corners (4, 2) [pixels]."""
    w, h = size
    image = np.clip(np.random.default_rng(0).normal(170, 2, (h, w, 3)), 0, 255).astype(np.uint8)
    corners = np.array([[0.3, 0.25], [0.72, 0.22], [0.74, 0.71], [0.31, 0.75]]) * size
    if garment:
        cv2.fillPoly(image, [np.round(corners * 16).astype(np.int32)], (60, 90, 150), cv2.LINE_AA, 4)
    cv2.imwrite(str(path), image)
    return corners


@pytest.mark.parametrize("size", [(1280, 960), (900, 700)])
def test_key_points_of_a_photograph_are_in_pixels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], size: tuple[int, int]
) -> None:
    corners = photograph(tmp_path / "towel.png", size)
    assert main(["perceive", str(tmp_path / "towel.png"), "--unit", "px", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert set(answer) >= KEYS and "keypoints_m" not in answer
    assert answer["unit"] == "px" and answer["accepted"] and answer["category"] == "towel"
    found = np.array(list(answer["keypoints"].values()))
    assert max(np.linalg.norm(found - c, axis=1).min() for c in corners) < 0.01 * size[0]


def test_a_doubtful_answer_says_how_to_correct_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A sure answer to the picture of a towel, and the same one with the confidence of a doubtful one."""
    photograph(tmp_path / "towel.png", (900, 700))
    assert main(["perceive", str(tmp_path / "towel.png"), "--unit", "px"]) == 0
    assert "\ndoubt " not in capsys.readouterr().out
    picture, settings = read_photograph(tmp_path / "towel.png", None), load_settings(None)
    perception = perceive_photograph(picture, None, "auto", "px", settings, lambda _: None)[0].unwrap()
    doubtful = replace(perception, state=replace(perception.state, confidence=SURE - 0.01))
    (doubt,) = doubts(doubtful)
    assert "confidence 0.69" in doubt and "garment new --edit" in doubt


def test_a_refused_picture_has_the_same_json_keys_and_a_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photograph(tmp_path / "table.png", (640, 480), garment=False)
    assert main(["perceive", str(tmp_path / "table.png"), "--unit", "px", "--json"]) == 2
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert set(answer) >= KEYS
    assert not answer["accepted"] and answer["reason"] == "no_garment" and answer["keypoints"] == {}


def test_an_identical_picture_is_refused_as_the_empty_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photograph(tmp_path / "towel.png", (640, 480))
    image = str(tmp_path / "towel.png")
    assert main(["perceive", image, "--reference", image, "--unit", "px", "--json"]) == 2
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["reason"] == "camera_fault" and "twice" in answer["failure"]["hint"]


@pytest.mark.parametrize(("kind", "seed"), [("towel", 6), ("skirt", 47), ("shorts", 11), ("vest", 5)])
def test_garments_in_independently_drawn_photographs_are_measured(kind: str, seed: int) -> None:
    """The camera is unknown, the light is uneven, and clutter lies about. Right: all key points are within 2 % of
    the garment's diagonal."""
    picture = draw(seed)
    assert picture.garment.category == kind
    seen = judge(picture)
    assert seen.accepted and seen.right


@pytest.mark.parametrize(("due", "seed"), [("folded", 12), ("heap", 212)])
def test_a_garment_that_is_not_flat_is_refused_with_a_hint(due: str, seed: int) -> None:
    picture = draw(seed)
    assert picture.details["due"] == due
    failure = judge(picture).failure
    assert failure is not None and "spread" in failure


def test_the_second_best_garment_is_told_if_none_was_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photograph(tmp_path / "towel.png", (640, 480))
    command = ["perceive", str(tmp_path / "towel.png"), "--unit", "px"]
    assert main([*command, "--json"]) == 0
    second = json.loads(capsys.readouterr().out.splitlines()[-1])["second_best"]
    assert second["category"] == "skirt" and second["garment"] == "skirt" and 0.01 < second["behind"] < 0.3
    assert main(command) == 0
    assert f"second best skirt (skirt), {second['behind']:.2f} less alike" in capsys.readouterr().out
    assert main([*command, "--garment", "medium_towel", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["second_best"] is None


@pytest.mark.parametrize(
    ("garment", "reason"), [("t_shirt", "not_flat"), ("medium_towel", "out_of_view")], ids=["misfit", "cut"]
)
def test_a_refusal_draws_and_names_the_missing_key_point(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], garment: str, reason: str
) -> None:
    photograph(tmp_path / "whole.png", (640, 480))
    picture = cv2.imread(str(tmp_path / "whole.png"))
    cut = picture if reason == "not_flat" else np.ascontiguousarray(picture[:, 230:])
    cv2.imwrite(str(tmp_path / "towel.png"), cut)
    command = ["perceive", str(tmp_path / "towel.png"), "--unit", "px", "--garment", garment]
    assert main([*command, "--json"]) == 2
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    name, expected = answer["missing"]["keypoint"], answer["missing"]["expected"]
    assert answer["reason"] == reason and name in load_garment(garment).keypoints
    drawn_over = cv2.imread(answer["overlay"])
    column, row = np.clip(np.round(expected).astype(int), 0, (cut.shape[1] - 1, cut.shape[0] - 1))
    blue, green, red = drawn_over[row, column].astype(int)
    assert red > 180 > max(blue, green) + 60, "a red cross stands there"
    assert main(command) == 2
    assert f"where {name} was expected" in capsys.readouterr().out


def test_a_print_is_not_taken_for_a_towel(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photograph(tmp_path / "towel.png", (640, 480), garment=False)
    picture = cv2.imread(str(tmp_path / "towel.png"))
    rest = np.array([[180, 70], [470, 60], [500, 240], [330, 420], [150, 330]])  # no garment has this outline
    cv2.fillPoly(picture, [rest.astype(np.int32)], (50, 60, 40), cv2.LINE_AA)
    cv2.rectangle(picture, (240, 140), (400, 260), (90, 60, 200), -1)
    cv2.imwrite(str(tmp_path / "towel.png"), picture)
    assert main(["perceive", str(tmp_path / "towel.png"), "--unit", "px", "--json"]) == 2
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["reason"] == "not_flat"


@pytest.mark.parametrize("command", ["perceive", "garment new --like medium_towel --unit m"])
def test_a_picture_that_was_not_searched_is_not_said_to_show_a_garment(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    photograph(tmp_path / "towel.png", (640, 480))
    cv2.imwrite(str(tmp_path / "depth.png"), np.full((480, 640), 5200, np.uint16))
    assert main([*command.split(), "towel.png", "--depth", "depth.png"]) == 2
    told = capsys.readouterr().out
    assert "the picture as given" in told and "what was taken for the garment" not in told
    assert "divide it by" in told, "the hint is that of the refusal"
