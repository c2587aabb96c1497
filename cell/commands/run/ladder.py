"""`foldcell hil ladder`: the ordered steps of a first day at a robot."""

from __future__ import annotations

import argparse
import time

from foldcell.cell.calibrating.session import CalibrationRequest
from foldcell.cell.campaigns.ladder.climb import Passes, climb, write_results
from foldcell.cell.campaigns.ladder.page import write_page
from foldcell.cell.campaigns.ladder.steps import STEPS
from foldcell.cell.commands.shared import answer, confirmed, teller
from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.support.files.paths import campaign_folder, logs_directory, prepare_logs
from foldcell.cell.support.files.whole_file import refuse_foreign, write_whole
from foldcell.cell.support.junit import JUnitCase, junit_text
from foldcell.cell.support.process.signals import BY_SIGNAL
from foldcell.robots.errors import ConfigurationError

LADDER = "ladder"
SUITE = "foldcell ladder"
SPEEDS = {"commissioning": 0.3, "planning": None}
"""Set of accelerations -> the velocity scale that goes with it; None: as in the settings."""


def run_ladder(options: argparse.Namespace) -> int:
    """Climb the ladder. Returns 0 if all steps from the first on passed, 2 if one did not and the cell is safe, 3
    if it is not, and 128 + its number after a signal. Raises ConfigurationError before anything moves."""
    if options.live or options.world != "xpbd":
        raise ConfigurationError(
            "the ladder has no --live and no --world", "leave them out; a step's report has a film"
        )
    settings = _at_speed(load_settings(options.cell), options.speed)
    if options.junit is not None:
        refuse_foreign(options.junit, f'<testsuite name="{SUITE}"'.encode())
    logs = prepare_logs(logs_directory(options.logs))
    passes = Passes(logs / f"ladder-{settings.robot}-{options.driver}.json")
    begin = options.begin or STEPS[0].name
    request = CalibrationRequest(
        name=LADDER, seed=0, driver=options.driver, settings=settings, logs=logs, realtime=options.realtime,
        say=teller(options.json),
    )  # fmt: skip
    began = time.monotonic()
    climbed = climb(request, begin, passes, confirmed)
    folder = campaign_folder(logs, LADDER)
    page = write_page(folder, climbed, options.driver, is_simulated(options.driver), options.speed)
    content = write_results(folder, climbed, options.driver)
    if options.junit is not None:
        tried = {result.of.name: result.as_case() for result in climbed.results}
        left = [JUnitCase(step.name, skipped="not tried") for step in STEPS if step.name not in tried]
        write_whole(options.junit, junit_text(SUITE, [*tried.values(), *left]))
    good = all(result.passed for result in climbed.results)
    code = (0 if good else 2) if climbed.safe else 3
    if climbed.signal is not None:
        code = BY_SIGNAL + climbed.signal
    took = f"{content['passed']} of {len(climbed.results)} steps passed, {time.monotonic() - began:.0f} s"
    return answer(options, {**content, "page": str(page)}, [f"\n{took}", f"page  {page}"], code)


def _at_speed(settings: CellSettings, speed: str) -> CellSettings:
    scale = SPEEDS[speed] or settings.motion.velocity_scale
    motion = settings.motion.model_copy(update={"accelerations": speed, "velocity_scale": scale})
    return settings.model_copy(update={"motion": motion})
