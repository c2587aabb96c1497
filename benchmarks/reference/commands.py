"""The pages of the commands, from their parsers."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Mapping

from benchmarks.reference.markdown import cell, table
from foldcell.cell.commands.main import COMMANDS, EPILOG, build_parser

PARTS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "run": ("Commands that run the cell", ("run",)),
    "calibrate": ("Commands that calibrate", ("calibrate",)),
    "plan": ("Commands for garments, cells and folds", ("skill", "library", "garment", "cell")),
    "look": ("Commands that look back", ("history",)),
    "install": ("Commands for the installation", ("installation",)),
}
"""Part of the commands -> title of its page, and the folders of `foldcell.cell.commands` whose commands it has."""


def pages() -> dict[str, str]:
    """Return the pages: file name -> Markdown."""
    whole = [
        "# Commands",
        "",
        "`python -m benchmarks.reference` writes these pages from the commands; `--help` of one says the same.",
        "",
        *table(("command", "what it does"), _index()),
        "",
        "## Exit codes",
        "",
        "Every command ends with one of these codes.",
        "",
        *table(("code", "meaning"), _exit_codes()),
    ]
    made = {"commands.md": "\n".join(whole) + "\n"}
    for part, (title, _) in PARTS.items():
        lines = [f"# {title}", "", "[All commands](commands.md) and exit codes."]
        for name in COMMANDS:
            if _part(name) == part:
                for words, parser in _leaves(name, _choices(build_parser((name,)))[name]):
                    lines += _of_command(words, parser)
        made[f"commands_{part}.md"] = "\n".join(lines) + "\n"
    return made


def _part(name: str) -> str:
    modules = COMMANDS[name][0]
    folder = (modules if isinstance(modules, str) else modules[0]).split(".")[0]
    return next(part for part, (_, folders) in PARTS.items() if folder in folders)


def _index() -> Iterator[tuple[str, str]]:
    for name, (_, about) in COMMANDS.items():
        first, _ = next(_leaves(name, _choices(build_parser((name,)))[name]))
        yield f"[`{name}`](commands_{_part(name)}.md#foldcell-{first.replace(' ', '-')})", about


def _exit_codes() -> list[tuple[str, str]]:
    """Return the codes and their meaning, from the text below the program's help."""
    text = " ".join(EPILOG.split()).removeprefix("exit codes: ")
    return [(f"`{code}`", cell(meaning)) for code, meaning in re.findall(r"(\d+) (.*?)(?:, (?=\d)|$)", text)]


def _choices(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    return next((a.choices for a in parser._actions if isinstance(a, argparse._SubParsersAction)), {})


def _leaves(words: str, parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield the command, or its actions: (words, parser)."""
    nested = _choices(parser)
    if not nested:
        yield words, parser
    for name, action in nested.items():
        yield from _leaves(f"{words} {name}", action)


def _of_command(words: str, parser: argparse.ArgumentParser) -> list[str]:
    given = [a for a in parser._actions if not a.option_strings]
    usage = " ".join([f"foldcell {words} [options]", *map(_argument, given)])
    options = [a for a in parser._actions if a.option_strings and "--help" not in a.option_strings]
    rows = [(f"`{_written(a)}`", cell(_help(a, parser))) for a in (*given, *options)]
    about = parser.description or ""
    return ["", f"## foldcell {words}", "", about, "", f"`{usage}`", "", *table(("argument", "meaning"), rows)]


def _written(action: argparse.Action) -> str:
    """Return an argument or an option as it is written."""
    if not action.option_strings:
        return _value(action)
    names = ", ".join(action.option_strings)
    return names if action.nargs == 0 else f"{names} {_value(action)}"


def _value(action: argparse.Action) -> str:
    if action.choices:
        return "{" + ",".join(map(str, action.choices)) + "}"
    metavar = action.metavar or action.dest.upper()
    return metavar if isinstance(metavar, str) else " ".join(metavar)


def _argument(action: argparse.Action) -> str:
    return {"*": "[{}...]", "+": "{}...", "?": "[{}]"}.get(str(action.nargs), "{}").format(_value(action))


def _help(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    return (action.help or "") % {**vars(action), "prog": parser.prog}
