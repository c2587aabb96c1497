"""Finds the commands. What a command does, and its flags, stand in one file of a folder beside this one, which is
imported only when the command is called, so that `foldcell --help` answers at once.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Mapping, Sequence
from typing import NoReturn

from cell.commands.exit_codes import USAGE, framed
from cell.commands.options import add_command

__all__ = ["build_parser", "main"]

COMMANDS: Mapping[str, tuple[str, str]] = {
    "fold": ("run.fold", "fold one garment, from a picture of it to a picture of the result"),
    "supervise": ("run.supervise", "fold under an operator's eyes: each fold is shown and approved first"),
    "hil": ("run.hil", "perform scripted runs and hold each to what its script expects"),
    "trials": ("run.trials", "repeat runs over seeds and garments, with Wilson intervals"),
    "perceive": ("skill.perceive", "key points of the garment in a picture, and an overlay PNG"),
    "optimise": ("skill.optimise", "find the trajectory of a garment's folds by cloth simulation"),
    "library": ("library.actions", "the library of optimised trajectories"),
    "calibrate": ("calibrate.actions", "measure what the cell has to know, and write it to a file"),
    "garment": ("garment.actions", "the garments that the cell knows"),
    "runs": ("history.runs", "the runs in the journal and how each ended"),
    "tidy": ("history.tidy", "free the disk of old recordings; reports and the journal stay"),
    "report": ("history.report", "what happened in a run, and where its report page is"),
    "replay": ("history.replay", "open a run's recording in the Rerun viewer, or decide it again"),
    "resume": ("run.resume", "go on with a run that was killed, stopped or ended before it had folded"),
    "reset": ("run.reset", "leave the robot's stop, once its cause is cleared (driver ros)"),
    "bench": ("installation.bench", "measure a part of the program beside its peers"),
    "doctor": ("installation.doctor", "what is installed, what is missing, and what to do"),
    "chart": ("installation.chart", "draw the states and what leads where (needs Graphviz)"),
}
"""Name -> module below `cell.commands`, with `add_options(parser)`, and what it is for."""

EPILOG = """exit codes: 0 done, 2 ended safe but not done, 3 fault, 64 bad usage, configuration or logs,
            129 hung up (SIGHUP), 130 interrupted (SIGINT), 143 terminated (SIGTERM)"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code."""
    line = sys.argv[1:] if arguments is None else list(arguments)
    named = next((word for word in line if not word.startswith("-")), None)
    return framed(lambda: build_parser(named or "").parse_args(line), "--json" in line)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """A bad line is a usage error like any other: 64, not argparse's 2 (which means 'not folded' here)."""
        self.print_usage(sys.stderr)
        self.exit(USAGE, f"{self.prog}: {message}\n  see {self.prog} --help\n")


def build_parser(only: str | None = None) -> argparse.ArgumentParser:
    """only: the one command whose flags are wanted; all when None."""
    parser = _Parser(
        prog="foldcell",
        description="The executive of a garment-folding robot cell.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and leave")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, (module, about) in COMMANDS.items():
        command = add_command(commands, name, about)
        if only is None or only == name:
            importlib.import_module(f"cell.commands.{module}").add_options(command)
    return parser


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"foldcell {version('foldcell')}")
        except PackageNotFoundError:
            print("foldcell (not installed)")
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())
