"""`foldcell doctor`: checks the installation and prints the findings."""

from __future__ import annotations

import argparse

from foldcell.cell.commands.installation.checks import Verdict, examine
from foldcell.cell.commands.shared import answer, logs_option, table
from foldcell.cell.support.files.paths import logs_directory

_MARKS = {Verdict.GOOD: "ok", Verdict.WARNING: "warn", Verdict.BAD: "BAD"}


def add_options(parser: argparse.ArgumentParser) -> None:
    logs_option(parser)


def run(options: argparse.Namespace) -> int:
    """Print the findings. Returns 0 if a fold can run here, 3 if something that it needs is missing."""
    checks = examine(logs_directory(options.logs))
    bad = [c for c in checks if c.verdict is Verdict.BAD]
    warnings = sum(c.verdict is Verdict.WARNING for c in checks)
    verdict = "foldcell can run here" + (f" ({warnings} warnings)" if warnings else "")
    if bad:
        verdict = f"foldcell cannot run here: {len(bad)} things are missing"
    rows = [(_MARKS[c.verdict], c.name, c.found) for c in checks]
    hints = [f"{c.name}: {c.hint}" for c in checks if c.hint]
    lines = [*table(("", "what", "found"), rows), *hints, verdict]
    return answer(options, {"good": not bad, "checks": checks}, lines, 3 if bad else 0)
