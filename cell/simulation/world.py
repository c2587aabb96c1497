"""The simulated world: robot, hands, garment and camera, advanced by one clock.

Rigid bodies step at 240 Hz, the cloth at 60 Hz, in a fixed order: faults, arms, grippers, cloth. The world and all
its errors are a function of the settings, the seed and the calls. The wall clock is used only to pace a run in
real time.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.simulation.camera.board import built_table
from foldcell.cell.simulation.faults import FaultBoard, FaultKind
from foldcell.cell.simulation.faults.port_faults import PortFaults
from foldcell.cell.simulation.faults.world_faults import WorldFaults
from foldcell.cell.simulation.garment.cloth_body import FRAME_RATE, check_body
from foldcell.cell.simulation.garment.garment import WorldGarment
from foldcell.cell.simulation.hands import Hands
from foldcell.cell.simulation.noise import load_noise
from foldcell.cell.simulation.robot.arms import SimulatedRobot
from foldcell.cell.simulation.settings import SimulationSettings
from foldcell.cell.simulation.truth import GarmentTruth, Truth
from foldcell.cell.simulation.world_camera import WorldCamera
from foldcell.robots.bullet import pb
from foldcell.robots.depth_averaging import EVERY_S, EXPOSURES
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import BoardPlace, CameraFrame, Side, frozen
from foldcell.robots.registry import find_robot
from foldcell.skills.garments.garment import Garment
from foldcell.skills.vocabulary import Table

STEP_RATE = 240
"""Rate of the physics steps [Hz]."""
STEPS_A_FRAME = STEP_RATE // FRAME_RATE
WATCH_RATE = 12
TABLE_THICKNESS = 0.03
STREAMS = ("robot", "garment", "hands", "camera", "look", "build", "board")
"""Parts of the world, each with a separate random generator. The generator depends on the part's position in this
list. Add new parts at the end, so that the generators of the others stay the same."""


class World:
    """The world behind the ports. Use it from one thread, except for the robot's `trigger_stop`."""

    def __init__(self, settings: SimulationSettings, seed: int) -> None:
        noise = self.noise = load_noise()
        children = np.random.SeedSequence(seed).spawn(len(STREAMS))
        rng = {name: np.random.default_rng(child) for name, child in zip(STREAMS, children, strict=True)}
        design = find_robot(settings.robot)
        model = design.load_model()
        if settings.as_built:
            settings = replace(settings, table=built_table(settings.table, noise.build, rng["build"]))
        self.settings = settings
        nominal = _choose(settings, rng["garment"])
        check_body(settings.world, nominal.name, nominal.layers)
        self.garment = WorldGarment(
            nominal, noise.garment, rng["garment"], ideal=not settings.garment_noise, world=settings.world
        )
        self.garment.pads = replace(settings.pads, friction=noise.gripper.pad_friction.draw(rng["hands"]))
        self.faults = FaultBoard()
        self.port_faults = PortFaults(self.faults)
        self._steps, self._time = 0, 0.0
        self._pace: tuple[float, float] | None = None
        self._watcher: Callable[[Truth], None] | None = None
        self._on_advance: Callable[[bool], None] = lambda rests: None
        self._client = _open_physics()
        body = design.simulation.body(self._client)
        body.let_fingers_through(_load_table(self._client, settings.table))
        q_start = model.q_park if settings.q_start is None else np.array(settings.q_start)
        ideal = not settings.robot_noise
        self.robot = SimulatedRobot(
            body, design.simulation, model, noise.robot, rng["robot"], np.array(q_start), ideal
        )
        self._world_faults = WorldFaults(self.faults, self.robot, self.garment)
        self.hands = Hands(
            body, design.gripper, settings.table, self.garment, self.faults, self._world_faults, noise,
            rng["hands"], ideal,
        )  # fmt: skip
        self._camera = WorldCamera(
            settings, design, noise, rng, body, lambda: self.hands.openings, self.garment, self.faults, self.now
        )

    def close(self) -> None:
        self._camera.close()
        pb.disconnect(physicsClientId=self._client)

    # time

    def now(self) -> float:
        return self._time

    def sleep_until(self, t: float) -> None:
        """Advance the world to cell time t [s]."""
        while (self._steps + 1) / STEP_RATE <= t + 1e-9:
            self._step()
            if self.settings.realtime and self._steps % STEPS_A_FRAME == 0:
                self._keep_pace()
        self._time = self.faults.now = max(self._time, t)

    def _keep_pace(self) -> None:
        wall = time.monotonic()
        cell = self._steps / STEP_RATE
        if self._pace is None or wall - self._pace[0] > cell - self._pace[1] + 0.5:
            self._pace = wall, cell  # first step, or too late to catch up: pace from now on
        time.sleep(max(0.0, self._pace[0] + cell - self._pace[1] - wall))

    def _step(self) -> None:
        self._steps += 1
        t, dt = self._steps / STEP_RATE, 1.0 / STEP_RATE
        self.faults.now = t
        self._world_faults.before_step(self.hands.grippers)
        self.robot.step(t, dt, self.hands.openings)
        pb.stepSimulation(physicsClientId=self._client)
        for gripper in self.hands.grippers.values():
            gripper.step(t, dt)
        if self._steps % STEPS_A_FRAME == 0:
            self._world_faults.before_frame()
            if self.garment.laid:
                self.hands.frame()
            self._on_advance(False)
        if self._watcher is not None and self._steps % (STEP_RATE // WATCH_RATE) == 0:
            self._watcher(replace(self.truth(), stamp=t))

    def steps(self) -> int:
        """Return how many steps the world has made. Any thread may ask."""
        return self._steps

    def on_advance(self, tell: Callable[[bool], None]) -> None:
        """Call `tell` after each frame of the cloth, and with True before a computation during which the world
        stands still. It must change nothing in the world."""
        self._on_advance = tell

    # attendant

    def lay_garment(self) -> None:
        """Let the attendant lay the garment, which takes cell time."""
        if not self.garment.laid and self.faults.take(FaultKind.NO_GARMENT) is None:
            self._on_advance(True)
            self.garment.lay()
        self.sleep_until(self._time + self.noise.attendant.lay_time)

    def bring_board(self, place: BoardPlace) -> None:
        """Let the attendant show the board, hand it over or put it away. Raises DriverError if there is no
        board."""
        if self._camera.board is None:
            raise DriverError(FailureKind.HARDWARE_FAULT, "there is no calibration board at this cell")
        self._camera.board.bring(place)
        self.sleep_until(self._time + self.noise.attendant.lay_time)

    # camera

    def capture(self) -> CameraFrame:
        """Take a still picture of several exposures, which take cell time."""
        self.sleep_until(self._time + EXPOSURES * EVERY_S)
        frame = self.glimpse(EXPOSURES)
        self.sleep_until(self._time + self._camera.lateness())
        return frame

    def glimpse(self, exposures: int = 1) -> CameraFrame:
        """Take a picture without waiting: one exposure, or the mean of several."""
        self._on_advance(True)
        return self._camera.picture(exposures, self._world_faults)

    def display(self) -> Callable[[], CameraFrame]:
        """Take the present state for a picture that a person sees. It changes nothing in the world: the next
        pictures, faults and noise are the same with and without it. The returned function draws the picture, on
        any thread."""
        return self._camera.display()

    # checkpoints

    def checkpoint(self) -> bytes:
        """Return the state of the world. A restored world has its arms at rest and no injected faults."""
        arrays, robot = self.robot.snapshot()
        plain = {
            "steps": self._steps, "time": self._time, "fold": self.faults.fold, "robot": robot,
            "pictures": self._camera.pictures, **self.hands.snapshot(),
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
        self._steps, self._pace = plain["steps"], None
        self._time = self.faults.now = plain["time"]
        self.faults.fold = plain["fold"]
        self.hands.resume(plain)
        self.robot.resume(robot, plain["robot"], self.hands.openings)
        self.hands.place()
        self._camera.resume(plain["pictures"])

    # ground truth

    def watch(self, tell: Callable[[Truth], None] | None) -> None:
        """Call `tell` with the truth WATCH_RATE times a second of cell time; None: stop calling."""
        self._watcher = tell

    def truth(self) -> Truth:
        T_table_base = np.linalg.inv(self.settings.table.T_base_table)
        return Truth(
            stamp=self._time,
            garment=_garment_truth(self.garment) if self.garment.laid else None,
            tools={side: frozen(self.hands.touch(side)[0]) for side in Side},
            held={side: self.hands.holds(side) for side in Side},
            faults=tuple(self.faults.happened),
            T_table_camera=frozen(T_table_base @ self._camera.T_base_camera()),
            table_height=self.settings.table.height,
            intrinsics=self._camera.lens,
        )


def _garment_truth(garment: WorldGarment) -> GarmentTruth:
    return GarmentTruth(
        name=garment.name,
        vertices=frozen(garment.positions),
        material=frozen(garment.flat),
        keypoints={name: frozen(p) for name, p in garment.keypoints.items()},
        pose=(garment.pose.x, garment.pose.y, garment.pose.angle),
        fabric=garment.material,
        layers=garment.layers,
        mesh=garment.mesh,
        traits=garment.traits,
        solver=garment.solver,
    )


def _open_physics() -> int:
    """Open an empty PyBullet world with gravity. Returns its number."""
    client = int(pb.connect(pb.DIRECT))
    pb.setTimeStep(1.0 / STEP_RATE, physicsClientId=client)
    pb.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
    pb.setPhysicsEngineParameter(numSolverIterations=20, physicsClientId=client)
    return client


def _load_table(client: int, table: Table) -> int:
    half = [0.5 * (table.x[1] - table.x[0]), 0.5 * (table.y[1] - table.y[0]), 0.5 * TABLE_THICKNESS]
    middle = [sum(table.x) / 2, sum(table.y) / 2, table.height - half[2]]
    shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=half, physicsClientId=client)
    return int(pb.createMultiBody(0.0, shape, -1, middle, physicsClientId=client))


def _choose(settings: SimulationSettings, rng: np.random.Generator) -> Garment:
    """Return the given garment, or for 'auto' a random shipped garment that this world can simulate."""
    draw = rng.random()
    if settings.garment != "auto":
        return load_garment(settings.garment, settings.surface)
    garments = [load_garment(name, settings.surface) for name in sorted(list_garments())]
    if settings.world == "mujoco":
        garments = [garment for garment in garments if garment.layers == 1]
    return garments[int(draw * len(garments))]
