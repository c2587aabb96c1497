"""A calibration of the cell says at once if every run would refuse the cell with its file."""

from __future__ import annotations

from pathlib import Path

import pytest

from foldcell.cell.commands.calibrate.run_on_cell import unfit_with
from foldcell.cell.config.calibration_file import calibration_text, table_text
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.camera import camera_calibration

IN_VIEW = "camera: {position: [0.2, 0, 1.0], target: [0.6, 0, 0], view_deg: 58}"


@pytest.mark.parametrize(
    ("cell", "why"),
    [("{}", ""), (IN_VIEW, "with this file the cell is refused: camera.calibration = ")],
)
def test_a_calibrated_camera_must_pass_the_check_of_the_cell(cell: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(cell)
    settings = load_settings(tmp_path / "cell.yaml")
    file = tmp_path / "camera.yaml"
    file.write_text(calibration_text(camera_calibration(settings), settings.table.height))
    said = unfit_with(load_settings(), "camera.calibration", file)
    assert said.startswith(why) and bool(said) is bool(why)


def test_a_measured_table_must_leave_room_for_the_parked_arms(tmp_path: Path) -> None:
    file = tmp_path / "table.yaml"
    file.write_text(table_text(0.3))
    assert "table.calibration" in unfit_with(load_settings(), "table.calibration", file)
