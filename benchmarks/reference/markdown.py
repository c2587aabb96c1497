"""Parts of Markdown pages that are written from the program."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any


def cell(text: str) -> str:
    """Return a text for a cell of a table, without marks."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("`", "")


def table(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> list[str]:
    """Return the lines of a table; none without rows. Cells are Markdown."""
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in rows]
    return ["| " + " | ".join(names) + " |", "|---" * len(names) + "|", *lines] if lines else []
