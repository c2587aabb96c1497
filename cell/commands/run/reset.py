"""`foldcell reset`: leave the robot's stop, once a person has seen to its cause. The motors stay off."""

from __future__ import annotations

import argparse
import sys

from cell.commands.options import json_option
from cell.commands.output import print_json
from cell.hardware.driver import stop_circuit
from robots.errors import DriverError, FailureKind
from robots.ports import Stop

__all__ = ["add_options", "run"]


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=run)
    parser.add_argument("--yes", action="store_true", help="the cause is cleared and nobody is near: do not ask")
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """0: it is not stopped any more; 2: it still is, since nobody agreed or the robot does not leave its stop."""
    with stop_circuit() as stop:
        before = stop.state()
        if not before.stopped:
            return _told(options, "not stopped", "the robot is not stopped")
        if not (options.yes or _agreed(before.reason)):
            return _told(options, "stopped", f"left stopped: {before.reason}")
        if _pressed_since(stop, before.reason):
            return _told(options, "stopped", f"stopped anew meanwhile: {stop.state().reason}")
        try:
            stop.reset()
        except DriverError as e:
            if e.kind is not FailureKind.STOPPED:
                raise
            return _told(options, "stopped", f"{e.what}; {e.hint}")
        return _told(options, "reset", f"reset ({before.reason}); the motors stay off until the next run")


def _pressed_since(stop: Stop, reason: str) -> bool:
    """Whether it is another stop by now than the one that was agreed to leave."""
    return stop.state().reason != reason


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
