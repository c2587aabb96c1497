"""The camera's place is judged by the picture that it would take, with head and arms in it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.camera_place import expected_picture, place_that_fits
from foldcell.cell.hardware.cell_check import Finding, cell_findings, refuse_unfit_cell
from foldcell.cell.hardware.cell_drawing import CAMERA_WIDTH, HEAD, PAD, draw_cell
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.vocabulary import CameraCalibration

BEHIND_ITS_HEAD = {"position": [0.2, 0.0, 1.0], "target": [0.6, 0.0, 0.0], "view_deg": 58}
"""The parked arms are outside the picture, the robot's own head is in it: runs are refused."""
INSIDE_ITS_HEAD = {"position": [0.1, 0.0, 0.95], "target": [0.6, 0.0, 0.0], "view_deg": 58}
"""The head hides most of the picture."""
AT_THE_LIMIT = {"position": [0.22, 0.0, 1.05], "target": [0.6, 0.0, 0.0], "view_deg": 58}
"""Only some simulated cameras of this place and lens see a part of the robot: those with large errors."""


def cell(folder: Path, **groups: Any) -> CellSettings:
    file = folder / "cell.yaml"
    file.write_text(yaml.safe_dump({"schema": 1, **groups}))
    return load_settings(file)


def bad(settings: CellSettings) -> Mapping[str, Finding]:
    return {finding.name: finding for finding in cell_findings(settings) if not finding.good}


@pytest.mark.parametrize("camera", [BEHIND_ITS_HEAD, INSIDE_ITS_HEAD, AT_THE_LIMIT])
def test_a_camera_that_sees_the_robot_itself_is_refused_before_a_run(
    camera: Mapping[str, Any], tmp_path: Path
) -> None:
    settings = cell(tmp_path, camera=camera)
    found = bad(settings)["robot in the camera's picture"]
    assert found.key == "camera.position" and "a part of the robot" in found.found
    with pytest.raises(ConfigurationError, match=r"camera\.position = .*in.* picture"):
        refuse_unfit_cell(settings)


def test_the_place_that_is_named_fits(tmp_path: Path) -> None:
    (told,) = [f.found for f in bad(cell(tmp_path, camera=BEHIND_ITS_HEAD)).values() if "fits" in f.found]
    assert told.endswith("the camera fits 0.05 m forward, at [0.25, 0.00, 1.00], looking at [0.60, 0.00, 0.00]")
    assert not bad(cell(tmp_path, camera={**BEHIND_ITS_HEAD, "position": [0.25, 0.0, 1.0]}))


def test_beside_a_table_that_does_not_fit_no_place_of_the_camera_is_advised(tmp_path: Path) -> None:
    found = bad(cell(tmp_path, table={"height": 0.4}))
    assert any(finding.key == "table.height" for finding in found.values())
    assert not [finding.found for finding in found.values() if "the camera fits" in finding.found]


def test_no_place_is_advised_that_the_settings_refuse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The nearest place that would show the table is below the least height that may be stated."""
    monkeypatch.setattr("foldcell.cell.hardware.camera_place._fits", lambda _s, _m, seen: eye_height(seen) < 0.3)
    settings = cell(tmp_path, camera={"position": [0.4, 0.0, 0.5], "target": [0.6, 0.0, 0.0]})
    told = place_that_fits(settings, load_robot(settings))
    height = float(told.split("at [")[1].split("]")[0].split(",")[2])
    assert 0.2 <= height < 0.3


def eye_height(calibration: CameraCalibration) -> float:
    return float(calibration.T_table_camera[2, 3])


def test_where_no_place_fits_it_is_said(tmp_path: Path) -> None:
    told = bad(cell(tmp_path, camera={"view_deg": 20.0}))["camera's view of the table"].found
    assert "no place within 0.50 m fits that looks at [0.60, 0.00, 0.00]" in told


@pytest.mark.parametrize("robot", ["baxter", "ur5_pair"])
def test_the_robots_own_camera_is_good(robot: str, tmp_path: Path) -> None:
    assert not bad(cell(tmp_path, robot=robot))


def test_the_camera_s_place_is_printed_beside_the_robot_s_own_and_the_table_s_height(tmp_path: Path) -> None:
    settings = cell(tmp_path, camera=AT_THE_LIMIT, table={"height": -0.15})
    (place,) = [f.found for f in cell_findings(settings) if f.name == "camera"]
    assert place == (
        "at [0.22, 0.00, 1.05], looking at [0.60, 0.00, 0.00]; the robot's own: at [0.25, 0.00, 1.15], "
        "looking at [0.62, 0.00, 0.00]; the table is -0.15 m from the robot's base"
    )


def test_the_drawing_shows_what_the_camera_sees(tmp_path: Path) -> None:
    settings = cell(tmp_path, camera={**BEHIND_ITS_HEAD, "width": 640, "height": 480})
    model = load_robot(settings)
    picture = expected_picture(settings, model, camera_calibration(settings)).rgb
    shown = draw_cell(settings, model)[HEAD : HEAD + 480, -PAD - CAMERA_WIDTH : -PAD]
    assert np.array_equal(shown, picture)
    red = np.mean((picture[..., 0] > 60) & (picture[..., 1] < 60))  # Baxter's head and arms
    assert red > 0.02
