"""Reads the figures that a benchmark printed, for the scripts that write the results pages."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from foldcell.robots.errors import CellError, ConfigurationError

USAGE = 64


def read_figures(arguments: Sequence[str], bench: str, program: str) -> dict[str, Any]:
    """Read the JSON object that is a file's content, or its last line: the output of `foldcell bench NAME --json`.

    arguments: of the command line of `program`, the name of the file; bench: NAME. Raises
    ConfigurationError for other arguments, and for a file that cannot be read or that contains no object.
    """
    hint = f"give the output of: foldcell bench {bench} --json"
    if len(arguments) != 1:
        raise ConfigurationError("one file of figures is expected", f"python -m {program} figures.json")
    path = Path(arguments[0])
    try:
        text = path.read_text(encoding="utf-8").strip()
    except OSError as e:
        raise ConfigurationError(f"{path} cannot be read: {e.strerror}", hint) from e
    except UnicodeDecodeError as e:
        raise ConfigurationError(f"{path} is no text", hint) from e
    for part in (text, text.rpartition("\n")[2]):
        try:
            figures = json.loads(part)
        except ValueError:
            continue
        if isinstance(figures, dict):
            return figures
    raise ConfigurationError(f"{path} holds no figures", hint)


def command(main: Callable[[Sequence[str]], int]) -> int:
    """Call `main` with the arguments of the command line, and return its exit code. An error of the user gives a
    message and exit code 64, without a traceback."""
    try:
        return main(sys.argv[1:])
    except CellError as e:
        print(f"{e.what}\n  {e.hint}", file=sys.stderr)
        return USAGE
