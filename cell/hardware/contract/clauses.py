"""The clauses of the contract in their order, and how a driver is checked against them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass

from foldcell.cell.hardware.contract import arm_clauses as arms
from foldcell.cell.hardware.contract import device_clauses as devices
from foldcell.cell.hardware.contract import reading_clauses as readings
from foldcell.cell.hardware.contract.result import Result, judged
from foldcell.cell.hardware.contract.rig import REASON, Rig
from foldcell.robots.errors import CellError, ConfigurationError


@dataclass(frozen=True)
class Clause:
    """One clause.

    proves: what the driver keeps if it passes. remedy: what its author can do if it fails. check: raises
    BrokenError or UnprovenError. moves: what may move meanwhile. powered: the arms' motors are on. guards: if it
    fails, the arms are stopped if they are powered, and nothing that moves or needs power is tried after it.
    reopens: it is checked on a second connection.
    """

    name: str
    proves: str
    remedy: str
    check: Callable[[Rig], Mapping[str, float] | None]
    moves: str = ""
    powered: bool = False
    guards: bool = False
    reopens: bool = False


ClauseResult = Result[Clause]

WRISTS, HANDS = "both wrists, by 9 degrees at most", "the pads of both grippers"

CLAUSES: Sequence[Clause] = (
    Clause(
        "shapes",
        "values have the shapes and types of robots/ports.py, are finite and cannot be written to",
        "return float64 arrays of all joints (left arm, right arm) through `frozen`",
        readings.shapes,
        guards=True,
    ),
    Clause(
        "units",
        "readings are in radians, metres and newtons, within the ranges of the model",
        "convert at the port; compare the model's ranges with the robot's",
        readings.units,
        guards=True,
    ),
    Clause(
        "stamps",
        "stamps never go back, are on the cell's clock, and readings are fresh",
        "stamp each value with Clock.now() when it arrives; read the device on a thread of its own",
        readings.stamps,
        guards=True,
    ),
    Clause(
        "stop at rest",
        "a stop is reported and refuses set-points at once; after a reset the motors stay off",
        "keep the stop until `reset`; check it in `command` and `enable`",
        arms.stop_at_rest,
        "the pads of both grippers begin to calibrate",
        powered=True,
        guards=True,
    ),
    Clause(
        "refusals",
        "a set-point that is not finite or lacks a joint is refused and moves nothing",
        "check shape and np.isfinite in `command`, and raise DriverError",
        arms.refusals,
        powered=True,
        guards=True,
    ),
    Clause(
        "two threads",
        "the stop can be read and triggered on any thread while another one commands",
        "make `Stop` safe for threads and signal handlers: set a flag, and act on it elsewhere",
        arms.two_threads,
        powered=True,
        guards=True,
    ),
    Clause(
        "clipping",
        "a set-point too far away is clipped to one step; what is returned is what was sent",
        "use foldcell.robots.setpoint.clip_setpoint and return its result",
        arms.clipping,
        "both wrists, by one step",
        powered=True,
        guards=True,
    ),
    Clause(
        "hold",
        "arms without a set-point hold after the command timeout",
        "let the robot's own controller hold, so that they also hold if the program dies",
        arms.hold,
        WRISTS,
        powered=True,
        guards=True,
    ),
    Clause(
        "stop in motion",
        "a stop brings moving arms to rest within 0.5 s",
        "pass the stop to the robot's own stop",
        arms.stop_in_motion,
        WRISTS,
        powered=True,
        guards=True,
    ),
    Clause(
        "stale state",
        "without joint states the last one stays with its stamp, and set-points are refused",
        "keep the last value; raise DriverError(STALE_STATE) if it is older than the command timeout",
        arms.stale_state,
        powered=True,
    ),
    Clause(
        "joint order",
        "each joint that is commanded is the one that turns, by the commanded angle",
        "map joints by their names, not by their places in a message",
        arms.joint_order,
        "one joint after the other, by 2 degrees",
        powered=True,
        guards=True,
    ),
    Clause(
        "velocities",
        "the reported velocities are those of the positions",
        "report radians per second",
        arms.velocities,
        WRISTS,
        powered=True,
    ),
    Clause(
        "gripper",
        "grippers calibrate, count as moving from a command on, and reach the commanded opening",
        "count unfinished commands as moving; give the distance between the pads",
        devices.gripper,
        HANDS,
    ),
    Clause(
        "gripper orders",
        "an invalid opening is refused; a command during a calibration is carried out after it",
        "check np.isfinite; keep the command until the calibration has ended",
        devices.gripper_refusals,
        HANDS,
    ),
    Clause(
        "head",
        "the head turns to the commanded angle and reports it",
        "report the measured angle in radians, positive to the left; a fixed head reports 0",
        devices.head,
        "the head, by 6 degrees",
        powered=True,
    ),
    Clause(
        "camera",
        "a still picture is taken after the request and has a new number; a glimpse does not wait",
        "skip pictures from before the request; fetch glimpses on a thread",
        devices.camera,
    ),
    Clause(
        "depth",
        "the depth is registered to the colours, in metres along the optical axis, NaN where there is none",
        "switch the camera's depth registration on; clear the table; calibrate the camera",
        devices.depth,
    ),
    Clause(
        "reconnect",
        "the driver can be closed and opened again, and nothing moves meanwhile",
        "release every connection and thread when the context ends",
        arms.reconnect,
        powered=True,
        reopens=True,
    ),
)


def check_driver(
    opened: Callable[[], AbstractContextManager[Rig]],
    clauses: Sequence[Clause] = CLAUSES,
) -> Iterator[ClauseResult]:
    """Check a driver and yield the result of each clause. opened: opens a connection.

    An error of the first connection's end counts as the failure of the clauses that reopen. Raises
    ConfigurationError if the robot is stopped before the check, and whatever opening raises.
    """
    guard, unclosed = "", None
    with ExitStack() as connection:
        rig = connection.enter_context(opened())
        stop = rig.ports.stop.state()
        if stop.stopped:
            raise ConfigurationError(
                f"the robot is stopped: {stop.reason}", "clear the cause, then `foldcell reset`"
            )
        for clause in clauses:
            if not clause.reopens:
                result = _checked(clause, rig, guard)
                if clause.guards and result.failed:
                    guard = guard or clause.name
                    if clause.powered:
                        rig.ports.stop.trigger(REASON)
                yield result
        try:
            connection.close()
        except Exception as error:
            unclosed = error
    for clause in clauses:
        if clause.reopens:
            yield _reopened(clause, opened, guard) if unclosed is None else _not_again(clause, unclosed)


def _checked(clause: Clause, rig: Rig, guard: str) -> ClauseResult:
    if rig.ended():
        return ClauseResult(clause, "not_run", "the check was interrupted")
    if guard and (clause.moves or clause.powered):
        return ClauseResult(clause, "not_run", f"nothing moves after the failure of '{guard}'")
    began = time.monotonic()
    state, reason, figures = judged(clause.check, rig)
    if rig.ended():
        state, reason = "not_run", "the check was interrupted"
    return ClauseResult(clause, state, reason, time.monotonic() - began, figures)


def _reopened(clause: Clause, opened: Callable[[], AbstractContextManager[Rig]], guard: str) -> ClauseResult:
    began = time.monotonic()
    try:
        with opened() as rig:
            return _checked(clause, rig, guard)
    except Exception as error:
        return _not_again(clause, error, time.monotonic() - began)


def _not_again(clause: Clause, error: Exception, seconds: float = 0.0) -> ClauseResult:
    what = error.what if isinstance(error, CellError) else f"{type(error).__name__}: {error}"
    return ClauseResult(clause, "failed", f"it cannot be closed and opened again: {what}", seconds)
