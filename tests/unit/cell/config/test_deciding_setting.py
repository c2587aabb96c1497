"""Messages name the setting that decides: file, key and value."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from cell.config import cell_settings
from cell.config.calibration_file import tactile_text
from cell.config.cell_settings import load_settings
from cell.config.deciding_setting import DECIDING, deciding_setting
from robots.errors import FailureKind

SHIPPED = yaml.safe_load(Path(cell_settings.__file__).with_name("cell.yaml").read_text())


@pytest.mark.parametrize("kind", DECIDING)
def test_the_key_is_one_of_cell_yaml(kind: FailureKind) -> None:
    group, name = DECIDING[kind].split(".")
    assert deciding_setting(kind, load_settings()) == f"`{group}.{name}: {SHIPPED[group][name]}` in cell.yaml"


def test_the_present_value_is_named(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text("inspection: {iou: 0.77}\n")
    settings = load_settings(tmp_path / "cell.yaml")
    assert deciding_setting(FailureKind.OFF_TARGET, settings) == "`inspection.iou: 0.77` in cell.yaml"
    assert deciding_setting(FailureKind.STOPPED, settings) == ""


def test_the_value_of_a_tactile_calibration_is_named_with_its_file(tmp_path: Path) -> None:
    (tmp_path / "pads.yaml").write_text(tactile_text({"contact_force": 0.3, "held_force": 1.25}))
    (tmp_path / "cell.yaml").write_text("grasp: {held_force: 0.77, calibration: pads.yaml}\n")
    settings = load_settings(tmp_path / "cell.yaml")
    named = deciding_setting(FailureKind.MISSED_GRASP, settings)
    assert named == f"`held_force: 1.25` in {tmp_path / 'pads.yaml'}"
    assert deciding_setting(FailureKind.SLIPPED, settings).startswith("`grasp.grip_force: ")
