"""The record of a run: one value with everything that is known of the run after its end.

`RunRecordBuilder` makes it. It is returned by `fold_once`, printed by `foldcell fold --json`, written to the run's
folder as `result.json`, and stored as the summary of the run in the journal. Read it with

    read_record(folder)     from the folder of a run
    record_of(values)       from a run's summary in the journal, or from the output of `fold --json`

Both check every value. Write it with `write_record`. `cell/record/words.py` has its figures as text.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, TypeAdapter, ValidationError

from foldcell.cell.states.transition_table import State
from foldcell.cell.support.json_values import to_json, write_json
from foldcell.cell.support.process.signals import BY_SIGNAL
from foldcell.robots.errors import FailureKind, StorageError
from foldcell.skills.perception.inspection.claim import Claim
from foldcell.skills.scoring.verdict import Figure, Score

RECORD = "result.json"
"""Name of the record's file in the folder of a run."""
RunResult = Literal["folded", "not_folded", "fault"]
EXIT_CODES: Mapping[RunResult, int] = {"folded": 0, "not_folded": 2, "fault": 3}


def known(figure: float) -> float | None:
    """Return the figure, or None if it is not finite, i.e. was not measured."""
    return figure if math.isfinite(figure) else None


def _unseen(claim: Any) -> Any:
    """Restore the figures of a claim that were not visible: null in JSON, NaN in the claim."""
    return {k: math.nan if v is None else v for k, v in claim.items()} if isinstance(claim, Mapping) else claim


@dataclass(frozen=True)
class FailureRecord:
    """The failure that ended a run. what, hint: in words. setting: the limit of cell.yaml that
    decided, with its value and the measured one. It is empty if no such limit decided."""

    kind: FailureKind
    what: str
    hint: str
    setting: str = ""


@dataclass(frozen=True)
class GraspRecord:
    """One grasp by one hand. Figures that were not measured are None.

    t: cell time at which the grasp ended [s]. contact_height_m: height above the table of cell.yaml of the point
    between the tips when they touched; contact_by: the signal of the touch ('tip', 'effort', 'stall'), or 'height'
    if the descent ended at its height. grip_n: mean force on the less loaded of the closed pads [N]. opening_m:
    mean opening of the closed pads. layers: most likely number of layers between them. failed: why the hands did
    not hold the garment, the same for both; None if they held it.
    """

    t: float
    hand: Literal["left", "right"]
    contact_height_m: float
    contact_by: str
    grip_n: float | None = None
    opening_m: float | None = None
    layers: int | None = None
    failed: FailureKind | None = None


@dataclass(frozen=True)
class FoldRecord:
    """One planned fold. Figures that were not measured are None.

    done: whether the run went on from this fold as made. accepted: the inspection's verdict; None if the fold was
    not inspected, or the run ended before the fold was done. source: 'library' or 'optimised'; None if no arc was
    chosen. simulations: number of cloth simulations by which the arc was found.

    dissimilarity_m: D of the predicted fold. aligned_iou, observed_iou: overlap of the observed and the predicted
    silhouette, with and without alignment. drift_m: distance of the garment from the predicted place.
    observed_height_m: of the stack, away from the creases; pressed_from_m: the same before each pressing.
    duration_s: duration of the arms' motion with the garment, without pauses.

    attempts: number of times that the hands went down to grasp. grasps: the grasps in which a hand touched the
    garment, in order, also those of repairs. recoveries: 'failure kind -> event (change)'.
    estimates: the states in which the garment was thought to lie after failures, in words. repairs: how the hands
    put the moved cloth right or spread the garment, in words.
    """

    name: str
    done: bool = False
    accepted: bool | None = None
    source: str | None = None
    simulations: int = 0
    dissimilarity_m: float | None = None
    aligned_iou: float | None = None
    observed_iou: float | None = None
    drift_m: float | None = None
    observed_height_m: float | None = None
    pressed_from_m: tuple[float | None, ...] = ()
    duration_s: float | None = None
    attempts: int = 0
    grasps: tuple[GraspRecord, ...] = ()
    recoveries: tuple[str, ...] = ()
    estimates: tuple[str, ...] = ()
    repairs: tuple[str, ...] = ()


@dataclass(frozen=True)
class IdealRecord:
    """The ideal fold with which the heights are compared (`skills.scoring.score.IdealHeights`). reason: why it is
    not valid; None if it is."""

    valid: bool
    reason: str | None = None
    crossings: int = 0
    strain: float | None = None
    motion_m: float | None = None
    iou: float | None = None


@dataclass(frozen=True)
class ScoreRecord:
    """The score of a simulated garment (`skills.scoring.score.Score`). flat is None if the heights are not judged.
    limits: the limit of each judged figure, a minimum for `iou` and a maximum for all others."""

    passed: bool
    shape: bool
    flat: bool | None
    iou: float | None = None
    correspondence_m: float | None = None
    edges_m: float | None = None
    keypoints_m: float | None = None
    height_m: float | None = None
    crease_height_m: float | None = None
    drift_m: float | None = None
    drift_rad: float | None = None
    ideal_height_m: float | None = None
    ideal_crease_height_m: float | None = None
    ideal: IdealRecord | None = None
    limits: Mapping[str, float] = field(default_factory=dict)
    layers: int = 0
    simulated: bool = True

    @classmethod
    def of(cls, score: Score) -> ScoreRecord:
        return _SCORE.validate_python(to_json(score.to_json()))

    @property
    def judged(self) -> dict[str, Figure]:
        """The judged figures by name. A figure that is not known does not pass."""
        values = {name: getattr(self, name, None) for name in self.limits}
        return {
            name: Figure(math.nan if value is None else value, self.limits[name], at_least=name == "iou")
            for name, value in values.items()
        }

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the judged figures that do not pass their limit."""
        return tuple(name for name, figure in self.judged.items() if not figure.passed)


@dataclass(frozen=True)
class Recognised:
    """The recognised garment, and the confidence in it (0..1)."""

    garment: str
    confidence: float


@dataclass(frozen=True)
class RecordingLosses:
    """Losses of recording and transcript. dropped: number of entries that the recording lacks; live_dropped:
    number of entries that only a live viewer missed; errors, live_errors: messages."""

    dropped: int = 0
    live_dropped: int = 0
    errors: tuple[str, ...] = ()
    live_errors: tuple[str, ...] = ()


NOTHING_LOST = RecordingLosses()


@dataclass(frozen=True)
class RunEvent:
    """A failure, an estimate of the garment's state, a recovery or a command of the operator, at cell time t
    [s]."""

    t: float
    kind: Literal["failure", "estimate", "recovery", "command"]
    title: str
    text: str


@dataclass(frozen=True)
class RunRecord:
    """The record of a run.

    world: cloth model of the simulated garment, None on hardware. state: last state of the machine. failure: None
    if the garment was folded. claim: what the executive says of the last fold, from the camera alone; None if it
    was not inspected. score: None on hardware and if the garment was not scored. robot_time_s: cell time of the
    run without waiting for an operator; stage_times_s: cell time spent in each state, including such waiting;
    wall_time_s: duration on the wall clock. signal: number of the signal that interrupted the run.

    resumed_from: the run that this one resumed. `steps` then has the folds of both runs, but times, events and
    grasps are of this run only. unwritten: messages about files that could not be written after the run's end.
    """

    garment: str
    seed: int
    driver: str
    simulated: bool
    world: str | None
    result: RunResult
    state: State
    failure: FailureRecord | None
    score: ScoreRecord | None
    steps: tuple[FoldRecord, ...]
    robot_time_s: float
    wall_time_s: float
    stage_times_s: Mapping[str, float]
    run_dir: str
    signal: int | None = None
    recording: RecordingLosses = NOTHING_LOST
    resumed_from: str | None = None
    unwritten: tuple[str, ...] = ()
    claim: Annotated[Claim | None, BeforeValidator(_unseen)] = None
    recognised: Recognised | None = None
    events: tuple[RunEvent, ...] = ()

    @property
    def exit_code(self) -> int:
        return EXIT_CODES[self.result] if self.signal is None else BY_SIGNAL + self.signal

    def as_json(self) -> dict[str, Any]:
        """Return the record as plain JSON values."""
        return dict(to_json(self))


@dataclass(frozen=True)
class Refusal:
    """Why a run did not begin, and what a person can do, in words."""

    what: str
    hint: str


@dataclass(frozen=True)
class Ending:
    """What is known of the end of any run: a run with a record, a calibration, or a run that did not begin
    (reason). Times [s]."""

    failure: FailureRecord | None = None
    robot_time_s: float | None = None
    wall_time_s: float | None = None
    reason: Refusal | None = None

    @property
    def why(self) -> str:
        """Why the run did not succeed, in words; empty if it did."""
        return self.failure.what if self.failure else self.reason.what if self.reason else ""


_RECORD, _SCORE, _ENDING = TypeAdapter(RunRecord), TypeAdapter(ScoreRecord), TypeAdapter(Ending)


def record_of(values: object) -> RunRecord | None:
    """Return the record from the values of a JSON object: the journal's summary of a run, or the output of `fold
    --json`. Return None if the values are no record. Then the run did not begin or did not end, was a calibration,
    or was recorded by a version of the program with other records."""
    try:
        return _RECORD.validate_python(values)
    except ValidationError:
        return None


def ending_of(values: object) -> Ending:
    """Return what is known of the end of a run, from its summary in the journal."""
    try:
        return _ENDING.validate_python(values)
    except ValidationError:
        return Ending()


def read_record(folder: Path) -> RunRecord:
    """Return the record in the folder of a run. Raises StorageError if it is missing, damaged or of another
    version of the program."""
    path = folder / RECORD
    try:
        return _RECORD.validate_json(path.read_bytes())
    except (OSError, ValidationError) as e:
        what = e.strerror if isinstance(e, OSError) else f"{e.error_count()} of its values are not valid"
        raise StorageError(f"{path} cannot be read: {what}", "see foldcell runs", path=str(path)) from None


def write_record(record: RunRecord) -> None:
    """Write the record into the folder of its run. Raises StorageError."""
    write_json(Path(record.run_dir) / RECORD, record)
