"""`foldcell reset`: leave the robot's stop, once a person has seen to its cause. The motors stay off."""

from __future__ import annotations

import argparse
import sys

from cell.attendant import PersonAttendant
from cell.commands import CommandQueue
from cell.config import load_settings
from cell.driver import opened_cell
from cell.simulation import SimulationSettings
from cell.subcommands.output import print_json
from robots.errors import DriverError, FailureKind
from robots.ports import Stop

__all__ = ["run"]


def run(options: argparse.Namespace) -> int:
    """0: it is not stopped any more; 2: it still is, since nobody agreed or the robot does not leave its stop."""
    settings = load_settings(options.cell)
    with opened_cell("ros", SimulationSettings(), 0, settings, _nobody) as ports:
        stop = ports.stop.state()
        if not stop.stopped:
            return _told(options, "not stopped", "the robot is not stopped")
        if not (options.yes or _agreed(stop.reason)):
            return _told(options, "stopped", f"left stopped: {stop.reason}")
        try:
            ports.stop.reset()
        except DriverError as e:
            if e.kind is not FailureKind.STOPPED:
                raise
            return _told(options, "stopped", f"{e.what}; {e.hint}")
        return _told(options, "reset", f"reset ({stop.reason}); the motors stay off until the next run")


def _nobody(stop: Stop) -> PersonAttendant:
    return PersonAttendant(CommandQueue(), stop, lambda _: None)


def _agreed(reason: str) -> bool:
    print(f"The robot is stopped: {reason}.", file=sys.stderr)
    question = "Is the cause cleared, and nobody within reach of the arms? (yes) "
    print(question, end="", file=sys.stderr, flush=True)
    return sys.stdin is not None and sys.stdin.readline().strip().lower() == "yes"


def _told(options: argparse.Namespace, state: str, text: str) -> int:
    if options.json:
        print_json({"state": state, "what": text})
    else:
        print(text)
    return 2 if state == "stopped" else 0
