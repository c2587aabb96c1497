"""`foldcell hil`: performs scripted runs and checks each against the expectations of its script, or climbs the
ladder."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from foldcell.cell.campaigns.hil.script import Script, read_script
from foldcell.cell.campaigns.hil.script_run import ScriptResult, check_script, run_script
from foldcell.cell.commands.run.ladder import LADDER, SPEEDS, run_ladder
from foldcell.cell.commands.shared import answer, cell_option, driver_options, logs_option, teller
from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.hardware.placement import refuse_unfit_folds
from foldcell.cell.support.files.paths import (
    campaign_folder,
    checked_name,
    logs_directory,
    prepare_logs,
    space_for,
)
from foldcell.cell.support.files.whole_file import refuse_foreign, write_whole
from foldcell.cell.support.json_values import write_json
from foldcell.cell.support.junit import JUnitCase, junit_text
from foldcell.cell.support.process.lock import OwnerLock
from foldcell.cell.support.process.signals import BY_SIGNAL, Terminated
from foldcell.robots.errors import ConfigurationError

RESULTS = "hil.json"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scripts", nargs="+", type=Path, metavar="SCRIPT",
        help=f"YAML files, or folders of them; or '{LADDER}': the steps of a first day at a robot",
    )  # fmt: skip
    driver_options(parser)
    cell_option(parser)
    logs_option(parser)
    parser.add_argument("--live", action="store_true", help="show the runs in a Rerun viewer while they last")
    parser.add_argument("--realtime", action="store_true", help="simulated time passes no faster than the clock")
    parser.add_argument(
        "--junit", type=Path, metavar="FILE", help="write the results as JUnit XML, for a build server"
    )
    parser.add_argument("--from", dest="begin", metavar="STEP", help=f"{LADDER}: the first step (the very first)")
    parser.add_argument(
        "--speed", choices=SPEEDS, default="commissioning", help=f"{LADDER}: limits of all motions (commissioning)"
    )


def run(options: argparse.Namespace) -> int:
    """Run the scripts. Returns 0 if every script passed, 2 if one did not, 3 if a cell had an unexpected fault.

    All scripts are read and checked before the first run begins. A signal ends the present run and skips the
    remaining scripts. The results of the performed runs are printed and written even if an error ends the command.
    """
    if options.scripts == [Path(LADDER)]:
        return run_ladder(options)
    if options.begin is not None:
        raise ConfigurationError("--from is for the ladder, not for scripts", f"foldcell hil {LADDER} --from STEP")
    settings = load_settings(options.cell)
    scripts = [read_script(path) for path in _files(options.scripts)]
    for script in scripts:
        refuse_unfit_folds([script.garment_named], check_script(script, settings, options.driver))
    if options.junit is not None:
        refuse_foreign(options.junit, b'<testsuite name="foldcell hil"')
    logs = prepare_logs(logs_directory(options.logs), space_for(len(scripts)))
    # each simulated run has its own cell; a real one is owned for all scripts
    with nullcontext() if is_simulated(options.driver) else OwnerLock(logs / "cell.lock"):
        return _campaign(options, settings, scripts, campaign_folder(logs, "hil"))


def _campaign(options: argparse.Namespace, settings: CellSettings, scripts: list[Script], folder: Path) -> int:
    done: list[ScriptResult] = []
    ended_by: int | None = None
    try:
        ended_by = _perform(options, settings, scripts, folder, done)
    except KeyboardInterrupt as e:  # a signal between two runs; during a run, a signal stops that run
        ended_by = e.number if isinstance(e, Terminated) else signal.SIGINT
    finally:  # also after an exception
        left = scripts[len(done) :]
        figures = _figures(done, left, options.driver)
        answer(options, {**figures, "directory": str(folder)}, _summary(done, left, folder))
        write_json(folder / RESULTS, figures)
        if options.junit is not None:
            cases = [p.as_case() for p in done]
            cases += [JUnitCase(script.name, skipped="interrupted before it was run") for script in left]
            write_whole(options.junit, junit_text("foldcell hil", cases))
    if ended_by is not None:
        return BY_SIGNAL + ended_by
    return 3 if any(p.faulty for p in done) else 2 if any(not p.passed for p in done) else 0


def _perform(
    options: argparse.Namespace, settings: CellSettings, scripts: list[Script], folder: Path,
    done: list[ScriptResult],
) -> int | None:  # fmt: skip
    """Run the scripts in order and append each result to `done`. Returns the signal that ended a run, or None."""
    tell = teller(options.json)
    for number, script in enumerate(scripts, 1):
        tell(f"{number:3d}/{len(scripts)}  {script.name}: {script.about}")
        performance = run_script(
            script, settings, folder, driver=options.driver, world=options.world, live=options.live,
            realtime=options.realtime, tell=lambda line: print(f"         -> {line}", file=sys.stderr, flush=True),
        )  # fmt: skip
        done.append(performance)
        write_json(
            folder / RESULTS, _figures(done, scripts[number:], options.driver)
        )  # the process may be killed later
        tell(_outcome(performance))
        if performance.result is not None and performance.result.signal is not None:
            return performance.result.signal
    return None


def _files(given: list[Path]) -> list[Path]:
    """Return the given scripts and those in the given folders. Raises ConfigurationError for a folder without
    scripts."""
    files: list[Path] = []
    for path in given:
        inside = sorted(p for p in path.iterdir() if p.suffix in (".yaml", ".yml")) if path.is_dir() else [path]
        if not inside:
            raise ConfigurationError(
                f"{path} contains no script", "scripts are YAML files; see docs/do/scripts.md"
            )
        files += (Path(checked_name(str(file), "script")) for file in inside)
    return files


def _figures(done: list[ScriptResult], left: list[Script], driver: str) -> dict[str, Any]:
    return {
        "schema": 1,
        "simulated": is_simulated(driver),
        "passed": sum(p.passed for p in done),
        "failed": sum(not p.passed for p in done),
        "not_performed": [str(script.path) for script in left],
        "scripts": [p.as_json() for p in done],
    }


def _outcome(p: ScriptResult) -> str:
    times = f"{p.result.robot_time_s:.1f} s robot, {p.seconds:.1f} s wall" if p.result else "no run"
    lines = [f"         {'passed' if p.passed else 'FAILED'}  ({times})"]
    lines += [f"         - {what}" for what in p.broken]
    if p.result:
        lines.append(f"         {p.result.run_dir}/report.html")
    return "\n".join(lines)


def _summary(done: list[ScriptResult], left: list[Script], folder: Path) -> Iterator[str]:
    failed = [p.script.name for p in done if not p.passed]
    names = f"; failed: {', '.join(failed)}" if failed else ""
    yield f"\n{len(done) - len(failed)} of {len(done)} passed{names}"
    if left:
        yield f"not performed: {', '.join(script.name for script in left)}"
    yield f"details  {folder / RESULTS}"
