"""Messages name the setting that decided: file, key, value and the measured value beside it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from foldcell.cell.config import cell_settings
from foldcell.cell.config.calibration_file import tactile_text
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.deciding_setting import LIMITS, deciding_setting, grasping_hint
from foldcell.robots.errors import Failure, FailureKind

SHIPPED = yaml.safe_load(Path(cell_settings.__file__).with_name("cell.yaml").read_text())


@pytest.mark.parametrize("kind", LIMITS)
@pytest.mark.parametrize("part", [0.9, 1.1])
def test_a_limit_is_named_only_if_the_measured_value_is_beyond_it(kind: FailureKind, part: float) -> None:
    for limit in LIMITS[kind]:
        group, name = limit.key.split(".")
        allowed = SHIPPED[group][name]
        measured = part * allowed / limit.factor
        values = {limit.figure: measured, limit.known or "hand": 1}
        said = deciding_setting(Failure(kind, "", values=values), load_settings())
        decided = part < 1.0 if limit.least else part > 1.0
        wanted = f"`{limit.key}: {allowed}` in cell.yaml, measured {part * allowed:.3g}"
        assert said == (wanted if decided else "")


def test_a_limit_that_another_value_would_not_have_changed_is_not_named() -> None:
    empty = {"force_n": 0.0, "opening_m": 0.0, "layers": 0}
    assert deciding_setting(Failure(FailureKind.MISSED_GRASP, "", values=empty), load_settings()) == ""
    whole = {"iou_aligned": 0.98, "target_iou": 0.975, "edge_deviation_m": 0.001}
    assert deciding_setting(Failure(FailureKind.OFF_TARGET, "", values=whole), load_settings()) == ""
    assert deciding_setting(Failure(FailureKind.OFF_TARGET, ""), load_settings()) == "", "nothing was measured"


def test_the_present_value_is_named(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text("inspection: {iou: 0.77}\n")
    settings = load_settings(tmp_path / "cell.yaml")
    failure = Failure(FailureKind.OFF_TARGET, "", values={"iou_aligned": 0.7})
    assert deciding_setting(failure, settings) == "`inspection.iou: 0.77` in cell.yaml, measured 0.7"
    assert deciding_setting(replace(failure, kind=FailureKind.STOPPED), settings) == ""


def test_the_value_of_a_tactile_calibration_is_named_with_its_file(tmp_path: Path) -> None:
    (tmp_path / "pads.yaml").write_text(tactile_text({"contact_force": 0.3, "held_force": 1.25}))
    (tmp_path / "cell.yaml").write_text("grasp: {held_force: 0.77, calibration: pads.yaml}\n")
    settings = load_settings(tmp_path / "cell.yaml")
    failure = Failure(FailureKind.MISSED_GRASP, "", values={"force_n": 1.0, "layers": 2})
    assert deciding_setting(failure, settings) == f"`held_force: 1.25` in {tmp_path / 'pads.yaml'}, measured 1"


def test_the_hint_of_a_grasp_names_the_settings_that_are_in_force(tmp_path: Path) -> None:
    missed = Failure(FailureKind.MISSED_GRASP, "", "grasp lower or further in")
    further = (
        "; further in: `inset` of the grasp in the garment file, or a larger `gripper.opening: 0.03` in cell.yaml)"
    )
    said = grasping_hint(missed, load_settings(), whole_stack=True)
    assert said == f"{missed.hint} (lower: a higher `grasp.contact_force: 0.35` in cell.yaml{further}"
    (tmp_path / "pads.yaml").write_text(tactile_text({"contact_force": 0.3, "held_force": 1.25}))
    (tmp_path / "cell.yaml").write_text("grasp: {calibration: pads.yaml}")
    said = grasping_hint(missed, load_settings(tmp_path / "cell.yaml"), whole_stack=True)
    assert f"a higher `contact_force: 0.3` in {tmp_path / 'pads.yaml'};" in said
    (tmp_path / "cell.yaml").write_text("grasp: {tactile: false}")
    said = grasping_hint(missed, load_settings(tmp_path / "cell.yaml"), whole_stack=True)
    assert said == f"{missed.hint} (lower: a lower `table.height: -0.1` in cell.yaml{further}", (
        "nothing feels a touch"
    )


def test_the_hint_of_a_grasp_of_upper_layers_names_the_height_too() -> None:
    fewer = Failure(FailureKind.MISSED_GRASP, "", "grasp lower")
    more = Failure(FailureKind.MISSED_LAYER, "", "let go and grasp less deep")
    keys = "`grasp.contact_force: 0.35` in cell.yaml or a {} `table.height: -0.1` in cell.yaml)"
    said = [grasping_hint(failure, load_settings(), whole_stack=False) for failure in (fewer, more)]
    assert said[0] == f"grasp lower (lower: a higher {keys.format('lower')}"
    assert said[1] == f"let go and grasp less deep (less deep: a lower {keys.format('higher')}"
