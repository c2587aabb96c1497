"""`foldcell doctor`: checks the installation and prints the findings."""

from __future__ import annotations

import argparse

from foldcell.cell.commands.installation.checks import Verdict, examine
from foldcell.cell.commands.options import json_option, logs_option
from foldcell.cell.commands.output import print_json, print_table
from foldcell.cell.support.files.paths import logs_directory

__all__ = ["add_options", "run"]

_MARKS = {Verdict.GOOD: "ok", Verdict.WARNING: "warn", Verdict.BAD: "BAD"}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=run)
    logs_option(parser)
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Print the findings. Returns 0 if a fold can run here, 3 if something that it needs is missing."""
    checks = examine(logs_directory(options.logs))
    bad = [c for c in checks if c.verdict is Verdict.BAD]
    if options.json:
        print_json({"good": not bad, "checks": checks})
        return 3 if bad else 0
    print_table(("", "what", "found"), [(_MARKS[c.verdict], c.name, c.found) for c in checks])
    for check in checks:
        if check.verdict is not Verdict.GOOD and check.hint:
            print(f"{check.name}: {check.hint}")
    warnings = sum(c.verdict is Verdict.WARNING for c in checks)
    if bad:
        print(f"foldcell cannot run here: {len(bad)} things are missing")
    else:
        print("foldcell can run here" + (f" ({warnings} warnings)" if warnings else ""))
    return 3 if bad else 0
