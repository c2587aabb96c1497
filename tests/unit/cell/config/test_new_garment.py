"""`foldcell garment new`: a garment file from a photograph."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from foldcell.cell.commands.main import main
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.photograph import Photograph, picture_measure
from foldcell.cell.operator.key_points.editing import KeyPointEdit
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.perception.rectification.table_view import TableView

OWN = {  # a user's T-shirt [m]: longer and narrower than the shipped one, with shorter sleeves
    "hem_right": (-0.36, -0.22), "armpit_right": (0.13, -0.22), "cuff_lower_right": (0.08, -0.34),
    "cuff_upper_right": (0.21, -0.40), "shoulder_right": (0.31, -0.19), "collar_right": (0.36, -0.08),
    "collar_left": (0.36, 0.08), "shoulder_left": (0.31, 0.19), "cuff_upper_left": (0.21, 0.40),
    "cuff_lower_left": (0.08, 0.34), "armpit_left": (0.13, 0.22), "hem_left": (-0.36, 0.22),
}  # fmt: skip
METRE = 1050.0
"""Picture size [pixels]."""


def photograph(path: Path, points: np.ndarray, angle: float) -> None:
    """The cloth on a uniform table, seen from straight above. Table x points up in the picture, y to the left."""
    image = np.clip(np.random.default_rng(0).normal(170, 2, (960, 1280, 3)), 0, 255).astype(np.uint8)
    c, s = np.cos(angle), np.sin(angle)
    xy = points @ np.array([[c, s], [-s, c]])
    pixels = np.column_stack([640 - METRE * xy[:, 1], 480 - METRE * xy[:, 0]])
    cv2.fillPoly(image, [np.round(pixels * 16).astype(np.int32)], (60, 90, 150), cv2.LINE_AA, 4)
    cv2.imwrite(str(path), image)


@pytest.fixture
def shirt(tmp_path: Path) -> Path:
    path = tmp_path / "My Shirt.png"
    photograph(path, np.array(list(OWN.values())), 0.15)
    return path


def answer(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    return dict(json.loads(capsys.readouterr().out.splitlines()[-1]))


def test_a_new_shirt_is_made_from_a_photograph(
    shirt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "foldcell.cell.hardware.placement.fitting_poses", lambda *_: None
    )  # planning a shirt takes long
    hem = ["--between", "hem_right,hem_left", "--length", "0.44"]
    line = ["garment", "new", str(shirt), "--like", "t_shirt", *hem]
    assert main([*line, "--json"]) == 0
    told = answer(capsys)
    assert Path(told["file"]) == Path("my_shirt.yaml") and (tmp_path / "my_shirt-perceived.png").exists()
    own, like = load_garment(tmp_path / "my_shirt.yaml"), load_garment("t_shirt")
    true = np.array([OWN[name] for name in own.keypoints])
    assert np.linalg.norm(own.template - true, axis=1).max() < 0.010
    assert own.plan == like.plan and own.title == "My shirt"
    assert own.material.stretch_fraction == pytest.approx(like.material.stretch_fraction, rel=1e-3)
    assert set(own.material.assumed) == set(like.material.assumed)
    assert own.poses == like.poses
    capsys.readouterr()
    assert main(line) == 64 and "exists" in capsys.readouterr().err, "an existing file is not overwritten"
    assert main([*line, "--replace"]) == 0 and "next" in capsys.readouterr().out


def test_a_new_towel_lies_where_this_cell_folds_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table ends where the towel after --like would lie."""
    monkeypatch.chdir(tmp_path)
    width, depth = 0.34, 0.26
    corners = 0.5 * np.array([[-depth, -width], [depth, -width], [depth, width], [-depth, width]])
    photograph(tmp_path / "cloth.png", corners, 0.1)
    (tmp_path / "cell.yaml").write_text("table: {x: [0.20, 0.66]}", encoding="utf-8")
    line = ["garment", "new", "cloth.png", "--like", "small_towel", "--length", str(float(np.hypot(width, depth)))]
    assert main([*line, "--cell", "cell.yaml"]) == 0 and "next" in capsys.readouterr().out
    poses = load_garment(tmp_path / "cloth.yaml").poses
    assert poses.x[1] + depth / 2 < 0.66 and poses != load_garment("small_towel").poses
    assert main(["garment", "check", "cloth.yaml", "--cell", "cell.yaml", "--no-predictions"]) == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "cuff_upper_left"),
        (["--length", "44"], "metres"),
        (["--length", "nan"], "metres"),
        (["--length", "0.44", "--between", "hem_right,belly"], "cuff_upper_left"),
        (["--length", "0.44", "--between", "hem_right"], "two key points"),
        (["--unit", "m", "--length", "0.44"], "knows the garment's size"),
        (["--length", "0.44", "--output", "shirt.txt"], ".yaml"),
    ],
)
def test_invalid_input_is_refused_with_its_reason(
    options: list[str], said: str, shirt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["garment", "new", str(shirt), "--like", "t_shirt", *options]) == 64
    assert said in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == [shirt.name]


def test_a_photograph_of_another_garment_type_writes_no_file(
    shirt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["garment", "new", str(shirt), "--like", "pants", "--length", "0.9", "--json"]) == 2
    told = answer(capsys)
    assert not told["recognised"] and told["reason"] and "--like" in told["hint"]
    assert sorted(p.name for p in tmp_path.iterdir()) == [shirt.name, "my_shirt-perceived.png"]
    assert told["overlay"] == "my_shirt-perceived.png", "the picture shows what was taken for the garment"


def pixels(angle: float = 0.15) -> dict[str, list[float]]:
    """Where `photograph` draws the key points of OWN."""
    c, s = np.cos(angle), np.sin(angle)
    xy = np.array(list(OWN.values())) @ np.array([[c, s], [-s, c]])
    places = np.column_stack([640 - METRE * xy[:, 1], 480 - METRE * xy[:, 0]])
    return {name: [round(float(v), 2) for v in p] for name, p in zip(OWN, places, strict=True)}


HEM = ["--between", "hem_right,hem_left", "--length", "0.44"]
BY_HAND = ["--like", "t_shirt", *HEM, "--key-points", "by_hand.yaml"]
NEAR_THE_HEM = [pixels()["hem_left"][0], pixels()["hem_left"][1] - 8.0]


def test_key_points_by_hand_make_a_garment_that_was_not_recognised(
    shirt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("foldcell.cell.hardware.placement.fitting_poses", lambda *_: None)
    monkeypatch.setattr("foldcell.cell.commands.garment.new.look_at", None)  # the picture is not interpreted
    Path("by_hand.yaml").write_text(json.dumps(pixels()), encoding="utf-8")
    assert main(["garment", "new", str(shirt), *BY_HAND, "--json"]) == 0
    told = answer(capsys)
    own = load_garment(tmp_path / told["file"])
    true = np.array([OWN[name] for name in own.keypoints])
    assert np.linalg.norm(own.template - true, axis=1).max() < 0.001
    drawn, plain = cv2.imread(told["overlay"]), cv2.imread(str(shirt))
    assert drawn is not None and plain is not None and drawn.shape == plain.shape and (drawn != plain).any()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"hem_left": None}, ["hem_left = None", "[column, row]"]),
        ({"hem_left": [100, "a"]}, ["by_hand.yaml:", "hem_left", "[column, row]"]),
        ({"hem_left": [100.0, 961.0]}, ["hem_left = [100.0, 961.0]", "960 rows"]),
        ({"belly": [1.0, 1.0]}, ["by_hand.yaml:1: belly is unknown", "hem_right, armpit_right"]),
        ({"hem_left": pixels()["collar_left"], "collar_left": pixels()["hem_left"]}, ["crosses itself"]),
        ({name: [1280 - p[0], p[1]] for name, p in pixels().items()}, ["clockwise", "left and right"]),
    ],
)
def test_implausible_key_points_are_refused_with_their_reason(
    change: dict[str, Any], said: list[str], shirt: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("by_hand.yaml").write_text(json.dumps(pixels() | change), encoding="utf-8")
    assert main(["garment", "new", str(shirt), *BY_HAND]) == 64
    message = capsys.readouterr().err
    assert all(part in message for part in said), message
    assert not (tmp_path / "my_shirt.yaml").exists()


def test_key_points_with_other_proportions_are_a_doubt(
    shirt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "foldcell.cell.hardware.placement.fitting_poses", lambda *_: None
    )  # planning a shirt takes long
    Path("by_hand.yaml").write_text(json.dumps(pixels() | {"armpit_left": NEAR_THE_HEM}), encoding="utf-8")
    assert main(["garment", "new", str(shirt), *BY_HAND]) == 0
    doubt = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("doubt"))
    assert "from armpit_left to hem_left" in doubt and "as far" in doubt
    assert load_garment(tmp_path / "my_shirt.yaml").plan == load_garment("t_shirt").plan


EDIT = ["--like", "t_shirt", *HEM, "--edit"]


def person(monkeypatch: pytest.MonkeyPatch, act: Callable[..., bool]) -> list[KeyPointEdit]:
    """Put a person in front of the page. act: is given keep and save, and returns whether it saved. Returns what
    the person saw."""
    seen: list[KeyPointEdit] = []

    def edit_key_points(edit: KeyPointEdit, listener: Any, announce: Any, keep: Any, save: Any, _: str) -> bool:
        listener.close()
        seen.append(edit)
        announce("http://127.0.0.1:8642/secret/")
        return act(keep, save)

    monkeypatch.setattr("foldcell.cell.commands.garment.edit.edit_key_points", edit_key_points)
    monkeypatch.setattr("foldcell.cell.hardware.placement.fitting_poses", lambda *_: None)
    return seen


def test_key_points_placed_on_the_page_make_a_garment_and_a_file_that_makes_it_again(
    shirt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    seen = person(monkeypatch, lambda keep, save: bool(save(pixels())))
    assert main(["garment", "new", str(shirt), *EDIT, "--json"]) == 0
    said = capsys.readouterr()
    told = dict(json.loads(said.out.splitlines()[-1]))
    assert "http://127.0.0.1:8642/secret/" in said.err and "ssh -L 8642:127.0.0.1:8642" in said.err
    own = load_garment(tmp_path / told["file"])
    assert np.linalg.norm(own.template - np.array([OWN[n] for n in own.keypoints]), axis=1).max() < 0.001
    places = np.array([seen[0].start[name] - np.array(pixels()[name]) for name in own.keypoints])
    assert np.linalg.norm(places, axis=1).max() < 12.0, "it begins with what was recognised"
    written = (tmp_path / "my_shirt.yaml").read_text(encoding="utf-8")
    again = ["--replace", "--like", "t_shirt", *HEM, "--key-points", told["key_points_file"]]
    assert main(["garment", "new", str(shirt), *again]) == 0
    assert (tmp_path / "my_shirt.yaml").read_text(encoding="utf-8") == written


def test_an_editing_that_is_cancelled_goes_on_with_the_points_that_were_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("my_shirt.png", np.full((96, 128, 3), 120, np.uint8))
    part = {"hem_left": [10.0, 20.0], "neck": [1.0, 2.0]}
    first = person(monkeypatch, lambda keep, save: bool(keep({"hem_left": part["hem_left"]})) and False)
    line = ["garment", "new", "my_shirt.png", *EDIT]
    assert main([*line, "--json"]) == 2
    assert answer(capsys)["reason"] == "cancelled" and dict(first[0].start) == {}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["my_shirt-key-points.yaml", "my_shirt.png"]
    assert main(line) == 64 and "my_shirt-key-points.yaml exists" in capsys.readouterr().err
    second = person(monkeypatch, lambda *_: False)
    assert main([*line, "--key-points", "my_shirt-key-points.yaml"]) == 2
    assert dict(second[0].start) == {"hem_left": [10.0, 20.0]}
    Path("my_shirt-key-points.yaml").write_text(json.dumps(part), encoding="utf-8")
    assert main([*line, "--key-points", "my_shirt-key-points.yaml"]) == 64
    assert "neck is unknown" in capsys.readouterr().err


def test_key_points_in_a_picture_by_the_cells_camera_need_no_length() -> None:
    settings = load_settings()
    calibration = camera_calibration(settings)
    shape = calibration.intrinsics.height, calibration.intrinsics.width, 3
    picture = Photograph(np.zeros(shape, np.uint8), None, "view.png", "")
    measure = picture_measure(picture, settings, None, None)
    template = load_garment("small_towel").template
    lying = template + np.array([0.6, 0.05])
    pixels = TableView(calibration, settings.table).to_image(lying)
    np.testing.assert_allclose(measure.to_laid(pixels), lying, atol=1e-6)
    np.testing.assert_allclose(measure.template(pixels, template), template, atol=1e-6)
    with pytest.raises(ConfigurationError, match=r"view.png: is 20 x 10 pixels"):
        picture_measure(Photograph(np.zeros((10, 20, 3), np.uint8), None, "view.png", ""), settings, None, None)
