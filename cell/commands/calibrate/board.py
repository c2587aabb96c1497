"""`foldcell calibrate board`: writes the calibration board as a sheet to print."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from foldcell.calibration.board import BOARD, DICTIONARY
from foldcell.calibration.board_sheet import PAGE, PIXELS_PER_MM, RULER_MM, draw_sheet
from foldcell.cell.calibrating.sheet_file import SHEET_FORMATS, SHEET_MARKS
from foldcell.cell.commands.shared import Commands, add_command, answer
from foldcell.cell.support.files.whole_file import refuse_foreign, write_whole
from foldcell.robots.errors import ConfigurationError


def add_options(actions: Commands) -> None:
    board = add_command(
        actions, "board", "write the calibration board as a page to print, A4 and true to scale", run
    )
    board.add_argument(
        "--output", type=Path, required=True, metavar="FILE", help="the page: .pdf, or .png of 304.8 dots an inch"
    )


def run(options: argparse.Namespace) -> int:
    """Write the sheet and print its dimensions. No cell is opened. Raises ConfigurationError, StorageError."""
    path = options.output
    write = SHEET_FORMATS.get(path.suffix.lower())
    if write is None:
        hint = "give --output a name that ends in .pdf or .png"
        raise ConfigurationError(f"{path} is neither PDF nor PNG", hint)
    refuse_foreign(path, SHEET_MARKS[path.suffix.lower()])
    write_whole(path, write(draw_sheet(), PIXELS_PER_MM))
    figures = _figures() | {"file": str(path.absolute())}
    following = (
        f"  next: print it at 100 % (not 'fit to page'), measure the line of {RULER_MM} mm and the pattern, cut"
        f" the card\n  to {_shown(figures['card_mm'])} mm and glue it flat on a stiff plate with a tab"
        " (docs/do/calibrate.md, Print the board)"
    )
    lines = [f"  {name:<28} {_shown(value)}" for name, value in figures.items()]
    return answer(options, {"calibration": "board", **figures}, [*lines, following])


def _figures() -> dict[str, Any]:
    """Return the dimensions of the printed sheet, most of them in [mm]."""
    square = 1e3 * BOARD.square
    return {
        "type": f"ChArUco, {BOARD.columns} x {BOARD.rows} squares",
        "dictionary": DICTIONARY,
        "square_mm": round(square, 3),
        "marker_mm": round(1e3 * BOARD.marker, 3),
        "pattern_mm": [round(BOARD.columns * square, 3), round(BOARD.rows * square, 3)],
        "card_mm": [round(1e3 * length, 3) for length in BOARD.size],
        "tab_mm": round(1e3 * BOARD.tab, 3),
        "page_mm": list(PAGE),
        "dpi": round(25.4 * PIXELS_PER_MM, 1),
        "ruler_mm": RULER_MM,
    }


def _shown(value: Any) -> str:
    return " x ".join(f"{v:g}" for v in value) if isinstance(value, list) else str(value)
