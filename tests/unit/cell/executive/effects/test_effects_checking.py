"""The look at the garment before the hands go down: what has not moved costs nothing, what has is planned anew."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

import foldcell.cell.executive.effects.checking as checking
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.checking import approach_watched
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import CameraFrame
from foldcell.skills.perception.camera_fault import picture_digests
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.scenes import TABLE, TOWEL, Scene, camera, empty, place, render, with_arm
from tests.workcells import fake_workcell

K = FailureKind
CAMERA = camera()
HOME = (0.6, 0.0, 0.1)
NOW = 20.0


@functools.cache
def picture(at: tuple[float, float, float] = HOME, sequence: int = 2) -> CameraFrame:
    polygons = [place(TOWEL * 0.8, *at)]
    return replace(render(Scene(seed=5, polygons=polygons, wobble=0.0), sequence=sequence), stamp=NOW)


@functools.cache
def bare() -> CameraFrame:
    return empty(Scene(seed=5))


@functools.cache
def planned() -> RunContext:
    return context_with(frame=picture(sequence=1), reference=bare())


class Camera:
    """Shows these pictures: glimpses, then still pictures. The last one of each is shown again and again."""

    def __init__(self, glimpses: list[CameraFrame | None], stills: list[CameraFrame]) -> None:
        self._glimpses, self._stills = glimpses, stills
        self.asked: list[str] = []

    def glimpse(self) -> CameraFrame | None:
        self.asked.append("glimpse")
        return self._glimpses.pop(0) if len(self._glimpses) > 1 else self._glimpses[0]

    def capture(self) -> CameraFrame:
        self.asked.append("capture")
        return self._stills.pop(0) if len(self._stills) > 1 else self._stills[0]


def watching(
    *glimpses: CameraFrame | None, stills: tuple[CameraFrame, ...] = (), **changes: Any
) -> tuple[Workcell, Camera]:
    cell = FakeCell()
    cell.now = NOW
    seeing = Camera(list(glimpses), list(stills))
    work = fake_workcell(
        cell, ports=replace(cell.ports(), camera=seeing), table=TABLE, calibration=CAMERA, **changes
    )
    return work, seeing


def check(work: Workcell, context: RunContext | None = None) -> Result:
    attempt: Any = SimpleNamespace()
    context = context or planned()
    frame = context.sight.frame
    assert frame is not None
    return checking.check_place(work, context, attempt, frame)


def test_a_garment_in_its_place_costs_one_glance() -> None:
    """The fault-free run may take 2 % longer at most, so it takes no still picture here."""
    work, camera_ = watching(picture())
    result = check(work)
    assert result.event is Event.DONE and result.context.sight.frame is planned().sight.frame
    assert camera_.asked == ["glimpse"]
    assert work.ports.clock.now() - NOW == pytest.approx(work.settings.computing.check_s)
    assert result.record["moved_m"] < 0.002  # type: ignore[operator]


@pytest.mark.long
@pytest.mark.parametrize(("shift", "turn"), [((0.08, 0.0), 0.0), ((0.0, -0.015), 0.0), ((0.0, 0.0), 0.1)])
def test_a_garment_that_was_shoved_is_reported_by_a_still_picture(shift: tuple[float, float], turn: float) -> None:
    at = (HOME[0] + shift[0], HOME[1] + shift[1], HOME[2] + turn)
    work, camera_ = watching(picture(at, 2), stills=(picture(at, 3),))
    result = check(work)
    failure = result.context.failure
    assert result.event is Event.FAILED and failure is not None and failure.kind is K.GARMENT_MOVED
    assert "was moved by" in failure.what and failure.hint and camera_.asked == ["glimpse", "capture"]
    assert result.context.disturbed


def test_a_garment_that_was_taken_away_has_been_moved_by_somebody() -> None:
    """When it is laid back, its new place is no drift of the cell's folds."""
    gone = replace(bare(), sequence=4, stamp=NOW)
    work, camera_ = watching(gone, stills=(replace(bare(), sequence=5, stamp=NOW),))
    result = check(work)
    failure = result.context.failure
    assert result.event is Event.FAILED and failure is not None and failure.kind is K.NO_GARMENT
    assert result.context.disturbed and camera_.asked == ["glimpse", "capture"]


def test_a_glance_is_no_verdict() -> None:
    """A hand passed by in the glance; the still picture shows the garment in its place."""
    passing = with_arm(picture(), CAMERA, (0.6, 0.2), (0.55, 0.75))
    work, camera_ = watching(passing, stills=(picture(sequence=3),))
    result = check(work)
    assert result.event is Event.DONE and camera_.asked == ["glimpse", "capture"]
    assert not result.context.disturbed


def test_a_hand_that_stays_is_reported() -> None:
    hand = functools.partial(with_arm, calibration=CAMERA, tip=(0.6, 0.2), start=(0.55, 0.75))
    work, _ = watching(hand(picture()), stills=(hand(picture(sequence=3)),))
    context = check(work).context
    failure, sight = context.failure, context.sight
    assert failure is not None and failure.kind is K.VIEW_OBSTRUCTED
    assert sight.shown is not None and sight.shown.sequence == 3, "a person sees the hand"
    assert sight.frame is not None and sight.frame.sequence != 3, "the plan is from the picture before"


def test_an_old_picture_does_not_acquit() -> None:
    """The camera shows the picture of the plan again, with a new stamp."""
    frame = planned().sight.frame
    assert frame is not None
    context = context_with(planned(), digests=picture_digests(frame))
    old = replace(frame, stamp=NOW, sequence=9)
    work, _ = watching(old, stills=(old,))
    failure = check(work, context).context.failure
    assert failure is not None and failure.kind is K.CAMERA_FAULT and "old picture" in failure.what


def test_a_camera_without_glimpses_takes_a_still_picture() -> None:
    def silent() -> CameraFrame:
        raise DriverError(K.CAMERA_FAULT, "no glimpse")

    later = replace(picture(sequence=3), stamp=NOW + checking.GLANCE_S)
    work, camera_ = watching(None, stills=(later,))
    assert check(work).event is Event.DONE and camera_.asked[-1] == "capture"
    work, camera_ = watching(None, stills=(picture(sequence=3),))
    camera_.glimpse = silent  # type: ignore[method-assign]
    assert check(work).event is Event.DONE and camera_.asked == ["capture"]


def test_without_inspections_the_cell_does_not_look(tmp_path: Any) -> None:
    """As in the paper: such a run relies on its first picture."""
    (tmp_path / "cell.yaml").write_text("inspection: {enabled: false}")
    work, camera_ = watching(picture(), settings=load_settings(tmp_path / "cell.yaml"))
    assert check(work).event is Event.DONE and camera_.asked == []


def test_a_garment_that_moves_every_time_is_asked_about_after_three_new_plans() -> None:
    choose = EFFECTS[Effect.CHOOSE_RECOVERY]
    context, events = planned(), []
    for _ in range(4):
        context = context.with_failure(Failure(K.GARMENT_MOVED, "it was moved"))
        result = choose(fake_workcell(FakeCell(), attended=True), context)
        context, events = result.context, [*events, result.event]
    assert events == [Event.LOOK_AGAIN] * 3 + [Event.ASK] and "moving" in context.asking


# while the hands come


def over(at: tuple[float, float, float]) -> CameraFrame:
    arm = {"height": 0.12, "width": 0.12, "colour": (60, 60, 62)}
    one = with_arm(picture(at, 6), CAMERA, (0.72, 0.1), (0.15, 0.75), **arm)
    return with_arm(one, CAMERA, (0.72, -0.1), (0.15, -0.75), **arm)


@pytest.mark.parametrize(("at", "event"), [(HOME, Event.DONE), ((0.6, 0.08, 0.1), Event.FAILED)])
def test_a_shove_during_the_approach_is_seen_before_the_descent(
    at: tuple[float, float, float], event: Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checking, "approach", lambda cell, context, attempt: Result(Event.DONE, context))
    work, _ = watching(over(at))
    attempt: Any = SimpleNamespace()
    result = approach_watched(work, planned(), attempt)
    assert result.event is event and result.context.disturbed is (event is Event.FAILED)
    if event is Event.FAILED:
        failure = result.context.failure
        assert failure is not None and failure.kind is K.GARMENT_MOVED and "left their place" in failure.what


def test_a_failed_approach_is_not_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    lags = Failure(K.TRACKING_ERROR, "the arm lags")
    monkeypatch.setattr(checking, "approach", lambda cell, c, attempt: Result(Event.FAILED, c.with_failure(lags)))
    work, camera_ = watching(picture())
    attempt: Any = SimpleNamespace()
    assert approach_watched(work, planned(), attempt).context.failure is lags and camera_.asked == []
