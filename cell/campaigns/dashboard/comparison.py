"""Two runs side by side: their figures, folds, pictures and differences."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from cell.campaigns.dashboard.entries import RunEntry, mapping
from cell.campaigns.dashboard.figure_texts import figure_text, value_text
from cell.campaigns.dashboard.history import RESULT
from cell.campaigns.trials.trial import TRIAL
from cell.journal.journal import Entry, Journal, JournalRun
from cell.report.camera_pictures.question_files import FOLDER as QUESTIONS
from cell.runs.run_difference import RunDifference, run_difference
from cell.support.files.paths import journal_path
from robots.errors import CellError

__all__ = ["Comparison", "PicturePair", "Row", "Value", "compare_runs"]

PICTURES = {"last.jpg": "the last picture", "fold.png": "key frames of the folds", "pressing.png": "pressing"}


@dataclass(frozen=True)
class Value:
    """A value as text; empty if the run does not have it. measured: it differs between any two runs; bad: it is a
    refusal, or beyond its limit."""

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
        """Whether the difference tells the runs apart: two measured figures are never quite the same."""
        return self.first.text != self.second.text and not (self.first.measured and self.second.measured)


@dataclass(frozen=True)
class PicturePair:
    """The same kind of picture of both runs. first, second: path relative to the logs folder, or empty."""

    caption: str
    first: str
    second: str


@dataclass(frozen=True)
class Comparison:
    """difference: settings, versions, decisions and figures; None if the runs' journals do not tell them.
    notices: what could not be read, in words."""

    result: Sequence[Row]
    claim: Sequence[Row]
    score: Sequence[Row]
    folds: Sequence[Row]
    pictures: Sequence[PicturePair]
    difference: RunDifference | None
    notices: Sequence[str]


@dataclass(frozen=True)
class _Loaded:
    entry: RunEntry
    figures: Mapping[str, Any]
    record: JournalRun | None
    entries: Sequence[Entry]
    notice: str


def compare_runs(first: RunEntry, second: RunEntry) -> Comparison:
    """Compare two runs. What cannot be read is left out and named in `notices`."""
    a, b = _load(first), _load(second)
    notices = [x.notice for x in (a, b) if x.notice]
    difference = None
    if a.record and b.record:
        try:
            difference = run_difference(a.record, a.entries, b.record, b.entries)
        except (CellError, OSError, ValueError, LookupError, TypeError, AttributeError) as e:
            notices.append(f"settings and decisions: {e.what if isinstance(e, CellError) else e}")
    return Comparison(
        result=_rows(a, b, _result),
        claim=_rows(a, b, _claim),
        score=_rows(a, b, _score),
        folds=_rows(a, b, _folds),
        pictures=tuple(_pictures(first, second)),
        difference=difference,
        notices=tuple(notices),
    )


def _load(entry: RunEntry) -> _Loaded:
    """Read a run from the journal beside its folder, or else the figures from its result files."""
    try:
        with Journal.open(journal_path(entry.folder.parent), readonly=True, traceless=True) as journal:
            record = journal.run(entry.folder.name)
            entries = journal.entries(record.id)
        if record.id != entry.folder.name:
            raise LookupError("there is no such run")
        return _Loaded(entry, mapping(record.summary), record, entries, "")
    except (CellError, ValueError, LookupError, TypeError) as e:
        notice = f"{entry.key}: the journal does not tell its decisions ({e})"
    return _Loaded(entry, _figures_of_files(entry.folder), None, (), notice)


def _figures_of_files(folder: Path) -> Mapping[str, Any]:
    for path, part in ((folder / RESULT, None), (folder.parent / TRIAL, "figures")):
        try:
            found = mapping(json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError):
            continue
        return mapping(found.get(part)) if part else found
    return {}


def _rows(a: _Loaded, b: _Loaded, values: Callable[[_Loaded], Values]) -> tuple[Row, ...]:
    first, second = dict(values(a)), dict(values(b))
    rows = (Row(name, first.get(name, Value()), second.get(name, Value())) for name in {**first, **second})
    return tuple(row for row in rows if row.first.text or row.second.text)


def _result(run: _Loaded) -> Values:
    entry = run.entry
    yield "result", Value(entry.verdict.replace("_", " "))
    yield "garment", Value(entry.garment.replace("_", " "))
    yield "seed", Value("" if entry.seed is None else str(entry.seed))
    driver = (entry.driver, str(run.figures.get("world") or ""), "(simulated)" if entry.simulated else "")
    yield "driver", Value(" ".join(filter(None, driver)))
    yield "failure", Value(entry.failure.replace("_", " "))
    yield "reason", Value(entry.reason)
    for name in ("robot_time_s", "wall_time_s"):
        yield _name(name), _figure(name, getattr(entry, name))
    yield "continues", Value(str(run.figures.get("resumed_from") or ""))


def _claim(run: _Loaded) -> Values:
    claim = mapping(run.figures.get("claim"))
    if not claim:
        return
    yield "in words", Value(str(claim.get("says") or ""), measured=True)
    yield from ((name, _answer(claim.get(name))) for name in ("shape", "flat"))
    yield "reliability", _figure("reliability", claim.get("reliability"))
    for name, limit in (("height_m", "height_limit_m"), ("crease_height_m", "crease_height_limit_m")):
        yield _name(name), _figure(name, claim.get(name), claim.get(limit))
    yield from ((_name(name), _figure(name, claim.get(name))) for name in ("target_iou", "drift_m", "drift_rad"))


def _score(run: _Loaded) -> Values:
    score = mapping(run.figures.get("score"))
    yield from ((name, _answer(score.get(name))) for name in ("passed", "shape", "flat"))
    for name, limit in mapping(score.get("limits")).items():
        yield _name(name), _figure(name, score.get(name), limit)


def _folds(run: _Loaded) -> Values:
    steps = run.figures.get("steps")
    for number, step in enumerate(steps if isinstance(steps, Sequence) else (), 1):
        fold = mapping(step)
        title = f"{number}. {str(fold.get('name') or 'fold').replace('_', ' ')}"
        accepted, done = fold.get("accepted") is True, fold.get("done") is True
        yield (
            title,
            Value("accepted" if accepted else "made, not accepted" if done else "not made", bad=not accepted),
        )
        yield f"{title}: arc from", Value(str(fold.get("source") or ""))
        yield f"{title}: grasps", Value(value_text(fold.get("attempts")))
        recoveries = fold.get("recoveries")
        done_about = recoveries if isinstance(recoveries, list | tuple) else ()
        yield f"{title}: recoveries", Value("; ".join(str(r).replace("_", " ") for r in done_about))
        for name, words in (("observed_iou", "IoU"), ("observed_height_m", "height"), ("drift_m", "drift")):
            yield f"{title}: {words}", _figure(name, fold.get(name))


def _answer(value: Any) -> Value:
    return Value(value_text(value), bad=value is False)


def _figure(name: str, value: Any, limit: Any = None) -> Value:
    """Return a measured figure, with its limit if it has one. For `iou` the limit is a minimum."""
    text = figure_text(name, value)
    if not text or not _is_number(value) or not _is_number(limit):
        return Value(text, measured=True)
    least = name == "iou"
    beyond = value < limit if least else value > limit
    return Value(f"{text} ({'at least' if least else 'at most'} {figure_text(name, limit)})", True, beyond)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _name(key: str) -> str:
    if key == "drift_rad":
        return "rotation"
    return key.removesuffix("_m").removesuffix("_s").replace("_", " ").replace("iou", "IoU")


def _pictures(first: RunEntry, second: RunEntry) -> Iterator[PicturePair]:
    for name, caption in PICTURES.items():
        pair = PicturePair(caption, *(_existing(run, run.folder / name) for run in (first, second)))
        if pair.first or pair.second:
            yield pair
    questions = (sorted((run.folder / QUESTIONS).glob("*.jpg")) for run in (first, second))
    for number, (a, b) in enumerate(zip_longest(*questions), 1):
        states = dict.fromkeys(p.stem.partition("-")[2].replace("_", " ") for p in (a, b) if p)
        yield PicturePair(
            f"question {number}: {' / '.join(states)}",
            _existing(first, a) if a else "",
            _existing(second, b) if b else "",
        )


def _existing(run: RunEntry, path: Path) -> str:
    return f"{run.key}/{path.relative_to(run.folder).as_posix()}" if path.is_file() else ""
