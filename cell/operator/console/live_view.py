"""The operator's picture: the camera's latest picture, with the plan or the expected result drawn on it.

The picture is drawn by the cell, because a 3-D viewer on a computer without a graphics card is always behind. The
view takes a display picture when the executive polls the stop, so it needs no thread of its own at the ports. In a
simulated cell it also does so when the world advances, and takes only the state of the world: the picture is drawn
on the view's thread, so that the executive does not wait. Only the newest picture waits to be drawn. The view also
remembers the last grip of each hand and the last set-point of the arms.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from foldcell.cell.operator.console.messages import PlanChange
from foldcell.cell.operator.console.plan_changes import offered_changes, plan_edit
from foldcell.cell.report.camera_pictures.live_picture import draw_live
from foldcell.cell.report.camera_pictures.question_picture import QUESTIONS
from foldcell.cell.simulation import Display
from foldcell.cell.states.observers import Step
from foldcell.cell.states.plan_edit import PlanEdit
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import State
from foldcell.cell.support.files.encoded_picture import jpeg_file
from foldcell.cell.support.forwarding import forwarding
from foldcell.cell.view.bounded_worker import BoundedWorker
from foldcell.robots.errors import DriverError
from foldcell.robots.ports import (
    Array,
    CameraFrame,
    Clock,
    JointSetpoint,
    Ports,
    Side,
    StopState,
    Tactile,
    TactileReading,
)
from foldcell.skills.vocabulary import CameraCalibration

PERIOD_S = 0.3
"""Shortest time between two display pictures [s]."""
Work = Callable[[], None]
CLOSE_S = 2.0


@dataclass(frozen=True, eq=False)
class _Moment:
    """The content from which a picture is drawn.

    number: grows with every change of the content. taken: time at which the frame was taken, or at which the cell
    last looked as in the frame [s, monotonic]. advance: `Display.progress` at that time. progress: share of the
    arc that is done (0..1), None when nothing is carried.
    """

    number: int = 0
    frame: CameraFrame | None = None
    taken: float = 0.0
    advance: int | None = None
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
        # an error of a picture is ignored: the page shows that the last picture grows old
        self._worker = BoundedWorker[Work]("operators-picture", lambda work: work(), lambda error: None, 1.0)
        self._offer = offer or self._worker.offer
        self._nominal, self._clock = calibration, clock
        self._lock, self._drawing = threading.Lock(), threading.Lock()
        self._moment = _Moment()
        self._display: Display | None = None
        self._due = 0.0
        self._busy = False
        self._next: Work | None = None
        self._commanded: Array | None = None
        """The last set-point."""
        self._grips: dict[Side, float] = {}
        self._drawn: tuple[int, bytes] | None = None

    # observer of the runner

    def entered(self, t: float, step: Step) -> None:
        with self._lock:
            if self._moment.frame is None and step.target in QUESTIONS:
                self._change(frame=self._moment.context.sight.shown, taken=self._clock())
            self._change(state=step.target, progress=None)

    def performed(self, t: float, step: Step, result: Result) -> None:
        with self._lock:
            self._moment = replace(self._moment, context=result.context)

    # at the ports

    def between(self, ports: Ports, display: Display | None = None) -> Ports:
        """Return ports that do the same, and tell this view of grips and of every poll of the stop.

        display: of a simulated cell; None: pictures come from the camera's `glimpse`. How many pictures are taken
        depends on the computer's speed, so in a simulated cell they must not change the world.
        """
        self._display = display = display or _glimpses(ports)
        poll = partial(self._poll, ports.clock, display)
        display.on_advance(poll)

        def stop_state() -> StopState:
            state = ports.stop.state()
            if not state.stopped:
                poll()
            return state

        def command(q: Array, qd: Array) -> JointSetpoint:
            self._commanded = np.array(q)
            return ports.arms.command(q, qd)

        def reading(tactile: Tactile) -> TactileReading:
            reading = tactile.reading()
            self._grips[tactile.side] = reading.grip
            return reading

        return replace(
            ports,
            stop=forwarding(ports.stop, state=stop_state),
            arms=forwarding(ports.arms, command=command),
            tactile={
                side: forwarding(port, reading=partial(reading, port)) for side, port in ports.tactile.items()
            },
        )

    def _poll(self, cell_clock: Clock, display: Display, rests: bool = False) -> None:
        """Take a picture if one is due. rests: whether the cell stands still for a while now. A picture is then
        taken even if none is due."""
        now = self._clock()
        if (not rests and (now < self._due or self._busy)) or self._still():
            return
        advance = display.progress()
        self._due = now + PERIOD_S
        try:
            picture = display.take()
        except DriverError:  # the picture ages, and the page says so
            return
        show = partial(self._show, picture, advance, now, cell_clock.now(), self._moment.state, self._commanded)
        with self._lock:
            self._next = show  # it replaces an older one that has not been drawn
            if self._busy:
                return
            self._busy = True
        if not self._offer(self._show_next):
            self._busy = False

    def _show_next(self) -> None:
        """Show the newest waiting picture, and repeat this until no picture waits."""
        while True:
            with self._lock:
                show, self._next = self._next, None
                if show is None:
                    self._busy = False
                    return
            show()

    def _still(self) -> bool:
        """Whether the simulated cell has not advanced since the present picture was taken."""
        display, advance = self._display, self._moment.advance
        return display is not None and advance is not None and display.progress() == advance

    def _show(
        self,
        picture: Callable[[], CameraFrame | None],
        advance: int | None,
        taken: float,
        t: float,
        state: State,
        q: Array | None,
    ) -> None:
        """Show a display picture. The other arguments belong to the moment at which it was taken: advance, taken
        [s, monotonic], t [s, cell], state, and q, the last set-point."""
        try:
            frame = picture()
            if frame is None:  # it was requested and has not arrived
                self._due = 0.0
                return
            taken -= max(t - frame.stamp, 0.0)
            with self._lock:
                before = self._moment
            progress = self._progress(before, q) if before.state is state else None
            same = before.frame is not None and np.array_equal(before.frame.rgb, frame.rgb)  # the cell is at rest
            if before.state is state and progress == before.progress and same:
                with self._lock:  # nothing is drawn and sent again
                    self._moment = replace(self._moment, taken=taken, advance=advance)
                return
            shown = replace(before, number=before.number + 1, frame=frame, progress=progress)
            drawn = self._draw(shown) if self._drawn is not None else None  # not before a page is open
            with self._lock:
                if self._moment.number == before.number:
                    self._change(frame=frame, taken=taken, advance=advance, progress=progress)
                    self._drawn = drawn
                else:  # another state was entered meanwhile, in which something else is drawn
                    self._change(frame=frame, taken=taken, advance=advance)
        except Exception:  # the cell may be closed meanwhile; a missing picture shows by the age of the last one
            return

    def close(self) -> None:
        """End the view's thread. Waits a short time for a picture that is being drawn."""
        self._worker.close(CLOSE_S)

    def _progress(self, moment: _Moment, q: Array | None) -> float | None:
        """Return the share of the arc that is done (0..1) at the set-point `q`. The share does not follow from the
        time, because a motion may pause or be slower than planned."""
        attempt = moment.context.fold.attempt
        if moment.state is not State.FOLDING or attempt is None or q is None:
            return None
        planned = attempt.motion.fold
        return float(planned.t[np.argmin(np.abs(planned.q - q).max(axis=1))] / max(planned.duration, 1e-3))

    def _change(self, **changes: object) -> None:
        self._moment = replace(self._moment, number=self._moment.number + 1, **changes)  # type: ignore[arg-type]

    # used by the page

    def about(self) -> dict[str, Any] | None:
        """Return the number of the present picture, its age [s], whether it belongs to a question, the progress of
        the arc and the grips [N]; None before the first picture."""
        with self._lock:
            if self._still():
                self._moment = replace(self._moment, taken=self._clock())
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
        """Return the changes that the page offers for the plan that the cell asks about (`offered_changes`)."""
        with self._lock:
            moment = self._moment
        if moment.state is not State.AWAITING_APPROVAL:
            return None
        return offered_changes(moment.context, moment.context.sight.calibration(self._nominal))

    def edit(self, change: PlanChange, by: str) -> PlanEdit | None:
        """Return the edit of the plan for a change that a page asks for. None if the plan cannot be changed so."""
        with self._lock:
            context = self._moment.context
        return plan_edit(change, context.sight.calibration(self._nominal), by)

    def jpeg(self) -> tuple[int, bytes] | None:
        """Return the number of the present picture and its file's content; None before the first picture. Each
        picture is drawn once, usually before a page asks for it."""
        with self._drawing:
            with self._lock:
                moment = self._moment
                if self._drawn is not None and self._drawn[0] == moment.number:
                    return self._drawn
            if moment.frame is None:
                return None
            drawn = self._draw(moment)
            with self._lock:
                self._drawn = drawn
            return drawn

    def _draw(self, moment: _Moment) -> tuple[int, bytes]:
        """Draw the picture of a moment that has a frame. Returns its number and its file's content."""
        assert moment.frame is not None
        calibration = moment.context.sight.calibration(self._nominal)
        if moment.state in QUESTIONS:
            picture = QUESTIONS[moment.state](moment.frame, calibration, moment.context)
        else:
            picture = draw_live(moment.frame, calibration, moment.context.fold.attempt, moment.progress)
        return moment.number, jpeg_file(picture)


def _glimpses(ports: Ports) -> Display:
    """Return a display whose pictures are the camera's glimpses."""

    def take() -> Callable[[], CameraFrame | None]:
        frame = ports.camera.glimpse()
        return lambda: frame

    return Display(take, lambda: None, lambda tell: None)
