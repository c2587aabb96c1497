"""Move one tool to a pose on a collision-free path, with or without the calibration board in the hand."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin

from foldcell.calibration.board import BOARD
from foldcell.calibration.effects import Reach
from foldcell.cell.calibrating.touch import park_other
from foldcell.cell.control.checks import fresh_state
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.executive.effects.checked_motion import move
from foldcell.cell.hardware.assembly import SLACK
from foldcell.cell.hardware.workcell import Workcell
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, Side, frozen
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.moves.free_motion import plan_free_motion
from foldcell.skills.motion.validation.collision import (
    BODY_MARGIN,
    FINGERTIP_MARGIN,
    TABLE_MARGIN,
    CollisionChecker,
)
from foldcell.skills.vocabulary import Outcome, refuse, skill

CARD = 0.006
"""Thickness of the board's collision shape [m]."""
SETTLE_S = 0.3
READINGS = 16
MAX_POSTURES = 2
"""Largest number of arm postures to which a path is planned. The nearest posture is tried first. The first path
that is found is used."""


@skill
def reach(cell: Workcell, effect: Reach) -> Outcome[Array]:
    """Move the tool to the pose of `effect`, in the nearest arm posture to which a collision-free path is found.
    Returns the joints (joints,) of the goal [rad]."""
    refuse(park_other(cell, effect.side))
    q, cut = fresh_state(cell.ports, cell.execution).unwrap().q, cell.robot.arm(effect.side)
    seeds = ik.arm_seeds(cell.robot, effect.side, q)
    postures = ik.solve_seeds(cell.robot, effect.side, effect.T_base_tool, seeds)
    failure: Failure | None = None
    goals = []
    for posture in sorted(postures, key=lambda p: float(np.abs(p - q[cut]).max())):
        goal = np.array(q)
        goal[cut] = posture
        contact = cell.checker.contact(goal)
        if contact is None:
            goals.append(goal)
        failure = failure or (_touching(effect.side, str(contact)) if contact else None)
    for goal in goals[:MAX_POSTURES]:
        path = plan_free_motion(cell.robot, cell.checker, q, goal, limits=cell.limits, rng=cell.rng())
        failure = failure or path.failure
        if path.ok:
            refuse(move(cell, path.unwrap()))
            return Outcome(goal)
    return Outcome(failure=failure or _unreachable(effect))


@skill
def settled_joints(cell: Workcell) -> Outcome[Array]:
    """Wait until the arms rest, then return the mean of READINGS joint readings (joints,) [rad]."""
    refuse(wait(cell.loop, SETTLE_S, cell.hands.recording()))
    readings = []
    for _ in range(READINGS):
        refuse(wait(cell.loop, TICK_S))
        readings.append(cell.ports.arms.state().q)
    return Outcome(frozen(np.mean(readings, axis=0)))


def with_board(cell: Workcell, side: Side) -> Workcell:
    """Return the cell with the board added to the collision shapes of that hand, for planning and for the checks
    during execution."""
    robot = holding_board(cell.robot, side)
    execution_checker = CollisionChecker(
        robot, cell.table, body_margin=BODY_MARGIN - SLACK, table_margin=TABLE_MARGIN - SLACK,
        fingertip_margin=FINGERTIP_MARGIN - SLACK,
    )  # fmt: skip
    return replace(
        cell, robot=robot, checker=CollisionChecker(robot, cell.table), execution_checker=execution_checker
    )


def holding_board(robot: RobotModel, side: Side) -> RobotModel:
    """Return the robot with a card of the board's size between the pads of that hand. Only contact between the
    card and this hand is allowed."""
    frame = robot.pin_model.frames[robot.pin_model.getFrameId(robot.tool_frame[side])]
    width, height = BOARD.size
    shape = coal.Box(width, height + 2 * BOARD.tab, CARD)
    placement = frame.placement * pin.SE3(BOARD.T_tool_board)
    geometry = pin.GeometryModel(robot.collision_model)
    others = list(geometry.geometryObjects)
    board = geometry.addGeometryObject(pin.GeometryObject("board", frame.parentJoint, placement, shape))
    own = set(robot.pin_model.subtrees[frame.parentJoint])  # the joint and its descendants
    for i, other in enumerate(others):
        if other.parentJoint not in own:
            geometry.addCollisionPair(pin.CollisionPair(i, board))
    return replace(robot, collision_model=geometry)


def _touching(side: Side, pair: str) -> Failure:
    what = f"at that pose the {side} hand would come too close: {pair}"
    return Failure(FailureKind.IN_COLLISION, what, "", {"pair": pair})


def _unreachable(effect: Reach) -> Failure:
    where = [round(float(v), 3) for v in effect.T_base_tool[:3, 3]]
    return Failure(
        FailureKind.UNREACHABLE, f"the {effect.side} arm cannot reach the pose at {where} (base frame, m)", "",
        {"where_m": where},
    )  # fmt: skip
