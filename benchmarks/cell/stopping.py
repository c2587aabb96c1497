"""Triggers the stop while the arms move, and measures the time and the distance until they are at rest.

The executive does not react to the stop: it stays within the same tick, as if it had hung, so only the driver
brakes. The time is compared with that of the brake alone, without lag: the maximum over the joints of speed
divided by deceleration.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.driver import OpenCell
from foldcell.cell.runs.fold_run import fold_once
from foldcell.cell.simulation.noise import load_noise
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.ports import Array, Ports, Side, arm_slice
from foldcell.skills.motion.kinematics.ik import tool_pose

GARMENT = "small_towel"
MOVING, AT_REST = 0.15, 0.02
"""Joint speed [rad/s] above which the arms count as moving, and below which they count as at rest."""
TICK_S = 0.005
LONGEST_S = 3.0


@dataclass(frozen=True)
class _Stop:
    """One stop. took: time until rest [s]. way: (2,) distance of each tool's place at rest from its place at the
    stop [m]. brake: time that the brake alone would take [s]."""

    took: float
    way: Array
    brake: float


class _StoppingClock:
    """A clock that replaces the cell's clock. At the first tick after the time `due` in which the arms move, it
    triggers the stop and measures it."""

    def __init__(self, ports: Ports, due: float) -> None:
        self._ports, self._due = ports, due
        self.stop: _Stop | None = None

    def now(self) -> float:
        return self._ports.clock.now()

    def sleep_until(self, t: float) -> None:
        self._ports.clock.sleep_until(t)
        if self.stop is None and self.now() > self._due:
            speed = np.abs(self._ports.arms.state().qd)
            if speed.max() > MOVING:
                self._ports.stop.trigger("a benchmark")
                self.stop = self._watch(float((speed / _deceleration()).max()))

    def _watch(self, brake: float) -> _Stop:
        began, tools = self.now(), _tools(self._ports)
        last = began
        while self.now() < began + LONGEST_S:
            self._ports.clock.sleep_until(self.now() + TICK_S)
            if np.abs(self._ports.arms.state().qd).max() > AT_REST:
                last = self.now()
        return _Stop(last - began, np.linalg.norm(_tools(self._ports) - tools, axis=1), brake)


def measure(tell: Callable[[str], None], stops: int) -> dict[str, Any]:
    """Stop runs at `stops` evenly spaced times, and measure how long and how far the arms move on."""
    made = [_stopped_at(due) for due in np.linspace(7.0, 30.0, stops)]
    found = [stop for stop in made if stop is not None]
    took = np.array([stop.took for stop in found])
    brake = np.array([stop.brake for stop in found])
    tell(f"{len(found)} stops: at rest after {1e3 * took.max():.0f} ms at most")
    return {
        "stops": len(found),
        "stop_to_rest_ms_median": 1e3 * float(np.median(took)),
        "stop_to_rest_ms_max": 1e3 * float(took.max()),
        "stop_way_mm_max": 1e3 * float(max(stop.way.max() for stop in found)),
        "brake_alone_ms_max": 1e3 * float(brake.max()),
        "stop_over_brake_alone": float(np.median(took / brake)),
    }


def _stopped_at(due: float) -> _Stop | None:
    clocks: list[_StoppingClock] = []

    def on_open(cell: OpenCell, _: Any) -> Ports:
        ports = cell.ports
        clocks.append(_StoppingClock(ports, due))
        return replace(ports, clock=clocks[0])

    with tempfile.TemporaryDirectory() as folder:
        settings, logs = load_settings(), Path(folder)
        request = FoldRequest(GARMENT, 1, "sim", settings, logs, quiet=True, record=False, record_truth=False)
        fold_once(request, on_open)
    return clocks[0].stop


def _deceleration() -> Array:
    """Deceleration (14,) of the joints by the simulated driver's brake [rad/s^2]: twice as large at the wrists as
    at shoulders and elbows."""
    return load_noise().robot.brake * np.array([1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0] * 2)


def _tools(ports: Ports) -> Array:
    """Return the positions (2, 3) of both tools, base frame [m]."""
    model, q = load_model(), ports.arms.state().q
    return np.array([tool_pose(model.chains[side], q[arm_slice(side, 14)])[:3, 3] for side in Side])
