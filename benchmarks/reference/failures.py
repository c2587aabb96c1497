"""The pages of all failures and refusals with cause and remedy, from the program's texts."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.reference.markdown import cell, table
from foldcell.cell.config.deciding_setting import LIMITS
from foldcell.cell.executive.effects import claiming, inspecting
from foldcell.cell.record.words import plain
from foldcell.cell.states.recovery_table import RECOVERIES
from foldcell.robots.errors import FailureKind

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ("cell", "skills", "robots", "calibration", "foldcell")
REFUSALS = ("ConfigurationError", "StorageError", "InternalError", "RecordError")
FAILURES = ("Failure", "DriverError")
SAYING = (*FAILURES, *REFUSALS)
"""The types whose calls have a message of the program."""

K = FailureKind
CAUSES: Mapping[FailureKind, str] = {
    K.NO_GARMENT: "the camera sees nothing on the table that differs from the empty table",
    K.UNKNOWN_GARMENT: "the outline fits no garment that the cell knows",
    K.CATEGORY_MISMATCH: "the outline is that of another kind of garment than the one that was named",
    K.OUT_OF_VIEW: "a part of the garment lies outside the picture, or where the arms do not reach",
    K.VIEW_OBSTRUCTED: "a hand or another object hides a part of the table",
    K.NOT_FLAT: "the garment is recognised, but stands too high or overlaps its outline too little to lie flat",
    K.LOW_CONFIDENCE: "the outline fits a garment, but key points of it are not certain",
    K.CAMERA_FAULT: "the picture or the depth is missing, damaged, too old, or contradicts the calibration",
    K.GARMENT_MOVED: "the garment lies elsewhere than when the fold was planned, and no hand has moved it",
    K.OPTIMISER_FAILED: "the search for the hands' arc ended without an arc",
    K.PREDICTION_POOR: "the best arc folds the garment too badly in the cloth simulation",
    K.UNREACHABLE: "an arm does not reach a grasp or a part of the arc in any posture",
    K.IN_COLLISION: "every motion that was found touches the table, the robot or itself",
    K.LIMIT_EXCEEDED: "a set-point breaks a limit of position, speed, acceleration or force",
    K.START_MISMATCH: "the arms are not where the motion begins",
    K.TRACKING_ERROR: "the arms do not follow their set-points",
    K.STALE_STATE: "the robot's state is too old to move by",
    K.NO_CONTACT: "a hand went down and touched neither cloth nor table",
    K.MISSED_GRASP: "the pads closed, but hold no cloth or fewer layers than planned",
    K.SLIPPED: "a hand held cloth and lost it",
    K.STUCK_ON_FINGER: "cloth does not come off an opened hand",
    K.TACTILE_FAULT: "a pad is dead, constant or gives no numbers",
    K.GRIPPER_FAULT: "a gripper does not do as it is told, or does not answer",
    K.DRIFT: "the fold has the planned shape, but the garment has moved or turned",
    K.PILING: "cloth lies in a heap where it should lie in layers",
    K.TOO_HIGH: "the stack stands higher than its fabric explains",
    K.SAG: "an edge lies short of its target",
    K.MISSED_LAYER: "the wrong number of layers was moved",
    K.DROPPED_CORNER: "a corner did not arrive at its target",
    K.OFF_TARGET: "the outline after the fold is not the planned one",
    K.HALF_FOLDED: "the garment lies neither as before nor as after the fold",
    K.HEAPED: "the garment lies in a heap",
    K.STOPPED: "somebody pressed the stop, or a signal ended the program",
    K.ABORTED: "the operator ended the run",
    K.HARDWARE_FAULT: "the robot or its driver reports a fault, or does not answer",
    K.SKILL_CRASHED: "a bug of the program",
    K.UNRECORDED: "the journal cannot be written",
}
"""Failure kind -> its usual cause."""
PARTS: Mapping[str, tuple[str, FailureKind]] = {
    "seeing": ("Failures of seeing", K.NO_GARMENT),
    "planning": ("Failures of planning", K.OPTIMISER_FAILED),
    "moving": ("Failures of moving", K.LIMIT_EXCEEDED),
    "grasping": ("Failures of grasping", K.NO_CONTACT),
    "folding": ("Folds that failed", K.DRIFT),
    "ending": ("Failures that end a run", K.STOPPED),
}
"""Part of the failures -> title of its page, and the first of its kinds; the parts have all kinds in order."""


@dataclass(frozen=True, order=True)
class Message:
    """One message of the program. kind: failure kind, or name of the exception; what, hint: the text, with three
    dots for what is filled in."""

    kind: str
    what: str
    hint: str


def messages(root: Path = ROOT) -> list[Message]:
    """Return all messages of the program, in order, each once."""
    files = (file for folder in PROGRAM for file in (root / folder).rglob("*.py"))
    texts = (file.read_text(encoding="utf-8") for file in files)
    told = (text for text in texts if any(f"{name}(" in text for name in SAYING))
    return sorted({message for text in told for message in _of_file(ast.parse(text))})


def _of_file(tree: ast.Module) -> Iterator[Message]:
    nodes = list(ast.walk(tree))
    calls = [
        (node, node.func.id)
        for node in nodes
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in SAYING
    ]
    for scope in (node for node in nodes if isinstance(node, ast.Module | ast.FunctionDef)):
        inside = [(call, name) for call, name in calls if _is_in(call, scope)]
        assigned = ast.walk(scope) if inside else ()
        said = {
            target.id: node.value
            for node in assigned
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for call, name in inside:
            yield from _of_call(call, name, said)


def _is_in(call: ast.Call, scope: ast.Module | ast.FunctionDef) -> bool:
    return isinstance(scope, ast.Module) or scope.lineno <= call.lineno <= (scope.end_lineno or scope.lineno)


def _of_call(call: ast.Call, name: str, said: Mapping[str, ast.expr]) -> Iterator[Message]:
    arguments = [*call.args, *(word.value for word in call.keywords if word.arg in ("kind", "what", "hint"))]
    if name in FAILURES:
        kinds, *arguments = arguments or [ast.Constant("")]
        names = [node.attr.lower() for node in ast.walk(kinds) if isinstance(node, ast.Attribute)]
    else:
        names = [name]
    what = _texts(arguments[0], said) if arguments else []
    hints = _texts(arguments[1], said) if len(arguments) > 1 else [""]
    known = {*map(str, FailureKind), *REFUSALS}
    for kind in names:
        for number, text in enumerate(what):
            if kind in known and re.search(r"[a-z]{3}", text):
                yield Message(kind, text, hints[min(number, len(hints) - 1)] if hints else "")


def _texts(node: ast.expr, said: Mapping[str, ast.expr]) -> list[str]:
    """Return the texts that an expression can have."""
    if isinstance(node, ast.Constant):
        return [str(node.value)]
    if isinstance(node, ast.JoinedStr):
        parts = [str(part.value) if isinstance(part, ast.Constant) else "..." for part in node.values]
        return ["".join(parts)]
    if isinstance(node, ast.IfExp):
        return [*_texts(node.body, said), *_texts(node.orelse, said)]
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return [a + b for a in _texts(node.left, said) or ["..."] for b in _texts(node.right, said) or ["..."]]
    if isinstance(node, ast.Name) and node.id in said:
        return _texts(said[node.id], {})
    return []


def pages(found: Iterable[Message]) -> dict[str, str]:
    """Return the pages: file name -> Markdown."""
    by_kind: dict[str, list[Message]] = {}
    for message in found:
        by_kind.setdefault(message.kind, []).append(message)
    kinds = list(FailureKind)
    begins = [*(kinds.index(first) for _, first in PARTS.values()), len(kinds)]
    whole = [
        "# Messages, causes and remedies",
        "",
        "What the program says when something fails, why, and what you can do. `python -m benchmarks.reference`",
        "writes these pages from the program's texts. Three dots stand for names and figures. On the screen, the",
        "remedy follows the message. [Safety](../do/safety.md) says what the cell does by itself.",
        "",
        "A command that refuses to begin has moved nothing and ends with exit code 64: it names a",
        "[wrong argument or file](refusals.md) or a [disk or log](refusals_disk.md) that cannot be used.",
        "",
        "The reason of a run that ends as not folded is one of the kinds below. It is in the last lines of the",
        "command, in the report, and as `failure.kind` in the result.",
    ]
    made = {}
    for (part, (title, _)), begin, end in zip(PARTS.items(), begins[:-1], begins[1:], strict=True):
        file = f"failures_{part}.md"
        whole += ["", f"## {title}", "", "| kind | cause |", "|---|---|"]
        lines = [f"# {title}", "", "[All messages](failures.md) and how to read them."]
        for kind in kinds[begin:end]:
            whole.append(f"| [`{kind}`]({file}#{plain(kind).replace(' ', '-')}) | {CAUSES[kind]} |")
            lines += _of_kind(kind, by_kind.get(kind.value, ()))
        made[file] = "\n".join(lines) + "\n"
    made["failures.md"] = "\n".join(whole) + "\n"
    for file, name, title in (
        ("refusals.md", "ConfigurationError", "Wrong arguments and files"),
        ("refusals_disk.md", "StorageError", "Disk and logs"),
    ):
        lines = [f"# {title}", "", "Nothing has moved. [All messages](failures.md) and how to read them."]
        made[file] = "\n".join([*lines, *_table(by_kind.get(name, ()))]) + "\n"
    return made


def _of_kind(kind: FailureKind, found: Iterable[Message]) -> list[str]:
    keys = [f"`{limit.key}`" for limit in LIMITS.get(kind, ())]
    lines = ["", f"## {plain(kind)}", "", f"`{kind}`: {CAUSES[kind]}."]
    if keys:
        lines.append(f"Limits in `cell.yaml`: {', '.join(dict.fromkeys(keys))}.")
    lines += [f"Remedy: {hints[kind]}." for hints in (inspecting.HINTS, claiming.HINTS) if kind in hints]
    lines.append(f"If its own tries do not help, the cell asks a person, because {RECOVERIES[kind][-1].reason}.")
    return [*lines, *_table(found)]


def _table(found: Iterable[Message]) -> list[str]:
    lines = table(("message", "remedy"), [(cell(m.what), cell(m.hint)) for m in found])
    return ["", *lines] if lines else []
