"""The clauses of the ports' contract: a sound driver keeps all, and one that breaks a clause fails exactly
there."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import cast

import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.contract.clauses import CLAUSES, ClauseResult, check_driver
from foldcell.cell.hardware.contract.rig import REASON, Rig
from foldcell.cell.support.forwarding import forwarding
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Ports, Side
from tests.broken_drivers import (
    Break,
    along_the_ray,
    as_requested,
    brakes_late,
    degrees,
    delayed_in,
    fast,
    first_two_exchanged,
    forgetful,
    fresh_stamp,
    mirrored,
    motors_on_after_a_reset,
    nan_is_zero,
    never_holds,
    never_moving,
    on_its_own_thread,
    same_number,
    unregistered,
    wall_clock,
    with_command,
    with_gripper,
    with_picture,
    with_state,
    with_stop,
    writable,
)
from tests.kinematic_cell import KinematicCell, kinematic_rig

SETTINGS = load_settings()
CAMERA = camera_calibration(SETTINGS)


def rig(broken: Break) -> AbstractContextManager[Rig]:
    return kinematic_rig(SETTINGS, CAMERA, SETTINGS.table, broken)


def results(broken: Break) -> dict[str, ClauseResult]:
    return {result.of.name: result for result in check_driver(lambda: rig(broken))}


BROKEN: dict[str, tuple[Break, str]] = {
    "writable arrays": (with_state(writable), "shapes"),
    "degrees": (with_state(degrees), "units"),
    "stamps of the wall clock": (with_state(wall_clock), "stamps"),
    "grippers whose states come late": (delayed_in(0.3, 0.6), "stamps"),
    "motors on after a reset": (motors_on_after_a_reset, "stop at rest"),
    "NaN taken for 0": (with_command(nan_is_zero), "refusals"),
    "a stop for one thread": (with_stop(on_its_own_thread), "two threads"),
    "the requested set-point returned": (with_command(as_requested), "clipping"),
    "no hold": (never_holds, "hold"),
    "late brakes": (brakes_late, "stop in motion"),
    "invented stamps": (with_state(fresh_stamp), "stale state"),
    "two joints exchanged": (with_state(first_two_exchanged), "joint order"),
    "velocities doubled": (with_state(fast), "velocities"),
    "a gripper that never moves": (with_gripper(state=never_moving), "gripper"),
    "a gripper that forgets": (with_gripper(command=forgetful), "gripper orders"),
    "a mirrored head": (mirrored, "head"),
    "one number for all pictures": (with_picture(same_number), "camera"),
    "depth of another size": (with_picture(unregistered), "depth"),
    "depth along the ray": (with_picture(along_the_ray), "depth"),
}  # fmt: skip


def test_a_sound_driver_keeps_every_clause() -> None:
    found = results(KinematicCell.ports)
    assert list(found) == [clause.name for clause in CLAUSES]
    assert {name: r.reason for name, r in found.items() if not r.passed} == {}


def test_a_driver_is_not_blamed_for_one_moment_of_a_busy_machine() -> None:
    stamps = [c for c in CLAUSES if c.name == "stamps"]
    (found,) = check_driver(lambda: rig(delayed_in(0.3, 1000.0)), stamps)
    assert found.passed, found.reason
    assert found.figures["oldest_left_gripper_s"] < 0.2, "of the time that was in order"


@pytest.mark.parametrize("name", BROKEN)
def test_a_driver_that_breaks_one_clause_fails_exactly_there(name: str) -> None:
    broken, clause = BROKEN[name]
    found = results(broken)
    assert {n: r.reason for n, r in found.items() if r.state == "failed"} == {clause: found[clause].reason}
    guarded = next(c for c in CLAUSES if c.name == clause).guards
    left = {n for n, r in found.items() if r.state == "not_run"}
    names = [c.name for c in CLAUSES]
    later = {c.name for c in CLAUSES[names.index(clause) + 1 :] if c.moves or c.powered}
    assert left == (later if guarded else set()), "nothing moves after the failure of a guard"


def test_a_driver_that_cannot_be_opened_twice_fails_to_reconnect() -> None:
    opened = 0

    def once() -> AbstractContextManager[Rig]:
        nonlocal opened
        opened += 1
        if opened > 1:
            raise ConfigurationError("the port is in use")
        return rig(KinematicCell.ports)

    failed = [r for r in check_driver(once) if not r.passed]
    assert [(r.of.name, r.state) for r in failed] == [("reconnect", "failed")]
    assert "in use" in failed[0].reason


def test_a_stop_by_somebody_else_is_never_reset() -> None:
    """Neither before the check nor in the middle of it."""
    cells: list[KinematicCell] = []

    def stopped_later(cell: KinematicCell) -> Ports:
        cells.append(cell)
        ports, trigger = cell.ports(), cell.trigger

        def pressed(reason: str) -> None:
            trigger("the button" if cell.pictures else reason)

        return replace(ports, stop=forwarding(ports.stop, trigger=pressed))

    def stopped_now(cell: KinematicCell) -> Ports:
        cell.trigger("the button")
        return cell.ports()

    with pytest.raises(ConfigurationError, match="the button"):
        list(check_driver(lambda: rig(stopped_now)))
    clauses = [c for c in CLAUSES if c.name in ("camera", "stop at rest", "head")]
    order = [dataclasses.replace(c, guards=False) for c in sorted(clauses, key=lambda c: c.name != "camera")]
    found = list(check_driver(lambda: rig(stopped_later), order))
    assert [r.state for r in found] == ["passed", "failed", "not_run"]
    assert cells[0].reason == "the button" and REASON not in cells[0].reason


def test_after_a_signal_the_check_resets_no_stop_and_commands_nothing() -> None:
    cells: list[KinematicCell] = []

    @contextmanager
    def interrupted() -> Iterator[Rig]:
        with rig(KinematicCell.ports) as sound:
            cells.append(cast(KinematicCell, sound.ports.arms))
            yield replace(sound, ended=lambda: bool(cells[0].reason))  # the signal comes with the first stop

    found = {r.of.name: r for r in check_driver(interrupted)}
    assert {r.state for r in list(found.values())[3:]} == {"not_run"}
    assert REASON in cells[0].reason and not cells[0].enabled


@pytest.mark.parametrize("side", Side)
def test_clauses_name_the_hand_that_is_at_fault(side: Side) -> None:
    def broken(cell: KinematicCell) -> Ports:
        ports = cell.ports()
        hand = cell.hands[side]
        own = forwarding(hand, state=lambda: never_moving(hand))
        return replace(ports, grippers={**ports.grippers, side: own})

    reason = results(broken)["gripper"].reason
    assert side in reason and side.other not in reason
