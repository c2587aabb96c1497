"""GitHub shows the forms under .github, and the commands in them exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from foldcell.cell.commands.main import build_parser

FORMS = sorted((Path(__file__).resolve().parents[2] / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_a_form_has_what_github_asks_for(path: Path) -> None:
    form = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert form["name"] and form["description"]
    questions = [part for part in form["body"] if part["type"] != "markdown"]
    assert {part["type"] for part in questions} <= {"input", "textarea", "dropdown", "checkboxes"}
    assert all(part["attributes"]["label"] for part in questions)
    assert len({part["id"] for part in questions}) == len(questions) > 0


def test_the_commands_in_the_forms_are_valid() -> None:
    commands = [line for path in FORMS for line in re.findall(r"`foldcell ([^`]+)`", path.read_text())]
    assert len(commands) >= 4
    for line in commands:
        if line != "--version":
            build_parser().parse_args(line.split())
