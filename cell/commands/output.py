"""Print the output of the commands: text for people, and one JSON line for programs."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = [
    "answer",
    "confirmed",
    "progress_stream",
    "refuse_drawing",
    "table",
    "teller",
    "write_drawing",
]


def answer(options: Namespace, figures: Mapping[str, Any], lines: Iterable[str], code: int = 0) -> int:
    """Print the result of a command: with --json the figures for programs, else the lines for people. Returns the
    exit code of the command."""
    from foldcell.cell.support.json_values import to_json

    if options.json:  # one line, in ASCII, which every stream can encode
        lines = [json.dumps(to_json(figures), allow_nan=False)]
    for line in lines:
        print(line, flush=True)
    return code


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> Iterator[str]:
    """Yield the lines of a table. Columns of numbers are aligned to the right."""
    cells = [[_text(v) for v in row] for row in rows]
    width = [max(len(line[i]) for line in (list(head), *cells)) for i in range(len(head))]
    right = [
        bool(rows) and all(isinstance(row[i], int | float) or row[i] is None for row in rows)
        for i in range(len(head))
    ]
    for line in (list(head), *cells):
        padded = [c.rjust(w) if r else c.ljust(w) for c, w, r in zip(line, width, right, strict=True)]
        yield "  ".join(padded).rstrip()


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}" if isinstance(value, float) else str(value)


def progress_stream(as_json: bool) -> Any:
    """Return the stream for progress messages: standard error with --json, else standard output."""
    return sys.stderr if as_json else sys.stdout


def teller(as_json: bool) -> Callable[[str], None]:
    """Return a function that prints a progress message at once."""
    return partial(print, file=progress_stream(as_json), flush=True)


def confirmed(question: str) -> bool:
    """Ask the person at the terminal. Whether the answer is yes."""
    print(f"{question} (yes) ", end="", file=sys.stderr, flush=True)
    return sys.stdin is not None and sys.stdin.readline().strip().lower() == "yes"


def write_drawing(folder: Path, name: str, picture: NDArray[np.uint8]) -> str:
    """Write the picture (H, W, 3) as a PNG into the folder, and return its path. Raises like `refuse_drawing`, and
    StorageError if the file cannot be written."""
    from foldcell.cell.support.files.encoded_picture import write_png

    path = refuse_drawing(folder, name)
    write_png(path, picture)
    return str(path)


def refuse_drawing(folder: Path, name: str) -> Path:
    """Return the path of a drawing. Raises ConfigurationError if the folder does not exist, or if a picture that
    foldcell did not draw has this path. Called also before a drawing's content is computed."""
    from foldcell.cell.support.files.own_file import PNG_MARK, refuse_foreign
    from foldcell.robots.errors import ConfigurationError

    if not folder.is_dir():
        raise ConfigurationError(
            f"{folder}: there is no such folder", "create it, or give another one with --draw"
        )
    path = folder / f"{name}.png"
    refuse_foreign(path, PNG_MARK)
    return path
