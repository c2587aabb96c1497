import cv2
import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.skills.perception.rectification.camera_refinement import refine_calibration, tilted_table
from foldcell.skills.vocabulary import CameraCalibration
from tests.scenes import TABLE, Scene, camera, render, with_arm


def hung(shift, turn):
    """The nominal camera, moved by `shift` [m] and turned by the rotation vector `turn` [rad], both in table
    axes."""
    nominal = camera()
    T = np.array(nominal.T_table_camera)
    T[:3, :3] = cv2.Rodrigues(np.array(turn, dtype=float))[0] @ T[:3, :3]
    T[:3, 3] += shift
    return CameraCalibration(nominal.intrinsics, T)


def on_table(calibration, uv):
    k, T = calibration.intrinsics, calibration.T_table_camera
    d = np.column_stack([(uv[:, 0] - k.cx) / k.fx, (uv[:, 1] - k.cy) / k.fy, np.ones(len(uv))]) @ T[:3, :3].T
    return T[:2, 3] - d[:, :2] * (T[2, 3] / d[:, 2])[:, None]


PIXELS = np.stack(np.meshgrid([120.0, 320.0, 520.0], [120.0, 240.0, 360.0]), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_tilted_bracket_is_measured(seed):
    """The bracket is off by a few millimetres and milliradians. Points on the table are found to within 2.5 mm,
    except for the shift along y, which no picture of the table shows."""
    rng = np.random.default_rng(seed)
    shift, turn = rng.normal(0, 0.003, 3) * (1, 0, 1), rng.normal(0, 0.004, 3)
    true = hung(shift, turn)
    picture = render(Scene(seed=seed, floor=(0.12, 0.12, 0.13)), true)
    outcome = refine_calibration(picture, camera(), TABLE)
    assert outcome.notes["edges"] == 2
    where = on_table(true, PIXELS)
    before = np.linalg.norm(on_table(camera(), PIXELS) - where, axis=1).max()
    after = np.linalg.norm(on_table(outcome.unwrap(), PIXELS) - where, axis=1).max()
    assert after < 0.0025 and after < 0.5 * before


def test_depth_alone_levels_the_camera_if_no_edge_is_in_view():
    true = hung((0.0, 0.0, 0.0), (0.006, 0.0, 0.0))
    outcome = refine_calibration(render(Scene(seed=1), true), camera(), TABLE)
    assert outcome.notes["edges"] == 0
    up = np.linalg.inv(true.T_table_camera)[:3, 2]
    error = np.arccos(np.clip(outcome.unwrap().T_table_camera[:3, :3] @ up @ [0, 0, 1], -1, 1))
    assert error < 0.001


def test_a_correct_calibration_is_unchanged():
    outcome = refine_calibration(render(Scene(seed=2, floor=(0.1, 0.1, 0.1))), camera(), TABLE)
    assert np.abs(on_table(outcome.unwrap(), PIXELS) - on_table(camera(), PIXELS)).max() < 0.001


def test_a_camera_far_from_its_calibration_is_refused():
    true = hung((0.0, 0.0, 0.05), (0.0, 0.0, 0.0))
    outcome = refine_calibration(render(Scene(seed=1, floor=(0.1, 0.1, 0.1)), true), camera(), TABLE)
    assert outcome.failure is not None and outcome.failure.kind is FailureKind.CAMERA_FAULT


def test_a_picture_without_a_table_plane_is_refused():
    picture = render(Scene(seed=1))
    picture.depth[:] = np.nan
    outcome = refine_calibration(picture, camera(), TABLE)
    assert outcome.failure is not None and outcome.failure.kind is FailureKind.CAMERA_FAULT


@pytest.mark.parametrize(("shift", "turn", "word"), [
    ((0.0, 0.0, 0.0), (0.04, 0.0, 0.0), "tilted by 2.3 degrees"),
    ((0.0, 0.0, 0.0), (0.0, -0.04, 0.0), "tilted by 2.3 degrees"),
    ((0.0, 0.0, 0.05), (0.0, 0.0, 0.0), "50 mm lower"), ((0.0, 0.0, -0.05), (0.0, 0.0, 0.0), "50 mm higher"),
])  # fmt: skip
def test_depth_that_contradicts_the_calibration_is_told(shift, turn, word):
    failure = tilted_table(render(Scene(seed=1), hung(shift, turn)), camera(), TABLE)
    assert failure is not None and failure.kind is FailureKind.CAMERA_FAULT and word in failure.what


@pytest.mark.parametrize("seed", range(4))
def test_the_tolerance_of_a_bracket_and_a_hand_on_the_table_contradict_nothing(seed):
    rng = np.random.default_rng(seed)
    picture = render(Scene(seed=seed), hung(rng.normal(0, 0.005, 3), rng.normal(0, 0.005, 3)))
    assert tilted_table(picture, camera(), TABLE) is None
    assert tilted_table(with_arm(picture, camera(), (0.6, 0.2), (0.55, 0.75)), camera(), TABLE) is None
