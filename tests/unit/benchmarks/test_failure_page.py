"""docs/failures.md has all messages of the program."""

from __future__ import annotations

import ast

from benchmarks.failure_page import CAUSES, PAGE, Message, _of_file, messages, page
from robots.errors import FailureKind


def test_the_page_is_that_of_the_present_program() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(messages()), "run python -m benchmarks.failure_page"


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
