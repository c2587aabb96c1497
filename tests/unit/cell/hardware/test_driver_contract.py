"""The clauses of the ports' contract: a sound driver keeps all, and one that breaks a clause fails exactly
there."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import cast

import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.contract.clauses import CLAUSES, ClauseResult, check_driver
from foldcell.cell.hardware.contract.opening import opened_rig
from foldcell.cell.hardware.contract.rig import REASON, Rig
from foldcell.cell.support.forwarding import forwarding
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import Ports, Side
from tests.broken_drivers import BROKEN, Break, delayed_in, never_moving
from tests.fakes import FakeCell
from tests.kinematic_cell import KinematicCell, kinematic_rig

SETTINGS = load_settings()
CAMERA = camera_calibration(SETTINGS)


def rig(broken: Break) -> AbstractContextManager[Rig]:
    return kinematic_rig(SETTINGS, CAMERA, SETTINGS.table, broken)


def results(broken: Break) -> dict[str, ClauseResult]:
    return {result.of.name: result for result in check_driver(lambda: rig(broken))}


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


def test_the_page_of_results_names_each_broken_driver_at_its_clause() -> None:
    page = (Path(__file__).parents[4] / "docs" / "results" / "drivers.md").read_text(encoding="utf-8")
    rows = [line.removeprefix("| ").split(" | ") for line in page.splitlines() if " | " in line]
    broken = {cells[0]: cells[3].split("; ") for cells in rows}
    for name, (_, clause) in BROKEN.items():
        assert name in broken[clause]


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


@pytest.fixture
def labs_driver(monkeypatch: pytest.MonkeyPatch) -> list[BaseException | None]:
    """A driver of another package that cannot be closed. Returns what its connections were told at their end."""
    ends: list[BaseException | None] = []

    @contextmanager
    def connect(limits: JointLimits) -> Iterator[Ports]:
        try:
            yield FakeCell().ports()
        except BaseException as error:
            ends.append(error)
            raise OSError("the port is gone") from None
        ends.append(None)
        raise OSError("the port is gone")

    module = ModuleType("labs_driver")
    module.connect = connect  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "labs_driver", module)
    return ends


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("a bug")])
def test_a_driver_is_told_what_ended_its_connection(
    labs_driver: list[BaseException | None], error: BaseException
) -> None:
    """Then it can stop the arms. What it raises itself does not replace that."""
    with pytest.raises(type(error)) as raised, opened_rig("labs_driver:connect", SETTINGS):
        raise error
    assert raised.value is error and labs_driver == [error]


def test_a_driver_that_cannot_be_closed_fails_to_reconnect(labs_driver: list[BaseException | None]) -> None:
    reconnect = [clause for clause in CLAUSES if clause.reopens]
    (found,) = check_driver(lambda: opened_rig("labs_driver:connect", SETTINGS), reconnect)
    assert found.failed and "the port is gone" in found.reason and labs_driver == [None]


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
