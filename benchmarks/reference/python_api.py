"""The pages of the Python API, from its signatures and docstrings."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import foldcell

ABOUT = (
    "`import foldcell`. `python -m benchmarks.reference` writes this page from the docstrings; [from"
    " Python](../learn/python.md) has examples. Lengths are in metres, angles in radians, times in seconds."
)


def pages() -> dict[str, str]:
    """Return the pages: file name -> Markdown."""
    things = {name: getattr(foldcell, name) for name in sorted(foldcell.__all__)}
    functions = ["# Python API: functions", "", ABOUT, "", "Their [values and errors](python_values.md)."]
    values = ["# Python API: values and errors", "", ABOUT, "", "The [functions](python.md) that return them."]
    for name, thing in things.items():
        if inspect.isfunction(thing):
            functions += [
                "",
                f"## {name}",
                "",
                "```text",
                f"foldcell.{name}{_signature(thing)}",
                "```",
                "",
                _text(thing),
            ]
            continue
        values += ["", f"## {name}", "", _text(thing)]
        for part, member in inspect.getmembers(thing, lambda m: isinstance(m, property) or inspect.isfunction(m)):
            about = inspect.getdoc(member)
            if about and not part.startswith("_") and not issubclass(thing, Exception):
                values += ["", f"- `{part}`: {' '.join(about.split())}"]
    return {"python.md": "\n".join(functions) + "\n", "python_values.md": "\n".join(values) + "\n"}


def _signature(function: Callable[..., object]) -> str:
    """Return a signature, one parameter a line if it is long."""
    signature = inspect.signature(function)
    parts, named = [], False
    for p in signature.parameters.values():
        if p.kind is p.KEYWORD_ONLY and not named:
            parts.append("*")
            named = True
        parts.append(f"{p.name}: {p.annotation}" + ("" if p.default is p.empty else f" = {p.default!r}"))
    back = f" -> {signature.return_annotation}"
    short = f"({', '.join(parts)}){back}"
    return short if len(short) < 80 else "(\n" + "".join(f"    {part},\n" for part in parts) + f"){back}"


def _text(thing: object) -> str:
    return (inspect.getdoc(thing) or "").replace("<", "&lt;")
