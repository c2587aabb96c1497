"""Faults of the camera, on a camera that sees a still plane."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from foldcell.cell.simulation.camera.camera import SimulatedCamera
from foldcell.cell.simulation.camera.render_server import Picture, Shot
from foldcell.cell.simulation.camera.slabs import hand_over, square_cloth, with_slabs
from foldcell.cell.simulation.faults import Fault, FaultBoard, FaultKind
from foldcell.cell.simulation.faults.camera_faults import CameraFaults, holes
from foldcell.cell.simulation.noise import load_noise
from foldcell.robots.baxter.robot import MOUNT
from foldcell.robots.errors import DriverError
from foldcell.robots.ports import CameraFrame

K = FaultKind
STILL = 8
TABLE = -0.10


def plane() -> Picture:
    """The table of the cell in the camera's picture, grey, without anything on it."""
    v, u = np.mgrid[0:480, 0:640]
    k, T = MOUNT.intrinsics, MOUNT.T_base_camera()
    rays = np.stack(((u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones_like(u, float)), axis=-1)
    depth = (TABLE - T[2, 3]) / (rays @ T[2, :3])
    return Picture(np.full((480, 640, 3), 120, np.uint8), depth.astype(np.float32))


class Watched:
    """A camera before the plane, and its faults. The grey of a picture tells its time."""

    def __init__(self, kind: FaultKind, **traits: float) -> None:
        self.board = FaultBoard()
        self.board.add(Fault(kind, at=1.0, **traits))  # type: ignore[arg-type]
        scene = SimpleNamespace(
            focal=(MOUNT.intrinsics.fx, MOUNT.intrinsics.fy), centre=(MOUNT.intrinsics.cx, MOUNT.intrinsics.cy)
        )
        renderer = SimpleNamespace(scene=scene, picture=self._picture)
        camera = SimulatedCamera(
            renderer, MOUNT.intrinsics, load_noise().camera, 1, lambda: Shot({}, None, MOUNT.T_base_camera()),  # type: ignore[arg-type]
            lambda: self.board.now, ideal=True,
        )  # fmt: skip
        self.faults = CameraFaults(self.board, camera)

    def _picture(self, _: Shot) -> Picture:
        seen = plane()
        return Picture(np.full_like(seen.rgb, round(10.0 * self.board.now)), seen.depth)

    def take(self, t: float, exposures: int = STILL) -> CameraFrame:
        self.board.now = t
        return self.faults.take(exposures)

    def lateness(self, t: float) -> float:
        self.board.now = t
        return self.faults.lateness()


def test_an_old_picture_has_a_fresh_stamp_and_number() -> None:
    watched = Watched(K.CAMERA_OLD_PICTURE, duration=2.0)
    first = watched.take(0.5)
    watched.take(0.8, exposures=1)  # a glimpse between two stills
    old, new = watched.take(1.5), watched.take(4.0)
    np.testing.assert_array_equal(old.rgb, first.rgb)
    assert (old.stamp, old.sequence) == (1.5, 3)
    assert new.rgb[0, 0, 0] == 40 and (new.stamp, new.sequence) == (4.0, 4)


def test_an_old_picture_of_a_driver_that_averages_exposures_is_the_last_of_a_row() -> None:
    watched = Watched(K.CAMERA_OLD_PICTURE, duration=2.0)
    greys = [watched.take(t, exposures=1).rgb[0, 0, 0] for t in (0.0, 0.1, 0.2, 0.9)]  # the last one is a glimpse
    old = watched.take(1.5, exposures=1)
    assert greys == [0, 1, 2, 9] and old.rgb[0, 0, 0] == 2
    assert (old.stamp, old.sequence) == (1.5, 5)


def test_a_frozen_camera_repeats_picture_and_stamp() -> None:
    watched = Watched(K.CAMERA_FREEZE, duration=2.0)
    first = watched.take(0.5)
    assert watched.take(1.5) is first
    assert watched.take(4.0).stamp == 4.0


def test_a_silent_camera_answers_again() -> None:
    watched = Watched(K.CAMERA_SILENT, duration=2.0)
    with pytest.raises(DriverError, match="does not answer"):
        watched.take(1.5)
    assert watched.take(4.0).stamp == 4.0


def test_a_picture_of_the_wrong_size_claims_its_usual_intrinsics() -> None:
    watched = Watched(K.CAMERA_WRONG_SIZE, duration=2.0)
    wrong, right = watched.take(1.5), watched.take(4.0)
    assert wrong.rgb.shape == (240, 320, 3) and wrong.depth.shape == (240, 320)
    assert wrong.intrinsics == right.intrinsics and right.rgb.shape == (480, 640, 3)


def test_depth_is_missing_where_stated() -> None:
    none, patches = (
        Watched(K.CAMERA_DEPTH_NAN, duration=2.0),
        Watched(K.CAMERA_DEPTH_HOLES, size=0.3, duration=2.0),
    )
    assert np.isnan(none.take(1.5).depth).all() and np.isfinite(none.take(4.0).depth).all()
    assert 0.3 <= np.isnan(patches.take(1.5).depth).mean() < 0.35
    assert np.isfinite(patches.take(4.0).depth).all()


@pytest.mark.parametrize("share", [0.05, 0.3, 0.7])
def test_holes_cover_their_share_in_other_places_for_other_seeds(share: float) -> None:
    masks = [holes((480, 640), share, seed) for seed in range(3)]
    assert all(share <= mask.mean() < share + 0.04 for mask in masks)
    assert (masks[0] != masks[1]).any()


def test_a_late_picture_is_as_late_as_stated() -> None:
    watched = Watched(K.CAMERA_LATE, size=2.0, duration=3.0)
    assert [watched.lateness(t) for t in (0.5, 1.5, 5.0)] == [0.0, 2.0, 0.0]


def test_a_second_garment_lies_where_it_is_and_is_as_high_as_stated() -> None:
    """The square's area in the picture agrees with its area on the table, by each pixel's own footprint."""
    before, k, T = plane(), MOUNT.intrinsics, MOUNT.T_base_camera()
    cloth = square_cloth(np.array([0.6, 0.1]), 0.2, 0.3, TABLE + 0.004, (10, 20, 200))
    after = with_slabs(before, [cloth], T, (k.fx, k.fy), (k.cx, k.cy))
    covered = (after.rgb == (10, 20, 200)).all(axis=-1)
    v, u = np.nonzero(covered)
    rays = np.column_stack(((u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(len(u))))
    points = (rays * after.depth[covered][:, None]) @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(points[:, 2], TABLE + 0.004, atol=1e-4)
    np.testing.assert_allclose(points[:, :2].mean(axis=0), (0.6, 0.1), atol=3e-3)
    footprint = after.depth[covered] ** 2 / (k.fx * k.fy) / -(rays @ T[2, :3])
    assert footprint.sum() == pytest.approx(0.2**2, rel=0.03)
    np.testing.assert_array_equal(after.depth[~covered], before.depth[~covered])


def test_a_hand_hides_what_is_under_it_and_leaves_the_picture() -> None:
    before, k, T = plane(), MOUNT.intrinsics, MOUNT.T_base_camera()
    after = with_slabs(before, [hand_over(np.array([0.6, 0.0]), TABLE + 0.08, 0.0)], T, (k.fx, k.fy), (k.cx, k.cy))
    covered = after.depth < before.depth
    assert covered[0].any() or covered[-1].any(), "the forearm reaches the edge of the picture"
    assert 0.02 < covered.mean() < 0.3
    np.testing.assert_array_equal(after.rgb[covered].std(axis=0), 0.0)


def test_what_is_nearer_to_the_camera_than_a_slab_stays_visible() -> None:
    before, k, T = plane(), MOUNT.intrinsics, MOUNT.T_base_camera()
    before.depth[200:280, 280:360] -= 0.3
    after = with_slabs(before, [hand_over(np.array([0.6, 0.0]), TABLE + 0.08, 0.0)], T, (k.fx, k.fy), (k.cx, k.cy))
    np.testing.assert_array_equal(after.rgb[200:280, 280:360], 120)
    np.testing.assert_array_equal(after.depth[200:280, 280:360], before.depth[200:280, 280:360])
