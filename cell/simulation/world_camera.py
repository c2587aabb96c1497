"""The camera of the simulated cell: where it really is, what it sees of the world, and its faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from foldcell.cell.simulation.camera.board import WorldBoard, built_lens
from foldcell.cell.simulation.camera.camera import Renderer, SimulatedCamera
from foldcell.cell.simulation.camera.render_server import Scene, Shot
from foldcell.cell.simulation.camera.slabs import Slab
from foldcell.cell.simulation.faults.board import FaultBoard
from foldcell.cell.simulation.faults.camera_faults import CameraFaults
from foldcell.cell.simulation.faults.world_faults import WorldFaults
from foldcell.cell.simulation.garment.fabric import contrasting_colour, fabric_texture, garment_uv, table_texture
from foldcell.cell.simulation.garment.garment import WorldGarment
from foldcell.cell.simulation.noise import CameraNoise, NoiseTable
from foldcell.cell.simulation.settings import SimulationSettings
from foldcell.robots.camera_mount import CameraMount
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Array, CameraFrame, Side
from foldcell.robots.robot import Robot, SimulatedBody


class WorldCamera:
    """The camera of one world. Without `settings.render` it raises DriverError instead of taking pictures.

    settings: with the true table. rng: generators of the streams build, board, camera and look. openings: returns
    the openings of the grippers [m]; now: returns the world's time [s].
    """

    def __init__(
        self,
        settings: SimulationSettings,
        robot: Robot,
        noise: NoiseTable,
        rng: Mapping[str, np.random.Generator],
        body: SimulatedBody,
        openings: Callable[[], Mapping[Side, float]],
        garment: WorldGarment,
        board: FaultBoard,
        now: Callable[[], float],
    ) -> None:
        self._settings, self._robot, self._model = settings, robot, robot.load_model()
        self._body, self._openings, self._garment = body, openings, garment
        self._mount = settings.camera or robot.camera
        self.lens = self._mount.intrinsics
        """The true intrinsics."""
        self.board: WorldBoard | None = None
        if settings.as_built:
            self.lens = built_lens(self.lens, noise.build, rng["build"])
            self.board = WorldBoard(noise.board, rng["board"])
        ideal = not settings.camera_noise
        self._T_head_camera = _mounted(self._mount, noise.camera, rng["camera"], ideal)
        self._camera: SimulatedCamera | None = None
        if settings.render:
            scene = self._scene(noise.camera.light_swing, rng["look"])
            self._fabric = _mean_colour(scene.garment_texture)
            seed = int(rng["camera"].integers(2**31))
            self._camera = SimulatedCamera(
                Renderer(scene), self._mount.intrinsics, noise.camera, seed, self._shot, now, ideal
            )
            self._faults = CameraFaults(board, self._camera)
        self._seen_slabs: Sequence[Slab] = ()

    def close(self) -> None:
        if self._camera is not None:
            self._camera.close()

    @property
    def pictures(self) -> int:
        """Number of pictures taken so far."""
        return self._camera.sequence if self._camera else 0

    def resume(self, pictures: int) -> None:
        """Continue after this number of pictures, when a world is restored."""
        if self._camera is not None:
            self._camera.resume(pictures)

    # pictures

    def picture(self, exposures: int, faults: WorldFaults) -> CameraFrame:
        """Take a picture that is the mean of several exposures. faults: objects before the camera."""
        self._seeing()
        self._seen_slabs = faults.slabs(self._settings.table, self._fabric)
        return self._faults.take(exposures, self._seen_slabs)

    def lateness(self) -> float:
        """Return by how much a picture that was taken now arrives late [s]."""
        return self._faults.lateness()

    def display(self) -> Callable[[], CameraFrame]:
        """Take the present state for a picture that a person sees: see `SimulatedCamera.display`."""
        return self._seeing().display(self._seen_slabs)

    def _seeing(self) -> SimulatedCamera:
        if self._camera is None:
            raise DriverError(FailureKind.CAMERA_FAULT, "this cell has no camera", "open it with render=True")
        return self._camera

    # view of the world

    def T_base_camera(self) -> Array:
        """Return the true pose (4, 4) of the camera."""
        return self._mount.T_base_head(self._body.read()[3]) @ self._T_head_camera

    def _shot(self) -> Shot:
        q, _, _, pan = self._body.read()
        joints = dict(zip(self._model.joint_names, q.tolist(), strict=True))
        if self._mount.head_joint is not None:
            joints[self._mount.head_joint] = pan
        for side, opening in self._openings().items():
            joints |= self._robot.gripper.finger_positions(side, opening)
        vertices = self._garment.seen if self._garment.laid else None
        if vertices is not None:
            vertices[:, 2] += self._settings.table.height
        T_base_camera = self.T_base_camera()
        board = self.board.pose(T_base_camera, self._T_base_tools()) if self.board else None
        return Shot(joints, vertices, T_base_camera, board)

    def _T_base_tools(self) -> dict[Side, Array]:
        poses = {}
        for side in Side:
            T = np.eye(4)
            T[:3, 3], T[:3, :3] = self._body.tool_pose(side)
            poses[side] = T
        return poses

    def _scene(self, swing: float, rng: np.random.Generator) -> Scene:
        """Draw the look of the world. swing: largest shift of the light along x and y [m]."""
        settings, mesh, lens = self._settings, self._garment.mesh, self.lens
        light = (float(rng.uniform(-swing, swing)), float(rng.uniform(-swing, swing)), 2.5)
        return Scene(
            urdf=str(self._robot.simulation.seen_urdf()),
            floor=self._model.floor,
            table=settings.table,
            table_texture=table_texture(rng, settings.surface),
            garment_uv=garment_uv(mesh.rest, mesh.layer),
            garment_triangles=mesh.triangles,
            garment_texture=fabric_texture(rng, contrasting_colour(rng)),
            width=lens.width,
            height=lens.height,
            focal=(lens.fx, lens.fy),
            centre=(lens.cx, lens.cy),
            light=light,
            ambient=float(rng.uniform(0.52, 0.62)),
            diffuse=float(rng.uniform(0.32, 0.42)),
            board=(self.board.picture, self.board.size) if self.board else None,
        )


def _mean_colour(texture: NDArray[np.uint8]) -> tuple[int, int, int]:
    red, green, blue = texture.reshape(-1, 3).mean(axis=0)
    return round(red), round(green), round(blue)


def _mounted(mount: CameraMount, noise: CameraNoise, rng: np.random.Generator, ideal: bool) -> Array:
    """Draw the true pose (4, 4) of the camera in the frame of the head link."""
    shift = rng.standard_normal(3) * noise.pose_position
    turn = rng.standard_normal(3) * noise.pose_angle
    T = np.array(mount.T_head_camera)
    if ideal:
        return T
    angle = float(np.linalg.norm(turn))
    k = turn / angle
    K = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    T[:3, :3] = T[:3, :3] @ (np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)
    T[:3, 3] += shift
    return T
