"""All pages of docs/look_up that are made from the program."""

from __future__ import annotations

from pathlib import Path

from benchmarks.reference import failures, faults, recoveries

__all__ = ["FOLDER", "pages"]

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "look_up"


def pages() -> dict[str, str]:
    """Return the pages: file name -> Markdown."""
    return {**failures.pages(failures.messages()), "recoveries.md": recoveries.page(), "faults.md": faults.page()}
