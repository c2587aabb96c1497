"""The Rerun recording of a run. It never raises into the runner and never delays it.

Each method passes a small job to the recorder's own thread and returns. That thread encodes the data (JPEG, PNG,
normals, batches), writes the file, and offers the same entries to a second thread that serves live viewers. File
and live view are two streams with the same recording id. With one stream for both, a viewer that hangs would stall
the file (rerun #12620). The live queue drops entries when it is full. The file's queue has room for minutes. Both
count the dropped entries.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.error_utils import catch_and_log_exceptions

from foldcell.cell.record.run_record import RecordingLosses
from foldcell.cell.states.observers import FAILING, Step
from foldcell.cell.states.run_context import Result
from foldcell.cell.states.transition_table import Event
from foldcell.cell.view.blueprint import layout
from foldcell.cell.view.bounded_worker import BoundedWorker
from foldcell.cell.view.entries import scene
from foldcell.cell.view.entries.entry import Entry, Log
from foldcell.cell.view.entries.robot import RobotFigure
from foldcell.cell.view.entries.series import Sample, Series
from foldcell.cell.view.live import LiveStream
from foldcell.cell.view.streams import begin_stream, drop_ended_streams
from foldcell.robots.ports import Array, CameraFrame, GripperState, JointState, Side, TactileReading, frozen
from foldcell.robots.robot import RobotVisual
from foldcell.skills.vocabulary import CameraCalibration, FoldStep, GarmentState, GraspId, PredictedShape, Table

K = TypeVar("K")

APPLICATION = "foldcell"
FILE_QUEUE_BYTES = 512e6
FILE_CLOSE_S = 60.0
KEPT_ERRORS = 20
HEARTBEAT = 1.0
"""Interval at which the recorder writes the present state again [s]. Without these rows, the viewer would end the
state at its last row."""

TRUTH_RATE = 15.0
"""Largest rate at which the true garment is recorded [Hz]."""
STILL = 2e-4
"""The true garment is recorded again only if a vertex has moved by at least this distance [m]."""

Job = Callable[[], Iterable[Entry]]


class Recorder:
    """Records a run. Times are in seconds of the cell's clock; geometry is in the table frame [m]."""

    def __init__(self, table: Table, robot: RobotVisual | None) -> None:
        self._table, self._visual = table, robot
        self._errors: list[str] = []
        self._live_errors: list[str] = []
        self._lock = threading.Lock()
        self._file: rr.RecordingStream | None = None
        self._worker: BoundedWorker[Job] | None = None
        self._live: LiveStream | None = None
        # used on the recorder's own thread only
        self._series = Series(None)
        self._calibration: CameraCalibration | None = None
        self._picture: tuple[int, int] | None = None
        self._state: tuple[str, float] | None = None
        self._latest = 0.0
        self._garment: tuple[float, Array, NDArray] | None = None

    @classmethod
    def open(
        cls, path: Path, run_id: str, table: Table, live: bool = False, robot: RobotVisual | None = None
    ) -> Recorder:
        """Begin the recording `path` (.rrd).

        live: serve viewers on this machine (see `live_url`). Does not raise: if the recording cannot be begun,
        `close` reports the error and the run continues without a recording.
        """
        recorder, floor = cls(table, robot), robot.floor if robot else 0.0
        try:
            stream = begin_stream(APPLICATION, rr.FileSink(str(path)), layout(floor), run_id)
            stream.send_recording_name(run_id)
            recorder._file = stream
        except Exception as error:
            recorder._note_error(error)
        if live:
            recorder._live = LiveStream(APPLICATION, run_id, floor, recorder._note_live)
        recorder._worker = BoundedWorker("recorder", recorder._work, recorder._note_error, FILE_QUEUE_BYTES)
        recorder._submit(recorder._begin, essential=True)
        return recorder

    @classmethod
    def silent(cls) -> Recorder:
        """A recorder that records nothing: for tests and for runs without a recording."""
        return cls(Table(0.0, (0.0, 1.0), (-0.5, 0.5)), None)

    @property
    def live_url(self) -> str | None:
        """Address to which a viewer can connect; None without a live stream."""
        return self._live.url if self._live else None

    def close(self) -> RecordingLosses:
        """Write the waiting entries and end the streams. Returns the losses, with each error message once."""
        dropped = live_dropped = 0
        if self._worker is not None:
            self._submit(self._end, essential=True)
            if not self._worker.close(FILE_CLOSE_S):
                self._note_error(TimeoutError(f"the recording was not written within {FILE_CLOSE_S:.0f} s"))
            dropped = self._worker.dropped
        if self._live is not None:
            live_dropped = self._live.close()
        if self._file is not None:
            try:
                self._file.flush()
                self._file.disconnect()
            except Exception as error:
                self._note_error(error)
            self._file = None
            if self._live is None:  # a live viewer that hangs would delay the clean-up
                drop_ended_streams()
        return RecordingLosses(dropped, live_dropped, tuple(self._errors), tuple(self._live_errors))

    # observer of the runner

    def entered(self, t: float, step: Step) -> None:
        self.state(t, step.target.value)
        self.event(t, f"{step.source.value} --{step.event.value}--> {step.target.value}")

    def performed(self, t: float, step: Step, result: Result) -> None:
        failure = result.context.failure
        if result.event in FAILING and failure is not None:
            level = "ERROR" if result.event in {Event.CRASH, Event.STOP, Event.UNRECORDED} else "WARN"
            self.event(t, str(failure), level)

    # called by the effects

    def state(self, t: float, state: str) -> None:
        """Record that the executive has entered `state`."""
        self._submit(partial(self._enter, t, str(state)), essential=True)

    def event(self, t: float, text: str, level: str = "INFO") -> None:
        """Record a line of the log. level: DEBUG, INFO, WARN or ERROR."""
        self._submit(partial(scene.log_entries, t, text, level), essential=True)

    def camera(self, t: float, frame: CameraFrame, calibration: CameraCalibration) -> None:
        self._submit(partial(self._picture_entries, t, frame, calibration), frame.nbytes)

    def perception(
        self, t: float, state: GarmentState, mask: NDArray, overlay: NDArray, fitting: Callable[[], NDArray]
    ) -> None:
        """Record the recognised garment. overlay: (H, W, 3) uint8, the picture with the garment drawn on it;
        fitting: draws another picture, which shows how it was fitted."""
        self._submit(partial(self._perception_entries, t, state, mask, overlay, fitting), 1e5 + overlay.nbytes)

    def plan(self, t: float, step: FoldStep) -> None:
        """Record the step that begins, and clear the drawings of the previous step."""
        self._submit(partial(scene.plan_entries, t, step), essential=True)

    def arcs(self, t: float, arcs: Mapping[Side, Array], planned: bool = True) -> None:
        """Record tool paths (n, 3) of the arms: planned or executed."""
        self._submit(partial(scene.arc_entries, t, _copied_arcs(arcs), planned), essential=True)

    def predicted(self, t: float, shape: PredictedShape) -> None:
        self._submit(partial(scene.predicted_entries, t, shape), shape.vertices.nbytes)

    def observed(self, t: float, points: Array) -> None:
        """Record an observed contour (n, 2) or height points (n, 3) [m]."""
        self._submit(partial(scene.observed_entries, t, frozen(points)), points.nbytes)

    def estimated(self, t: float, says: str, picture: NDArray, shape: PredictedShape | None) -> None:
        """Record the estimated state of the garment after a failure: in words, with the candidates drawn over the
        picture (H, W, 3), and the shape of the best one (None for a heap)."""
        self._submit(partial(scene.estimate_entries, t, says, picture, shape), picture.nbytes, essential=True)

    def candidate(
        self,
        t: float,
        simulations: int,
        arcs: Mapping[GraspId, Array],
        own: tuple[float, float],
        best: tuple[float, float],
    ) -> None:
        """Record a simulated fold of an optimisation. arcs: (n, 3) for each grasp; own, best: dissimilarity D [m]
        and cost C [m] of this candidate and of the best candidate so far."""
        entries = partial(scene.candidate_entries, t, simulations, _copied_arcs(arcs), own, best)
        self._submit(entries, sum(arc.nbytes for arc in arcs.values()) + 200.0)

    def adapted(self, t: float, friction: float, learned: float) -> None:
        """Record the estimated friction between cloth and table after a fold. learned: share (0..1) by which the
        fold reduced the uncertainty of the estimate."""
        self._submit(partial(scene.adapted_entries, t, friction, learned), essential=True)

    def joints(self, state: JointState) -> None:
        self._submit(partial(self._sample_entries, state), 400.0)

    def gripper(self, state: GripperState) -> None:
        self._submit(partial(self._sample_entries, state), 200.0)

    def tactile(self, reading: TactileReading) -> None:
        self._submit(partial(self._sample_entries, reading), 600.0)

    def garment_truth(self, t: float, vertices: Array, triangles: NDArray) -> None:
        """Record the simulated garment itself, labelled as truth. vertices (n, 3), triangles (m, 3)."""
        self._submit(partial(self._truth_entries, t, frozen(vertices), triangles), vertices.nbytes)

    # on the recorder's own thread

    def _submit(self, job: Job, cost: float = 200.0, essential: bool = False) -> None:
        if self._worker is not None:
            self._worker.offer(job, cost, essential)

    def _work(self, job: Job) -> None:
        with catch_and_log_exceptions(strict=True):  # otherwise Rerun only prints its errors
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

    def _sample_entries(self, sample: Sample) -> Iterable[Entry]:
        yield from self._series.add(sample)
        self._latest = max(self._latest, sample.stamp)
        if self._state is not None and sample.stamp - self._state[1] >= HEARTBEAT:
            self._state = (self._state[0], sample.stamp)
            yield from scene.state_entries(sample.stamp, self._state[0])

    def _picture_entries(self, t: float, frame: CameraFrame, calibration: CameraCalibration) -> Iterable[Entry]:
        self._calibration, self._picture = calibration, frame.rgb.shape[:2]
        yield from scene.camera_entries(t, frame, calibration)

    def _perception_entries(
        self, t: float, state: GarmentState, mask: NDArray, overlay: NDArray, fitting: Callable[[], NDArray]
    ) -> Iterable[Entry]:
        yield from scene.perception_entries(t, state)
        if self._calibration is not None and self._picture is not None:
            yield from scene.mask_entries(t, mask, self._calibration, self._table, self._picture)
        yield Log("perception/fitting", t, (scene.jpeg(fitting()),))
        yield Log("perception/overlay", t, (scene.jpeg(overlay),))
        yield Log("perception/confidence", t, (rr.Scalars(state.confidence),))

    def _truth_entries(self, t: float, vertices: Array, triangles: NDArray) -> Iterable[Entry]:
        """Return entries at TRUTH_RATE at most, and only while the garment moves, because they fill most of the
        file."""
        first = True
        if self._garment is not None:
            last_t, last_vertices, last_triangles = self._garment
            first = last_triangles is not triangles and not np.array_equal(last_triangles, triangles)
            still = not first and np.abs(vertices - last_vertices).max() < STILL
            if not first and (still or t - last_t < 0.99 / TRUTH_RATE):
                return
        self._garment = (t, vertices, triangles)
        yield from scene.truth_entries(t, vertices, triangles, first)

    def _note_error(self, error: BaseException) -> None:
        with self._lock:
            _note(self._errors, error)

    def _note_live(self, error: BaseException) -> None:
        """Note an error of the live view separately: the file is complete without the live view."""
        with self._lock:
            _note(self._live_errors, error)


def _note(errors: list[str], error: BaseException) -> None:
    text = f"{type(error).__name__}: {error}"
    if len(errors) < KEPT_ERRORS and text not in errors:
        errors.append(text)


def _copied_arcs(arcs: Mapping[K, Array]) -> dict[K, Array]:
    """Return read-only copies: the caller may change its own arrays."""
    return {key: frozen(arc) for key, arc in arcs.items()}
