"""Two runs side by side: their figures, folds, pictures and differences."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from cell.campaigns.dashboard.entries import RunEntry, mapping
from cell.campaigns.dashboard.figure_texts import figure_text, times_text, value_text
from cell.campaigns.dashboard.history import RESULT
from cell.campaigns.trials.trial import TRIAL
from cell.recording.camera_pictures.question_files import FOLDER as QUESTIONS
from cell.recording.journal import Entry, Journal, RunRecord
from cell.runs.run_difference import RunDifference, run_difference
from cell.support.files.paths import journal_path
from robots.errors import CellError

__all__ = ["Comparison", "PicturePair", "Row", "compare_runs"]

PICTURES = {"last.jpg": "the last picture", "fold.png": "key frames of the folds", "pressing.png": "pressing"}


@dataclass(frozen=True)
class Row:
    """A figure of both runs as text; empty if a run does not have it."""

    name: str
    first: str
    second: str

    @property
    def differs(self) -> bool:
        return self.first != self.second


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
    record: RunRecord | None
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


def _rows(a: _Loaded, b: _Loaded, figures: Callable[[_Loaded], Iterator[tuple[str, str]]]) -> tuple[Row, ...]:
    first, second = dict(figures(a)), dict(figures(b))
    names = [*first, *(name for name in second if name not in first)]
    return tuple(Row(name, first.get(name, ""), second.get(name, "")) for name in names)


def _result(run: _Loaded) -> Iterator[tuple[str, str]]:
    entry = run.entry
    yield "result", entry.verdict.replace("_", " ")
    yield "garment", entry.garment
    yield "seed", "" if entry.seed is None else str(entry.seed)
    yield "driver", " ".join(filter(None, (entry.driver, str(run.figures.get("world") or ""))))
    yield "failure", entry.failure.replace("_", " ")
    yield "reason", entry.reason
    yield "robot time", figure_text("robot_time_s", entry.robot_time_s)
    yield "wall time", figure_text("wall_time_s", entry.wall_time_s)
    yield "continues", str(run.figures.get("resumed_from") or "")


def _claim(run: _Loaded) -> Iterator[tuple[str, str]]:
    claim = mapping(run.figures.get("claim"))
    if not claim:
        return
    yield "in words", str(claim.get("says") or "")
    yield "shape", value_text(claim.get("shape"))
    yield "flat", value_text(claim.get("flat"))
    yield "reliability", figure_text("reliability", claim.get("reliability"))
    for name, limit in (("height_m", "height_limit_m"), ("crease_height_m", "crease_height_limit_m")):
        yield _name(name), _limited(name, claim.get(name), claim.get(limit))
    for name in ("target_iou", "drift_m", "drift_rad"):
        yield _name(name), figure_text(name, claim.get(name))


def _score(run: _Loaded) -> Iterator[tuple[str, str]]:
    score = mapping(run.figures.get("score"))
    if not score:
        return
    for name in ("passed", "shape", "flat"):
        yield name, value_text(score.get(name))
    for name, limit in mapping(score.get("limits")).items():
        yield _name(name), _limited(name, score.get(name), limit)


def _folds(run: _Loaded) -> Iterator[tuple[str, str]]:
    steps = run.figures.get("steps")
    for number, step in enumerate(steps if isinstance(steps, Sequence) else (), 1):
        fold = mapping(step)
        parts = [
            "accepted" if fold.get("accepted") else "made, not accepted" if fold.get("done") else "not made",
            f"arc from {fold['source']}" if fold.get("source") else "",
            times_text(fold.get("attempts"), "grasp"),
            *(
                f"{word} {figure_text(name, fold.get(name))}"
                for name, word in (("observed_iou", "IoU"), ("observed_height_m", "height"), ("drift_m", "drift"))
                if fold.get(name) is not None
            ),
        ]
        recoveries = fold.get("recoveries")
        done = [str(r).replace("_", " ") for r in recoveries] if isinstance(recoveries, Sequence) else []
        name = f"{number}. {str(fold.get('name') or 'fold').replace('_', ' ')}"
        yield name, ", ".join(filter(None, parts))
        yield f"{name}: recoveries", "; ".join(done)


def _name(key: str) -> str:
    if key == "drift_rad":
        return "rotation"
    return key.removesuffix("_m").replace("_", " ").replace("iou", "IoU")


def _limited(name: str, value: Any, limit: Any) -> str:
    if value is None or limit is None:
        return figure_text(name, value)
    return f"{figure_text(name, value)} ({'at least' if name == 'iou' else 'at most'} {figure_text(name, limit)})"


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
