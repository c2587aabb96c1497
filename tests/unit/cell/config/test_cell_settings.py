"""Settings: invalid values are refused with a helpful message."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from foldcell.cell.config.calibration_file import calibration_text, load_camera_calibration
from foldcell.cell.config.cell_settings import RENAMED_KEYS, CellSettings, default_settings_path, load_settings
from foldcell.cell.config.yaml_file import merge, read_yaml
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ros.driver import CameraTopics, Network, RosSettings
from foldcell.skills.cloth.pinch import PadGeometry


def refusal(tmp_path: Path, text: str) -> ConfigurationError:
    path = tmp_path / "cell.yaml"
    path.write_text(text)
    with pytest.raises(ConfigurationError) as caught:
        load_settings(path)
    return caught.value


def test_the_shipped_file_states_every_key() -> None:
    stated = yaml.safe_load(default_settings_path().read_text())
    assert stated.keys() == {f.alias or n for n, f in CellSettings.model_fields.items()}
    for key, group in stated.items():
        if isinstance(group, dict):
            model = next(f.annotation for n, f in CellSettings.model_fields.items() if (f.alias or n) == key)
            assert model is not None and group.keys() == model.model_fields.keys()


def test_a_settings_file_needs_only_the_changed_keys(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("table: {height: -0.05}\nmotion:\n  velocity_scale: 0.5\n")
    mine, shipped = load_settings(path), load_settings()
    assert mine.table.height == -0.05
    assert mine.motion.velocity_scale == 0.5
    assert mine.table.x == shipped.table.x
    assert mine.grasp == shipped.grasp
    assert mine.fingerprint() != shipped.fingerprint()


def test_an_empty_file_means_the_shipped_settings(tmp_path: Path) -> None:
    path = tmp_path / "empty.yaml"
    path.write_text("# nothing differs\n")
    assert load_settings(path).fingerprint() == load_settings().fingerprint()


def test_settings_saved_with_a_run_read_back_equal(tmp_path: Path) -> None:
    path = tmp_path / "kept.yaml"
    path.write_text(load_settings().as_yaml())
    assert load_settings(path) == load_settings()


def test_the_fingerprint_does_not_depend_on_the_order_of_keys(tmp_path: Path) -> None:
    data = yaml.safe_load(default_settings_path().read_text())
    path = tmp_path / "reversed.yaml"
    path.write_text(yaml.safe_dump(dict(reversed(list(data.items()))), sort_keys=False))
    assert load_settings(path).fingerprint() == load_settings().fingerprint()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("table:\n  height: 820", ["cell.yaml:2", "table.height", "820", "-0.6 to 0.5 m", "millimetres", "0.82"]),
        ("table: {height: -100}", ["table.height", "-100", "millimetres", "-0.1"]),
        ("table: {x: [200, 1100]}", ["table.x[0]", "200", "millimetres", "0.2"]),
        ("table: {x: [20, 110]}", ["table.x[0]", "centimetres"]),
        ("motion: {tracking_tolerance: 10}", ["motion.tracking_tolerance", "degrees", "0.1745"]),
        ("motion: {max_state_age_s: 100}", ["motion.max_state_age_s", "0.02 to 1 s", "milliseconds", "0.1"]),
        ("motion: {tool_speed: 250}", ["motion.tool_speed", "millimetres per second", "0.25"]),
        ("motion: {tool_speed: 0.4 m}", ["motion.tool_speed", "plain number, without a unit"]),
        ("motion: {accelerations: fast}", ["'fast'", "planning, commissioning"]),
        ("tabel: {}", ["cell.yaml:1", "unknown key 'tabel'", "did you mean 'table'"]),
        ("motion: {velocity: 1}", ["unknown key 'motion.velocity'", "did you mean 'velocity_scale'"]),
        ("table: {height: 0.1}\ntable: {height: 0.2}", ["cell.yaml:2", "'table' is repeated", "line 1"]),
        ("table: {height: 0.1, height: 0.2}", ["'height' is repeated"]),
        ("table: {x: [1.0, 0.3]}", ["table.x", "exceed the first"]),
        ("table: {x: [0.3]}", ["table.x", "too few entries"]),
        ("table: 4", ["table = 4", "height, x, y"]),
        ("table: null", ["table = None", "group of keys"]),
        ("grasp: {grip_force: true}", ["grasp.grip_force", "True"]),
        ("grasp: {grip_force: .nan}", ["grasp.grip_force", "nan"]),
        ("grasp: {grip_force: .inf}", ["grasp.grip_force", "inf"]),
        ("grasp: {grip_force: '10'}", ["grasp.grip_force", "'10'", "1 to 60 N"]),
        ("optimiser: {use_library: yes}", ["optimiser.use_library", "true or false"]),
        ("optimiser: {simulations: 2.5}", ["optimiser.simulations", "2.5"]),
        ("schema: 2", ["schema = 2"]),
        ("robot: pr2", ["robot", "'pr2'", "baxter"]),
        ("surface: 3", ["surface"]),
        ("a: [", ["cell.yaml:1", "not a valid"]),
        ("- 1", ["list of 'key: value' lines"]),
        ("? [a, b]\n: 3", ["a key has to be a plain word"]),
        ("robot: !!python/object/apply:os.getcwd []", ["not a valid"]),
        ("[" * 100_000, ["nested too deep"]),
    ],
)
def test_errors_name_the_place_the_value_and_the_allowed_values(
    tmp_path: Path, text: str, parts: list[str]
) -> None:
    message = str(refusal(tmp_path, text))
    for part in parts:
        assert part in message
    assert len(message) < 2000


@pytest.mark.parametrize(("former", "present"), RENAMED_KEYS.items())
def test_the_error_about_a_former_key_names_the_present_one(tmp_path: Path, former: str, present: str) -> None:
    group, key = former.split(".")
    message = str(refusal(tmp_path, f"{group}: {{{key}: 1}}"))
    assert f"unknown key '{former}'" in message and f"renamed to '{present}'" in message
    fields = {f.alias or n: f.annotation for n, f in CellSettings.model_fields.items()}
    assert present in fields[group].model_fields and key not in fields[group].model_fields


def test_all_errors_of_a_file_are_reported_together(tmp_path: Path) -> None:
    message = str(refusal(tmp_path, "tabel: {}\nmotion: {max_state_age_s: 0}\n"))
    assert "tabel" in message and "motion.max_state_age_s" in message


def test_each_hint_names_its_key_if_there_are_several_errors(tmp_path: Path) -> None:
    error = refusal(tmp_path, "table: {height: 5000}\noptimiser: {method: nope}\n")
    first, second = error.hint.splitlines()
    assert first.startswith("table.height: looks like millimetres")
    assert second.strip() == "optimiser.method: how arcs are found"


def test_an_error_about_a_value_out_of_range_has_its_key(tmp_path: Path) -> None:
    error = refusal(tmp_path, "table: {height: 820}")
    assert (error.values["key"], error.values["value"]) == ("table.height", "820")


def test_numbers_in_common_notations_are_read(tmp_path: Path) -> None:
    path = tmp_path / "numbers.yaml"
    path.write_text("motion: {approach_height: 5e-2}\noptimiser: {simulations: 010}\ngrasp: {grip_force: 12}\n")
    settings = load_settings(path)
    assert settings.motion.approach_height == 0.05
    assert settings.optimiser.simulations == 10
    assert settings.grasp.grip_force == 12.0


@pytest.mark.parametrize("make", ["missing", "folder", "binary", "huge"])
def test_files_without_settings_are_refused(tmp_path: Path, make: str) -> None:
    path = tmp_path / "cell.yaml"
    if make == "folder":
        path.mkdir()
    elif make == "binary":
        path.write_bytes(b"\xff\xfe\x00\x80" * 10)
    elif make == "huge":
        path.write_text("# " + "x" * 5_000_000)
    with pytest.raises(ConfigurationError, match=r"cell\.yaml"):
        load_settings(path)


def test_a_missing_file_suggests_a_similar_name(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text("")
    with pytest.raises(ConfigurationError, match=r"did you mean .*cell\.yaml"):
        load_settings(tmp_path / "cel.yaml")


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused_with_the_files_name(text: str) -> None:
    path = Path("/dev/shm") / "foldcell-any-text.yaml"
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    try:
        read_yaml(path)
    except ConfigurationError as e:
        assert str(path) in str(e)
    finally:
        path.unlink()


_values = st.recursive(
    st.integers() | st.text(max_size=3),
    lambda v: st.dictionaries(st.text(max_size=3), v, max_size=3) | st.lists(v, max_size=3),
    max_leaves=10,
)
_mappings = st.dictionaries(st.text(max_size=2), _values, max_size=4)


@given(_mappings)
def test_merge_with_nothing_and_with_itself_changes_nothing(a: dict) -> None:
    assert merge(a, {}) == a == merge({}, a) == merge(a, a)


@given(_mappings, _mappings)
def test_merge_prefers_the_second_and_loses_no_key(a: dict, b: dict) -> None:
    merged = merge(a, b)
    assert merged.keys() == a.keys() | b.keys()
    for key, value in b.items():
        if not (isinstance(value, dict) and isinstance(a.get(key), dict)):
            assert merged[key] == value
        else:
            assert merged[key] == merge(a[key], value)


# calibration files


def calibration_file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    return path


def test_calibration_reads_back_as_written(tmp_path: Path) -> None:
    nominal = camera_calibration(load_settings())
    read = load_camera_calibration(calibration_file(tmp_path, calibration_text(nominal)))
    assert np.array_equal(read.T_table_camera, nominal.T_table_camera)
    assert np.array_equal(read.intrinsics.matrix, nominal.intrinsics.matrix)
    assert read.head_pan == nominal.head_pan
    assert not read.T_table_camera.flags.writeable


def test_a_calibration_path_is_relative_to_the_settings_file(tmp_path: Path) -> None:
    nominal = camera_calibration(load_settings())
    (tmp_path / "camera.yaml").write_text(calibration_text(nominal).replace("head_pan: 0.0", "head_pan: 0.1"))
    (tmp_path / "cell.yaml").write_text("camera: {calibration: camera.yaml}")
    assert camera_calibration(load_settings(tmp_path / "cell.yaml")).head_pan == 0.1


def test_the_nominal_camera_looks_down_on_the_table() -> None:
    calibration = camera_calibration(load_settings())
    T, K = calibration.T_table_camera, calibration.intrinsics.matrix
    ray = T[:3, :3] @ np.linalg.inv(K) @ [319.5, 239.5, 1.0]
    hit = T[:3, 3] - ray * T[2, 3] / ray[2]
    assert 0.4 < hit[0] < 0.8
    assert abs(hit[1]) < 0.01


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (("schema: 1", "schema: 3"), "schema"),
        (("kind: camera", "kind: gripper"), "kind"),
        (("  fx: ", "  fxx: "), "fxx"),
        (("  width: 640", "  width: 0"), "width"),
        (("head_pan: 0.0", "head_pan: 30"), "degrees"),
        (("T_table_camera:", "T_camera_table:"), "T_camera_table"),
    ],
)
def test_corrupt_calibrations_are_refused(tmp_path: Path, change: tuple[str, str], part: str) -> None:
    text = calibration_text(camera_calibration(load_settings()))
    assert change[0] in text
    with pytest.raises(ConfigurationError, match=part):
        load_camera_calibration(calibration_file(tmp_path, text.replace(*change)))


def test_truncated_and_binary_calibrations_are_refused_by_the_settings(tmp_path: Path) -> None:
    text = calibration_text(camera_calibration(load_settings()))
    (tmp_path / "cell.yaml").write_text("camera:\n  calibration: camera.yaml\n")
    for content in (text[: len(text) // 2].encode(), b"\x89PNG\r\n\x1a\n\xff\x00", b""):
        (tmp_path / "camera.yaml").write_bytes(content)
        with pytest.raises(ConfigurationError, match=r"cell\.yaml:2: camera\.calibration.*camera\.yaml"):
            load_settings(tmp_path / "cell.yaml")


@pytest.mark.parametrize("fault", ["scaled", "mirrored", "millimetres", "looking up", "below"])
def test_impossible_camera_poses_are_refused(tmp_path: Path, fault: str) -> None:

    nominal = camera_calibration(load_settings())
    T = np.array(nominal.T_table_camera)
    if fault == "scaled":
        T[:3, :3] *= 1.01
    elif fault == "mirrored":
        T[:3, 0] *= -1
    elif fault == "millimetres":
        T[:3, 3] *= 1000
    elif fault == "looking up":
        T[:3, 1:3] *= -1
    elif fault == "below":
        T[2, 3] = -1.0
    path = calibration_file(tmp_path, calibration_text(replace(nominal, T_table_camera=T)))
    with pytest.raises(ConfigurationError, match="T_table_camera"):
        load_camera_calibration(path)


# settings of the skills


def test_the_shipped_thresholds_are_those_that_the_skills_were_tested_with() -> None:
    settings = load_settings()
    assert settings.gripper.pads == PadGeometry()
    assert settings.ros.settings() == RosSettings()
    assert settings.network.settings() == Network()


def test_the_robots_topics_reach_the_driver(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(
        "ros: {raw_position: true, tactile_rows: 6, camera_settle: 1.5, "
        "camera_rgb: /a/b, camera_depth: /c, camera_info: /d/e_1}"
    )
    camera = CameraTopics("/a/b", "/c", "/d/e_1")
    assert load_settings(tmp_path / "cell.yaml").ros.settings() == RosSettings(camera, True, 6, 1.5)


def test_the_network_of_the_emulator_can_be_set(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(
        "network: {delay: 0.02, jitter: 0.01, loss: 0.03, reordering: true, repeat: 0.1, clock_ahead: -5.0, "
        "picture_period: 1.0, master_silent_from: 20.0, master_silent_for: 5.0}"
    )
    expected = Network(0.02, 0.01, 0.03, True, 0.1, -5.0, 1.0, 20.0, 5.0)
    assert load_settings(tmp_path / "cell.yaml").network.settings() == expected


@pytest.mark.parametrize("topic", ["camera/rgb", "/", "/a//b", "/1a", "/a b", ""])
def test_an_invalid_topic_name_is_refused(tmp_path: Path, topic: str) -> None:
    (tmp_path / "cell.yaml").write_text(f"ros: {{camera_rgb: '{topic}'}}")
    with pytest.raises(ConfigurationError, match="camera_rgb"):
        load_settings(tmp_path / "cell.yaml")


def test_every_settings_key_is_used() -> None:
    """Every key of the shipped file has a use in the code. Groups with `settings()` are tested above."""
    root = default_settings_path().parents[1]
    sources = [p for p in root.rglob("*.py") if p.name != "cell_settings.py"]
    names = {n.attr for p in sources for n in ast.walk(ast.parse(p.read_text())) if isinstance(n, ast.Attribute)}
    for group, keys in yaml.safe_load(default_settings_path().read_text()).items():
        tested = ("table", "perception", "inspection", "grasp", "ros", "network")
        if isinstance(keys, dict) and group not in tested:
            assert keys.keys() <= names, group


def test_thresholds_of_a_file_reach_the_skills(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("perception: {method: grabcut, flat_height: 0.03}\ninspection: {drift_deg: 90e-1, iou: 0.8}")
    settings = load_settings(path)
    inspection = settings.inspection.settings(settings.perception)
    assert inspection.perception.method == "grabcut" and inspection.perception.flat_height == 0.03
    assert inspection.drift_angle == pytest.approx(np.pi / 20) and inspection.iou == 0.8


@pytest.mark.parametrize(
    ("values", "parts"),
    [
        ({"cy": 179.5}, ["intrinsics.cy = 179.5", "360 pixels"]),
        ({"cx": 639.5}, ["intrinsics.cx = 639.5", "1280 pixels"]),
        ({"fy": 434.0}, ["fy = 434", "square"]),
    ],
)
def test_intrinsics_of_another_resolution_are_refused(
    tmp_path: Path, values: dict[str, float], parts: list[str]
) -> None:
    nominal = camera_calibration(load_settings())
    other = replace(nominal, intrinsics=replace(nominal.intrinsics, **values))
    with pytest.raises(ConfigurationError) as refused:
        load_camera_calibration(calibration_file(tmp_path, calibration_text(other)))
    assert all(part in str(refused.value) for part in parts)


def test_a_lens_that_is_a_little_off_its_middle_is_accepted(tmp_path: Path) -> None:
    nominal = camera_calibration(load_settings())
    real = replace(nominal, intrinsics=replace(nominal.intrinsics, cx=335.0, cy=225.0, fx=560.0))
    read = load_camera_calibration(calibration_file(tmp_path, calibration_text(real)))
    assert np.array_equal(read.intrinsics.matrix, real.intrinsics.matrix)
