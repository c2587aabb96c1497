"""`foldcell library build|show`: the trajectories that need no optimising any more."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from cell.campaigns.library.build import BuildProgress, BuiltStep, build_library
from cell.campaigns.library.unfinished_build import UnfinishedBuild
from cell.commands.options import add_command, cell_option, count, json_option, logs_option
from cell.commands.output import print_json, print_table, progress_stream
from cell.config.cell_settings import load_settings
from cell.config.garments.garment_file import list_garments, load_garment
from cell.config.library.library_file import load_library, put_garments, user_library_path
from cell.operator.progress.bar import ProgressBar
from cell.support.files.paths import logs_directory, prepare_logs
from cell.support.process.workers import worker_pool
from skills.trajectory.library import LibraryEntry

__all__ = ["add_options", "run"]


def add_options(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    build = add_command(actions, "build", "optimise every fold of the garments and keep the trajectories", run)
    build.add_argument("garments", nargs="*", metavar="GARMENT", help="names or files (all that are shipped)")
    build.add_argument(
        "--method", choices=["default", "paper", "initial", "two_parameter"], help="(of the settings)"
    )
    build.add_argument("--output", type=Path, metavar="FILE", help="library file (the user's own, among the logs)")
    cores = os.cpu_count() or 1
    build.add_argument("--workers", type=count, default=cores, metavar="N", help="processes (one a core)")
    show = add_command(actions, "show", "what the library holds", run)
    for action, name in ((build, "build"), (show, "show")):
        action.set_defaults(action=name)
        cell_option(action)
        logs_option(action)
        json_option(action)


def run(options: argparse.Namespace) -> int:
    return _build(options) if options.action == "build" else _show(options)


def _build(options: argparse.Namespace) -> int:
    """0 when every fold has its entry, 2 when one could not be optimised (the others are kept)."""
    settings = load_settings(options.cell)
    loaded = [load_garment(name, settings.surface) for name in options.garments or list_garments()]
    most = settings.motion.tool_speed
    garments = [replace(g, max_tool_speed=min(g.max_tool_speed, most)) for g in loaded]
    path = options.output or user_library_path(prepare_logs(logs_directory(options.logs)))
    out = progress_stream(options.json)
    unfinished = UnfinishedBuild(path, garments, settings.grasp.lift_height)
    bar = ProgressBar(out)
    if unfinished.library.entries:
        begun = len(unfinished.library.entries)
        bar.line(f"goes on from the {begun} folds in {unfinished.path}; delete it to begin anew")
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

    with worker_pool(options.workers) as pool:
        library = build_library(
            garments, options.method or settings.optimiser.method, report=report, executor=pool,
            at_once=options.workers, finished=unfinished.library, progress=progress,
            lift_height=settings.grasp.lift_height,
        )  # fmt: skip
    bar.clear()
    put_garments(path, library, [g.name for g in garments])
    unfinished.end()
    print(f"{len(library.entries)} folds  {path}", file=out)
    if options.json:
        print_json({
            "library": str(path),
            "entries": [_figures(e) for e in library.entries],
            "failed": [{"garment": b.garment, "step": b.step, "failure": b.failure} for b in failures],
        })  # fmt: skip
    return 2 if failures else 0


def _show(options: argparse.Namespace) -> int:
    loaded = load_library(logs_directory(options.logs))
    entries = loaded.library.entries
    refused = [f"{path}, entry {r.index}: {r.reason}" for path, r in loaded.refused]
    if options.json:
        print_json({"entries": [_figures(e) for e in entries], "refused": refused})
        return 0
    if entries:
        print_table(
            ("garment", "fold", "variant", "method", "D first [mm]", "D [mm]", "simulations", "arms"),
            [
                (e.garment, e.step, e.variant, e.method, 1e3 * e.dissimilarity_initial, 1e3 * e.dissimilarity,
                 e.simulations, len(e.inner))
                for e in entries
            ],
        )  # fmt: skip
    else:
        print("the library is empty; 'foldcell library build' fills it")
    for line in refused:
        print(f"not used: {line}")
    return 0


def _gain(entry: LibraryEntry) -> str:
    first, best = 1e3 * entry.dissimilarity_initial, 1e3 * entry.dissimilarity
    return f"D {first:.1f} -> {best:.1f} mm (predicted) in {entry.simulations} simulations"


def _figures(entry: LibraryEntry) -> dict[str, Any]:
    return {
        "garment": entry.garment,
        "category": entry.category,
        "step": entry.step,
        "variant": entry.variant,
        "size_m": entry.size_m,
        "method": entry.method,
        "dissimilarity_initial_m": entry.dissimilarity_initial,
        "dissimilarity_m": entry.dissimilarity,
        "simulations": entry.simulations,
        "version": entry.version,
    }
