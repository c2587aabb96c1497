"""No command writes over a file that it did not make. Its own files are replaced."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from foldcell.cell.commands.main import main
from foldcell.cell.config.calibration_file import table_text
from foldcell.cell.config.garments.garment_file import shipped_garment_path
from foldcell.cell.support.junit import junit_text
from foldcell.skills.trajectory.export import MARKS, tool_poses_text
from foldcell.skills.trajectory.trajectory_library import Library, to_json

SCRIPT = {
    "about": "a towel",
    "garment": "small_towel",
    "seed": 1,
    "do": [{"when": {"state": "folding"}, "say": "abort"}],
    "expect": {"end": "not_folded"},
}


def photograph(path: Path) -> bytes:
    grey = np.random.default_rng(0).integers(90, 110, (120, 160, 3), dtype=np.uint8)
    path.write_bytes(cv2.imencode(".png", grey)[1].tobytes())
    return path.read_bytes()


def own_garment(path: Path) -> Path:
    path.write_text(shipped_garment_path("small_towel").read_text(encoding="utf-8"), encoding="utf-8")
    return path


@pytest.mark.long
def test_a_garment_is_drawn_beside_the_photograph_of_its_name(tmp_path: Path) -> None:
    mine, photo = own_garment(tmp_path / "my_shirt.yaml"), photograph(tmp_path / "my_shirt.png")
    line = ["garment", "check", str(mine), "--draw", str(tmp_path), "--no-predictions"]
    assert main(line) == 0 and main(line) == 0, "its own drawings of the first time are replaced"
    assert (tmp_path / "my_shirt.png").read_bytes() == photo
    assert {p.name for p in tmp_path.glob("*.png")} == {
        "my_shirt.png", "my_shirt-drawing.png", "my_shirt-on-table.png",
    }  # fmt: skip


Line = Callable[[Path, Path], list[str]]
WRITERS: dict[str, tuple[str, Line]] = {
    "drawing": (
        "my_shirt-drawing.png",
        lambda at, _: ["garment", "check", str(at / "my_shirt.yaml"), "--draw", str(at), "--no-predictions"],
    ),
    "prediction": (
        "my_shirt-predicted.png",
        lambda at, _: ["garment", "check", str(at / "my_shirt.yaml"), "--draw", str(at)],
    ),
    "show": ("small_towel-drawing.png", lambda at, _: ["garment", "show", "small_towel", "--draw", str(at)]),
    "cell": ("cell.png", lambda at, _: ["cell", "check", "--draw", str(at)]),
    "overlay": ("photo-perceived.png", lambda at, _: ["perceive", str(at / "photo.png"), "--unit", "px"]),
    "overlay onto the picture": (
        "photo.png",
        lambda at, file: ["perceive", str(file), "--unit", "px", "--output", str(file)],
    ),
    "new": (
        "photo-perceived.png",
        lambda at, _: [
            "garment", "new", str(at / "photo.png"), "--like", "small_towel", "--length", "0.4",
            "--output", str(at / "photo.yaml"),
        ],
    ),
    "new, by hand": (
        "photo-key-points.png",
        lambda at, _: [
            "garment", "new", str(at / "photo.png"), "--like", "small_towel", "--length", "0.4",
            "--key-points", str(at / "points.yaml"), "--output", str(at / "photo.yaml"),
        ],
    ),
    "tool poses": ("my_shirt.yaml", lambda _, file: ["optimise", str(file), "--export", str(file)]),
    "junit": ("script.yaml", lambda _, file: ["hil", str(file), "--junit", str(file)]),
    "board": ("board.png", lambda _, file: ["calibrate", "board", "--output", str(file)]),
    "board as PDF": ("board.pdf", lambda _, file: ["calibrate", "board", "--output", str(file)]),
    "calibration": ("my_shirt.yaml", lambda _, file: ["calibrate", "table", "--output", str(file)]),
    "library": ("my_shirt.yaml", lambda _, file: ["library", "build", "small_towel", "--output", str(file)]),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_that_foldcell_did_not_make_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    name, line = WRITERS[kind]
    monkeypatch.setenv("FOLDCELL_LOGS", str(tmp_path / "logs"))
    own_garment(tmp_path / "my_shirt.yaml")
    (tmp_path / "script.yaml").write_text(yaml.safe_dump(SCRIPT), encoding="utf-8")
    (tmp_path / "points.yaml").write_text("near_right: [20, 20]\n", encoding="utf-8")
    photograph(tmp_path / "photo.png")
    file = tmp_path / name
    if not file.exists():
        photograph(file)
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    assert main(line(tmp_path, file)) == 64
    said = capsys.readouterr()
    assert f"{file} exists and was not made by this command" in said.out + said.err
    assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


@pytest.mark.parametrize(
    "command", [["calibrate", "board", "--output", "b.png"], ["calibrate", "board", "--output", "b.pdf"]]
)
def test_a_file_of_the_same_command_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(command) == 0 and main(command) == 0


def test_every_kind_of_file_contains_its_mark() -> None:
    poses = {"half": {"left": np.arange(16.0).reshape(2, 8)}}
    assert all(mark in tool_poses_text("towel", poses, suffix).encode() for suffix, mark in MARKS.items())
    assert b'<testsuite name="foldcell hil"' in junit_text("foldcell hil", [])
    origin = {"height": {"by": "foldcell calibrate table"}}
    assert "by: foldcell calibrate " in table_text(-0.1, origin)
    assert '"entries"' in to_json(Library())


def test_two_garments_of_one_name_are_not_drawn_into_one_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other").mkdir()
    files = [str(own_garment(tmp_path / "mine.yaml")), str(own_garment(tmp_path / "other" / "mine.yaml"))]
    assert main(["garment", "check", *files, "--draw", str(tmp_path), "--no-predictions"]) == 64
    assert "two have one name" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.png"))
