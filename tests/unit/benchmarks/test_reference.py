"""The pages of docs/look_up that are made from the program are those of the present program."""

from __future__ import annotations

import ast
from collections.abc import Mapping

import pytest

from benchmarks.reference.failures import CAUSES, Message, _of_file
from benchmarks.reference.pages import FOLDER, pages
from foldcell.cell.record.words import plain
from foldcell.robots.errors import FailureKind


@pytest.fixture(scope="module")
def made() -> Mapping[str, str]:
    return pages()


def test_the_pages_are_those_of_the_present_program(made: Mapping[str, str]) -> None:
    stale = [name for name, text in made.items() if (FOLDER / name).read_text(encoding="utf-8") != text]
    assert stale == [], "run python -m benchmarks.reference"


def test_every_kind_of_failure_has_its_section(made: Mapping[str, str]) -> None:
    """Also the first kind of a part and the last one."""
    sections = [line[3:] for name, text in made.items() if name.startswith("look_up/failures_")
                for line in text.splitlines() if line.startswith("## ")]  # fmt: skip
    assert sections == [plain(kind) for kind in FailureKind]


def test_every_kind_has_a_cause() -> None:
    assert list(CAUSES) == list(FailureKind)


def test_messages_are_found_with_their_remedies() -> None:
    source = """
def lift(side, fast):
    hint = f"look at the {side} hand"
    if fast:
        return Failure(FailureKind.SLIPPED, f"the {side} hand lost it" if fast else "lost", hint)
    raise ConfigurationError("too " + str(fast), "go slower")
"""
    assert sorted(set(_of_file(ast.parse(source)))) == [
        Message("ConfigurationError", "too ...", "go slower"),
        Message("slipped", "lost", "look at the ... hand"),
        Message("slipped", "the ... hand lost it", "look at the ... hand"),
    ]
