"""Read the HTML pages of the program, which share one palette (palette.css).

A page has the line PLACE in its style. Reading replaces this line by the palette, so that every page is complete
in itself. The colour `mark` is for charts of good and bad runs, also for readers who cannot tell red from green.
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["PLACE", "read_page"]

PLACE = "/* palette */\n"
PALETTE = Path(__file__).with_name("palette.css")


def read_page(path: Path) -> str:
    """Return the text of a page or template with its colours."""
    return path.read_text(encoding="utf-8").replace(PLACE, PALETTE.read_text(encoding="utf-8"))
