"""Compute the prediction of `foldcell garment check`, show its progress, and describe it in words and figures."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from foldcell.cell.commands.shared import progress_stream, write_drawing
from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.config.trajectory_library.ideal_heights_file import ideal_heights_of
from foldcell.cell.config.trajectory_library.library_file import load_library, user_library_path
from foldcell.cell.hardware.placement import PlacedFold
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.operator.progress.bar import ProgressBar
from foldcell.cell.operator.progress.compiling import report_compilation
from foldcell.cell.planning.plan_prediction import PlanPrediction, PredictedFold, predict_plan
from foldcell.cell.support.files.paths import logs_directory
from foldcell.skills.garments.garment import Garment

ARCS = {"library": "stored arc", "plain": "plain arc", "optimised": "optimised arc"}


def predict(
    options: argparse.Namespace, garment: Garment, settings: CellSettings, folds: Sequence[PlacedFold]
) -> PlanPrediction:
    """Predict the folds of a garment with the variants that the arms can make, and show the progress. Raises
    ConfigurationError."""
    logs = logs_directory(options.logs)
    bar = ProgressBar(progress_stream(options.json))
    with report_compilation(bar.line):
        found = predict_plan(
            garment, settings, load_robot(settings), load_library(logs).library,
            {fold.name: fold.variant for fold in folds}, ideal_heights_of(garment, user_library_path(logs)),
            options.optimise, bar.restart, lambda done, total, remark: bar.update(done, total, remark),
            lambda line: bar.line(f"{garment.name}: {line}"),
        )  # fmt: skip
    bar.clear()
    return found


def draw_prediction(
    options: argparse.Namespace, garment: Garment, settings: CellSettings, found: PlanPrediction
) -> str | None:
    """Draw the predicted folds into the folder of --draw, and return the picture's path; None without a folder."""
    if options.draw is None:
        return None
    from foldcell.cell.report.pictures.prediction_drawing import draw_predictions

    picture = draw_predictions(garment.name, found.folds, settings.table)
    return write_drawing(options.draw, f"{garment.name}-predicted", picture)


def lines(found: PlanPrediction) -> list[str]:
    """Say in plain words how each fold is predicted to go, and why a fold will not succeed."""
    said = []
    for fold in found.folds:
        head = f"fold {fold.step.index + 1} {fold.step.name}"
        if fold.score is not None:
            said.append(f"{head}: {', '.join(_words(fold))}")
        said += [f"{head}: {reason.what}" for reason in fold.reasons]
        said += [f"  {hint}" for hint in dict.fromkeys(reason.hint for reason in fold.reasons)]
    left = found.planned - len(found.folds)
    if left:
        said.append(f"{left} more {'fold was' if left == 1 else 'folds were'} not predicted")
    return said


def figures(found: PlanPrediction, drawing: str | None) -> dict[str, Any]:
    """Return the prediction as plain values for --json."""
    return {
        "good": found.good,
        "optimised": found.optimised,
        "drawing": drawing,
        "folds": [_figures(fold) for fold in found.folds],
    }


def _words(fold: PredictedFold) -> list[str]:
    assert fold.score is not None
    seen, arc = fold.score.figures, fold.trajectory
    words = [
        f"simulated, {1e3 * fold.dissimilarity_m:.1f} mm off on average (limit {1e3 * fold.limit_m:.0f})",
        f"key points up to {1e3 * seen['keypoints_m'].value:.0f} mm (limit {1e3 * seen['keypoints_m'].limit:.0f})",
        f"overlap {seen['iou'].value:.2f} (at least {seen['iou'].limit:.2f})",
    ]
    if fold.score.ideal is not None:
        for part, name in (("high", "height_m"), ("at the creases", "crease_height_m")):
            words.append(f"{1e3 * seen[name].value:.0f} mm {part} (limit {1e3 * seen[name].limit:.0f})")
    if arc is not None:
        words.append(ARCS[arc.source] + (f" of {arc.simulations} simulations" if arc.simulations > 1 else ""))
    return words


def _figures(fold: PredictedFold) -> dict[str, Any]:
    score, arc = fold.score, fold.trajectory
    known: Mapping[str, Any] = {} if score is None else {name: f.value for name, f in score.figures.items()}
    judged = () if score is None else tuple(score.to_json()["limits"])
    return {
        "name": fold.step.name,
        "variant": fold.step.variant,
        "good": fold.good,
        "reasons": [{"what": reason.what, "hint": reason.hint} for reason in fold.reasons],
        "arc": None if arc is None else arc.source,
        "simulations": 1 + (arc.simulations if arc else 0),
        "dissimilarity_m": None if score is None else fold.dissimilarity_m,
        "dissimilarity_limit_m": fold.limit_m,
        **known,
        "limits": {name: score.figures[name].limit for name in judged} if score else {},
        "wall_time_s": fold.wall_time_s,
    }
