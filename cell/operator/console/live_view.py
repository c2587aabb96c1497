"""The operator's picture: the camera's latest picture with the plan, or with what is expected, drawn on it.

The picture is drawn by the cell, because a 3-D viewer on a computer without a graphics card is always behind. The
view takes a display picture when the executive polls the stop, so it needs no thread of its own at the ports. It
also remembers the last grip of each hand. It draws only when a page asks for the picture.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from cell.recording.camera_pictures.live_picture import draw_live
from cell.recording.camera_pictures.projected_drawing import jpeg_file
from cell.recording.camera_pictures.question_picture import QUESTIONS
from cell.states.observers import Step
from cell.states.run_context import Result, RunContext
from cell.states.transition_table import State
from robots.errors import DriverError
from robots.ports import CameraFrame, Clock, Ports, Side, Stop, StopState, Tactile, TactileReading
from skills.vocabulary import CameraCalibration

__all__ = ["LiveView"]

PERIOD_S = 0.5
"""Shortest time between two display pictures [s]."""
LARGEST_SHARE = 0.2
"""Share of the executive's time that display pictures may take."""


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

    def __init__(self, calibration: CameraCalibration, clock: Callable[[], float] = time.monotonic) -> None:
        self._nominal, self._clock = calibration, clock
        self._lock = threading.Lock()
        self._moment = _Moment()
        self._due = 0.0
        self._fold_began = 0.0
        self._grips: dict[Side, float] = {}
        self._drawn: tuple[int, bytes] | None = None

    # observer of the runner

    def entered(self, t: float, step: Step) -> None:
        with self._lock:
            if step.target is State.FOLDING:
                self._fold_began = t
            frame, taken = self._moment.frame, self._moment.taken
            if step.target in QUESTIONS and self._moment.context.sight.frame is not None:
                frame, taken = self._moment.context.sight.frame, self._clock()  # the arms rest out of the view
            self._change(frame=frame, taken=taken, state=step.target, progress=None)

    def performed(self, t: float, step: Step, result: Result) -> None:
        with self._lock:
            self._moment = replace(self._moment, context=result.context)

    # at the ports

    def between(self, ports: Ports, display: Callable[[], CameraFrame | None] | None = None) -> Ports:
        """Return ports that do the same, and tell this view of grips and of every poll of the stop.

        display: takes a picture for the view; None: the camera's `glimpse`. How many pictures are taken depends on
        the computer's speed, so in a simulated cell they must not change the world.
        """
        take = display or ports.camera.glimpse
        tactile = {side: _FeltTactile(port, self._grips) for side, port in ports.tactile.items()}
        return replace(ports, stop=_PolledStop(ports.stop, lambda: self._poll(ports.clock, take)), tactile=tactile)

    def _poll(self, cell_clock: Clock, take: Callable[[], CameraFrame | None]) -> None:
        now = self._clock()
        if now < self._due:
            return
        try:
            frame = take()
        except DriverError:  # the picture ages, and the page says so
            frame = None
        ended = self._clock()
        self._due = ended + max(PERIOD_S, (ended - now) / LARGEST_SHARE)
        if frame is None:
            return
        t = cell_clock.now()
        with self._lock:
            self._change(frame=frame, taken=ended, progress=self._progress(t))

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
