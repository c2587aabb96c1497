"""Check the names of files that a user gives, before they reach journal, pages and messages."""

from __future__ import annotations

from foldcell.robots.errors import ConfigurationError

__all__ = ["checked_name"]


def checked_name(name: str, what: str) -> str:
    """Return `name` unchanged. what: the argument or variable that holds it, for the message.

    Raises ConfigurationError if it holds bytes that are no UTF-8 (which Python keeps as surrogates), or a zero
    byte. Journal, pages and JSON could not hold the former, and no file has the latter.
    """
    shown = name.encode("utf-8", "backslashreplace").decode().replace("\0", "\\0")
    if shown != name:
        raise ConfigurationError(
            f"{what}: the name '{shown}' is no UTF-8 text", "rename it, or take a copy with another name"
        )
    return name
