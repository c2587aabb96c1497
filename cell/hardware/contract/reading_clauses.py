"""Clauses about what the ports report while nothing is commanded."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from foldcell.cell.hardware.contract.rig import Rig, require
from foldcell.robots.ports import Side

ROOM, AT_REST = 0.1, 0.1
"""Joints at rest may be this far outside their ranges [rad], and this fast [rad/s]."""
LARGEST_OPENING, SLACK = 0.3, 0.003
"""Largest opening of a gripper, and error of the reported one [m]."""
LARGEST_FORCE = 200.0
"""Largest force of a pad or cell that is a reading in newtons [N]."""
LISTENED_S, LISTENINGS = 1.0, 3
"""The readings are listened to for so long, so many times if they come late [s]."""
OLDEST = {"joints": 0.1, "pads": 0.1, "gripper": 0.2, "stop": 0.5}
"""Largest age of a reading of a sound device [s]."""
LEAST_READINGS = 20
"""Least number of new joint states in LISTENED_S."""


def shapes(rig: Rig) -> None:
    ports, state, joints = rig.ports, rig.state, len(rig.model.q_park)
    for name in ("q", "qd", "effort"):
        _array(f"JointState.{name}", getattr(state, name), (joints,))
    require(np.isfinite(state.head_pan), f"JointState.head_pan is {state.head_pan}")
    for name, devices in (("grippers", ports.grippers), ("tactile", ports.tactile)):
        require(set(devices) == set(Side), f"Ports.{name} has {sorted(devices)}")
        sides = {side: port.side for side, port in devices.items()}
        require(all(side is own for side, own in sides.items()), f"Ports.{name} exchanges sides: {sides}")
    for side in Side:
        opening, reading = ports.grippers[side].state(), ports.tactile[side].reading()
        require(opening.side is side and reading.side is side, f"a reading of the {side} hand names another side")
        require(np.isfinite([opening.opening, opening.force]).all(), f"the {side} gripper reports no numbers")
        require(reading.cells.ndim == 3, f"TactileReading.cells has {reading.cells.ndim} dimensions, not 3")
        _array("TactileReading.cells", reading.cells, (2, *reading.cells.shape[1:]))
        _array("TactileReading.tip", reading.tip, (2,))


def _array(name: str, value: object, shape: tuple[int, ...]) -> None:
    require(isinstance(value, np.ndarray), f"{name} is a {type(value).__name__}, not an array")
    assert isinstance(value, np.ndarray)
    require(value.shape == shape, f"{name} has the shape {value.shape}, not {shape}")
    require(value.dtype == np.float64, f"{name} has the type {value.dtype}, not float64")
    require(not value.flags.writeable, f"{name} can be written to")
    require(np.isfinite(value).all(), f"{name} contains values that are not finite")


def units(rig: Rig) -> None:
    ports, state, limits = rig.ports, rig.state, rig.model.protective
    outside = (state.q < limits.lower - ROOM) | (state.q > limits.upper + ROOM)
    if outside.any():
        k = int(np.flatnonzero(outside)[0])
        span = f"{limits.lower[k]:.2f} to {limits.upper[k]:.2f} rad"
        require(False, f"{rig.model.joint_names[k]} is at {state.q[k]:.2f}; its range is {span}")
    require(np.abs(state.qd).max() < AT_REST, f"a joint at rest has {np.abs(state.qd).max():.2f} rad/s")
    require(abs(state.head_pan) <= rig.head_range + ROOM, f"the head is at {state.head_pan:.2f} rad")
    require(0.05 <= ports.arms.command_timeout <= 0.5, f"the command timeout is {ports.arms.command_timeout} s")
    for side in Side:
        gripper, reading = ports.grippers[side], ports.tactile[side].reading()
        state_of_hand, largest = gripper.state(), gripper.max_opening
        require(0.01 < largest < LARGEST_OPENING, f"the {side} gripper opens to {largest} m")
        opening = state_of_hand.opening
        fits = -SLACK <= opening <= largest + SLACK
        require(fits, f"the {side} gripper is open by {opening:.3f} m of {largest} m")
        forces = np.append(reading.cells.ravel(), [*reading.tip, state_of_hand.force])
        require(np.abs(forces).max() < LARGEST_FORCE, f"the {side} hand reports {np.abs(forces).max():.0f} N")


def stamps(rig: Rig) -> Mapping[str, float]:
    """Listen. A busy machine delays a reading now and then, so readings that come late are listened to again:
    a driver that delays them does so each time. Figures: the largest ages of the last time, in seconds."""
    for _ in range(LISTENINGS):
        ages, late = _listen(rig)
        if not late:
            break
    require(not late, late)
    return {f"oldest_{name.replace(' ', '_')}_s": age for name, age in ages.items()}


def _listen(rig: Rig) -> tuple[Mapping[str, float], str]:
    """Return the largest age of each source's readings [s], and what came too late or too seldom."""
    ports = rig.ports
    sources: Mapping[str, Callable[[], float]] = {
        "joints": lambda: rig.state.stamp,
        **{f"{side} pads": lambda side=side: ports.tactile[side].reading().stamp for side in Side},  # type: ignore[misc]
        **{f"{side} gripper": lambda side=side: ports.grippers[side].state().stamp for side in Side},  # type: ignore[misc]
        "stop": lambda: ports.stop.state().stamp,
    }
    last = {name: read() for name, read in sources.items()}
    changes, ages = dict.fromkeys(sources, 0), dict.fromkeys(sources, 0.0)
    for _ in rig.ticks(LISTENED_S):
        for name, read in sources.items():
            stamp = read()
            now = rig.now
            require(stamp >= last[name], f"{name}: the stamp goes back by {last[name] - stamp:.3f} s")
            require(stamp <= now + 1e-6, f"{name}: the stamp is {stamp - now:.3f} s in the future")
            ages[name] = max(ages[name], now - stamp)
            changes[name] += stamp > last[name]
            last[name] = stamp
    require(min(changes.values()) > 0, f"no new reading in {LISTENED_S:g} s: {changes}")
    for name, age in ages.items():
        oldest = OLDEST[name.split()[-1]]
        if age > oldest:
            return ages, f"{name}: a reading is {age:.3f} s old (largest age {oldest} s), {LISTENINGS} times"
    few = changes["joints"] < LEAST_READINGS
    return ages, f"only {changes['joints']} joint states in {LISTENED_S:g} s, {LISTENINGS} times" if few else ""
