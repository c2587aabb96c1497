"""Garment files: errors are named, and assumed values are marked."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import yaml

from foldcell.cell.config.garments.garment_file import AVERAGE, list_garments, load_garment, shipped_garment_path
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.vocabulary import Material


def towel() -> dict[str, Any]:
    return yaml.safe_load(shipped_garment_path("medium_towel").read_text())


def write(tmp_path: Path, data: object) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(data if isinstance(data, str) else yaml.safe_dump(data, sort_keys=False))
    return path


def refusal(tmp_path: Path, data: object) -> str:
    with pytest.raises(ConfigurationError) as caught:
        load_garment(write(tmp_path, data))
    text = str(caught.value)
    assert "mine.yaml" in text and "pydantic" not in text and "Traceback" not in text
    return text


def test_a_copy_of_a_shipped_file_is_the_same_garment_with_another_name(tmp_path: Path) -> None:
    ours, shipped = load_garment(write(tmp_path, towel())), load_garment("medium_towel")
    assert ours.name == "mine" and ours.material == shipped.material and ours.plan == shipped.plan
    assert (ours.template == shipped.template).all()
    with pytest.raises(ValueError):
        ours.template[0, 0] = 1.0


def test_the_error_about_an_unknown_name_lists_the_known_names_and_suggests_one() -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_garment("medium_towl")
    assert "did you mean 'medium_towel'" in str(caught.value)
    assert all(name in str(caught.value) for name in list_garments())


BROKEN = {
    "unknown key": ({"colour": "red"}, ["unknown key 'colour'", "known here: title, category"]),
    "nearly a key": ({"categry": "towel"}, ["categry", "category"]),
    "millimetres": ({"keypoints": {"a": [-200, -300], "b": [200, -300], "c": [200, 300]}}, ["keypoints", "-200"]),
    "speed out of range": ({"max_tool_speed": 35}, ["max_tool_speed", "35"]),
    "not a number": ({"max_tool_speed": float("nan")}, ["max_tool_speed", "nan"]),
    "three layers": ({"layers": 3}, ["layers", "3"]),
    "empty plan": ({"plan": []}, ["plan"]),
    "pose upside down": ({"poses": {"x": [0.6, 0.5], "y": [0, 0], "angle_deg": [0, 0]}}, ["lower end 0.6"]),
    "no poses": ({"poses": None}, ["poses"]),
    "clockwise": ({"keypoints": {"near_right": [-0.2, -0.3], "near_left": [-0.2, 0.3], "far_left": [0.2, 0.3],
                                 "far_right": [0.2, -0.3]}}, ["counter-clockwise"]),
    "crossing": ({"keypoints": {"near_right": [-0.2, -0.3], "far_left": [0.2, 0.3], "far_right": [0.2, -0.3],
                                "near_left": [-0.2, 0.3]}}, ["crosses itself"]),
    "off centre": ({"keypoints": {"near_right": [0, 0], "far_right": [0.4, 0], "far_left": [0.4, 0.6],
                                  "near_left": [0, 0.6]}}, ["middle", "0.2"]),
    "edge of nothing": ({"edge_pairs": [[["near_right", "hood"], ["far_right", "far_left"]]]}, ["hood", "near"]),
}  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), BROKEN.values(), ids=BROKEN)
def test_errors_in_a_garment_file_are_named(tmp_path: Path, change: dict[str, Any], expected: list[str]) -> None:
    text = refusal(tmp_path, towel() | change)
    assert all(word in text for word in expected), text


def test_all_faults_of_a_garment_file_are_named_at_once(tmp_path: Path) -> None:
    data = towel() | {"layers": 3, "poses": {"x": [54, 62], "y": [0.0, 0.0], "angle_deg": [0, 0]}}
    text = refusal(tmp_path, data)
    assert all(
        word in text for word in ("layers = 3", "poses.x[0] = 54", "poses.x[1] = 62", "range of the place [m]")
    ), text


def test_nested_errors_in_the_plan_are_named(tmp_path: Path) -> None:
    data = towel()
    data["plan"][1]["variants"][0]["grasps"][0]["at"] = "sleeve"
    assert "plan[1].variants[0].grasps[0].at.sleeve" in refusal(tmp_path, data)
    data = towel()
    data["plan"][0]["line"][0] = {"near_right": 0.5, "far_right": 0.6}
    assert "sum to one, not 1.1" in refusal(tmp_path, data)
    data = towel()
    for grasp in data["plan"][0]["variants"][0]["grasps"]:
        grasp["arm"] = "left"
    assert "one arm cannot take two grasps" in refusal(tmp_path, data)
    data = towel()
    data["plan"][1]["name"] = data["plan"][0]["name"]
    assert "same name" in refusal(tmp_path, data)
    data = towel()
    data["material"]["thickness"] = 2.5
    text = refusal(tmp_path, data)
    assert "material.thickness = 2.5" in text and "0.01" in text


def test_grasps_must_lie_on_the_moving_part(tmp_path: Path) -> None:
    data = towel()
    for grasp, point in zip(data["plan"][0]["variants"][0]["grasps"], ("far_right", "near_right"), strict=True):
        grasp |= {"at": point, "inset": [0.0, 0.0]}
    text = refusal(tmp_path, data)
    assert "plan.half.grasps (left_onto_right)" in text and "-300 mm inside the moved part" in text
    data = towel()
    data["plan"][0]["variants"][0]["grasps"][0]["at"] = {"far_left": 2.0, "far_right": -1.0}
    assert "plan.half.grasps" in refusal(tmp_path, data) and "beside the garment" in refusal(tmp_path, data)
    data["plan"][0]["variants"][0]["grasps"][0]["at"] = "far_left"
    assert load_garment(write(tmp_path, data)).plan


def test_every_variant_of_a_step_is_checked(tmp_path: Path) -> None:
    data = towel()
    data["plan"][0]["variants"][1]["moves"] = ["near_right", "far_left"]
    text = refusal(tmp_path, data)
    assert "plan.half.line (right_onto_left)" in text and "no fold line" in text
    data = towel()
    data["plan"][0]["variants"][1]["name"] = "left_onto_right"
    assert "two variants of the step 'half' have the same name" in refusal(tmp_path, data)


LINES = {
    "a wrong value": ("layers: 1", "layers: 3", "layers: 3"),
    "an unknown key": ("layers: 1", "layers: 1\ncolour: red", "colour"),
    "a wrong number in a list": ("  near_left: [-0.20, 0.30]", "  near_left: [-200, 0.30]", "near_left: [-200"),
    "an outline that crosses itself": ("  near_left: [-0.20, 0.30]", "  near_left: [0.40, 0.10]", "keypoints:"),
    "a wrong number in a group": ("thickness: 0.0025", "thickness: 2.5", "thickness: 2.5"),
    "a point that is not there": ("moves: [near_right, near_left]", "moves: [hood]", "moves: [hood]"),
    "a grasp that is not there": ("{at: far_right, inset: [0.006, 0.015], arm: auto}\n          - {at: {far_left",
                                  "{at: hood, inset: [0.006, 0.015], arm: auto}\n          - {at: {far_left",
                                  "{at: hood"),
    "weights of a line": ("{near_left: 0.5, far_left: 0.5}]", "{near_left: 0.5, far_left: 0.6}]", "far_left: 0.6"),
    "two steps of one name": ("  - name: quarter", "  - name: half", "  - name: half"),
    "two variants of one name": ("name: near_onto_far", "name: far_onto_near", "name: far_onto_near"),
    "an edge of nothing": ("[near_right, far_right], [near_left, far_left]",
                           "[near_right, hood], [near_left, far_left]", "hood"),
    "a pose upside down": ("x: [0.54, 0.62]", "x: [0.62, 0.54]", "poses:"),
    "a fold line on a border": ("line: [{near_right: 0.5, far_right: 0.5}, {near_left: 0.5, far_left: 0.5}]",
                                "line: [{near_right: 1}, {near_left: 1}]", "line: [{near_right: 1}"),
    "a grasp beside the garment": ("{at: {near_left: 0.5, near_right: 0.5}", "{at: {near_left: -1, near_right: 2}",
                                   "grasps:"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "named"), LINES.values(), ids=LINES)
def test_errors_name_the_line(tmp_path: Path, old: str, new: str, named: str) -> None:
    text = shipped_garment_path("medium_towel").read_text(encoding="utf-8")
    assert old in text
    wrong = new.join(text.rsplit(old, 1))
    number = max(k for k, line in enumerate(wrong.splitlines(), 1) if named in line)
    message = refusal(tmp_path, wrong)
    assert f"mine.yaml:{number}: " in message, message


def test_a_surface_without_friction_is_named_with_the_line_of_the_known_ones(tmp_path: Path) -> None:
    text = shipped_garment_path("medium_towel").read_text(encoding="utf-8")
    number = next(k for k, line in enumerate(text.splitlines(), 1) if "friction_angle_deg" in line)
    with pytest.raises(ConfigurationError, match=rf"mine\.yaml:{number}: .*no surface 'glass'"):
        load_garment(write(tmp_path, text), "glass")


def test_a_plan_with_more_ways_than_can_be_checked_is_refused(tmp_path: Path) -> None:
    """Twenty steps of two variants are a million ways, each of which would be planned."""
    data = towel()
    data["plan"] = [{**data["plan"][0], "name": f"step_{k}"} for k in range(20)]
    assert "plan: its variants make 1048576 ways to fold" in refusal(tmp_path, data)


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "a: [1, 2", "\x00\x01", "just words"])
def test_a_file_that_is_no_garment_is_refused(tmp_path: Path, text: str) -> None:
    refusal(tmp_path, text)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path / "sub/none.yml", f"{tmp_path}/"):
        with pytest.raises(ConfigurationError, match=r"no such garment file|this is a folder"):
            load_garment(path)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigurationError, match="not UTF-8 text"):
        load_garment(binary)


def test_the_friction_depends_on_garment_and_surface(tmp_path: Path) -> None:
    data = towel()
    data["material"]["friction_angle_deg"] = {"bare_table": 20.0, "felt": 35.0}
    path = write(tmp_path, data)
    assert load_garment(path, "felt").material.friction_static == pytest.approx(math.tan(math.radians(35)))
    assert load_garment(path).material.friction_static == pytest.approx(math.tan(math.radians(20)))
    with pytest.raises(ConfigurationError) as caught:
        load_garment(path, "glass")
    assert "'glass'" in str(caught.value) and "bare_table, felt" in str(caught.value)


def test_unmeasured_material_values_are_the_papers_averages_and_marked_as_assumed(tmp_path: Path) -> None:
    data = towel()
    del data["material"]
    material = load_garment(write(tmp_path, data), "any_surface").material
    assert material.stretch_fraction == 0.024
    assert material.friction_static == pytest.approx(math.tan(math.radians(22.2)))
    assert material.areal_mass == AVERAGE["areal_mass"]
    assert {*material.assumed, "assumed"} == {field.name for field in fields(Material)}
