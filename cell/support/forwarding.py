"""An object that replaces some methods of another object and forwards everything else to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

T = TypeVar("T")


def forwarding(behind: T, **own: Callable[..., Any]) -> T:
    """Return an object with the methods `own`. It takes every other attribute from the object `behind`."""
    return cast(T, _Forwarding(behind, own))


class _Forwarding:
    def __init__(self, behind: object, own: dict[str, Callable[..., Any]]) -> None:
        self._behind = behind
        self.__dict__.update(own)

    def __getattr__(self, name: str) -> Any:  # called for what the object itself does not have
        return getattr(self._behind, name)
