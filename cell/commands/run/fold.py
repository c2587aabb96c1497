"""`foldcell fold`: performs one run of the cell."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from foldcell.cell.commands.shared import answer, run_options
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.journal.checkpoint_file import has_checkpoint
from foldcell.cell.record.run_record import FoldRecord, RunRecord, ScoreRecord
from foldcell.cell.record.words import (
    figure,
    figure_name,
    garment_name,
    length,
    lost_in_words,
    missed_in_words,
    percent,
    plain,
)
from foldcell.cell.states.transition_table import State
from foldcell.cell.support.files.paths import command_for, logs_directory, prepare_logs
from foldcell.skills.perception.inspection.claim import Claim


def add_options(parser: argparse.ArgumentParser) -> None:
    run_options(parser)
    parser.add_argument("--approve", action="store_true", help="ask before each fold")
    parser.add_argument("--realtime", action="store_true", help="simulated time passes no faster than the clock")
    parser.set_defaults(page=False, page_port=0, page_origin="")


def run(options: argparse.Namespace) -> int:
    """Check the arguments, then open the cell and fold. Raises ConfigurationError, StorageError."""
    settings = load_settings(options.cell)
    if options.garment != "auto":
        load_garment(options.garment, settings.surface)
    logs = prepare_logs(logs_directory(options.logs))
    from foldcell.cell.runs.fold_run import fold_once
    from foldcell.cell.states.fold_request import FoldRequest

    record = fold_once(
        FoldRequest(
            garment=options.garment,
            seed=options.seed,
            driver=options.driver,
            settings=settings,
            logs=logs,
            live=options.live,
            approve=options.approve,
            realtime=options.realtime,
            page=options.page,
            page_port=options.page_port,
            page_origin=options.page_origin or "",
            world=options.world,
            quiet=options.json,
        )
    )
    return tell(record, options)


def tell(record: RunRecord, options: argparse.Namespace) -> int:
    """Print the record of a run, in a few lines or as JSON. Returns the exit code."""
    return answer(options, record.as_json(), _lines(record), record.exit_code)


def _lines(run: RunRecord) -> Iterator[str]:
    seed = f", seed {run.seed}" if run.simulated else ""  # a real cell has no seed
    yield f"\n{garment_name(run.garment)}{seed}: {_result(run)}"
    if run.resumed_from:
        yield f"  resumed {run.resumed_from}"
    if run.recognised:
        yield f"  recognised {plain(run.recognised.garment)}, confidence {run.recognised.confidence:.2f} of 1"
    if run.failure:
        yield f"  {run.failure.what}" + (f" ({run.failure.hint})" if run.failure.hint else "")
        if run.failure.setting:
            yield f"  the limit is {run.failure.setting}"
    for fold in run.steps:
        yield f"  {fold.name}: {_fold(fold)}, attempts {fold.attempts}"
    if run.claim:
        yield f"  claim (camera): {_claim(run.claim)}"
    if run.score:
        yield f"  score (simulated, cloth: {run.world}): {_score(run, run.score)}"
    yield f"  robot time {run.robot_time_s:.1f} s, wall time {run.wall_time_s:.1f} s"
    yield from _files(run)


def _result(run: RunRecord) -> str:
    if run.state is State.STOPPED:
        return "STOPPED (the arms hold their position; the grippers do not open)"
    fault = "FAULT" if run.unwritten else "FAULT (see the report)"
    return {"folded": "folded", "not_folded": "NOT FOLDED (the cell is safe)", "fault": fault}[run.result]


def _fold(fold: FoldRecord) -> str:
    made = fold.source
    if not fold.done:
        made = "not accepted" if fold.accepted is False else "not finished" if fold.attempts else "not made"
    made = ", ".join([str(made), *(repair.partition(":")[0] for repair in fold.repairs)])
    overlap = "" if fold.observed_iou is None else f", observed overlap {fold.observed_iou:.3f}"
    if fold.observed_height_m is None:
        return f"{made}{overlap}"
    pressed = "".join(f", pressed from {length(height, 0)}" for height in fold.pressed_from_m)
    return f"{made}{overlap}, {length(fold.observed_height_m, 0)} high{pressed}"


def _claim(claim: Claim) -> str:
    verdicts = (("shape", claim.shape), ("flat", claim.flat))
    parts = (f"{part} {'yes' if holds else 'no'}" for part, holds in verdicts)
    return (
        f"{', '.join(parts)},"
        f" reliability {percent(claim.reliability)},"
        f" height {length(claim.height_m, 0)} (at most {length(claim.height_limit_m, 0)}),"
        f" creases {length(claim.crease_height_m, 0)} (at most {length(claim.crease_height_limit_m, 0)})"
    )


def _score(run: RunRecord, score: ScoreRecord) -> str:
    verdict = "passed" if score.passed else "not passed"
    open_folds = ", ".join(fold.name for fold in run.steps if not fold.done)
    if open_folds and not score.passed:
        verdict += f" (not completed: {open_folds})"
    if run.result == "folded" and not score.passed:
        verdict += f" ({missed_in_words(score)})"
    names = ("iou", "correspondence_m", "edges_m", "drift_m", "height_m")
    figures = ", ".join(f"{figure_name(name)} {figure(name, getattr(score, name))}" for name in names)
    ideal = "" if score.ideal_height_m is None else f" (of an ideal fold: {length(score.ideal_height_m)})"
    return f"{verdict}, {figures}{ideal}"


def _files(run: RunRecord) -> Iterator[str]:
    """Yield lines about the files that the run left or could not keep, and how it can be resumed."""
    folder, lost = Path(run.run_dir), lost_in_words(run.recording)
    for what in (*run.unwritten, *lost):
        yield f"  not kept   {what}"
    if run.state in {State.STOPPED, State.FAULT} and has_checkpoint(folder):
        resume = command_for(f"resume {folder.name}", folder.parent)
        yield f"  resume     {resume}   (the arms release the garment, park, and the camera looks again)"
    if not run.unwritten:
        yield f"  report     {folder}/report.html"
    if not lost or (folder / "run.rrd").exists():
        replay = command_for("replay last", folder.parent)
        yield f"  recording  {folder}/run.rrd   ({'incomplete; ' if lost else ''}{replay})"
