"""Touch-off: a closed hand moves straight down onto the table, presses slowly and moves up again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foldcell.calibration.effects import Touch, TouchReadings
from foldcell.cell.config.deciding_setting import setting_in_words
from foldcell.cell.control.checks import SETTLED, fresh_state
from foldcell.cell.control.motion import Motion
from foldcell.cell.control.motions.guarded_motions import GuardedHand, Lowering, guarded_descent
from foldcell.cell.control.motions.hands import each_hand
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.executive.effects.checked_motion import move
from foldcell.cell.hardware.workcell import Workcell
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import JointState, Side
from foldcell.skills.grasping.descend import Contact, DescentGoal, start_descent
from foldcell.skills.grasping.hand_reading import GripCommand, HandReading
from foldcell.skills.grasping.release import RELEASE_FORCE
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.grasping.tare import TactileBias, TareState, tare
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.kinematics.posture import Posture
from foldcell.skills.motion.moves.free_motion import plan_free_motion
from foldcell.skills.motion.moves.grasp import Descent, GraspMotion, plan_grasp
from foldcell.skills.motion.moves.lift import plan_lift
from foldcell.skills.motion.timing.jerk_limiter import JerkLimiter
from foldcell.skills.vocabulary import GraspId, Outcome, ToolPath, refuse, skill, tool_rotation

ABOVE = 0.08
"""Height above the configured table at which the descent begins [m]."""
CLOSING_S = 1.0
BACK_OFF = 0.003
"""Distance by which the hand rises between the first touch and the slow press [m]."""
PRESS_SPEED = 0.003
PRESS_FORCE = 1.5
"""Force on one fingertip at which the slow press ends [N]."""
HEADINGS = np.deg2rad([0.0, 90.0, -90.0, 45.0, -45.0, 180.0])


@skill
def touch_table(cell: Workcell, effect: Touch) -> Outcome[TouchReadings]:
    """Move over the point, touch the table, press slowly and rise to the start height. The hand also rises after a
    failure, except after a stop."""
    cell.hands.command(effect.side, GripCommand(0.0, RELEASE_FORCE))
    refuse(wait(cell.loop, CLOSING_S, cell.hands.recording()) or park_other(cell, effect.side))
    motion = _plan_descent(cell, effect).unwrap()
    refuse(move(cell, motion.approach))
    pressed = _touch_and_press(cell, effect, motion.descend[effect.side])
    if pressed.failure and pressed.failure.kind is FailureKind.STOPPED:
        return pressed
    failure = _rise(cell, effect.side, ABOVE - cell.hands.height(effect.side, cell.ports.arms.state().q))
    return pressed if pressed.failure or not failure else Outcome(failure=failure)


def park_other(cell: Workcell, side: Side) -> Failure | None:
    """Park the other arm unless it is parked already."""
    state = fresh_state(cell.ports, cell.execution)
    if state.failure:
        return state.failure
    q, other = state.unwrap().q, cell.robot.arm(side.other)
    if np.abs(q[other] - cell.robot.q_park[other]).max() < SETTLED:
        return None
    goal = np.array(q)
    goal[other] = cell.robot.q_park[other]
    path = plan_free_motion(cell.robot, cell.checker, q, goal, limits=cell.limits, rng=cell.rng())
    return path.failure or move(cell, path.unwrap())


@skill
def _plan_descent(cell: Workcell, effect: Touch) -> Outcome[GraspMotion]:
    """Plan a motion to above the point and then straight down, with an upright hand. The first heading and arm
    posture that are free of collision are used."""
    q, side = fresh_state(cell.ports, cell.execution).unwrap().q, effect.side
    only = GraspId(side.value)
    failure: Failure | None = None
    for heading in HEADINGS:
        path = _point(effect.x, effect.y, float(heading))
        T = np.eye(4)
        T[:3, :3] = tool_rotation(path.heading, path.pitch, path.roll)[0]
        T[:3, 3] = effect.x, effect.y, cell.table.height + ABOVE
        for hint in ik.solve_seeds(cell.robot, side, T, ik.arm_seeds(cell.robot, side, q)):
            motion = plan_grasp(
                cell.robot, cell.checker, cell.table, {only: path}, {side: Posture(only)}, q,
                limits=cell.limits, approach_height=ABOVE, overtravel=effect.search, q_hint={side: hint},
                rng=cell.rng(),
            )  # fmt: skip
            if motion.ok and motion.unwrap().descend[side].depth[-1] > ABOVE + effect.search - 1e-6:
                return motion
            failure = failure or motion.failure
    return Outcome(
        failure=failure
        or Failure(
            FailureKind.UNREACHABLE,
            f"the {side} arm cannot reach ({effect.x:.2f}, {effect.y:.2f}) from above",
            "touch the table closer to its middle",
        )
    )


def _point(x: float, y: float, heading: float) -> ToolPath:
    """Return a tool path that stays at one point on the table."""
    zero = np.zeros(2)
    return ToolPath(np.array([0.0, 1.0]), np.tile([x, y, 0.0], (2, 1)), np.full(2, heading), zero, zero)


@skill
def _touch_and_press(cell: Workcell, effect: Touch, descent: Descent) -> Outcome[TouchReadings]:
    side, settings = effect.side, cell.grasp
    bias = each_hand(cell.loop, cell.hands, {side: TareState(settings)}, lambda _, r, s: tare(r, s)).unwrap()[side]
    first = _descend(cell, side, descent, settings, bias, -effect.search, [])
    if first.failure:
        return Outcome(failure=_explained(cell, first.failure, effect))
    refuse(_rise(cell, side, BACK_OFF))
    slow = replace(settings, guarded_speed=PRESS_SPEED, approach_speed=PRESS_SPEED, contact_force=PRESS_FORCE)
    readings: list[HandReading] = []
    second = _descend(cell, side, descent, slow, bias, -effect.search, readings)
    if second.failure:
        return Outcome(failure=_explained(cell, second.failure, effect))
    at = ik.tool_pose(cell.robot.chains[side], cell.ports.arms.state().q[cell.robot.arm(side)])[:2, 3]
    height = np.array([r.height for r in readings]) + cell.table.height
    force = np.array([(r.tactile.tip - bias.tip).sum() for r in readings])
    return Outcome(TouchReadings(side, float(at[0]), float(at[1]), height, force))


def _descend(
    cell: Workcell,
    side: Side,
    descent: Descent,
    settings: GraspSettings,
    bias: TactileBias,
    bottom: float,
    readings: list[HandReading],
) -> Outcome[dict[Side, Contact]]:
    """Lower the hand until it touches, and bring it to rest. The hand moves slowly from the start of the search
    range, because the table may be anywhere in this range.

    bottom: lowest height of the search, relative to the configured table [m]. readings: each new reading is
    appended.
    """
    settings = replace(settings, slow_above=-bottom, early_margin=-bottom)
    goal = DescentGoal(contact=0.0, bottom=bottom)

    def feel(reading: HandReading) -> None:
        if not readings or reading.tactile.stamp > readings[-1].tactile.stamp:
            readings.append(reading)

    def begin(start: JointState) -> Motion[dict[Side, Contact]]:
        q0 = start.q + cell.last_command.offset(start.q)
        above = np.array(q0)
        above[cell.robot.arm(side)] = descent.q[0]
        top = cell.hands.height(side, above)
        lowering = Lowering(descent, top, JerkLimiter(top - cell.hands.height(side, q0)))
        state = start_descent(settings, goal, bias, cell.hands.read(side, start))
        return guarded_descent(
            cell.hands, cell.last_command, start, {side: GuardedHand(lowering, state)}, settles=True, felt=feel
        )

    return cell.loop.run(begin)


def _explained(cell: Workcell, failure: Failure, effect: Touch) -> Failure:
    """Replace the message of a missing or early contact, because its causes over a bare table differ from those
    over a garment."""
    height = setting_in_words("table.height", cell.settings)
    if failure.kind is FailureKind.IN_COLLISION:
        return Failure(
            FailureKind.LOW_CONFIDENCE,
            f"the {effect.side} hand touched something at ({effect.x:.2f}, {effect.y:.2f}), more than"
            f" {1e3 * effect.search:.0f} mm above the table's height",
            f"clear the table; if it is clear, correct {height} and calibrate again",
            failure.values,
        )
    if failure.kind is not FailureKind.NO_CONTACT:
        return failure
    return Failure(
        FailureKind.NO_CONTACT,
        f"the {effect.side} hand felt no table at ({effect.x:.2f}, {effect.y:.2f}), down to"
        f" {1e3 * effect.search:.0f} mm below the table's height",
        f"measure the height of the table, correct {height}, and calibrate again",
        failure.values,
    )


def _rise(cell: Workcell, side: Side, by: float) -> Failure | None:
    """Move straight up by `by` [m]."""
    if by <= 0.0:
        return None
    q = cell.ports.arms.state().q
    up = plan_lift(cell.robot, cell.checker, q, (side,), by, limits=cell.limits)
    return up.failure or move(cell, up.unwrap(), fingertips=True)
