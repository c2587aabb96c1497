"""Convert the arguments of the public functions to plain Python values, NumPy's scalars included, or refuse them.

Each function takes the value and the argument's name for messages, and raises ConfigurationError.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from foldcell.robots.errors import ConfigurationError

P = ParamSpec("P")
R = TypeVar("R")


def own_numeric_state(function: Callable[P, R]) -> Callable[P, R]:
    """Let `function` compute with NumPy's default error state, whatever state its caller has set."""

    @wraps(function)
    def with_defaults(*arguments: P.args, **options: P.kwargs) -> R:
        import numpy as np

        with np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"):
            return function(*arguments, **options)

    return with_defaults


def plain(value: Any) -> Any:
    """Return the plain value of a NumPy scalar, an array, or a mapping or list of them; others unchanged."""
    if isinstance(value, Mapping):
        return {plain(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if type(value).__module__ == "numpy" and hasattr(value, "tolist"):
        return value.tolist()
    return value


def whole(value: object, name: str) -> int:
    """Return a whole number, which may be given as a float."""
    given = plain(value)
    if isinstance(given, bool) or not isinstance(given, int | float) or given != given // 1:
        raise ConfigurationError(f"{name}: {value!r} is no whole number", "give an int")
    return int(given)


def number(value: object, name: str) -> float:
    """Return a finite number."""
    given = plain(value)
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given):
        raise ConfigurationError(f"{name}: {value!r} is no finite number", "give a float")
    return float(given)


def flag(value: object, name: str) -> bool:
    given = plain(value)
    if not isinstance(given, bool):
        raise ConfigurationError(f"{name}: {value!r} is neither True nor False")
    return given


def text(value: object, name: str) -> str:
    """Return a text that can be written as UTF-8."""
    from foldcell.cell.support.files.paths import checked_name

    if not isinstance(value, str):
        raise ConfigurationError(f"{name}: {value!r} is no text", "give a str")
    return checked_name(str(value), name)


def path(value: object, name: str) -> Path:
    """Return a path whose name can be written as UTF-8."""
    given = os.fspath(value) if isinstance(value, os.PathLike) else value
    if not isinstance(given, str) or not given:
        raise ConfigurationError(f"{name}: {value!r} is no path", "give a str or a pathlib.Path")
    return Path(text(given, name))
