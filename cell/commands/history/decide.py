"""`foldcell replay RUN --decide`: checks whether the present program repeats the decisions of a recorded run."""

from __future__ import annotations

import argparse
from typing import Any

from cell.commands.output import print_json, progress_stream
from cell.journal.journal import Journal
from cell.support.files.paths import journal_path, logs_directory

__all__ = ["run"]

SAME, DEVIATES = 0, 2


def run(options: argparse.Namespace) -> int:
    with Journal.open(journal_path(logs_directory(options.logs)), readonly=True) as journal:
        record = journal.run(options.name)
        entries = journal.entries(record.id)
    from cell.operator.progress.compiling import report_compilation
    from cell.operator.progress.lines import ProgressLines
    from cell.runs.decide_again import changed_versions, decide_again

    changed = changed_versions(record.versions)
    lines = ProgressLines(progress_stream(options.json))
    lines.note(f"deciding {record.id} again from its recorded readings")
    for name, (then, now) in changed.items():
        lines.note(f"the version of {name} was {then} and is {now} now")
    with report_compilation(lines.note):
        verdict = decide_again(record, entries, (lines,), lines.note, lines.computing)
    figures: dict[str, Any] = {
        "run": record.id,
        "same": verdict.same,
        "deviation": verdict.deviation,
        "broken_off": verdict.broken_off,
        "cell_time_s": verdict.cell_time_s,
        "effects": verdict.effects,
        "set_points": verdict.set_points,
        "pictures": verdict.pictures,
        "exchanges": verdict.exchanges,
        "wall_time_s": verdict.wall_time_s,
        "changed_versions": {name: {"then": then, "now": now} for name, (then, now) in changed.items()},
    }
    if options.json:
        print_json(figures)
    else:
        _summary(figures)
    return SAME if verdict.same else DEVIATES


def _summary(figures: dict[str, Any]) -> None:
    compared = (
        f"{figures['effects']} effects, {figures['set_points']} set-points, {figures['pictures']} pictures,"
        f" {figures['exchanges']} exchanges with the cell"
    )
    deviation = figures["deviation"]
    if deviation is None:
        print(f"\nthe same decisions: {compared}, in {figures['wall_time_s']:.0f} s")
        if figures["broken_off"]:
            print(f"  up to {figures['cell_time_s']:.2f} s: {figures['broken_off']}")
        return
    print(f"\nANOTHER DECISION at {deviation.cell_time_s:.2f} s, {_place(deviation.state, deviation.effect)}")
    print(f"  then   {deviation.then}")
    print(f"  now    {deviation.now}")
    print(f"  in {deviation.place}; equal before it: {compared}")


def _place(state: str, effect: str | None) -> str:
    return f"state {state}" + (f", effect {effect}" if effect else "")
