"""The operator's picture: the camera's latest picture with the plan, or with what is expected, drawn on it.

The picture is drawn by the cell, because a 3-D viewer on a computer without a graphics card is always behind. The
view takes a display picture when the executive polls the stop, so it needs no thread of its own at the ports. A
simulated camera only takes the state of the world then, and its picture is rendered on the view's thread, so that
the executive does not wait. The view also remembers the last grip of each hand. It draws only if a page is open.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from cell.operator.console.messages import PlanChange
from cell.operator.console.plan_changes import offered_changes, plan_edit
from cell.recording.camera_pictures.live_picture import draw_live
from cell.recording.camera_pictures.projected_drawing import jpeg_file
from cell.recording.camera_pictures.question_picture import QUESTIONS
from cell.recording.rerun.bounded_worker import BoundedWorker
from cell.states.observers import Step
from cell.states.plan_edit import PlanEdit
from cell.states.run_context import Result, RunContext
from cell.states.transition_table import State
from robots.errors import DriverError
from robots.ports import CameraFrame, Clock, Ports, Side, Stop, StopState, Tactile, TactileReading
from skills.vocabulary import CameraCalibration

__all__ = ["LiveView"]

PERIOD_S = 0.4
"""Shortest time between two display pictures [s]."""
LARGEST_SHARE = 0.2
"""Share of the executive's time that display pictures may take."""
Take = Callable[[], Callable[[], CameraFrame | None]]
"""Takes a display picture. The returned function gives it, on any thread; None: the camera has none."""
Work = Callable[[], None]
CLOSE_S = 2.0


@dataclass(frozen=True, eq=False)
class _Moment:
    """What a picture is drawn from. number: grows with every change. taken: when the frame was taken [s,
    monotonic]. progress: share of the arc that is done (0..1), None when nothing is carried."""

    number: int = 0
    frame: CameraFrame | None = None
    taken: float = 0.0
    state: State = State.IDLE
    context: RunContext = field(default_factory=RunContext)
    progress: float | None = None


class LiveView:
    """The operator's picture of one run: an observer, and ports that notice when a picture is due."""

    def __init__(
        self,
        calibration: CameraCalibration,
        clock: Callable[[], float] = time.monotonic,
        offer: Callable[[Work], bool] | None = None,
    ) -> None:
        """offer: performs work on another thread, and returns False if it is busy; None: a thread of its own."""
        self._worker = BoundedWorker[Work]("operators-picture", lambda work: work(), _ignore, 1.0)
        self._offer = offer or self._worker.offer
        self._nominal, self._clock = calibration, clock
        self._lock = threading.Lock()
        self._moment = _Moment()
        self._due = 0.0
        self._busy = False
        self._fold_began = 0.0
        self._grips: dict[Side, float] = {}
        self._drawn: tuple[int, bytes] | None = None

    # observer of the runner

    def entered(self, t: float, step: Step) -> None:
        with self._lock:
            if step.target is State.FOLDING:
                self._fold_began = t
            frame, taken = self._moment.frame, self._moment.taken
            if (
                frame is None and step.target in QUESTIONS
            ):  # else the latest picture: the arms rest out of the view
                frame, taken = self._moment.context.sight.frame, self._clock()
            self._change(frame=frame, taken=taken, state=step.target, progress=None)

    def performed(self, t: float, step: Step, result: Result) -> None:
        with self._lock:
            self._moment = replace(self._moment, context=result.context)

    # at the ports

    def between(self, ports: Ports, display: Take | None = None) -> Ports:
        """Return ports that do the same, and tell this view of grips and of every poll of the stop.

        display: takes a picture for the view; None: by the camera's `glimpse`. How many pictures are taken
        depends on the computer's speed, so in a simulated cell they must not change the world.
        """
        take = display or partial(_glimpsed, ports)
        tactile = {side: _FeltTactile(port, self._grips) for side, port in ports.tactile.items()}
        return replace(ports, stop=_PolledStop(ports.stop, lambda: self._poll(ports.clock, take)), tactile=tactile)

    def _poll(self, cell_clock: Clock, take: Take) -> None:
        now = self._clock()
        if now < self._due or self._busy:
            return
        try:
            picture = take()
        except DriverError:  # the picture ages, and the page says so
            return
        finally:
            ended = self._clock()
            self._due = max(now + PERIOD_S, ended + (ended - now) / LARGEST_SHARE)
        self._busy = True
        if not self._offer(partial(self._show, picture, now, cell_clock.now(), self._moment.state)):
            self._busy = False

    def _show(self, picture: Callable[[], CameraFrame | None], taken: float, t: float, state: State) -> None:
        """Show a display picture that was taken at `taken` [s, monotonic], `t` [s, cell] and in `state`."""
        try:
            frame = picture()
            if frame is None:  # it was requested and has not arrived
                self._due = 0.0
            else:
                taken -= max(t - frame.stamp, 0.0)
                with self._lock:
                    progress = self._progress(t) if self._moment.state is state else None
                    self._change(frame=frame, taken=taken, progress=progress)
                if self._drawn is not None:  # a page is open: it will ask for this picture at once
                    self.jpeg()
        except (DriverError, OSError):  # the cell may be closed meanwhile
            return
        finally:
            self._busy = False

    def close(self) -> None:
        """End the view's thread. A picture that is being rendered is waited for, for a short time."""
        self._worker.close(CLOSE_S)

    def _progress(self, t: float) -> float | None:
        attempt = self._moment.context.fold.attempt
        if self._moment.state is not State.FOLDING or attempt is None:
            return None
        return min((t - self._fold_began) / max(attempt.motion.fold.duration, 1e-3), 1.0)

    def _change(self, **changes: object) -> None:
        self._moment = replace(self._moment, number=self._moment.number + 1, **changes)  # type: ignore[arg-type]

    # used by the page

    def about(self) -> dict[str, Any] | None:
        """Return the number of the present picture, its age [s], whether it belongs to a question, the progress of
        the arc and the grips [N]; None before the first picture."""
        with self._lock:
            moment, grips = self._moment, dict(self._grips)
        if moment.frame is None:
            return None
        return {
            "number": moment.number,
            "age_s": round(self._clock() - moment.taken, 2),
            "question": moment.state in QUESTIONS,
            "progress": None if moment.progress is None else round(moment.progress, 2),
            "grip_n": {side.value: round(grip, 1) for side, grip in grips.items()},
        }

    def changes(self) -> dict[str, Any] | None:
        """Return what can be changed in the plan that the cell asks about (`offered_changes`)."""
        with self._lock:
            moment = self._moment
        if moment.state is not State.AWAITING_APPROVAL:
            return None
        return offered_changes(moment.context, moment.context.sight.calibration(self._nominal))

    def edit(self, change: PlanChange, by: str) -> PlanEdit | None:
        """Return the edit for a change that a page asks for. None if it is no change of a plan."""
        with self._lock:
            context = self._moment.context
        return plan_edit(change, context.sight.calibration(self._nominal), by)

    def jpeg(self) -> tuple[int, bytes] | None:
        """Draw the present picture. Returns its number and the file's content; None before the first picture."""
        with self._lock:
            moment = self._moment
            if self._drawn is not None and self._drawn[0] == moment.number:
                return self._drawn
        if moment.frame is None:
            return None
        calibration = moment.context.sight.calibration(self._nominal)
        if moment.state in QUESTIONS:
            picture = QUESTIONS[moment.state](moment.frame, calibration, moment.context)
        else:
            picture = draw_live(moment.frame, calibration, moment.context.fold.attempt, moment.progress)
        drawn = moment.number, jpeg_file(picture)
        with self._lock:
            self._drawn = drawn
        return drawn


def _glimpsed(ports: Ports) -> Callable[[], CameraFrame | None]:
    frame = ports.camera.glimpse()
    return lambda: frame


def _ignore(error: BaseException) -> None:
    """A picture that fails is missing; its age shows that."""


class _PolledStop:
    """A stop that calls `poll` each time its state is read."""

    def __init__(self, stop: Stop, poll: Callable[[], None]) -> None:
        self._stop, self._poll = stop, poll

    def trigger(self, reason: str) -> None:
        self._stop.trigger(reason)

    def state(self) -> StopState:
        state = self._stop.state()
        if not state.stopped:
            self._poll()
        return state

    def reset(self) -> None:
        self._stop.reset()


class _FeltTactile:
    """Tactile cells whose last grip is written to `grips` [N]."""

    def __init__(self, tactile: Tactile, grips: dict[Side, float]) -> None:
        self._tactile, self._grips, self.side = tactile, grips, tactile.side

    def reading(self) -> TactileReading:
        reading = self._tactile.reading()
        self._grips[self.side] = reading.grip
        return reading
