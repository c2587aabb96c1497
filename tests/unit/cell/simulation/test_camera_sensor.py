"""The simulated camera: rendering, projection, and sensor noise."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from foldcell.cell.simulation.camera.camera import Renderer, SimulatedCamera
from foldcell.cell.simulation.camera.display_drawing import DisplayDrawing
from foldcell.cell.simulation.camera.render_server import Picture, Scene, Shot
from foldcell.cell.simulation.garment.fabric import contrasting_colour, fabric_texture, garment_uv, table_texture
from foldcell.cell.simulation.noise import load_noise
from foldcell.cell.simulation.settings import DEFAULT_TABLE
from foldcell.robots.baxter.names import JOINT_NAMES
from foldcell.robots.baxter.robot import FLOOR, MOUNT, ROBOT, load_model
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Array

NOISE = load_noise().camera
K = MOUNT.intrinsics
Z = DEFAULT_TABLE.height


def sheet() -> tuple[Array, np.ndarray]:
    """A grid of 0.40 x 0.60 m centred on 0: vertices (n, 2) and triangles."""
    nx, ny = 11, 16
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, nx), np.linspace(-0.3, 0.3, ny), indexing="ij")
    xy = np.column_stack((x.ravel(), y.ravel()))
    cells = [(i * ny + j, (i + 1) * ny + j) for i in range(nx - 1) for j in range(ny - 1)]
    triangles = [t for a, b in cells for t in ((a, b, a + 1), (a + 1, b, b + 1))]
    return xy, np.array(triangles, np.int32)


def scene() -> Scene:
    xy, triangles = sheet()
    rng = np.random.default_rng(5)
    return Scene(
        urdf=str(ROBOT.simulation.seen_urdf()), floor=FLOOR, table=DEFAULT_TABLE,
        table_texture=table_texture(rng, "bare_table"),
        garment_uv=garment_uv(xy, np.zeros(len(xy), np.int32)), garment_triangles=triangles,
        garment_texture=np.full((8, 8, 3), (0, 0, 255), np.uint8), width=K.width, height=K.height,
        focal=(K.fx, K.fy), centre=(K.cx, K.cy), light=(0.4, 0.2, 2.5), ambient=0.6, diffuse=0.4,
    )  # fmt: skip


def shot(vertices: Array | None) -> Shot:
    return Shot(dict(zip(JOINT_NAMES, load_model().q_park.tolist(), strict=True)), vertices, MOUNT.T_base_camera())


def project(points: Array) -> Array:
    p = (points - MOUNT.T_base_camera()[:3, 3]) @ MOUNT.T_base_camera()[:3, :3]
    uvw = p @ K.matrix.T
    return uvw[:, :2] / uvw[:, 2:]


@pytest.fixture(scope="module")
def renderer() -> Iterator[Renderer]:
    r = Renderer(scene())
    yield r
    r.close()


def blue(picture: Picture) -> np.ndarray:
    rgb = picture.rgb.astype(int)
    return (rgb[..., 2] > 60) & (rgb[..., 2] > 1.8 * rgb[..., 0])


def lying(xy: Array, height: float = 0.002) -> Array:
    return np.column_stack((xy + np.array([0.58, 0.0]), np.full(len(xy), Z + height)))


def test_table_and_cloth_appear_at_their_pinhole_projections(renderer: Renderer) -> None:
    xy, _ = sheet()
    empty, laid = renderer.picture(shot(None)), renderer.picture(shot(lying(xy)))
    v, u = np.mgrid[80:400:16, 100:540:16].reshape(2, -1)
    T = MOUNT.T_base_camera()
    ray = np.column_stack(((u - K.cx) / K.fx, (v - K.cy) / K.fy, np.ones(len(u)))) @ T[:3, :3].T
    np.testing.assert_allclose(empty.depth[v, u], (Z - T[2, 3]) / ray[:, 2], atol=2e-5)
    assert not blue(empty).any()
    rows, columns = np.nonzero(blue(laid))
    corners = project(lying(xy)[[0, 15, 160, 175]])
    assert abs(columns.min() - corners[:, 0].min()) <= 1 and abs(columns.max() - corners[:, 0].max()) <= 1
    assert abs(rows.min() - corners[:, 1].min()) <= 1 and abs(rows.max() - corners[:, 1].max()) <= 1


def test_both_sides_of_the_cloth_are_seen(renderer: Renderer) -> None:
    xy, _ = sheet()
    face_up, face_down = lying(xy), lying(xy * (1.0, -1.0))
    areas = [blue(renderer.picture(shot(v))).sum() for v in (face_up, face_down)]
    assert areas[1] == pytest.approx(areas[0], rel=0.01)


def test_a_dead_render_process_is_replaced_and_draws_the_same_picture(renderer: Renderer) -> None:
    xy, _ = sheet()
    before = renderer.picture(shot(lying(xy)))
    renderer.picture(shot(None))
    pid = renderer.pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    after = renderer.picture(shot(lying(xy)))
    assert renderer.pid != pid
    np.testing.assert_array_equal(before.rgb, after.rgb)
    np.testing.assert_array_equal(before.depth, after.depth)


def test_only_a_shot_that_differs_is_rendered(renderer: Renderer) -> None:
    xy, _ = sheet()
    before = shot(lying(xy))
    picture = renderer.picture(before)
    assert renderer.picture(replace(before, vertices=lying(xy))) is picture
    T = MOUNT.T_base_camera() + np.eye(4, k=3) * 1e-3
    others = [
        shot(None),
        replace(before, vertices=lying(xy, 0.0021)),
        replace(before, joints=before.joints | {JOINT_NAMES[0]: 0.3}),
        replace(before, T_base_camera=T),
        replace(before, T_base_board=np.eye(4)),
    ]
    for other in others:
        assert renderer.picture(before) is not renderer.picture(other)


def test_the_drawing_for_a_person_shows_the_same(renderer: Renderer) -> None:
    """With the arms in view, so that the robot is compared too."""
    parked = shot(lying(sheet()[0]))
    bent = {name: angle + 0.3 * name.endswith("s1") for name, angle in parked.joints.items()}
    both = [c.picture(replace(parked, joints=bent)) for c in (renderer, DisplayDrawing(renderer.scene))]
    exact, drawn = both
    assert drawn.rgb.shape == exact.rgb.shape and drawn.depth.shape == exact.depth.shape
    assert np.mean(exact.depth < 0.8) > 0.02, "the arms are in view"
    assert np.mean(np.abs(drawn.depth - exact.depth) < 0.001) > 0.99, "up to the pixels of edges"
    assert np.mean(blue(drawn) == blue(exact)) > 0.995


class Still:
    """A renderer that always sees a plane at 1.1 m with a block 0.1 m high in the middle."""

    depth = np.full((480, 640), 1.1, np.float32)
    depth[200:280, 280:360] = 1.0

    def __init__(self) -> None:
        self.scene = scene()

    def picture(self, _: Shot) -> Picture:
        return Picture(np.full((480, 640, 3), 128, np.uint8), self.depth.copy())


def camera(seed: int = 7, ideal: bool = False) -> SimulatedCamera:
    return SimulatedCamera(Still(), K, NOISE, seed, lambda: shot(None), lambda: 2.5, ideal)  # type: ignore[arg-type]


def test_depth_noise_grows_with_the_square_of_the_distance_and_depth_is_quantised() -> None:
    depth = camera().capture().depth
    flat = depth[20:180, 20:600]
    flat = flat[np.isfinite(flat)]
    step = NOISE.disparity_step * 1.1**2 / (K.fx * NOISE.depth_baseline)
    sigma = np.hypot(NOISE.depth_sigma * 1.1**2, step / np.sqrt(12))
    assert flat.std() == pytest.approx(sigma, rel=0.1)
    assert flat.mean() == pytest.approx(1.1, abs=2e-4)
    disparity = K.fx * NOISE.depth_baseline / flat / NOISE.disparity_step
    np.testing.assert_allclose(disparity, np.rint(disparity), atol=1e-3)


def test_the_lasting_part_of_the_noise_remains_in_the_mean_of_many_exposures() -> None:
    c = camera()
    mean = c.capture(exposures=40).depth[20:180, 20:600] - 1.1
    lasting = NOISE.depth_lasting * NOISE.depth_sigma * 1.1**2
    assert np.nanstd(mean) == pytest.approx(lasting, rel=0.15)
    again = c.capture(exposures=40).depth[20:180, 20:600] - 1.1
    assert np.corrcoef(mean.ravel(), again.ravel())[0, 1] > 0.8, "the lasting part is the same in every picture"


def test_depth_is_lost_almost_only_at_edges() -> None:
    lost = np.isnan(camera().capture().depth)
    assert lost[200, 280:360].mean() > 0.6
    assert lost[20:180, 20:600].mean() < 0.005


def test_the_noise_depends_only_on_seed_and_picture_number() -> None:
    one, other = camera(), camera()
    other.capture()
    first, second = one.capture(), one.capture()
    np.testing.assert_array_equal(second.rgb, other.capture().rgb)
    assert (first.sequence, second.sequence, first.stamp) == (1, 2, 2.5)
    assert (first.rgb != second.rgb).any()
    assert (camera(seed=8).capture().rgb != first.rgb).any()
    assert not first.rgb.flags.writeable and not first.depth.flags.writeable


def test_faults_freeze_blacken_and_silence_the_camera() -> None:
    c = camera()
    first = c.capture()
    c.frozen = True
    assert c.capture() is first
    c.frozen, c.black = False, True
    dark = c.capture()
    assert dark.rgb.max() == 0 and np.isnan(dark.depth).all() and dark.sequence == 2
    c.silent = True
    with pytest.raises(DriverError) as error:
        c.capture()
    assert error.value.kind is FailureKind.CAMERA_FAULT


def test_a_glimpse_is_made_while_the_world_goes_on_and_shows_what_was_there() -> None:
    """The renderer waits for this thread: a camera that waited for the renderer would never return. Only the
    picture's pixels may depend on it."""
    asked, free = list[Shot](), threading.Event()

    class Slow(Still):
        def picture(self, shot: Shot) -> Picture:
            assert free.wait(10.0)
            asked.append(shot)
            return super().picture(shot)

    shots = [shot(None), shot(lying(sheet()[0]))]
    now = iter(shots)
    slow = SimulatedCamera(Slow(), K, NOISE, 7, lambda: next(now), lambda: 2.5)  # type: ignore[arg-type]
    glimpses = [slow.capture(), slow.capture()]
    slow.black = True  # a fault that begins later changes no picture
    assert [g.sequence for g in glimpses] == [1, 2] and asked == [] and glimpses[0].nbytes == 7 * 640 * 480
    free.set()
    copy = replace(glimpses[0], stamp=9.0)
    assert copy.stamp == 9.0 and copy.rgb is glimpses[0].rgb
    at_once = camera()
    for glimpse in glimpses:
        same = at_once.capture()
        assert (glimpse.rgb == same.rgb).all() and np.array_equal(glimpse.depth, same.depth, equal_nan=True)
    assert asked == shots


def test_without_a_renderer_a_glimpse_is_black_and_a_still_picture_fails() -> None:
    class Broken(Still):
        def picture(self, _: Shot) -> Picture:
            raise DriverError(FailureKind.CAMERA_FAULT, "the render process gave no picture")

    broken = SimulatedCamera(Broken(), K, NOISE, 7, lambda: shot(None), lambda: 2.5)  # type: ignore[arg-type]
    glimpse = broken.capture()
    assert glimpse.rgb.max() == 0 and np.isnan(glimpse.depth).all()
    with pytest.raises(DriverError, match="no picture"):
        broken.capture(exposures=2)


@pytest.mark.parametrize("seed", range(6))
def test_a_contrasting_fabric_differs_from_the_table(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table, fabric = (f.reshape(-1, 3).mean(axis=0) for f in (
        table_texture(rng, "bare_table"), fabric_texture(rng, contrasting_colour(rng))))  # fmt: skip
    assert np.linalg.norm(table / table.sum() - fabric / fabric.sum()) > 0.1


def test_pictures_for_display_change_no_picture_that_the_cell_takes() -> None:
    """How many of them are taken depends on the computer's speed; a run depends on its seed alone."""
    alone, watched = camera(), camera()
    for _ in range(3):
        shown = watched.display()()
        mine, theirs = alone.capture(2), watched.capture(2)
        assert (mine.rgb == theirs.rgb).all() and np.array_equal(mine.depth, theirs.depth, equal_nan=True)
        assert mine.sequence == theirs.sequence and not (shown.rgb == theirs.rgb).all()
