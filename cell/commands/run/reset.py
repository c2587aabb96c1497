"""`foldcell reset`: resets the robot's stop after a person has cleared its cause. The motors stay off."""

from __future__ import annotations

import argparse
import sys

from foldcell.cell.commands.shared import answer, cell_option, confirmed
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.driver import stop_circuit
from foldcell.robots.errors import DriverError, FailureKind


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--yes", action="store_true", help="the cause is cleared and nobody is near: do not ask")
    cell_option(parser)


def run(options: argparse.Namespace) -> int:
    """Reset the stop. Returns 0 if the robot is no longer stopped, 2 if it is still stopped because the person did
    not agree or the reset failed."""
    with stop_circuit(load_settings(options.cell)) as stop:
        before = stop.state()
        if not before.stopped:
            return _report(options, "not stopped", "the robot is not stopped")
        if not (options.yes or _agreed(before.reason)):
            return _report(options, "stopped", f"still stopped: {before.reason}")
        if stop.state().reason != before.reason:  # the person agreed to another one
            return _report(options, "stopped", f"stopped again meanwhile: {stop.state().reason}")
        try:
            stop.reset()
        except DriverError as e:
            if e.kind is not FailureKind.STOPPED:
                raise
            return _report(options, "stopped", f"{e.what}; {e.hint}")
        return _report(options, "reset", f"reset ({before.reason}); the motors stay off until the next run")


def _agreed(reason: str) -> bool:
    print(f"The robot is stopped: {reason}.", file=sys.stderr)
    return confirmed("Is the cause cleared, and nobody within reach of the arms?")


def _report(options: argparse.Namespace, state: str, text: str) -> int:
    return answer(options, {"state": state, "what": text}, [text], 2 if state == "stopped" else 0)
