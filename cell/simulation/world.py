"""The simulated world: robot, hands, garment and camera, advanced by one clock.

Rigid bodies step at 240 Hz, the cloth at 60 Hz, in a fixed order: faults, arms, grippers, cloth. The world and all
its errors are a function of the settings, the seed and the calls. The wall clock is used only to pace a run in
real time.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cell.config.garments.garment_file import list_garments, load_garment
from cell.simulation.camera.board import WorldBoard, built_lens, built_table
from cell.simulation.camera.camera import Renderer, SimulatedCamera
from cell.simulation.camera.render_server import Scene, Shot
from cell.simulation.camera.slabs import Slab
from cell.simulation.faults import FaultBoard, FaultKind
from cell.simulation.faults.camera_faults import CameraFaults
from cell.simulation.faults.port_faults import PortFaults
from cell.simulation.faults.world_faults import HANDS, WorldFaults
from cell.simulation.garment.cloth_body import FRAME_RATE, check_body
from cell.simulation.garment.fabric import fabric_texture, garment_uv, table_texture
from cell.simulation.garment.garment import WorldGarment
from cell.simulation.noise import CameraNoise, NoiseTable, load_noise
from cell.simulation.robot import contact
from cell.simulation.robot.arms import SimulatedRobot
from cell.simulation.robot.gripper import SimulatedGripper
from cell.simulation.robot.tactile import SimulatedTactile
from cell.simulation.settings import SimulationSettings
from cell.simulation.truth import GarmentTruth, Truth
from robots.bullet.body import pb
from robots.camera_mount import CameraMount
from robots.depth_averaging import EVERY_S, EXPOSURES
from robots.errors import ConfigurationError, DriverError, FailureKind
from robots.ports import Array, BoardPlace, CameraFrame, Side, frozen
from robots.registry import find_robot
from skills.garments.garment import Garment

__all__ = ["STEP_RATE", "World"]

STEP_RATE = 240
"""Rate of the physics steps [Hz]."""
STEPS_A_FRAME = STEP_RATE // FRAME_RATE
WATCH_RATE = 12
RAISED = 0.040
"""While a hand holds cloth, this length of each finger, from the tip upwards, does not push cloth [m]. The held
cloth is in this part. The same applies after a release, until the fingers are clear of the cloth."""
NEAR = 0.08
"""A hand that is higher than this above the garment cannot touch it [m]."""
THICKEST = 0.025
"""Fingertips above this height can touch neither the table nor a stack of cloth [m]."""
SQUEEZE = 2e-4
"""Depth to which a fingertip compresses the flat stack of cloth under it [m]. With a larger depth, table and
finger would push the cloth in opposite directions."""
LIFTED = 0.05
"""A fold has begun when a hand holds the garment above this height [m]."""
TABLE_THICKNESS = 0.03
STREAMS = ("robot", "garment", "hands", "camera", "look", "build", "board")
"""Parts of the world, each with a separate random generator. The generator depends on the part's position in this
list. Add new parts at the end, so that the generators of the others stay the same."""


class _Hand:
    """One hand: its pose at the last cloth frame (table frame), its gripper and its tactile sensors."""

    def __init__(self, gripper: SimulatedGripper, tactile: SimulatedTactile) -> None:
        self.gripper, self.tactile = gripper, tactile
        self.position, self.rotation = np.zeros(3), np.eye(3)
        self.tip_force = np.zeros(2)
        """Force on each fingertip [N]."""
        self.free = True
        """Whether the tips push cloth. False from a grasp until the cloth no longer touches the tips."""
        self.capsules: tuple[Array, Array] | None = None
        self.grasps = 0


class World:
    """The world behind the ports. Use it from one thread, except for the robot's `trigger_stop`."""

    def __init__(self, settings: SimulationSettings, seed: int) -> None:
        self._noise: NoiseTable = load_noise()
        rng = {
            name: np.random.default_rng(child)
            for name, child in zip(STREAMS, np.random.SeedSequence(seed).spawn(len(STREAMS)), strict=True)
        }
        noise = self._noise
        self._design = find_robot(settings.robot)
        self._model = self._design.load_model()
        self._mount = settings.camera or self._design.camera
        self._lens, self._board = self._mount.intrinsics, None
        if settings.as_built:
            settings = replace(settings, table=built_table(settings.table, noise.build, rng["build"]))
            self._lens = built_lens(self._lens, noise.build, rng["build"])
            self._board = WorldBoard(noise.board, rng["board"])
        self.settings = settings
        nominal = _choose(settings, rng["garment"])
        check_body(settings.world, nominal.name, nominal.layers)
        self.garment = WorldGarment(
            nominal, noise.garment, rng["garment"], ideal=not settings.garment_noise, world=settings.world
        )
        self.faults = FaultBoard()
        self.port_faults = PortFaults(self.faults, self.now, lambda: self._fold)
        self._steps = 0
        self._time = 0.0
        self._fold = 0
        self._lifted = False
        self._pace: tuple[float, float] | None = None
        self._watcher: Callable[[Truth], None] | None = None
        self._on_advance: Callable[[bool], None] | None = None
        self._client = pb.connect(pb.DIRECT)
        pb.setTimeStep(1.0 / STEP_RATE, physicsClientId=self._client)
        pb.setGravity(0.0, 0.0, -9.81, physicsClientId=self._client)
        pb.setPhysicsEngineParameter(numSolverIterations=20, physicsClientId=self._client)
        self._body = self._design.simulation.body(self._client)
        self._body.let_fingers_through(self._load_table())
        q_start = self._model.q_park if settings.q_start is None else np.array(settings.q_start)
        if len(q_start) != len(self._model.joint_names):
            raise ConfigurationError(
                f"q_start has {len(q_start)} joints",
                f"it takes {len(self._model.joint_names)}: left arm, then right",
            )
        self.robot = SimulatedRobot(
            self._body,
            self._design.simulation,
            self._model,
            noise.robot,
            rng["robot"],
            np.array(q_start),
            ideal=not settings.robot_noise,
        )
        self._stiffness = contact.Stiffness(
            noise.robot.arm_stiffness, noise.tactile.tip_stiffness, noise.tactile.cloth_stiffness
        )
        self.garment.pads = replace(settings.pads, friction=noise.gripper.pad_friction.draw(rng["hands"]))
        self._hands = {side: self._hand(side, rng["hands"]) for side in Side}
        grippers = {side: hand.gripper for side, hand in self._hands.items()}
        self._world_faults = WorldFaults(self.faults, self.robot, grippers, self.garment)
        for side in Side:
            self._place_hand(side)
        self._T_head_camera = _mounted(self._mount, noise.camera, rng["camera"], ideal=not settings.camera_noise)
        self._renderer, self._fabric = None, (0, 0, 0)
        if settings.render:
            scene = self._scene(rng["look"])
            self._renderer, self._fabric = Renderer(scene), _mean_colour(scene.garment_texture)
        self._camera = self._build_camera(int(rng["camera"].integers(2**31)))
        self._seen_slabs: Sequence[Slab] = ()
        self._camera_faults = CameraFaults(self.faults, self._camera) if self._camera else None

    # construction

    def _load_table(self) -> int:
        table = self.settings.table
        half = [0.5 * (table.x[1] - table.x[0]), 0.5 * (table.y[1] - table.y[0]), 0.5 * TABLE_THICKNESS]
        middle = [sum(table.x) / 2, sum(table.y) / 2, table.height - half[2]]
        shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=half, physicsClientId=self._client)
        return int(pb.createMultiBody(0.0, shape, -1, middle, physicsClientId=self._client))

    def _hand(self, side: Side, rng: np.random.Generator) -> _Hand:
        ideal = not self.settings.robot_noise
        gripper = SimulatedGripper(
            side, self._design.gripper.max_opening, self._noise.gripper, int(rng.integers(2**31)), ideal,
            caught=lambda stroke, force: self._caught(side, stroke, force),
            opened=lambda: self._opened(side),
        )  # fmt: skip
        tactile = SimulatedTactile(
            side, self._noise.tactile, int(rng.integers(2**31)), ideal,
            pressing=lambda: gripper.pressing,
            tips=lambda: self._touch(side)[2].force,
            clinging=lambda: self._clinging(side),
        )  # fmt: skip
        return _Hand(gripper, tactile)

    def _scene(self, rng: np.random.Generator) -> Scene:
        settings, garment, swing = self.settings, self.garment, self._noise.camera.light_swing
        light = (float(rng.uniform(-swing, swing)), float(rng.uniform(-swing, swing)), 2.5)
        return Scene(
            urdf=str(self._design.simulation.seen_urdf()),
            floor=self._model.floor,
            table=settings.table,
            table_texture=table_texture(rng, settings.surface),
            garment_uv=garment_uv(garment.mesh.rest, garment.mesh.layer),
            garment_triangles=garment.mesh.triangles,
            garment_texture=fabric_texture(rng, settings.fabric, settings.surface),
            width=self._lens.width,
            height=self._lens.height,
            focal=(self._lens.fx, self._lens.fy),
            centre=(self._lens.cx, self._lens.cy),
            light=light,
            ambient=float(rng.uniform(0.52, 0.62)),
            diffuse=float(rng.uniform(0.32, 0.42)),
            board=(self._board.picture, self._board.size) if self._board else None,
        )

    def _build_camera(self, seed: int) -> SimulatedCamera | None:
        if self._renderer is None:
            return None
        ideal = not self.settings.camera_noise
        drawn = self._mount.intrinsics
        return SimulatedCamera(self._renderer, drawn, self._noise.camera, seed, self._shot, self.now, ideal)

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
        pb.disconnect(physicsClientId=self._client)

    @property
    def command_timeout(self) -> float:
        return self._noise.robot.command_timeout

    # time

    def now(self) -> float:
        return self._time

    def sleep_until(self, t: float) -> None:
        """Advance the world to cell time t [s]."""
        while (self._steps + 1) / STEP_RATE <= t + 1e-9:
            self._step()
            if self.settings.realtime and self._steps % STEPS_A_FRAME == 0:
                self._keep_pace()
        self._time = max(self._time, t)

    def _keep_pace(self) -> None:
        wall = time.monotonic()
        cell = self._steps / STEP_RATE
        if self._pace is None or wall - self._pace[0] > cell - self._pace[1] + 0.5:
            self._pace = wall, cell  # first step, or too late to catch up: pace from now on
        time.sleep(max(0.0, self._pace[0] + cell - self._pace[1] - wall))

    def _step(self) -> None:
        self._steps += 1
        t, dt = self._steps / STEP_RATE, 1.0 / STEP_RATE
        self._world_faults.before_step(t, self._fold)
        self.robot.step(t, dt, {side: hand.gripper.opening for side, hand in self._hands.items()})
        pb.stepSimulation(physicsClientId=self._client)
        for hand in self._hands.values():
            hand.gripper.step(t, dt)
        if self._steps % STEPS_A_FRAME == 0:
            self._frame(t)
            if self._on_advance is not None:
                self._on_advance(False)
        if self._watcher is not None and self._steps % (STEP_RATE // WATCH_RATE) == 0:
            self._watcher(replace(self.truth(), stamp=t))

    # hands and cloth

    def _touch(self, side: Side) -> tuple[Array, Array, contact.Touch]:
        """Return the tool position (3,) after the table has lifted the hand, the rotation (3, 3), both in the
        table frame, and the contact of the tips."""
        position, rotation = self._body.tool_pose(side)
        position[2] -= self.settings.table.height
        tips = contact.fingertips(self._design.gripper, position, rotation, self._hands[side].gripper.opening)
        if tips[:, 2].min() > THICKEST or not self._over_table(position):
            return position, rotation, contact.Touch(np.zeros(2), 0.0)
        stack = np.array([self.garment.stack(tip) for tip in tips])
        contacts = contact.touch(tips, stack, self._stiffness)
        position[2] += contacts.lift
        return position, rotation, contacts

    def _clinging(self, side: Side) -> float:
        """Return the pull of cloth that is caught on a finger of this side [N]."""
        return float(np.linalg.norm(self.garment.pull(HANDS[side]))) if self._world_faults.caught(side) else 0.0

    def _over_table(self, p: Array) -> bool:
        table = self.settings.table
        return bool(table.x[0] <= p[0] <= table.x[1] and table.y[0] <= p[1] <= table.y[1])

    def _place_hand(self, side: Side) -> None:
        hand = self._hands[side]
        hand.position, hand.rotation, touch = self._touch(side)
        hand.tip_force = touch.force

    def _caught(self, side: Side, stroke: float, force: float) -> float:
        """Hold the cloth between the closing pads from now on. Returns its thickness [m], 0 for nothing."""
        hand, garment = self._hands[side], self.garment
        if not garment.laid:
            return 0.0
        hand.position, hand.rotation, _ = self._touch(side)
        self._world_faults.freed(side)
        report = garment.grip(HANDS[side], hand.position, hand.rotation, stroke, force)
        if report.held_points == 0:
            return 0.0
        hand.grasps += 1
        hand.free = False
        t = self._steps / STEP_RATE
        if self.faults.take(FaultKind.MISSED_GRASP, t, self._fold, side, grasp=hand.grasps):
            garment.release(HANDS[side])
            return 0.0
        return report.layers * garment.material.thickness

    def _opened(self, side: Side) -> None:
        """Release the cloth, unless it is caught on a finger."""
        if not self._world_faults.catches(side, self._steps / STEP_RATE, self._fold):
            self.garment.release(HANDS[side])

    def _frame(self, t: float) -> None:
        """Advance the cloth by one frame, in which the tools move from their last poses to the present ones."""
        self._world_faults.before_frame(t, self._fold)
        if not self.garment.laid:
            return
        hands = self._hands.values()
        before = [hand.capsules for hand in hands]
        p, r = [hand.position for hand in hands], [hand.rotation for hand in hands]
        for side, hand in self._hands.items():
            self._place_hand(side)
            hand.capsules = self._hand_capsules(side)
            if self.garment.holds(HANDS[side]):
                force = self._world_faults.grip_force(side, hand.gripper.force, t, self._fold)
                self.garment.squeeze(HANDS[side], force)
        gripper = self._design.gripper
        tips = [contact.fingertips(gripper, hand.position, hand.rotation, hand.gripper.opening) for hand in hands]
        self.garment.press(
            np.vstack(tips), np.hstack([hand.tip_force for hand in hands]), self._noise.tactile.tip_area
        )
        position = np.array([p, [hand.position for hand in hands]])
        rotation = np.array([r, [hand.rotation for hand in hands]])
        self.garment.frame(position, rotation, self._capsule_path(before))
        self._after_frame(t)

    def _hand_capsules(self, side: Side) -> tuple[Array, Array] | None:
        """Return both ends (3, 3) of the capsules of fingers and gripper body; None if far above the garment."""
        hand, gripper = self._hands[side], self._design.gripper
        if hand.position[2] > self.garment.highest() + NEAR:
            hand.free = True
            return None
        opening = hand.gripper.opening
        holds = self.garment.holds(HANDS[side])
        if not hand.free and not holds:
            low, high = contact.finger_axes(gripper, hand.position, hand.rotation, opening, np.zeros(2), 0.0)
            reach = gripper.finger_radius + self.garment.material.thickness
            hand.free = all(self.garment.clear_of(a, b, reach) for a, b in zip(low, high, strict=True))
        tips = contact.fingertips(gripper, hand.position, hand.rotation, opening)
        floor = np.zeros(2)
        if tips[:, 2].min() < THICKEST:
            floor = np.array([self.garment.stack(tip) for tip in tips]) - SQUEEZE
        raised = 0.0 if hand.free and not holds else RAISED
        low, high = contact.finger_axes(gripper, hand.position, hand.rotation, opening, floor, raised)
        body_low, body_high = contact.hand_axis(gripper, hand.position, hand.rotation)
        return np.vstack((low, body_low)), np.vstack((high, body_high))

    def _capsule_path(self, before: list[tuple[Array, Array] | None]) -> tuple[Array, Array, Array] | None:
        """Return both ends (2, k, 3) [m], at the start and the end of the frame, and radius (k,) [m] of the
        capsules near the garment."""
        moved = [
            (old or hand.capsules, hand.capsules)
            for old, hand in zip(before, self._hands.values(), strict=True)
            if hand.capsules is not None
        ]
        if not moved:
            return None
        low = np.array([np.vstack([pair[when][0] for pair in moved]) for when in (0, 1)])
        high = np.array([np.vstack([pair[when][1] for pair in moved]) for when in (0, 1)])
        gripper = self._design.gripper
        radius = [gripper.finger_radius, gripper.finger_radius, gripper.hand_radius] * len(moved)
        return low, high, np.array(radius)

    def _after_frame(self, t: float) -> None:
        """Release cloth that slipped out, by force or by fault, and count the folds."""
        held = False
        for side, hand in self._hands.items():
            if not hand.gripper.holding:
                continue
            lifted = float(hand.position[2])
            if self.faults.take(FaultKind.DROPPED_CORNER, t, self._fold, side, hand.grasps, lifted):
                self.garment.release(HANDS[side])
            if not self.garment.holds(HANDS[side]):
                hand.gripper.lost()
                continue
            held = True
            self._lifted |= lifted > LIFTED
        if self._lifted and not held:
            self._lifted = False
            self._fold += 1

    # called by the ports

    def gripper(self, side: Side) -> SimulatedGripper:
        return self._hands[side].gripper

    def tactile(self, side: Side) -> SimulatedTactile:
        return self._hands[side].tactile

    def lay_garment(self) -> None:
        """Let the attendant lay the garment, which takes cell time."""
        if not self.garment.laid and self.faults.take(FaultKind.NO_GARMENT, self._time, self._fold) is None:
            self._rest()
            self.garment.lay()
        self.sleep_until(self._time + self._noise.attendant.lay_time)

    def bring_board(self, place: BoardPlace) -> None:
        """Let the attendant show the board, hand it over or put it away. Raises DriverError if there is no
        board."""
        if self._board is None:
            raise DriverError(FailureKind.HARDWARE_FAULT, "there is no calibration board at this cell")
        self._board.bring(place)
        self.sleep_until(self._time + self._noise.attendant.lay_time)

    def capture(self) -> CameraFrame:
        """Take a still picture of several exposures, which take cell time."""
        self.sleep_until(self._time + EXPOSURES * EVERY_S)
        frame = self._picture(EXPOSURES)
        if self._camera_faults is not None:
            self.sleep_until(self._time + self._camera_faults.lateness(self._time, self._fold))
        return frame

    def glimpse(self, exposures: int = 1) -> CameraFrame:
        """Take a picture without waiting: one exposure, or the mean of several."""
        return self._picture(exposures)

    def display(self) -> Callable[[], CameraFrame]:
        """Take the present state for a picture that a person sees. It changes nothing in the world: the next
        pictures, faults and noise are the same with and without it. The returned function draws the picture, on
        any thread."""
        if self._camera is None:
            raise DriverError(FailureKind.CAMERA_FAULT, "this cell has no camera", "open it with render=True")
        return self._camera.display(self._seen_slabs)

    def steps(self) -> int:
        """Return how many steps the world has made. Any thread may ask."""
        return self._steps

    def on_advance(self, tell: Callable[[bool], None]) -> None:
        """Call `tell` after each frame of the cloth, and with True before a computation during which the world
        stands still. It must change nothing in the world."""
        self._on_advance = tell

    def _rest(self) -> None:
        if self._on_advance is not None:
            self._on_advance(True)

    def _picture(self, exposures: int) -> CameraFrame:
        if self._camera_faults is None:
            raise DriverError(FailureKind.CAMERA_FAULT, "this cell has no camera", "open it with render=True")
        self._rest()
        slabs = self._world_faults.slabs(self._time, self._fold, self.settings.table, self._fabric)
        self._seen_slabs = slabs
        return self._camera_faults.take(self._time, self._fold, exposures, slabs)

    def _shot(self) -> Shot:
        q, _, _, pan = self._body.read()
        joints = dict(zip(self._model.joint_names, q.tolist(), strict=True))
        if self._mount.head_joint is not None:
            joints[self._mount.head_joint] = pan
        for side, hand in self._hands.items():
            joints |= self._design.gripper.finger_positions(side, hand.gripper.opening)
        vertices = self.garment.seen if self.garment.laid else None
        if vertices is not None:
            vertices[:, 2] += self.settings.table.height
        T_base_camera = self._T_base_camera(pan)
        board = self._board.pose(T_base_camera, self._T_base_tools()) if self._board else None
        return Shot(joints, vertices, T_base_camera, board)

    def _T_base_tools(self) -> dict[Side, Array]:
        poses = {}
        for side in Side:
            T = np.eye(4)
            T[:3, 3], T[:3, :3] = self._body.tool_pose(side)
            poses[side] = T
        return poses

    def _T_base_camera(self, pan: float) -> Array:
        return self._mount.T_base_head(pan) @ self._T_head_camera

    # checkpoints

    def checkpoint(self) -> bytes:
        """Return the state of the world. A restored world has its arms at rest and no injected faults."""
        arrays, robot = self.robot.snapshot()
        plain = {
            "steps": self._steps, "time": self._time, "fold": self._fold, "lifted": self._lifted, "robot": robot,
            "grippers": {side.value: hand.gripper.snapshot() for side, hand in self._hands.items()},
            "hands": {side.value: [hand.grasps, hand.free] for side, hand in self._hands.items()},
            "pictures": self._camera.sequence if self._camera else 0,
        }  # fmt: skip
        cloth = self.garment.checkpoint() or {}
        out = {f"robot.{name}": a for name, a in arrays.items()} | {f"cloth.{n}": a for n, a in cloth.items()}
        stream = io.BytesIO()
        np.savez(stream, plain=np.array(json.dumps(plain)), **out)  # compression would take longer than writing it
        return stream.getvalue()

    def restore(self, saved: bytes) -> None:
        """Restore a checkpoint of a world with the same settings and seed."""
        with np.load(io.BytesIO(saved)) as data:
            plain = json.loads(str(data["plain"]))
            robot = {name.removeprefix("robot."): data[name] for name in data if name.startswith("robot.")}
            cloth = {name.removeprefix("cloth."): data[name] for name in data if name.startswith("cloth.")}
        self.garment.restore(cloth or None)
        self._steps, self._time, self._pace = plain["steps"], plain["time"], None
        self._fold, self._lifted = plain["fold"], plain["lifted"]
        for side, hand in self._hands.items():
            hand.gripper.resume(plain["grippers"][side.value])
            hand.tactile.forget()
            hand.grasps, hand.free = plain["hands"][side.value]
            hand.capsules = None
        opening = {side: hand.gripper.opening for side, hand in self._hands.items()}
        self.robot.resume(robot, plain["robot"], opening)
        for side in Side:
            self._place_hand(side)
        if self._camera is not None:
            self._camera.sequence = plain["pictures"]

    # ground truth

    def watch(self, tell: Callable[[Truth], None] | None) -> None:
        """Call `tell` with the truth WATCH_RATE times a second of cell time; None: stop calling."""
        self._watcher = tell

    def truth(self) -> Truth:
        garment = self.garment
        laid = None
        if garment.laid:
            laid = GarmentTruth(
                name=garment.name,
                vertices=frozen(garment.positions),
                triangles=garment.mesh.triangles,
                material=frozen(garment.flat),
                keypoints={name: frozen(p) for name, p in garment.keypoints.items()},
                pose=(garment.pose.x, garment.pose.y, garment.pose.angle),
                fabric=garment.material,
                layers=garment.layers,
                mesh=garment.mesh,
                traits=garment.traits,
                solver=garment.solver,
            )
        _, _, _, pan = self._body.read()
        T_table_base = np.linalg.inv(self.settings.table.T_base_table)
        return Truth(
            stamp=self._time,
            garment=laid,
            tools={side: frozen(self._touch(side)[0]) for side in Side},
            held={side: garment.holds(HANDS[side]) for side in Side},
            faults=tuple(self.faults.happened),
            T_table_camera=frozen(T_table_base @ self._T_base_camera(pan)),
            table_height=self.settings.table.height,
            intrinsics=self._lens,
        )


def _choose(settings: SimulationSettings, rng: np.random.Generator) -> Garment:
    """Return the given garment, or for 'auto' a random shipped garment that this world can simulate."""
    draw = rng.random()
    if settings.garment != "auto":
        return load_garment(settings.garment, settings.surface)
    garments = [load_garment(name, settings.surface) for name in sorted(list_garments())]
    if settings.world == "mujoco":
        garments = [garment for garment in garments if garment.layers == 1]
    return garments[int(draw * len(garments))]


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
