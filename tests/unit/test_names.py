"""Names that were replaced by the field's terms (CONTRIBUTING.md, Glossary) do not come back."""

from __future__ import annotations

import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("benchmarks", "calibration", "cell", "robots", "skills", "tests")
FORMER = frozenset(
    {
        "Agenda",
        "Answers",
        "Asking",
        "Audience",
        "Errands",
        "Halt",
        "Heard",
        "Hearing",
        "Heavy",
        "Keeper",
        "Listen",
        "Overheard",
        "Past",
        "Performance",
        "Performer",
        "Pump",
        "PunctualClock",
        "Pushes",
        "Remark",
        "Remarks",
        "Said",
        "Stenographer",
        "Touched",
        "Withdrawal",
        "Witness",
        "Zero",
        "ZeroState",
        "applied_to",
        "compiling_told",
        "faded",
        "first_belief",
        "has_belief",
        "heavy_runs",
        "kept_fraction",
        "ledger_path",
        "lighten",
        "moved_along",
        "notes_by_step",
        "perform_script",
        "plan_withdrawal",
        "read_belief",
        "senseless_goal",
        "senseless_height",
        "senseless_paths",
        "senseless_state",
        "start_zero",
        "stenographer",
        "unhindered",
        "write_belief",
        "zero_readings",
    }
)
FORMER_MODULES = frozenset(
    {
        "audience",
        "d_relax",
        "door",
        "drifting",
        "helpful_shift",
        "ledger",
        "pump",
        "remarks",
        "sent",
        "stenographer",
        "tidying",
        "turned",
        "witness",
        "world_of_port",
    }
)


def python_files() -> list[Path]:
    return [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]


def identifiers(path: Path) -> set[str]:
    with path.open("rb") as file:
        return {token.string for token in tokenize.tokenize(file.readline) if token.type == tokenize.NAME}


@pytest.mark.long
def test_no_file_uses_a_former_name() -> None:
    used = {str(path.relative_to(ROOT)): identifiers(path) & FORMER for path in python_files()}
    assert not {path: names for path, names in used.items() if names}


def test_no_module_has_a_former_name() -> None:
    assert not [path for path in python_files() if path.stem.removeprefix("test_") in FORMER_MODULES]
