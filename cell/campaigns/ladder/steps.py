"""The steps of the ladder in their order. Each is built on clauses of the drivers' contract, motions of the
calibrations, or scripted runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.calibration.board import find_board
from foldcell.calibration.effects import Touch
from foldcell.calibration.table import contact_height
from foldcell.calibration.tactile import POINTS
from foldcell.cell.calibrating.touch import touch_table
from foldcell.cell.campaigns.ladder.rung import Rung
from foldcell.cell.campaigns.ladder.runs import ScriptedRuns
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.executive.effects.checked_motion import move
from foldcell.cell.executive.effects.moving import prepare
from foldcell.cell.hardware.contract import arm_clauses, device_clauses, reading_clauses
from foldcell.cell.hardware.contract.rig import Rig, UnprovenError, require
from foldcell.cell.states.run_context import RunContext
from foldcell.robots.errors import Failure
from foldcell.robots.ports import BoardPlace, Side
from foldcell.skills.grasping.hand_reading import GripCommand
from foldcell.skills.motion.moves.lift import plan_lift

Figures = Mapping[str, float]

NOISE, ZERO = 0.1, 1.0
"""Largest noise of a tactile cell, and largest sum of an unloaded pad [N]."""
PRESSED, PRESS_S = 0.5, 60.0
"""Force by which a finger presses a pad [N], and how long a person has for it [s]."""
SMALL_TURN = float(np.deg2rad(2.0))
LIFT, LIFT_ERROR = 0.05, 0.01
"""Height by which both hands rise, and error of their height [m]."""
TABLE_ERROR = 0.015
"""Largest distance of the touched table from its configured height [m]."""
GRIP_FORCE, GRIP_S = 10.0, 1.5
NOTHING = 0.003
"""Largest opening of hands that have closed on nothing [m]."""


@dataclass(frozen=True)
class Step:
    """One step. proves: what is known if it passes. moves: what may move. person: what the person does. remedy:
    what helps if it fails. check: returns the measured figures, and raises BrokenError or UnprovenError. runs:
    performs scripted runs instead, with the cell closed."""

    name: str
    proves: str
    moves: str
    person: str
    remedy: str
    check: Callable[[Rung], Figures] | None = None
    runs: Callable[[ScriptedRuns], Figures] | None = None


def by(*clauses: Callable[[Rig], object]) -> Callable[[Rung], Figures]:
    """Return a check that consists of clauses of the contract."""

    def check(rung: Rung) -> Figures:
        for clause in clauses:
            clause(rung.rig)
        return {}

    return check


def _expect(failure: Failure | None) -> None:
    require(failure is None, f"{failure and failure.what}")


def _clock(rung: Rung) -> Figures:
    rig, begun = rung.rig, rung.rig.now
    steps = np.diff([begun, *rig.ticks(1.0)])
    require(steps.min() > 0.0, "the clock stands still or goes back")
    require(abs(steps.sum() - 1.0) < 0.1, f"100 sleeps of 10 ms take {steps.sum():.2f} s")
    return {"longest_sleep_s": float(steps.max())}


def _joint_state(rung: Rung) -> Figures:
    reading_clauses.stamps(rung.rig)
    rig = rung.rig
    heard = [(rig.state.stamp, t - rig.state.stamp) for t in rig.ticks(1.0)]
    stamps = np.unique([stamp for stamp, _ in heard])
    gaps = np.diff(stamps)
    return {
        "rate_hz": float(1.0 / gaps.mean()), "jitter_s": float(gaps.std()),
        "oldest_s": max(age for _, age in heard),
    }  # fmt: skip


def _pads(rung: Rung) -> Figures:
    rig, tactile = rung.rig, rung.rig.ports.tactile
    heard: dict[Side, list[np.ndarray]] = {side: [] for side in Side}
    for _ in rig.ticks(1.0):
        for side in Side:
            heard[side].append(tactile[side].reading().cells)
    noise = {side: float(np.std(cells, axis=0).max()) for side, cells in heard.items()}
    zero = {side: float(np.abs(np.mean(cells, axis=0).sum(axis=(1, 2))).max()) for side, cells in heard.items()}
    for side in Side:
        require(noise[side] < NOISE, f"a cell of the {side} hand has a noise of {noise[side]:.2f} N")
        require(zero[side] < ZERO, f"an unloaded pad of the {side} hand reads {zero[side]:.1f} N")
        constant = np.ptp(heard[side], axis=0).max() == 0.0
        require(not constant, f"no cell of the {side} hand changes: its readings have no noise")
    if not rig.ports.simulated:
        _pressed_by_a_person(rung)
    return {"noise_n": max(noise.values()), "zero_n": max(zero.values())}


def _pressed_by_a_person(rung: Rung) -> None:
    for side in Side:
        for pad in range(2):
            rest = rung.rig.ports.tactile[side].reading().cells[pad].sum()
            rung.tell(f"press pad {pad} of the {side} hand with a finger, within {PRESS_S:g} s")

            def felt(side: Side = side, pad: int = pad, rest: float = rest) -> bool:
                return bool(rung.rig.ports.tactile[side].reading().cells[pad].sum() - rest > PRESSED)

            name = f"pad {pad} of the {side} hand"
            require(rung.rig.within(PRESS_S, felt), f"{name} has not felt a finger in {PRESS_S:g} s")


def _camera(rung: Rung) -> Figures:
    device_clauses.camera(rung.rig)
    device_clauses.depth(rung.rig)
    ports, begun = rung.rig.ports, rung.rig.now
    ports.attendant.bring_board(BoardPlace.SHOWN)
    view = find_board(ports.camera.capture().rgb)
    ports.attendant.bring_board(BoardPlace.AWAY)
    require(view is not None, "the calibration board is not found in the picture")
    assert view is not None
    return {"board_corners": float(len(view.index)), "found_after_s": rung.rig.now - begun}


def _one_joint(rung: Rung) -> Figures:
    rig, turn = rung.rig, np.zeros(len(rung.rig.model.q_park))
    rig.ready()
    turn[-1] = SMALL_TURN
    before = rig.state.q
    rig.move(turn)
    turned = rig.state.q - before
    rig.move(-turned * (turn > 0.0))
    back = float(np.abs(rig.state.q - before).max())
    require(
        abs(abs(turned[-1]) - SMALL_TURN) < 0.5 * SMALL_TURN, f"it turned by {np.rad2deg(turned[-1]):.1f} degrees"
    )
    require(back < 0.5 * SMALL_TURN, f"a joint has not come back: {np.rad2deg(back):.1f} degrees are left")
    return {"turned_deg": float(np.rad2deg(turned[-1])), "left_deg": float(np.rad2deg(back))}


def _both_arms(rung: Rung) -> Figures:
    rig, cell = rung.rig, rung.cell
    rig.ready()
    before = rig.state.q
    up = plan_lift(cell.robot, cell.checker, before, tuple(Side), LIFT, limits=cell.robot.commissioning)
    if up.failure:
        raise UnprovenError(up.failure.what)
    heights = [cell.hands.height(side, before) for side in Side]
    _expect(move(cell, up.unwrap()))
    risen = [cell.hands.height(side, rig.state.q) - z for side, z in zip(Side, heights, strict=True)]
    cell.last_command.q = None
    rig.move(before - rig.state.q)
    for side, height in zip(Side, risen, strict=True):
        require(abs(height - LIFT) < LIFT_ERROR, f"the {side} hand rose by {1e3 * height:.0f} mm")
    return {f"{side}_rise_m": height for side, height in zip(Side, risen, strict=True)}


def _stop(rung: Rung) -> Figures:
    arm_clauses.clipping(rung.rig)
    return arm_clauses.stop_in_motion(rung.rig)


def _link(rung: Rung) -> Figures:
    arm_clauses.hold(rung.rig)
    if rung.rig.interrupt is not None:
        arm_clauses.stale_state(rung.rig)
    return {}


def _descent(rung: Rung) -> Figures:
    """Prepare and park as a run does, then touch the table with each hand."""
    result = prepare(rung.cell, RunContext())
    _expect(result.context.failure)
    off: dict[str, float] = {}
    for side, (x, y) in POINTS.items():
        touched = touch_table(rung.cell, Touch(side, x, y))
        _expect(touched.failure)
        height = contact_height(touched.unwrap())
        _expect(height.failure)
        off[f"{side}_error_m"] = height.unwrap()[0] - rung.cell.table.height
        found = f"{1e3 * off[f'{side}_error_m']:.0f} mm from its configured height"
        require(abs(off[f"{side}_error_m"]) < TABLE_ERROR, f"the {side} hand finds the table {found}")
    return off


def _grasp_nothing(rung: Rung) -> Figures:
    cell, figures = rung.cell, dict[str, float]()
    for opening in (cell.settings.gripper.opening, cell.settings.gripper.closed_opening):
        for side in Side:
            cell.hands.command(side, GripCommand(opening, GRIP_FORCE))
        _expect(wait(cell.loop, GRIP_S))
    for side in Side:
        opening, grip = cell.ports.grippers[side].state().opening, cell.ports.tactile[side].reading().grip
        require(
            opening < NOTHING + cell.settings.gripper.closed_opening,
            f"the {side} hand stays open: {opening:.4f} m",
        )
        held = cell.grasp.held_force
        require(grip < held, f"the {side} hand feels {grip:.1f} N between its pads (held: {held:.1f} N)")
        figures |= {f"{side}_opening_m": opening, f"{side}_grip_n": grip}
    return figures


TABLE = "clear the table; compare `table.height` with a ruler, then `foldcell calibrate table`"
STEPS: Sequence[Step] = (
    Step(
        "clock", "the cell's clock runs", "nothing", "nothing",
        "synchronise the clocks; over ROS check /use_sim_time and /clock", _clock,
    ),
    Step(
        "connection", "every device answers, there is one robot, and values have the right shapes and units",
        "nothing", "nothing", "see `foldcell robot check`", by(reading_clauses.shapes, reading_clauses.units),
    ),
    Step(
        "joint state", "joint states are fresh and regular", "nothing", "nothing",
        "use a cable instead of a wireless network; end other programs on this machine", _joint_state,
    ),
    Step(
        "enable", "the motors can be switched on, and invalid set-points are refused", "nothing (the brakes open)",
        "keeps a hand on the emergency stop from here on", "look at the robot's own display for a fault",
        by(arm_clauses.refusals),
    ),
    Step(
        "stop at rest", "the stop is reported, refuses set-points and leaves the motors off", "nothing", "nothing",
        "do not go on: the stop has to work first", by(arm_clauses.stop_at_rest, arm_clauses.two_threads),
    ),
    Step(
        "grippers", "both grippers calibrate, open and close", "the pads", "keeps fingers away from the pads",
        "check the grippers' plugs and that they move freely",
        by(device_clauses.gripper, device_clauses.gripper_refusals),
    ),
    Step(
        "pads", "the pressure cells are live and near zero", "nothing", "presses each pad with a finger",
        "check the pads' readers; `foldcell calibrate tactile` sets their thresholds", _pads,
    ),
    Step(
        "head", "the head turns to the angle at which the camera is calibrated", "the head", "nothing",
        "report radians, positive to the left", by(device_clauses.head),
    ),
    Step(
        "camera", "pictures are new, the depth fits the bare table, and the board is found", "nothing",
        "clears the table, then shows the calibration board and takes it away",
        "switch depth registration on; light the table; calibrate the camera", _camera,
    ),
    Step(
        "one joint", "one joint turns by 2 degrees and back", "the right wrist",
        "stays out of the arms' reach from here",
        "compare the robot's own limits with the model's", _one_joint,
    ),
    Step(
        "each joint", "each joint is the one that was commanded, with the right sign and velocity",
        "one joint after the other, by 2 degrees", "watches that joints turn from shoulder to wrist, left first",
        "map joints by their names", by(arm_clauses.joint_order, arm_clauses.velocities),
    ),
    Step(
        "both arms", "both hands rise by 5 cm, straight and together", "both arms", "watches that both hands rise",
        "check the model: link lengths, joint offsets", _both_arms,
    ),
    Step(
        "stop in motion", "a stop brings moving arms to rest within 0.5 s", "both wrists, by 9 degrees", "nothing",
        "do not go on: the stop has to work first", _stop,
    ),
    Step(
        "link loss", "arms without set-points hold; set-points without joint states are refused",
        "both wrists, by 9 degrees", "nothing", "the robot's own controller has to hold", _link,
    ),
    Step(
        "guarded descent", "each hand goes down until it feels the bare table", "both arms, one after the other",
        "watches that a hand stops at the table", TABLE, _descent,
    ),
    Step(
        "grasp nothing", "hands that close on nothing know it", "the pads", "nothing",
        "`foldcell calibrate tactile`; correct `gripper.closed_opening`", _grasp_nothing,
    ),
    Step(
        "grasp a cloth", "cloth is grasped, held for 10 s and released", "everything, as in a run",
        "lays a small towel", "see the run's report", runs=ScriptedRuns.hold,
    ),
    Step(
        "pull until it slips", "a hand feels the cloth slip before a joint feels the pull as a contact",
        "both arms, slowly apart", "lays a small towel", "`foldcell calibrate tactile`; see the run's report",
        runs=ScriptedRuns.pull,
    ),
    Step(
        "one fold", "a fold is shown, approved, made and inspected", "everything, as in a run",
        "lays a small towel, approves the fold, ends the run before the second", "see the run's report",
        runs=ScriptedRuns.approved_fold,
    ),
    Step(
        "stop in a fold", "a stop in a fold holds the arms, and the run is resumed", "everything, as in a run",
        "lays a small towel; after the stop clears the cause and takes the cloth out of the hands",
        "see the runs' reports", runs=ScriptedRuns.stop_and_resume,
    ),
)  # fmt: skip
