"""`foldcell optimise GARMENT`: finds trajectories for the folds of a garment, for this cell or another robot."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

from foldcell.cell.commands.shared import answer, cell_option, count, progress_stream
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.operator.progress.bar import ProgressBar
from foldcell.cell.operator.progress.compiling import report_compilation
from foldcell.cell.planning.plan_optimisation import StepOptimisation, check_step, optimise_plan
from foldcell.cell.support.files.whole_file import refuse_foreign, write_whole
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array
from foldcell.skills.trajectory.export import MARKS, pose_rows, tool_poses_text
from foldcell.skills.vocabulary import FoldStep


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("garment", metavar="GARMENT", help="name or file")
    parser.add_argument("--step", type=count, metavar="N", help="only the N-th fold, from 1 (all)")
    parser.add_argument(
        "--method",
        choices=["default", "paper", "initial", "two_parameter"],
        help="method of the optimiser (of the settings)",
    )
    parser.add_argument("--budget", type=count, metavar="N", help="simulations of one fold (of the settings)")
    parser.add_argument(
        "--export", type=Path, metavar="FILE", help="tool poses and times, as .csv, .json or .yaml (ROS)"
    )
    cell_option(parser)


def run(options: argparse.Namespace) -> int:
    """Optimise the folds and print the results. Returns 0 if every fold was optimised, 2 if one could not be
    optimised. Raises ConfigurationError, StorageError."""
    settings = load_settings(options.cell)
    garment = load_garment(options.garment, settings.surface)
    _check_export(options.export)
    check_step(garment, options.step)
    method = options.method or settings.optimiser.method
    bar = ProgressBar(progress_stream(options.json))
    results: list[dict[str, Any]] = []
    poses: dict[str, dict[str, Array]] = {}
    with report_compilation(bar.line):
        for fold in optimise_plan(
            garment, settings, options.step, method, options.budget, bar.restart, partial(_show, bar)
        ):
            results.append(_figures(fold, settings.grasp.lift_height))
            bar.line(_line(results[-1]))
            if fold.paths:
                poses[fold.step.name] = {i.value: pose_rows(path) for i, path in fold.paths.items()}
    bar.clear()
    export = str(options.export) if options.export and poses else None
    if options.export is not None and not poses:
        bar.line(f"no fold has a trajectory; {options.export} is not written")
    elif options.export is not None:
        write_whole(options.export, tool_poses_text(garment.name, poses, options.export.suffix).encode())
        bar.line(f"tool poses and times  {options.export}")
    figures = {"garment": garment.name, "method": method, "steps": results, "export": export}
    return answer(options, figures, (), 2 if any(s["failure"] for s in results) else 0)


def _show(bar: ProgressBar, step: FoldStep, done: int, budget: int, best: float) -> None:
    bar.update(done, budget, f"simulations of fold {step.index + 1} {step.name}: best D {1e3 * best:.1f} mm")


def _check_export(path: Path | None) -> None:
    if path is None:
        return
    if path.suffix not in MARKS:
        raise ConfigurationError(f"--export {path}: a file ending in {', '.join(MARKS)} is expected")
    refuse_foreign(path, MARKS[path.suffix])


def _figures(fold: StepOptimisation, lift_height: float) -> dict[str, Any]:
    step, outcome, trajectory = fold.step, fold.outcome, fold.outcome.value
    return {
        "name": step.name,
        "step": step.index + 1,
        **outcome.notes,
        "lift_m": lift_height,
        "duration_s": trajectory.duration if trajectory else None,
        "wall_time_s": fold.wall_time_s,
        "control_points_m": trajectory.control_points if trajectory else None,
        "failure": outcome.failure,
    }


def _line(figures: dict[str, Any]) -> str:
    name = f"fold {figures['step']} {figures['name']}: "
    if figures["failure"]:
        return name + str(figures["failure"])
    first, best = 1e3 * figures["dissimilarity_initial_m"], 1e3 * figures["dissimilarity_m"]
    return (
        f"{name}D {first:.1f} -> {best:.1f} mm (predicted)"
        f" in {figures['simulations']} simulations, {figures['wall_time_s']:.1f} s"
    )
