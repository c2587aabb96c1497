"""The Rerun view of a run: a visitor of the runner that never raises into it and never delays it.

Each method hands a small job to the recorder's own thread and returns. That thread encodes (JPEG, PNG,
normals, batches), writes the file, and offers the same entries to a second thread that feeds a live
viewer. File and live are two streams with one recording id: a stream that serves both stalls the file
when the viewer hangs (rerun #12620). The live queue drops when it is full; the file's is large enough
for minutes, and both count what they drop.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.error_utils import catch_and_log_exceptions

from cell.recording.rerun import scene
from cell.recording.rerun.blueprint import layout
from cell.recording.rerun.entry import Entry, Log
from cell.recording.rerun.live import LiveStream
from cell.recording.rerun.pump import Pump
from cell.recording.rerun.robot import RobotFigure
from cell.recording.rerun.series import Series
from robots.ports import Array, CameraFrame, GripperState, JointState, Side, TactileReading, frozen
from robots.visual import RobotVisual
from skills.perception.fitting_picture import draw_fitting
from skills.perception.overlay import draw_on_view
from skills.perception.perceive import Perception
from skills.vocabulary import CameraCalibration, FoldStep, GarmentState, GraspId, PredictedShape, Table

__all__ = ["APPLICATION", "Recorder", "RecorderReport", "Seen"]

K = TypeVar("K")

APPLICATION = "foldcell"
FILE_QUEUE_BYTES = 512e6
FILE_CLOSE_S = 60.0
KEPT_ERRORS = 20
HEARTBEAT = 1.0
"""A state's lane ends at its last row, so the state is said again at least this often [s]."""

TRUTH_RATE = 15.0
"""Pictures of the true garment a second [Hz]."""
STILL = 2e-4
"""Smaller movements of its vertices are not worth a picture [m]."""

Job = Callable[[], Iterable[Entry]]


class Seen(Protocol):
    """What the recorder needs of a perception: the state, and which pixels are garment."""

    @property
    def state(self) -> GarmentState: ...

    @property
    def mask(self) -> NDArray: ...


@dataclass(frozen=True)
class RecorderReport:
    """What became of a recording. dropped: entries that the file lacks; live_dropped: that a viewer missed;
    live_errors: what the live view met."""

    dropped: int = 0
    live_dropped: int = 0
    errors: tuple[str, ...] = ()
    error_count: int = 0
    live_errors: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        return self.dropped == 0 and self.error_count == 0


class Recorder:
    """Everything that a run shows. Times are seconds of the cell's clock; geometry is in the table frame."""

    def __init__(self, table: Table, robot: RobotVisual | None, truth: bool) -> None:
        self._table, self._truth_on = table, truth
        self._visual = robot
        self._errors: list[str] = []
        self._live_errors: list[str] = []
        self._error_count = 0
        self._lock = threading.Lock()
        self._file: rr.RecordingStream | None = None
        self._pump: Pump[Job] | None = None
        self._live: LiveStream | None = None
        self._report: RecorderReport | None = None
        # what the recorder's own thread knows
        self._series = Series(None)
        self._calibration: CameraCalibration | None = None
        self._picture: tuple[int, int] | None = None
        self._state: tuple[str, float] | None = None
        self._latest = 0.0
        self._garment: tuple[float, Array, NDArray] | None = None

    @classmethod
    def open(
        cls,
        path: Path,
        run_id: str,
        table: Table,
        live: bool | str = False,
        robot: RobotVisual | None = None,
        truth: bool = True,
    ) -> Recorder:
        """Begin the recording `path` (.rrd).

        live: True serves viewers on 127.0.0.1 (`live_url` says where), 'HOST:PORT' elsewhere. truth: whether
        `garment_truth` is kept. Does not raise: a recording that cannot be begun is reported by `close`, and
        the run goes on without it.
        """
        recorder = cls(table, robot, truth)
        try:
            stream = rr.RecordingStream(APPLICATION, recording_id=run_id)
            stream.set_sinks(rr.FileSink(str(path)), default_blueprint=layout(floor_of(robot)))
            stream.send_recording_name(run_id)
            recorder._file = stream
        except Exception as error:
            recorder._note_error(error)
        if live:
            recorder._live = LiveStream(APPLICATION, run_id, live, floor_of(robot), recorder._note_live)
        recorder._pump = Pump("recorder", recorder._work, recorder._note_error, FILE_QUEUE_BYTES)
        recorder._submit(recorder._begin, essential=True)
        return recorder

    @classmethod
    def silent(cls) -> Recorder:
        """One that keeps nothing: for tests, and where no recording is wanted."""
        return cls(Table(0.0, (0.0, 1.0), (-0.5, 0.5)), None, truth=False)

    @property
    def live_url(self) -> str | None:
        """Where a viewer can connect; None without a live stream."""
        return self._live.url if self._live else None

    def close(self) -> RecorderReport:
        """Write what waits and end the streams. Returns what was lost; may be called twice."""
        if self._report is not None:
            return self._report
        dropped = live_dropped = 0
        if self._pump is not None:
            self._submit(self._end, essential=True)
            if not self._pump.close(FILE_CLOSE_S):
                self._note_error(TimeoutError(f"the recording was not written within {FILE_CLOSE_S:.0f} s"))
            dropped = self._pump.dropped
        if self._live is not None:
            live_dropped = self._live.close()
        if self._file is not None:
            try:
                self._file.flush()
                self._file.disconnect()
            except Exception as error:
                self._note_error(error)
        self._report = RecorderReport(
            dropped, live_dropped, tuple(self._errors), self._error_count, tuple(self._live_errors)
        )
        return self._report

    # what the runner calls

    def state(self, t: float, state: str) -> None:
        """The executive has entered `state`."""
        self._submit(partial(self._enter, t, str(state)), essential=True)

    def event(self, t: float, text: str, level: str = "INFO") -> None:
        """A line of the log. level: DEBUG, INFO, WARN or ERROR."""
        self._submit(partial(scene.log_entries, t, text, level), essential=True)

    def camera(self, t: float, frame: CameraFrame, calibration: CameraCalibration) -> None:
        self._submit(partial(self._picture_entries, t, frame, calibration), frame.rgb.nbytes + frame.depth.nbytes)

    def perception(self, t: float, seen: Seen, overlay: NDArray | None = None) -> None:
        """What was recognised. overlay: (H, W, 3) uint8, a picture of it for people; None: drawn here."""
        self._submit(partial(self._perception_entries, t, seen, overlay), seen_cost(seen, overlay))

    def plan(self, t: float, step: FoldStep) -> None:
        """The step that begins; clears what was drawn for the step before."""
        self._submit(partial(scene.plan_entries, t, step), essential=True)

    def arcs(self, t: float, arcs: Mapping[Side, Array], planned: bool = True) -> None:
        """Tool paths (n, 3) of the arms: planned ones green."""
        self._submit(partial(scene.arc_entries, t, _kept(arcs), planned), essential=True)

    def predicted(self, t: float, shape: PredictedShape) -> None:
        self._submit(partial(scene.predicted_entries, t, shape), shape.vertices.nbytes)

    def observed(self, t: float, points: Array) -> None:
        """A contour (n, 2) or height points (n, 3) [m]."""
        self._submit(partial(scene.observed_entries, t, _copy(points)), points.nbytes)

    def candidate(
        self,
        t: float,
        simulations: int,
        arcs: Mapping[GraspId, Array],
        own: tuple[float, float],
        best: tuple[float, float],
    ) -> None:
        """One more simulated fold of an optimisation. arcs: (n, 3) of its arms; own, best: its dissimilarity D [m]
        and cost C [m], and those of the best so far."""
        entries = partial(scene.candidate_entries, t, simulations, _kept(arcs), own, best)
        self._submit(entries, sum(arc.nbytes for arc in arcs.values()) + 200.0)

    def adapted(self, t: float, friction: float, learned: float) -> None:
        """The friction that is believed after a fold, and the share of what was unsure that the fold told."""
        self._submit(partial(scene.adapted_entries, t, friction, learned), essential=True)

    def joints(self, state: JointState) -> None:
        self._submit(partial(self._series_entries, state.stamp, self._series_of("joints"), state), 400.0)

    def gripper(self, state: GripperState) -> None:
        self._submit(partial(self._series_entries, state.stamp, self._series_of("gripper"), state), 200.0)

    def tactile(self, reading: TactileReading) -> None:
        self._submit(partial(self._series_entries, reading.stamp, self._series_of("tactile"), reading), 600.0)

    def garment_truth(self, t: float, vertices: Array, triangles: NDArray) -> None:
        """Simulation only: the garment itself, (n, 3) and (m, 3), labelled as truth."""
        if self._truth_on:
            self._submit(partial(self._truth_entries, t, _copy(vertices), triangles), vertices.nbytes)

    # on the recorder's own thread

    def _submit(self, job: Job, cost: float = 200.0, essential: bool = False) -> None:
        if self._pump is not None:
            self._pump.offer(job, cost, essential)

    def _work(self, job: Job) -> None:
        with catch_and_log_exceptions(strict=True):  # or Rerun would print its errors and go on
            for entry in job():
                if self._file is not None:
                    entry.write(self._file)
                if self._live is not None:
                    self._live.offer(entry)

    def _begin(self) -> Iterable[Entry]:
        yield from scene.cell_entries(self._table, self._visual.floor if self._visual else None)
        if self._visual is not None:
            figure = RobotFigure(self._visual)
            self._series = Series(figure)
            yield from scene.joint_names_entries(self._visual.joint_names)
            yield from figure.scene()

    def _end(self) -> Iterable[Entry]:
        yield from self._series.flush()
        if self._state is not None:
            yield from scene.state_entries(max(self._latest, self._state[1]), self._state[0])

    def _enter(self, t: float, state: str) -> Iterable[Entry]:
        self._state = (state, t)
        self._latest = max(self._latest, t)
        yield from scene.state_entries(t, state)

    def _series_of(self, name: str) -> Callable[[object], list[Entry]]:
        return lambda value: getattr(self._series, name)(value)  # the series are made on that thread

    def _series_entries(self, t: float, add: Callable[[object], list[Entry]], value: object) -> Iterable[Entry]:
        yield from add(value)
        self._latest = max(self._latest, t)
        if self._state is not None and t - self._state[1] >= HEARTBEAT:
            self._state = (self._state[0], t)
            yield from scene.state_entries(t, self._state[0])

    def _picture_entries(self, t: float, frame: CameraFrame, calibration: CameraCalibration) -> Iterable[Entry]:
        self._calibration, self._picture = calibration, frame.rgb.shape[:2]
        yield from scene.camera_entries(t, frame, calibration)

    def _perception_entries(self, t: float, seen: Seen, overlay: NDArray | None) -> Iterable[Entry]:
        yield from scene.perception_entries(t, seen.state)
        if self._calibration is not None and self._picture is not None:
            yield from scene.mask_entries(t, seen.mask, self._calibration, self._table, self._picture)
        if isinstance(seen, Perception):
            yield Log("perception/fitting", t, (scene.jpeg(draw_fitting(seen)),))
            overlay = draw_on_view(seen) if overlay is None else overlay
        if overlay is not None:
            yield Log("perception/overlay", t, (scene.jpeg(overlay),))
        yield Log("perception/confidence", t, (rr.Scalars(seen.state.confidence),))

    def _truth_entries(self, t: float, vertices: Array, triangles: NDArray) -> Iterable[Entry]:
        """At most TRUTH_RATE, and only while something moves: the garment is most of the file."""
        first = True
        if self._garment is not None:
            when, before, known = self._garment
            first = known is not triangles and not np.array_equal(known, triangles)
            still = not first and np.abs(vertices - before).max() < STILL
            if not first and (still or t - when < 0.99 / TRUTH_RATE):
                return
        self._garment = (t, vertices, triangles)
        yield from scene.truth_entries(t, vertices, triangles, first)

    def _note_error(self, error: BaseException) -> None:
        with self._lock:
            self._error_count += 1
            _note(self._errors, error)

    def _note_live(self, error: BaseException) -> None:
        """What the live view met: the file has it all."""
        with self._lock:
            _note(self._live_errors, error)


def _note(errors: list[str], error: BaseException) -> None:
    text = f"{type(error).__name__}: {error}"
    if len(errors) < KEPT_ERRORS and text not in errors:
        errors.append(text)


def _copy(points: Array) -> Array:
    """Read-only, so that the caller may go on with its own array."""
    return frozen(points)


def _kept(arcs: Mapping[K, Array]) -> dict[K, Array]:
    return {key: _copy(arc) for key, arc in arcs.items()}


def floor_of(robot: RobotVisual | None) -> float:
    return robot.floor if robot else 0.0


def seen_cost(seen: Seen, overlay: NDArray | None) -> float:
    return 1e5 + (0 if overlay is None else overlay.nbytes)
