"""Figures, failures, recoveries and verdicts of a run as text. Every page, line and message takes them from here.

The unit of a figure follows from the end of its name: `_m`, `_rad`, `_s`, `_n`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from foldcell.cell.record.run_record import FoldRecord, RecordingLosses, RunRecord, ScoreRecord
from foldcell.cell.states.recovery_table import Adjustment, Laying
from foldcell.cell.states.transition_table import Event, State
from foldcell.skills.perception.inspection.claim import Claim

UNKNOWN = "–"
"""Text of a figure that was not measured."""

# names and figures


def plain(name: str) -> str:
    """Return a name in words: 'planning_motion' -> 'planning motion'."""
    return name.replace("_", " ").strip()


def garment_name(garment: str) -> str:
    """Return the name of a garment that was given by name or as a file: 'mine/my_shirt.yaml' -> 'my_shirt'."""
    return Path(garment).stem if garment.endswith((".yaml", ".yml")) else garment


def capital(text: str) -> str:
    """Return the text with a capital first letter."""
    return text[:1].upper() + text[1:]


def sentences(*parts: str) -> str:
    """Join the parts that are not empty as sentences."""
    return " ".join(f"{capital(part)}." for part in parts if part)


def length(metres: float | None, decimals: int = 1) -> str:
    """Return a length [m] as '12.3 mm'."""
    return UNKNOWN if metres is None or not math.isfinite(metres) else f"{1e3 * metres:.{decimals}f} mm"


def seconds(s: float | None) -> str:
    """Return a duration [s] as '8.31 s', '83.1 s' or '2 min 03 s'."""
    if s is None or not math.isfinite(s):
        return UNKNOWN
    if s >= 120.0:
        return f"{int(s) // 60} min {int(s) % 60:02d} s"
    return f"{s:.2f} s" if s < 10.0 else f"{s:.1f} s"


def percent(share: float | None) -> str:
    """Return a share (0..1) as '98 %'."""
    return UNKNOWN if share is None else f"{100.0 * share:.0f} %"


def interval(ends: tuple[float, float]) -> str:
    """Return the ends of an interval of a share (0..1) as '84 to 97 %'."""
    return f"{100.0 * ends[0]:.0f} to {100.0 * ends[1]:.0f} %"


def difference(name: str, value: float | None, ends: tuple[float, float] | None = None) -> str:
    """Return the difference of a length (`_m`) or a time (`_s`), with the ends of its interval: '-1.2 mm (-2.0 to
    +0.1 mm)'."""
    if value is None:
        return UNKNOWN
    scale, unit = (1e3, "mm") if name.endswith("_m") else (1.0, "s")
    within = f" ({scale * ends[0]:+.1f} to {scale * ends[1]:+.1f} {unit})" if ends else ""
    return f"{scale * value:+.1f} {unit}{within}"


def value_in_words(value: object, longest: int = 120) -> str:
    """Return a value of any kind as a text of at most `longest` characters; empty for None."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= longest else text[: longest - 3] + "..."


def figure(name: str, value: float | None) -> str:
    """Return a figure in mm (`_m`), degrees (`_rad`), s (`_s`), N (`_n`), percent (reliability), or plain."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if name.endswith("_m"):
        return length(value)
    if name.endswith("_rad"):
        return f"{math.degrees(value):.1f}°"
    if name.endswith("_s"):
        return seconds(value)
    if name.endswith("_n"):
        return f"{value:.2f} N"
    return percent(value) if name == "reliability" else f"{value:.3f}"


def figure_name(name: str) -> str:
    """Return the short name of a figure: 'crease_height_m' -> 'crease height'."""
    if name == "drift_rad":
        return "turn"
    return plain(name.removesuffix("_m").removesuffix("_s")).replace("iou", "IoU")


FIGURES = {
    "iou": "Overlap of the outlines (IoU)",
    "correspondence_m": "Mean distance of corresponding points",
    "edges_m": "Largest distance of edges that belong together",
    "keypoints_m": "Largest distance of a key point from its place",
    "height_m": "Height of the stack away from creases, 95th percentile",
    "crease_height_m": "Height beside creases, 95th percentile",
    "drift_m": "Drift",
    "drift_rad": "Turn",
}
"""The figures of the score, as a table names them."""
FIGURE_NOTES = {
    "iou": "Intersection over union: the area that garment and target share, relative to that of both.",
    "correspondence_m": "Distance of every place of the cloth from its place in the target, on average.",
    "edges_m": "Edges that the garment file names as a pair, such as two hems, lie on each other.",
    "keypoints_m": "Key points are the named corners of the garment.",
    "height_m": "95 % of the places are lower.",
    "crease_height_m": "Within 40 mm of a fold line; 95 % of the places are lower.",
    "drift_m": "How far the whole garment lies from the target.",
    "drift_rad": "By how much the whole garment is turned.",
}

# commands, recoveries, layings

COMMANDS: Mapping[Event, str] = {
    Event.APPROVE: "approve",
    Event.RETRY: "look again",
    Event.SKIP: "skip",
    Event.PAUSE: "pause",
    Event.RESUME: "resume",
    Event.ABORT: "end run",
    Event.EDIT: "change the plan",
}
"""The operator's commands, on the terminal, on the page and in the report. Scripts use the events' names."""
_RECOVERIES: Mapping[Event, str] = {
    Event.START_OVER: "photographed the empty table again",
    Event.LOOK_AGAIN: "looked again",
    Event.LOOK_AFTER: "looked at the fold again",
    Event.PLAN_AGAIN: "planned the fold again",
    Event.OPTIMISE_AGAIN: "chose another arc",
    Event.GRASP_AGAIN: "planned the motion again, to grasp again",
    Event.REPAIR: "planned to put the moved cloth right",
    Event.SPREAD: "planned to spread the garment by a pull",
    Event.CARRY_ON: "went on: the next fold can build on it",
    Event.ASK: "asked the operator",
    Event.GIVE_UP: "ended the run",
}
_CHANGES: Mapping[Adjustment, str] = {
    Adjustment.LOWER: "with the tips pressed deeper",
    Adjustment.HIGHER: "with the tips less deep",
    Adjustment.INWARD: "with the grasp further inside the edge",
    Adjustment.UPRIGHT: "with upright hands",
    Adjustment.STRONGER: "with a firmer grip",
    Adjustment.OPTIMISE: "optimised for this fold",
    Adjustment.PLAIN_ARC: "a plain arc",
    Adjustment.OTHER_SEARCH: "by another motion of the arms",
    Adjustment.OTHER_VARIANT: "by another fold variant of the garment file",
    Adjustment.NO_EDITS: "without the operator's edits",
}
_LAYINGS: Mapping[Laying, str] = {
    Laying.BACK: "laid the cloth down where it was taken",
    Laying.ONWARD: "laid the cloth down at its target",
    Laying.RELEASE: "opened the hands where they were: they held no cloth",
}


def recovery_in_words(event: Event, record: Mapping[str, object]) -> str:
    """Return a recovery in words. record: the figures of the effect that chose it: `change`, `because` of what
    the last grasp has shown, and `reason` where the operator was asked or the run ended."""
    said = _RECOVERIES.get(event, plain(event))
    if record.get("reason"):
        return f"{said}: {record['reason']}"
    change = Adjustment(str(record.get("change", Adjustment.NONE.value)))
    said += f", {_CHANGES[change]}" if change in _CHANGES else ""
    return f"{said}: {record['because']}" if record.get("because") else said


def laying_in_words(record: Mapping[str, object]) -> str:
    """Return in words what the hands did with the cloth that they held. record: the figures of that effect."""
    return _LAYINGS[Laying(str(record["laying"]))] if "laying" in record else "laid the cloth down"


# the end of a run


def claim_in_words(claim: Claim | None) -> str:
    """Return the claim as a sentence with its reliability; empty if there is none."""
    return f"{claim.says}, reliability {percent(claim.reliability)}" if claim else ""


def missed_in_words(score: ScoreRecord) -> str:
    """Return the figures of the score that are beyond their limits, each with its limit, and why the heights are
    not judged. Empty if the score is passed."""
    judged = score.judged
    missed = [
        f"{figure_name(name)} {figure(name, judged[name].value)}, limit {figure(name, judged[name].limit)}"
        for name in score.failed
    ]
    if score.ideal and score.ideal.reason:
        missed.append(f"the heights are not judged, because the ideal fold is not valid: {score.ideal.reason}")
    return "; ".join(missed)


def lost_in_words(recording: RecordingLosses) -> tuple[str, ...]:
    """Return messages about the losses of recording and transcript; empty if nothing was lost. Entries that only a
    live viewer missed are in the file and do not count as lost."""
    if not recording.dropped:
        return recording.errors
    entries = f"{recording.dropped} entries of the recording, which arrived faster than they could be written"
    return (*recording.errors, entries)


_ALL_MADE = {0: "All folds were made", 1: "The only fold was made", 2: "Both folds were made"}


def verdict(run: RunRecord) -> str:
    """Return the verdict of the run and what decided it, in one sentence."""
    folds, claim = run.steps, claim_in_words(run.claim).strip().rstrip(".")
    made = _ALL_MADE.get(len(folds), f"All {len(folds)} folds were made")
    if run.result == "folded":
        seen = f"by the last picture the garment is {claim}" if claim else "the last fold was not inspected"
        text = f"{made}; {seen}"
    elif claim and run.state is State.NOT_FOLDED and _only_the_claim_failed(folds):
        text = f"{made}, but the garment does not count as folded: by the last picture it is {claim}"
    else:
        why = run.failure.what.strip().rstrip(".") if run.failure else ""
        text = f"{_where(run)}: {why or 'the reason is not known'}"
    if run.score is None:
        return f"{text}."
    says = "passes" if run.score.passed else f"does not pass ({missed_in_words(run.score)})"
    return f"{text}; the score, measured on the simulated garment itself, {says}."


def _only_the_claim_failed(folds: tuple[FoldRecord, ...]) -> bool:
    return bool(folds) and all(fold.done for fold in folds[:-1]) and folds[-1].accepted is False


def _where(run: RunRecord) -> str:
    """Say what ended, and at which fold."""
    folds = run.steps
    missing = next((k for k, fold in enumerate(folds) if not fold.done), None)
    if missing is None:
        place = "after the last fold" if folds else "before the first fold"
    else:
        place = f"at fold {missing + 1} of {len(folds)} ({plain(folds[missing].name)})"
    if run.state is State.STOPPED:
        return f"The run was stopped {place}"
    if run.result == "fault":
        return f"A fault ended the run {place}"
    if missing is None:
        return f"The run ended {place}"
    fold = folds[missing]
    how = "was not made" if not fold.attempts else "was not finished" if fold.accepted is None else "failed"
    return f"Fold {place.removeprefix('at fold ')} {how}"
