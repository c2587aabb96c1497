"""`foldcell trials --hours H`: performs runs with random garments and faults for hours, and checks that the
processes do not hold more and more resources."""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import asdict

from foldcell.cell.campaigns.trials.campaign import ALL, distinct_garments
from foldcell.cell.campaigns.trials.endurance import (
    SAMPLES,
    SETTLED,
    EnduranceRun,
    endure,
    growths,
    random_requests,
)
from foldcell.cell.commands.run.perform import first_seed
from foldcell.cell.commands.shared import answer, table, teller
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.placement import refuse_unfit_folds
from foldcell.cell.record.words import garment_name
from foldcell.cell.support.files.paths import campaign_folder, logs_directory, prepare_logs

MEMORY_GROWTH = 0.05
"""Largest allowed growth of a process's memory, as a fraction."""


def run_endurance(options: argparse.Namespace) -> int:
    """Perform the runs and print the growth of the processes. Returns 0 if every run ended with a result, no
    process gained threads or file handles, and no process's memory grew by more than 5 %; else 3."""
    settings = load_settings(options.cell)
    garments = distinct_garments((options.garments or ALL).split(","))
    refuse_unfit_folds(garments, settings)
    logs = prepare_logs(logs_directory(options.logs))
    path, tell = campaign_folder(logs, "endurance"), teller(options.json)
    tell(f"folder   {path}")

    def report(run: EnduranceRun) -> None:
        name = garment_name(run.garment)
        tell(
            f"{run.number:4d}  {name:<24} {run.fault or '-':<15} {run.result:<13} {run.seconds:6.1f} s  "
            f"{run.threads} threads  {run.handles} handles  {run.memory_mib:.0f} MiB"
        )

    runs = endure(
        random_requests(garments, settings, first_seed(options)), path, options.hours, options.renew, report
    )
    grown = growths(runs)
    bad = sum(bool(run.error) for run in runs)
    leaks = [g for g in grown if g.threads > 0 or g.handles > 0 or g.memory > MEMORY_GROWTH]
    results = Counter(run.result for run in runs)
    figures = {
        "schema": 1, "directory": str(path), "runs": len(runs), "broken": bad, "results": dict(results),
        "processes": [asdict(g) for g in grown],
    }  # fmt: skip
    head = ("process", "runs", "threads gained", "handles gained", "memory gained")
    rows = [(g.process, g.runs, g.threads, g.handles, f"{100 * g.memory:+.1f} %") for g in grown]
    lines = [
        f"\n{len(runs)} runs, simulated: {', '.join(f'{n} {result}' for result, n in results.items())}",
        f"{bad} ended without a result",
        *(() if grown else (f"growth was not measured: no process made more than {SETTLED} runs",)),
        *table(head, rows),
        f"gained: after the run {SETTLED} of a process; details  {path / SAMPLES}",
    ]
    return answer(options, figures, lines, 3 if bad or leaks else 0)
