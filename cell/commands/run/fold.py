"""`foldcell fold`: performs one run of the cell."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from cell.commands.options import json_option, run_options
from cell.commands.output import print_json
from cell.config.cell_settings import load_settings
from cell.config.garments.garment_file import load_garment
from cell.journal.checkpoint_file import has_checkpoint
from cell.report.recording_losses import recording_losses
from cell.support.files.paths import command_for, logs_directory, prepare_logs

if TYPE_CHECKING:
    from cell.states.fold_request import FoldResult

__all__ = ["add_options", "run", "tell"]


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=run)
    run_options(parser)
    parser.add_argument("--approve", action="store_true", help="ask before each fold")
    parser.add_argument("--realtime", action="store_true", help="simulated time passes no faster than the clock")
    parser.set_defaults(page=False, page_port=0)
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Check the arguments, then open the cell and fold. Raises ConfigurationError, StorageError."""
    settings = load_settings(options.cell)
    if options.garment != "auto":
        load_garment(options.garment, settings.surface)
    logs = prepare_logs(logs_directory(options.logs))
    from cell.runs.fold_run import FoldRequest, fold_once

    result = fold_once(
        FoldRequest(
            garment=options.garment,
            seed=options.seed,
            driver=options.driver,
            settings=settings,
            settings_path=options.cell,
            logs=logs,
            live=options.live,
            approve=options.approve,
            realtime=options.realtime,
            page=options.page,
            page_port=options.page_port,
            world=options.world,
            quiet=options.json,
        )
    )
    return tell(result, options.json)


def tell(result: FoldResult, json: bool) -> int:
    """Print the result of a run, in a few lines or as JSON. Returns the exit code."""
    if json:
        print_json(result.as_json())
    else:
        _summary(result.as_json())
    return int(result.exit_code)


def _summary(figures: dict) -> None:
    unwritten = figures.get("unwritten") or ()
    fault = "FAULT" if unwritten else "FAULT (see the report)"
    words = {"folded": "folded", "not_folded": "NOT FOLDED (the cell is safe)", "fault": fault}
    result = str(figures.get("result"))
    if figures.get("state") == "stopped":
        words[result] = "STOPPED (the arms hold their position; the grippers do not open)"
    seed = f", seed {figures.get('seed')}" if figures.get("simulated", True) else ""  # a real cell has no seed
    print(f"\n{figures.get('garment')}{seed}: {words.get(result, result)}")
    if figures.get("resumed_from"):
        print(f"  resumed {figures['resumed_from']}")
    seen = figures.get("recognised")
    if seen:
        print(f"  recognised {seen['garment'].replace('_', ' ')}, confidence {seen['confidence']:.2f} of 1")
    failure = figures.get("failure")
    if failure:
        print(f"  {failure['what']}" + (f" ({failure['hint']})" if failure.get("hint") else ""))
        if failure.get("setting"):
            print(f"  the limit is {failure['setting']}")
    for step in figures.get("steps") or []:
        overlap = step.get("observed_iou")
        seen = f", observed overlap {overlap:.3f}" if isinstance(overlap, float) else ""
        if isinstance(step.get("observed_height_m"), float):
            seen += f", {_mm(step['observed_height_m'])} high"
            seen += "".join(f", pressed from {_mm(height)}" for height in step.get("pressed_from_m") or ())
        made = step.get("source")
        if not step.get("done"):
            made = "not accepted" if step.get("accepted") is False else "not finished"
            made = made if step.get("attempts") else "not made"
        print(f"  {step.get('name')}: {made}{seen}, attempts {step.get('attempts')}")
    claim = figures.get("claim")
    if claim:
        print(f"  claim (camera): {_claimed(claim)}")
    score = figures.get("score")
    if score:
        verdict = "passed" if score.get("passed") else "not passed"
        if result == "folded" and not score.get("passed"):
            verdict += f" ({_missed(score)})"
        ideal = score.get("ideal_height_m")
        print(
            f"  score (simulated, cloth: {figures.get('world')}): {verdict}, IoU {_figure(score.get('iou'))},"
            f" correspondence {_mm(score.get('correspondence_m'))}, edges {_mm(score.get('edges_m'))},"
            f" drift {_mm(score.get('drift_m'))}, height {_mm(score.get('height_m'))}"
            + (f" (of an ideal fold: {_mm(ideal)})" if ideal is not None else "")
        )
    print(
        f"  robot time {figures.get('robot_time_s', 0.0):.1f} s, wall time {figures.get('wall_time_s', 0.0):.1f} s"
    )
    lost = recording_losses(figures.get("recording") or {})
    for what in (*unwritten, *lost):
        print(f"  not kept   {what}")
    folder = figures.get("run_dir")
    if folder and figures.get("state") in {"stopped", "fault"} and has_checkpoint(Path(folder)):
        resume = command_for(f"resume {Path(folder).name}", Path(folder).parent)
        print(f"  resume     {resume}   (the arms release the garment, park, and the camera looks again)")
    if folder:
        if not unwritten:
            print(f"  report     {folder}/report.html")
        if not lost or Path(folder, "run.rrd").exists():
            replay = command_for("replay last", Path(folder).parent)
            print(f"  recording  {folder}/run.rrd   ({'incomplete; ' if lost else ''}{replay})")


def _claimed(claim: dict) -> str:
    parts = ", ".join(f"{part} {'yes' if claim.get(part) else 'no'}" for part in ("shape", "flat"))
    return (
        f"{parts}, reliability {100 * claim.get('reliability', 0.0):.0f} %,"
        f" height {_mm(claim.get('height_m'))} (at most {_mm(claim.get('height_limit_m'))}),"
        f" creases {_mm(claim.get('crease_height_m'))} (at most {_mm(claim.get('crease_height_limit_m'))})"
    )


def _missed(score: dict) -> str:
    """Return the figures of the score that are beyond their limits, each with its limit."""
    missed = []
    for name, limit in (score.get("limits") or {}).items():
        value, word = score[name], name.rpartition("_")[0] or name
        if name == "iou" and value < limit:
            missed.append(f"IoU {value:.3f}, limit {limit:.3f}")
        elif name.endswith("_m") and value > limit:
            missed.append(f"{word} {1e3 * value:.1f} mm, limit {1e3 * limit:.1f}")
        elif name.endswith("_rad") and value > limit:
            missed.append(f"turn {math.degrees(value):.1f} degrees, limit {math.degrees(limit):.1f}")
    ideal = score.get("ideal") or {}
    if ideal.get("reason"):
        missed.append(f"the heights are not judged, because the ideal fold is not valid: {ideal['reason']}")
    return "; ".join(missed)


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _mm(value: float | None) -> str:
    return "-" if value is None else f"{1e3 * value:.0f} mm"
