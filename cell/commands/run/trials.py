"""`foldcell trials`: success rates over seeds and garments in the simulated cell, as in the paper's table."""

from __future__ import annotations

import argparse
import functools
import shutil
import sys
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cell.campaigns.trials import GarmentFigures, Trial, run_trials, tabulate
from cell.commands.options import cell_option, count, driver_options, json_option, logs_option, seed
from cell.commands.output import print_json, print_table, progress_stream
from cell.config.cell_settings import CellSettings, load_settings
from cell.config.garments.garment_file import list_garments, load_garment
from cell.config.library.library_file import user_library_path
from cell.support.files.paths import campaign_folder, logs_directory, new_folder, prepare_logs
from cell.support.files.whole_file import write_whole
from cell.support.json_values import to_json
from cell.support.process.workers import worker_pool
from robots.errors import StorageError

__all__ = ["add_options", "run"]

RUNS_EACH = 8
"""A worker process is replaced after this number of runs, which limits its memory."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=run)
    parser.add_argument("--garments", default="all", metavar="A,B", help="names separated by commas, or all (all)")
    parser.add_argument("--n", type=count, default=10, metavar="N", help="runs of each garment (10)")
    parser.add_argument("--first-seed", type=seed, default=1, metavar="N", help="first seed (1)")
    parser.add_argument("--workers", type=count, default=1, metavar="N", help="runs at a time (1)")
    driver_options(parser, real=False)  # no real cell: a person cannot lay the garment hundreds of times
    cell_option(parser)
    logs_option(parser)
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Returns 0 if every run ended without a fault, 3 if a run ended in a fault or was not performed. A bad fold
    appears in the figures and is no error. `trials.json` is written after each run, so that an interrupted
    campaign keeps its results."""
    settings = load_settings(options.cell)
    garments = list(list_garments()) if options.garments == "all" else _named(options.garments)
    for name in garments:
        load_garment(name, settings.surface)
    logs = prepare_logs(logs_directory(options.logs))
    campaign = campaign_folder(logs, "trials")
    work = functools.partial(_one, options.driver, options.world, options.cell, settings, campaign)
    seeds = range(options.first_seed, options.first_seed + options.n)
    planned = [(g, s) for g in garments for s in seeds]
    trials: list[Trial] = []
    out = progress_stream(options.json)
    _copy_library(logs, campaign)
    results_file = campaign / "trials.json"
    write_whole(results_file, _text(_figures(trials, planned)))
    print(f"{len(planned)} runs, {options.workers} at a time", file=out, flush=True)
    try:
        with (
            worker_pool(options.workers, RUNS_EACH) as pool,
            closing(run_trials(work, garments, seeds, pool)) as running,
        ):
            for trial in running:
                trials.append(trial)
                write_whole(results_file, _text(_figures(trials, planned)))
                print(f"{len(trials):4d}/{len(planned)}  {_line(trial)}", file=out, flush=True)
    except KeyboardInterrupt:
        print(f"{len(trials)} of {len(planned)} runs were performed: {results_file}", file=sys.stderr)
        raise
    if options.json:
        print_json({**_figures(trials, planned), "directory": str(campaign)})
    else:
        _print(tabulate(trials), sum(not t.performed for t in trials), campaign)
    return 3 if any(t.result in ("fault", "not_performed") for t in trials) else 0


def _named(garments: str) -> list[str]:
    """The names without repetitions: repeating the same seeds gives no further evidence."""
    return list(dict.fromkeys(name.strip() for name in garments.split(",")))


def _figures(trials: list[Trial], planned: list[tuple[str, int]]) -> dict[str, Any]:
    """The results so far. not_performed: the planned runs that have no figures."""
    performed = sorted((t for t in trials if t.performed), key=_key)
    missing = sorted(set(planned) - {_key(t) for t in performed})
    return {
        "schema": 1,
        "garments": [asdict(r) for r in tabulate(trials)],
        "runs": [_run(t) for t in performed],
        "not_performed": [{"garment": garment, "seed": seed} for garment, seed in missing],
    }


def _one(
    driver: str, world: str, path: Path | None, settings: CellSettings, campaign: Path, garment: str, seed: int
) -> dict[str, Any]:
    """Perform one run in a worker process. The run has a separate logs folder with a copy of the user's library,
    so that trajectories which another run optimised do not affect it."""
    from cell.runs.fold_run import FoldRequest, fold_once

    logs = new_folder(campaign, f"{Path(garment).stem}-seed{seed}")
    _copy_library(campaign, logs)
    request = FoldRequest(
        garment=garment, seed=seed, driver=driver, settings=settings, settings_path=path, logs=logs,
        live=False, approve=False, realtime=False, world=world, quiet=True,
    )  # fmt: skip
    return dict(to_json(fold_once(request).as_json()))


def _copy_library(logs: Path, to: Path) -> None:
    """Copy the user's library, if there is one, from one logs folder to another. Raises StorageError."""
    try:
        shutil.copyfile(user_library_path(logs), user_library_path(to))
    except FileNotFoundError:
        return
    except OSError as error:
        hint = "check the permissions of both folders and whether the disk is full"
        raise StorageError(f"{user_library_path(logs)} cannot be copied to {to}: {error.strerror}", hint) from None


def _key(trial: Trial) -> tuple[str, int]:
    return trial.garment, trial.seed


def _run(trial: Trial) -> dict[str, Any]:
    return {"garment": trial.garment, "seed": trial.seed, "success": trial.success, "result": trial.result,
            "error": trial.error, "figures": trial.figures}  # fmt: skip


def _text(figures: dict[str, Any]) -> bytes:
    import json

    return (json.dumps(to_json(figures), indent=1) + "\n").encode()


def _line(trial: Trial) -> str:
    figures = trial.figures or {}
    times = f"  {figures.get('robot_time_s') or 0:6.1f} s robot, {figures.get('wall_time_s') or 0:6.1f} s wall"
    verdict = "folded" if trial.success else "false claim" if trial.result == "folded" else trial.result
    return f"{trial.garment:<24} seed {trial.seed:<5} {verdict:<14}" + (times if figures else f"  {trial.error}")


def _print(rows: list[GarmentFigures], not_performed: int, campaign: Path) -> None:
    print("\nsimulated; folded: passed the scorer; interval: Wilson, 95 %; times and IoU: medians")
    print_table(
        ("garment", "folded", "interval", "false claims", "faults", "recoveries", "robot s", "wall s", "IoU"),
        [
            (
                r.garment,
                f"{r.folded}/{r.runs}",
                f"{100 * r.interval[0]:.0f}-{100 * r.interval[1]:.0f} %",
                r.false_claims,
                r.faults,
                r.recoveries,
                r.robot_time_s,
                r.wall_time_s,
                "-" if r.iou is None else f"{r.iou:.3f}",
            )
            for r in rows
        ],
    )
    if not_performed:
        print(f"{not_performed} runs were not performed because a worker process died; they are not in the table")
    print(f"details  {campaign / 'trials.json'}")
