"""A simulated cell and the motions that tests of the world use."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from foldcell.cell.simulation import SimulationSettings, open_simulated_cell
from foldcell.cell.simulation.truth import Truth
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.ports import Array, Side
from foldcell.skills.motion.kinematics.ik import solve_pose
from foldcell.skills.vocabulary import tool_rotation

BLIND = SimulationSettings(garment="small_towel", render=False)
QUIET = SimulationSettings(
    garment="small_towel", render=False, robot_noise=False, camera_noise=False, garment_noise=False
)
DT = 0.01


class Bench:
    """A simulated cell and the motions that the tests use."""

    def __init__(self, settings: SimulationSettings, seed: int = 1) -> None:
        self._open = ExitStack()
        self.cell = self._open.enter_context(open_simulated_cell(settings, seed))
        self.ports = self.cell.ports
        self.q = self.ports.arms.state().q.copy()
        self.height = settings.table.height

    def close(self) -> None:
        self._open.close()

    def truth(self) -> Truth:
        return self.cell.truth.now()

    def ready(self) -> Bench:
        self.ports.arms.enable()
        for gripper in self.ports.grippers.values():
            gripper.calibrate()
        self.wait(1.3)
        return self

    def wait(self, seconds: float) -> None:
        clock = self.ports.clock
        clock.sleep_until(clock.now() + seconds)

    def hold(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self.wait(DT)
            self.ports.arms.command(self.q, np.zeros(14))

    def move(self, goal: Array, seconds: float) -> None:
        start, n = self.q, round(seconds / DT)
        for k in range(1, n + 1):
            u = k / n
            q = start + (goal - start) * u**3 * (10 - 15 * u + 6 * u * u)
            self.wait(DT)
            self.ports.arms.command(q, (q - self.q) / DT)
            self.q = q

    def above(self, side: Side, point: Array, height: float, heading: float) -> Array:
        """Joint positions (14,) with one tool pointing straight down at a point above the table."""
        T = np.eye(4)
        T[:3, :3] = tool_rotation(np.array(heading), np.array(0.0), np.array(0.0))
        T[:3, 3] = [point[0], point[1], height + self.height]
        cut = slice(0, 7) if side is Side.LEFT else slice(7, 14)
        rng, near = np.random.default_rng(0), self.q[cut]
        for _ in range(300):
            found = solve_pose(load_model(), side, T, near)
            if found is not None:
                q = self.q.copy()
                q[cut] = found
                return q
            near = self.q[cut] + rng.normal(0.0, 0.6, 7)
        raise AssertionError("out of reach")

    def pinch(self, side: Side, point: Array, height: float = -0.001, heading: float = np.pi / 2) -> None:
        gripper = self.ports.grippers[side]
        gripper.command(0.03, 12.0)
        self.move(self.above(side, point, 0.08, heading), 2.5)
        self.move(self.above(side, point, height, heading), 1.5)
        self.hold(0.2)
        gripper.command(0.0, 12.0)
        self.hold(0.8)


def corner(bench: Bench) -> Array:
    """A point inside the towel, 20 mm from its far left corner along x and y."""
    garment = bench.truth().garment
    assert garment is not None
    return garment.keypoints["far_left"] + 0.02 * np.array([-1.0, -1.0])
