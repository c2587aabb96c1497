"""Cells and garments that cannot work are refused before anything moves, with key and value."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from foldcell.cell.commands.main import main
from foldcell.cell.config.calibration_file import calibration_text, table_text
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import shipped_garment_path
from foldcell.cell.hardware.camera import camera_calibration

Refused = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Runs a command line that must be refused before a run begins, and returns its message."""
    monkeypatch.chdir(tmp_path)

    def run(line: str, *parts: str) -> str:
        assert main([*line.split(), *(("--logs", "logs") if line.startswith("fold") else ())]) == 64
        message = "".join(capsys.readouterr())
        assert all(part in message for part in parts), message
        assert not list(tmp_path.glob("logs/*/run.rrd")) and "Traceback" not in message
        return message

    return run


def write(path: Path, values: Mapping[str, Any]) -> None:
    path.write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")


@pytest.mark.parametrize(
    ("settings", "parts"),
    [
        ({"table": {"height": 0.30}}, ["table.height = 0.3", "left_wrist", "heights up to 0.05 are free"]),
        ({"table": {"height": 3.0}}, ["table.height = 3", "0.5"]),
        ({"table": {"height": -0.6}}, ["table.height = -0.6", "reach", "29% of 24 places"]),
        ({"table": {"x": [1.1, 0.2]}}, ["table.x = [1.1, 0.2]"]),
        ({"table": {"x": [1.3, 1.9]}}, ["table.x = [1.3, 1.9]", "before the robot"]),
        ({"table": {"y": [0.5, 0.6]}}, ["table.y = [0.5, 0.6]"]),
        ({"table": {"y": [0.4, 1.4]}}, ["table.y = [0.4, 1.4]", "where garments lie"]),
        ({"camera": {"position": [0.3, 0.0, 1.1]}}, ["camera.target is missing"]),
        ({"camera": {"position": [0.3, 0.0, 1.1], "target": [0.6, 0.0, 1.2]}}, ["camera.target", "look down"]),
        ({"camera": {"position": [0.3, 0.0, 0.1], "target": [0.6, 0.0, 0.0]}}, ["camera.position", "0.1"]),
        ({"camera": {"position": [5.0, 0.0, 1.1], "target": [0.6, 0.0, 0.0]}}, ["camera.position", "5"]),
        ({"camera": {"position": [0.25, 0.0, 1.1], "target": [1.9, 1.9, 0.0]}}, ["camera.target = [1.9, 1.9"]),
        ({"camera": {"position": [0.75, 0.0, 1.2], "target": [0.6, 0.0, 0.0]}}, ["camera.position", "gripper"]),
        ({"camera": {"view_deg": 200.0}}, ["camera.view_deg = 200"]),
        ({"camera": {"view_deg": 20.0}}, ["camera.view_deg = 20", "view of the table"]),
        ({"camera": {"width": 10, "height": 10}}, ["camera.width = 10"]),
        ({"camera": {"width": 640}}, ["camera.height is missing"]),
        ({"camera": {"fov": 60}}, ["camera.fov", "view_deg"]),
        ({"park": {"left": [0.1, 0.2]}}, ["park.left = [0.1, 0.2]", "2 angles", "7 joints"]),
        ({"park": {"right": [9.0] * 7}}, ["park.right", "9", "6.3"]),
        ({"park": {"left": [0.0] * 7}}, ["park.left = [0.0, 0.0", "parked"]),
        ({"gripper": {"opening": 0.05}}, ["gripper.opening = 0.05", "open 50 of 42 mm"]),
        ({"gripper": {"opening": 0.006, "closed_opening": 0.008}}, ["gripper.opening = 0.006", "8.0 mm closed"]),
        ({"gripper": {"pad_width": 20}}, ["gripper.pad_width = 20", "millimetres"]),
        ({"grasp": {"held_force": 16.0}}, ["grasp.held_force = 16", "grip force 15.0 N"]),
        ({"grasp": {"press_force": 1.0, "contact_force": 2.0}}, ["grasp.contact_force = 2", "press force 1.0 N"]),
        ({"robot": "r2d2"}, ["robot", "r2d2", "baxter"]),
    ],
)  # fmt: skip
def test_a_cell_that_cannot_work_is_refused(
    refused: Refused, tmp_path: Path, settings: Mapping[str, Any], parts: list[str]
) -> None:
    write(tmp_path / "cell.yaml", settings)
    refused("fold small_towel --cell cell.yaml", *parts)


def garment(name: str, **changes: Any) -> dict[str, Any]:
    return yaml.safe_load(shipped_garment_path(name).read_text(encoding="utf-8")) | changes


@pytest.mark.parametrize("command", ["fold big.yaml", "garment check big.yaml"])
def test_a_garment_larger_than_the_table_is_refused_with_the_size_that_fits(
    refused: Refused, tmp_path: Path, command: str
) -> None:
    shirt = garment("t_shirt")
    write(
        tmp_path / "big.yaml",
        shirt | {"keypoints": {k: [3 * v for v in p] for k, p in shirt["keypoints"].items()}},
    )
    refused(command, "big", "1.98 x 2.58 m", "at 40% of this size")


def test_a_garment_that_lies_beside_the_table_is_told_where_it_can_be_folded(
    refused: Refused, tmp_path: Path
) -> None:
    poses = {"x": [1.4, 1.5], "y": [0.0, 0.0], "angle_deg": [0.0, 0.0]}
    write(tmp_path / "far.yaml", garment("small_towel", poses=poses))
    message = refused("garment check far.yaml", "poses", "x 1.45", "it can be folded at x ")
    x = float(message.split("folded at x ")[1].split(",")[0])
    write(tmp_path / "near.yaml", garment("small_towel", poses=poses | {"x": [x, x]}))
    assert main(["garment", "check", "near.yaml", "--no-predictions"]) == 0


def test_the_stated_camera_is_drawn_with_the_cell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import cv2

    stated = {"camera": {"position": [0.25, 0.0, 1.1], "target": [0.62, 0.0, 0.0], "width": 800, "height": 600}}
    write(tmp_path / "cell.yaml", stated)
    line = ["cell", "check", "--cell", str(tmp_path / "cell.yaml"), "--draw", str(tmp_path), "--garment", "vest"]
    assert main(line) == 0, capsys.readouterr()
    picture = cv2.imread(str(tmp_path / "cell.png"))
    assert picture is not None and np.ptp(picture) > 200


def test_an_inverted_calibration_is_named_instead_of_the_key_that_it_overrides(
    refused: Refused, tmp_path: Path
) -> None:
    calibration = camera_calibration(load_settings())
    T = np.linalg.inv(calibration.T_table_camera)
    (tmp_path / "camera.yaml").write_text(calibration_text(replace(calibration, T_table_camera=T)))
    place = {"position": [0.25, 0.0, 1.1], "target": [0.62, 0.0, 0.0], "calibration": "camera.yaml"}
    write(tmp_path / "cell.yaml", {"camera": place})
    message = refused("fold small_towel --cell cell.yaml", "camera.calibration = ", "camera.yaml", "inverted")
    assert "camera.target" not in message


def test_a_calibrated_table_is_named_by_its_file(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "table.yaml").write_text(table_text(0.30))
    write(tmp_path / "cell.yaml", {"table": {"calibration": "table.yaml"}})
    message = refused("fold small_towel --cell cell.yaml", "table.calibration = ", "table.yaml", "are free")
    assert "table.height" not in message
