"""`foldcell chart`: draws the state chart from the transition table."""

from __future__ import annotations

import argparse
from pathlib import Path

from foldcell.cell.commands.shared import answer
from foldcell.cell.executive.draw_state_chart import draw_chart
from foldcell.cell.states.state_chart import CHART
from foldcell.cell.support.files.paths import repository_root
from foldcell.cell.support.files.whole_file import refuse_foreign, write_whole
from foldcell.robots.errors import ConfigurationError


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--output", type=Path, metavar="SVG", help="file to write (the chart of the report and the page)"
    )


def run(options: argparse.Namespace) -> int:
    """Write the SVG file. Without --output, the new file replaces the chart that reports and the operator's page
    show. Raises ConfigurationError if that belongs to an installed package."""
    if options.output is None and repository_root() is None:
        raise ConfigurationError(
            "the chart of an installed program is not replaced", "name a file with --output SVG"
        )
    path = options.output or CHART
    refuse_foreign(path, b'<svg class="states"')
    write_whole(path, draw_chart())
    return answer(options, {"chart": str(path)}, [str(path)])
