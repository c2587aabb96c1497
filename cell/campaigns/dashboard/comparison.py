"""Two runs side by side: their figures, folds, pictures and differences."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from foldcell.cell.campaigns.dashboard.entries import RunEntry
from foldcell.cell.journal.journal import Entry, Journal, JournalRun
from foldcell.cell.record.words import figure, figure_name, plain, value_in_words
from foldcell.cell.report.camera_pictures.question_picture import FOLDER as QUESTIONS
from foldcell.cell.runs.run_difference import RunDifference, run_difference
from foldcell.cell.support.files.paths import journal_path
from foldcell.robots.errors import CellError
from foldcell.skills.scoring.verdict import Figure

PICTURES = {"last.jpg": "the last picture", "fold.png": "key frames of the folds", "pressing.png": "pressing"}


@dataclass(frozen=True)
class Value:
    """A value as text; empty if the run does not have it. measured: whether the value is measured, so that it
    differs between any two runs. bad: whether it is a refusal or beyond its limit."""

    text: str = ""
    measured: bool = False
    bad: bool = False


Values = Iterator[tuple[str, Value]]
"""Values with their names."""


@dataclass(frozen=True)
class Row:
    """The same value of both runs."""

    name: str
    first: Value
    second: Value

    @property
    def differs(self) -> bool:
        """Whether the difference is worth marking. Measured figures do not count, because they are never quite the
        same."""
        return self.first.text != self.second.text and not (self.first.measured and self.second.measured)


@dataclass(frozen=True)
class Comparison:
    """values: rows of the tables, by their titles. pictures: a caption, and the paths of the same picture of both
    runs, relative to the logs folder (empty for none). difference: settings, versions, decisions and figures; None
    if the journals do not have both runs. notices: messages about everything that could not be read."""

    values: Mapping[str, Sequence[Row]]
    pictures: Sequence[tuple[str, str, str]]
    difference: RunDifference | None
    notices: Sequence[str]


def compare_runs(first: RunEntry, second: RunEntry) -> Comparison:
    """Compare two runs. Anything that cannot be read is left out and named in `notices`."""
    notices: list[str] = []
    a, b = (_journalled(run, notices) for run in (first, second))
    difference = None
    if a and b:
        try:
            difference = run_difference(*a, *b)
        except (CellError, OSError, ValueError, LookupError, TypeError, AttributeError) as e:
            notices.append(f"settings and decisions: {e.what if isinstance(e, CellError) else e}")
    return Comparison(
        values={title: _rows(first, second, values) for title, values in VALUES.items()},
        pictures=tuple(_pictures(first, second)),
        difference=difference,
        notices=tuple(notices),
    )


def _journalled(entry: RunEntry, notices: list[str]) -> tuple[JournalRun, list[Entry]] | None:
    """Read a run from the journal beside its folder. None, and a notice, if the journal does not have it."""
    try:
        with Journal.open(journal_path(entry.folder.parent), readonly=True, traceless=True) as journal:
            run = journal.run(entry.folder.name)
            entries = journal.entries(run.id)
        if run.id != entry.folder.name:
            raise LookupError("there is no such run")
    except (CellError, ValueError, LookupError, TypeError) as e:
        notices.append(f"{entry.key}: the journal does not tell its decisions ({e})")
        return None
    return run, entries


def _rows(a: RunEntry, b: RunEntry, values: Callable[[RunEntry], Values]) -> tuple[Row, ...]:
    first, second = dict(values(a)), dict(values(b))
    rows = (Row(name, first.get(name, Value()), second.get(name, Value())) for name in {**first, **second})
    return tuple(row for row in rows if row.first.text or row.second.text)


def _result(run: RunEntry) -> Values:
    record = run.record
    yield "result", Value(plain(run.verdict))
    yield "garment", Value(plain(run.name))
    yield "seed", Value("" if run.seed is None else str(run.seed))
    world = record.world if record else None
    yield "driver", Value(" ".join(filter(None, (run.driver, world, "(simulated)" if run.simulated else ""))))
    yield "failure", Value(plain(run.failure))
    yield "reason", Value(run.ending.why)
    for name in ("robot_time_s", "wall_time_s"):
        yield figure_name(name), _figure(name, getattr(run.ending, name))
    yield "continues", Value(record.resumed_from or "" if record else "")


def _claim(run: RunEntry) -> Values:
    claim = run.record.claim if run.record else None
    if claim is None:
        return
    yield "in words", Value(claim.says, measured=True)
    yield from (("shape", _answer(claim.shape)), ("flat", _answer(claim.flat)))
    yield "reliability", _figure("reliability", claim.reliability)
    yield "height", _figure("height_m", claim.height_m, claim.height_limit_m)
    yield "crease height", _figure("crease_height_m", claim.crease_height_m, claim.crease_height_limit_m)
    for name in ("target_iou", "drift_m", "drift_rad"):
        yield figure_name(name), _figure(name, getattr(claim, name))


def _score(run: RunEntry) -> Values:
    score = run.record.score if run.record else None
    if score is None:
        return
    for verdict in ("passed", "shape", "flat"):
        yield verdict, _answer(getattr(score, verdict))
    for name, judged in score.judged.items():
        yield figure_name(name), _figure(name, judged.value, judged.limit, judged.at_least)


def _folds(run: RunEntry) -> Values:
    for number, fold in enumerate(run.record.steps if run.record else (), 1):
        title = f"{number}. {plain(fold.name)}"
        how = "accepted" if fold.accepted else "made, not accepted" if fold.done else "not made"
        yield title, Value(how, bad=not fold.accepted)
        yield f"{title}: arc from", Value(fold.source or "")
        yield f"{title}: grasps", Value(str(fold.attempts))
        yield f"{title}: recoveries", Value(plain("; ".join(fold.recoveries)))
        yield f"{title}: IoU", _figure("iou", fold.observed_iou)
        yield f"{title}: height", _figure("height_m", fold.observed_height_m)
        yield f"{title}: drift", _figure("drift_m", fold.drift_m)


VALUES: Mapping[str, Callable[[RunEntry], Values]] = {
    "Result": _result,
    "Claim of the cell, from the camera": _claim,
    "Score, the simulated truth": _score,
    "Folds": _folds,
}


def _answer(value: bool | None) -> Value:
    return Value(value_in_words(value), bad=value is False)


def _figure(name: str, value: float | None, limit: float | None = None, at_least: bool = False) -> Value:
    """Return a measured figure, with its limit if it has one."""
    if value is None or not math.isfinite(value):
        return Value(measured=True)
    if limit is None:
        return Value(figure(name, value), measured=True)
    text = f"{figure(name, value)} ({'at least' if at_least else 'at most'} {figure(name, limit)})"
    return Value(text, True, not Figure(value, limit, at_least).passed)


def _pictures(first: RunEntry, second: RunEntry) -> Iterator[tuple[str, str, str]]:
    for name, caption in PICTURES.items():
        shown = [_existing(run, run.folder / name) for run in (first, second)]
        if any(shown):
            yield caption, shown[0], shown[1]
    questions = (sorted((run.folder / QUESTIONS).glob("*.jpg")) for run in (first, second))
    for number, (a, b) in enumerate(zip_longest(*questions), 1):
        states = dict.fromkeys(p.stem.partition("-")[2].replace("_", " ") for p in (a, b) if p)
        yield (
            f"question {number}: {' / '.join(states)}",
            _existing(first, a) if a else "",
            _existing(second, b) if b else "",
        )


def _existing(run: RunEntry, path: Path) -> str:
    return f"{run.key}/{path.relative_to(run.folder).as_posix()}" if path.is_file() else ""
