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
from foldcell.cell.commands.output import print_json, print_table, progress_stream
from foldcell.cell.commands.run.perform import first_seed
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.placement import refuse_unfit_folds
from foldcell.cell.record.words import garment_name
from foldcell.cell.support.files.paths import campaign_folder, logs_directory, prepare_logs

__all__ = ["run_endurance"]

MEMORY_GROWTH = 0.05
"""Largest allowed growth of a process's memory, as a fraction."""


def run_endurance(options: argparse.Namespace) -> int:
    """Perform the runs and print the growth of the processes. Returns 0 if every run ended with a result, no
    process gained threads or file handles, and no process's memory grew by more than 5 %; else 3."""
    settings = load_settings(options.cell)
    garments = distinct_garments((options.garments or ALL).split(","))
    refuse_unfit_folds(garments, settings)
    logs = prepare_logs(logs_directory(options.logs))
    path, out = campaign_folder(logs, "endurance"), progress_stream(options.json)
    print(f"folder   {path}", file=out, flush=True)

    def report(run: EnduranceRun) -> None:
        name = garment_name(run.garment)
        print(
            f"{run.number:4d}  {name:<24} {run.fault or '-':<15} {run.result:<13} {run.seconds:6.1f} s  "
            f"{run.threads} threads  {run.handles} handles  {run.memory_mib:.0f} MiB",
            file=out, flush=True,
        )  # fmt: skip

    runs = endure(
        random_requests(garments, settings, first_seed(options)), path, options.hours, options.renew, report
    )
    grown = growths(runs)
    bad = sum(bool(run.error) for run in runs)
    leaks = [g for g in grown if g.threads > 0 or g.handles > 0 or g.memory > MEMORY_GROWTH]
    if options.json:
        print_json({
            "schema": 1, "directory": str(path), "runs": len(runs), "broken": bad,
            "results": dict(Counter(run.result for run in runs)), "processes": [asdict(g) for g in grown],
        })  # fmt: skip
    else:
        print(
            f"\n{len(runs)} runs, simulated: "
            + ", ".join(f"{n} {r}" for r, n in Counter(r.result for r in runs).items())
        )
        print(f"{bad} ended without a result")
        if not grown:
            print(f"growth was not measured: no process made more than {SETTLED} runs")
        print_table(
            ("process", "runs", "threads gained", "handles gained", "memory gained"),
            [(g.process, g.runs, g.threads, g.handles, f"{100 * g.memory:+.1f} %") for g in grown],
        )
        print(f"gained: after the run {SETTLED} of a process; details  {path / SAMPLES}")
    return 3 if bad or leaks else 0
