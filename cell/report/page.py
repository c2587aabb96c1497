"""The report of one run as an HTML page: verdict, film, folds, score, failures and times.

The page is one file: pictures and film are inlined, drawings are SVG, and nothing is fetched. It has a light and a
dark theme and can be printed. A click enlarges a picture.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from cell.report.failure_stories import FailureStory
from cell.report.formats import (
    FIGURE_NOTES,
    figure_name,
    flatten,
    length,
    quantity,
    seconds,
    words,
)
from cell.report.pictures.outline_drawing import outline_drawing
from cell.report.verdict import FoldEnd, verdict
from cell.states.state_chart import marked_chart
from cell.states.transition_table import State
from cell.support.files.html_page import page_template
from cell.support.files.whole_file import write_whole
from robots.ports import Array

__all__ = ["Picture", "RunRecord", "ScoreRow", "StepRecord", "TimelineItem", "write_report"]

PICTURE_WIDTH = 640
"""Wider pictures are scaled down to this width [px]."""
JPEG_QUALITY = 82
RESULTS = {"folded": "Folded", "not_folded": "Not folded", "fault": "Fault"}


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture and its caption. rgb: (H, W, 3) uint8."""

    rgb: NDArray[np.uint8]
    caption: str = ""


@dataclass(frozen=True)
class ScoreRow:
    """One figure of the score and its limit. at_least: larger is better. unit: 'm', 'rad' or '' for a plain
    number. ideal: the same figure of the ideal fold, None if it has no such figure."""

    name: str
    value: float
    limit: float
    at_least: bool = False
    unit: str = ""
    ideal: float | None = None

    @property
    def passed(self) -> bool:
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True)
class TimelineItem:
    """A failure, a recovery or a command. level: 'failure', 'recovery', 'operator' or 'note'."""

    t: float
    level: str
    title: str
    text: str = ""


@dataclass(frozen=True, eq=False)
class StepRecord:
    """One fold. Outlines are contours (k, 2) in the table frame [m]. Unknown values are None or empty.

    source: 'library' or 'optimised'. dissimilarity_m: D, predicted by the simulation. aligned_iou, observed_iou:
    overlap of the observed and the predicted silhouette, with and without alignment. duration_s: duration of the
    arms' motion with the garment, without pauses.
    """

    name: str
    source: str = ""
    simulations: int = 0
    dissimilarity_m: float | None = None
    aligned_iou: float | None = None
    observed_iou: float | None = None
    drift_m: float | None = None
    attempts: int = 1
    recoveries: tuple[str, ...] = ()
    duration_s: float | None = None
    accepted: bool | None = None
    key_frames: tuple[Picture, ...] = ()
    key_frames_note: str = ""
    """Source of the key frames, e.g. 'camera' or 'recorded garment (simulation)'."""
    target: tuple[Array, ...] = ()
    predicted: tuple[Array, ...] = ()
    observed: tuple[Array, ...] = ()
    height_m: float | None = None
    """Observed height of the stack [m]."""
    pressed_from_m: tuple[float, ...] = ()
    """Height of the stack before each pressing [m]."""
    done: bool = False
    """Whether the run went on from this fold as made."""
    original: tuple[Array, ...] = ()
    """The outline of the flat garment, as it was laid."""


@dataclass(frozen=True, eq=False)
class RunRecord:
    """The content of the page. Times [s]: robot_time_s on the cell's clock, wall_time_s on the wall clock."""

    run_id: str
    garment: str
    result: str
    """'folded', 'not_folded' or 'fault'."""
    state: State | None = None
    """The state in which the run ended; None: no chart is shown."""
    seed: int | None = None
    driver: str = "sim"
    simulated: bool = True
    world: str = ""
    title: str = ""
    reason: str = ""
    """Why the garment was not folded; empty if it was."""
    hint: str = ""
    claim: str = ""
    """What the executive says of the finished fold, from the camera alone; empty if it was not inspected."""
    started: str = ""
    robot_time_s: float | None = None
    wall_time_s: float | None = None
    steps: tuple[StepRecord, ...] = ()
    stage_times_s: Mapping[str, float] = field(default_factory=dict)
    stage_wall_times_s: Mapping[str, float] = field(default_factory=dict)
    timeline: tuple[TimelineItem, ...] = ()
    score: tuple[ScoreRow, ...] = ()
    verdicts: Mapping[str, bool | None] = field(default_factory=dict)
    """The two parts of the score, `shape` and `flat`; None: not judged."""
    invalid_ideal: str = ""
    """Why the ideal fold is not valid, so that the heights are not judged and the run has not passed."""
    film: bytes = b""
    """The film of the run, an animated WebP; empty if nothing was filmed."""
    film_name: str = "film.webp"
    """Path of the film's file, relative to the page."""
    film_note: str = ""
    """What the film shows."""
    pictures: tuple[Picture, ...] = ()
    """Pictures of the whole run: the empty table, the recognised garment, the last picture."""
    stories: tuple[FailureStory, ...] = ()
    """The failures as stories in pictures."""
    estimates: tuple[Picture, ...] = ()
    """Estimates of the garment's state that no story tells: the candidates over the picture, and the state in
    words."""
    versions: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    """The settings that the page lists."""
    shipped: Mapping[str, Any] = field(default_factory=dict)
    """The shipped values of these settings, where known."""
    settings_note: str = ""
    recording: str = ""
    """Path of the recording, relative to the page."""
    recording_note: str = ""

    @property
    def passed(self) -> bool:
        """Whether the score passed."""
        return all(row.passed for row in self.score) and not self.invalid_ideal

    @property
    def sentence(self) -> str:
        """The verdict and what decided it."""
        folds = [FoldEnd(words(s.name).lower(), s.attempts, s.done, s.accepted) for s in self.steps]
        return verdict(self.result, self.state, folds, self.reason, self.claim, _scored(self))


def write_report(path: Path, run: RunRecord) -> Path:
    """Write the page atomically and return its path. Raises StorageError if the file cannot be written."""
    write_whole(path, render(run), "free some disk space, or make the run's folder writable")
    return path


def render(run: RunRecord) -> str:
    """Return the page as HTML text."""
    template = page_template(
        Path(__file__).with_name("page.html"), data_uri=data_uri, figure_name=figure_name,
        figure_note=FIGURE_NOTES.get, metres=length, quantity=quantity, seconds=seconds, words=words,
    )  # fmt: skip
    return template.render(
        silhouettes=silhouettes,
        webp_uri=webp_uri,
        run=run,
        verdict=RESULTS.get(run.result, words(run.result)),
        stages=stages(run),
        chart=run.state and Markup(marked_chart(run.state, [State(name) for name in run.stage_times_s])),
        settings=flatten(run.settings),
        shipped=dict(flatten(run.shipped)),
    )


def webp_uri(film: bytes) -> str:
    """Encode a WebP file as a data URI."""
    return "data:image/webp;base64," + base64.b64encode(film).decode("ascii")


def data_uri(rgb: NDArray[np.uint8]) -> str:
    """Encode a picture (H, W, 3) as a data URI that contains a JPEG."""
    if rgb.shape[1] > PICTURE_WIDTH:
        size = (PICTURE_WIDTH, round(rgb.shape[0] * PICTURE_WIDTH / rgb.shape[1]))
        rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    bgr = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2BGR)
    ok, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not ok:
        raise ValueError(f"a picture of shape {rgb.shape} cannot be encoded")
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def stages(run: RunRecord) -> list[dict[str, Any]]:
    """Return the rows of the table of times, in the order of the run's states. share: length of a row's bar in
    percent of the longest time."""
    names = [*run.stage_times_s, *(n for n in run.stage_wall_times_s if n not in run.stage_times_s)]
    longest = max([*run.stage_times_s.values(), 1e-9])
    return [
        {
            "name": words(name),
            "robot": run.stage_times_s.get(name),
            "wall": run.stage_wall_times_s.get(name),
            "share": 100.0 * run.stage_times_s.get(name, 0.0) / longest,
        }
        for name in names
    ]


def silhouettes(step: StepRecord) -> Markup | None:
    """Draw the outlines of a fold as SVG, None if there are none."""
    outlines = {"predicted": step.predicted, "observed": step.observed}
    if not any(outlines.values()) and not step.target:
        return None
    return outline_drawing({"original": step.original, "target": step.target, **outlines})


def _scored(run: RunRecord) -> str:
    """Say in words what the score says; empty without a score."""
    if not run.score:
        return ""
    missed = [
        f"{figure_name(row.name).lower()} {quantity(row.value, row.unit)}, limit {quantity(row.limit, row.unit)}"
        for row in run.score
        if not row.passed
    ]
    says = "passes" if run.passed else f"does not pass ({'; '.join(missed) or 'the heights are not judged'})"
    return f"the score, measured on the simulated garment itself, {says}"
