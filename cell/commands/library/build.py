"""`foldcell library build`: optimises the folds of garments and stores their trajectories."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

from foldcell.cell.campaigns.executors import chosen_workers
from foldcell.cell.commands.library.show import figures
from foldcell.cell.commands.shared import (
    Commands,
    add_command,
    answer,
    cell_option,
    count,
    logs_option,
    progress_stream,
)
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.config.trajectory_library.ideal_heights_file import (
    ideal_heights_of,
    put_ideal_heights,
)
from foldcell.cell.config.trajectory_library.library_file import put_garments, user_heights_path, user_library_path
from foldcell.cell.operator.progress.bar import ProgressBar
from foldcell.cell.planning.trajectory_library_build import BuildProgress, BuiltStep, build_library
from foldcell.cell.planning.unfinished_build import UnfinishedBuild
from foldcell.cell.support.files.paths import logs_directory, prepare_logs
from foldcell.cell.support.files.whole_file import refuse_foreign
from foldcell.skills.fold_plan.ideal_heights import bending_lengths, ideal_fold_heights
from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.search.optimise import ClothPredictor
from foldcell.skills.trajectory.trajectory_library import LibraryEntry


def add_options(actions: Commands) -> None:
    build = add_command(
        actions, "build", "optimise every fold of the garments, and compute the heights of their ideal folds", _run
    )
    build.add_argument("garments", nargs="*", metavar="GARMENT", help="names or files (all shipped garments)")
    build.add_argument(
        "--method",
        choices=["default", "paper", "initial", "two_parameter"],
        help="method of the optimiser (of the settings)",
    )
    build.add_argument("--output", type=Path, metavar="FILE", help="library file (the user's own, in the logs)")
    build.add_argument("--workers", type=count, metavar="N", help="number of processes (one for each core)")
    build.add_argument("--cluster", metavar="ADDRESS", help="simulate on the workers of this Dask scheduler")
    cell_option(build)
    logs_option(build)


def _run(options: argparse.Namespace) -> int:
    """Build the library. Returns 0 if every fold was optimised, 2 if one could not be optimised. The optimised
    folds are stored in both cases."""
    settings = load_settings(options.cell)
    loaded = [load_garment(name, settings.surface) for name in options.garments or list_garments()]
    cell_speed = settings.motion.tool_speed
    garments = [replace(g, max_tool_speed=min(g.max_tool_speed, cell_speed)) for g in loaded]
    path = options.output or user_library_path(prepare_logs(logs_directory(options.logs)))
    if options.output is not None:
        refuse_foreign(path, b'"entries"')
    unfinished = UnfinishedBuild(path, garments, settings.grasp.lift_height)
    bar = ProgressBar(progress_stream(options.json))
    if unfinished.library.entries:
        finished = len(unfinished.library.entries)
        bar.line(f"continues from the {finished} folds in {unfinished.path}; delete it to start again")
    failures: list[BuiltStep] = []

    def report(built: BuiltStep) -> None:
        if built.entry is None:
            failures.append(built)
            bar.line(f"{built.garment} {built.step}: {built.failure}")
        else:
            bar.line(f"{built.garment} {built.step}: {_gain(built.entry)}" + (", kept" if built.kept else ""))
            if not built.kept:
                unfinished.keep(built.entry)

    def progress(now: BuildProgress) -> None:
        best = f"{now.garment} {now.step}: best D {1e3 * now.dissimilarity:.1f} mm"
        bar.update(now.done, now.total, f"simulations  {best}")

    with chosen_workers(options.workers, options.cluster, path.absolute().parent) as workers:
        library = build_library(
            garments, options.method or settings.optimiser.method,
            ClothPredictor(pads=settings.gripper.pads), report, executor=workers.executor,
            at_once=workers.count, finished=unfinished.library, progress=progress,
            lift_height=settings.grasp.lift_height,
        )  # fmt: skip
        bar.clear()
        put_garments(path, library, [g.name for g in garments])
        _store_heights(path, garments, workers.executor, bar)
    unfinished.end()
    bar.line(f"{len(library.entries)} folds  {path}")
    built = {
        "library": str(path),
        "entries": [figures(e) for e in library.entries],
        "failed": [{"garment": b.garment, "step": b.step, "failure": b.failure} for b in failures],
    }
    return answer(options, built, (), 2 if failures else 0)


def _store_heights(library: Path, garments: Sequence[Garment], executor: Executor, bar: ProgressBar) -> None:
    """Compute and store the heights of ideal folds of the garments that have none."""
    wanted = [g for g in garments if not ideal_heights_of(g, library)]
    jobs = {g.name: [executor.submit(ideal_fold_heights, g, c) for c in bending_lengths(g)] for g in wanted}
    total = sum(map(len, jobs.values()))
    done = 0
    for garment in wanted:
        heights = []
        for job in jobs[garment.name]:
            bar.update(done, total, f"ideal folds  {garment.name}")
            heights.append(job.result())
            done += 1
        put_ideal_heights(user_heights_path(library), garment, heights)
        low, high = heights[0].height, heights[-1].height
        bar.line(f"{garment.name}: an ideal fold is {1e3 * low:.0f} to {1e3 * high:.0f} mm high, by its fabric")
    bar.clear()


def _gain(entry: LibraryEntry) -> str:
    first, best = 1e3 * entry.dissimilarity_initial, 1e3 * entry.dissimilarity
    return f"D {first:.1f} -> {best:.1f} mm (predicted) in {entry.simulations} simulations"
