"""The entry point and the list of commands.

Each command is one module with its flags and its code. The module is imported only if its command is called, so
that `foldcell --help` starts fast. An action's module is imported alone if it has the action's name.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, NoReturn

from foldcell.cell.commands.exit_codes import USAGE, framed
from foldcell.cell.commands.shared import add_command, performed_by
from foldcell.cell.support.files.paths import checked_name

COMMANDS: Mapping[str, tuple[str | tuple[str, ...], str]] = {
    "fold": ("run.fold", "fold one garment, from a picture of it to a picture of the result"),
    "supervise": ("run.supervise", "fold with an operator, who sees and approves each fold first"),
    "hil": ("run.hil", "perform scripted runs and check each against its script"),
    "trials": ("run.trials", "repeat runs over seeds and garments, with Wilson intervals"),
    "perceive": ("skill.perceive", "recognise the garment in a picture and draw its key points into a PNG"),
    "optimise": ("skill.optimise", "find the trajectories of a garment's folds by cloth simulation"),
    "library": (("library.build", "library.show"), "build or show the library of optimised trajectories"),
    "calibrate": (
        ("calibrate.board", "calibrate.cell_calibrations", "calibrate.fabric_calibrations"),
        "measure a property of the cell or a fabric and write it to a file",
    ),
    "garment": (
        ("garment.list", "garment.check", "garment.show", "garment.new"),
        "list, show, check and make garment files",
    ),
    "cell": (("cell.check",), "check and draw the cell that the settings describe"),
    "robot": (("installation.robot",), "list and check robots, and make the package of a new one"),
    "runs": ("history.runs", "list the runs in the journal and how each ended"),
    "dashboard": ("history.dashboard", "serve a page with all runs and campaigns, and two runs side by side"),
    "tidy": ("history.tidy", "remove old recordings to free disk space; reports and the journal stay"),
    "report": ("history.report", "show the effects of a run and the path of its report page"),
    "compare": ("history.compare", "compare two campaigns on the same seeds, or two runs"),
    "replay": ("history.replay", "open a run's recording in the Rerun viewer, or decide it again"),
    "resume": ("run.resume", "resume a run that was killed, stopped or ended before the garment was folded"),
    "reset": ("run.reset", "reset the robot's stop after its cause is cleared (driver ros)"),
    "bench": ("installation.bench", "measure a part of the program and its peers"),
    "doctor": ("installation.doctor", "check the installation: what is missing, and what to do"),
}
"""Name of each command -> its module in `cell.commands`, and its help text. The module has `add_options(parser)`
and `run(options)`. A command with actions has a tuple of modules; each has `add_options(actions)`, which adds one
or more actions."""

GARBAGE = 50_000
"""Python looks for cycles of garbage after this number of new objects. With its own number, 700, this took a tenth
of the time of the imports, which leave no garbage."""

EPILOG = """exit codes: 0 done, 2 ended safe but not done, 3 fault, 64 bad usage, configuration or logs,
            129 hung up (SIGHUP), 130 interrupted (SIGINT), 143 terminated (SIGTERM)"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    gc.set_threshold(GARBAGE)
    line = sys.argv[1:] if arguments is None else list(arguments)
    named = tuple(word for word in line if not word.startswith("-"))[:2] or ("",)
    return framed(lambda: _parsed(line, named), "--json" in line)


def _parsed(line: list[str], commands: Sequence[str]) -> argparse.Namespace:
    """Parse the command line. Every name is checked here, before anything begins: the words of the line, and the
    working directory, because relative names become absolute ones."""
    for word in line:
        checked_name(word, "command line")
    options = build_parser(commands).parse_args(line)
    with suppress(FileNotFoundError):  # it was removed
        checked_name(os.getcwd(), "working directory")
    return options


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Print the error and exit with code 64. argparse's own code for it is 2, which means 'not folded'
        here."""
        self.print_usage(sys.stderr)
        self.exit(USAGE, f"{self.prog}: {message}\n  see {self.prog} --help\n")


def build_parser(only: Sequence[str] = ()) -> argparse.ArgumentParser:
    """Build the parser of the command line. only: the command whose flags are added, and its action if the action
    has a module of its own; empty: the flags of all commands."""
    parser = _Parser(
        prog="foldcell",
        description="The executive of a garment-folding robot cell.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, (modules, about) in COMMANDS.items():
        command = add_command(commands, name, about)
        if only and only[0] != name:
            continue
        if isinstance(modules, str):
            module = _module(modules)
            performed_by(command, module.run)
            module.add_options(command)
            continue
        actions = command.add_subparsers(title="actions", metavar="ACTION", required=True)
        named = [path for path in modules if path.rpartition(".")[2] in only[1:]]
        for path in named or modules:
            _module(path).add_options(actions)
    return parser


def _module(name: str) -> Any:
    return importlib.import_module(f"foldcell.cell.commands.{name}")


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
