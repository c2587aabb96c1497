"""Every benchmark can be started: its modules are imported, and `foldcell bench NAME` finds what it measures."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from benchmarks.cell import journal
from foldcell.cell.commands.installation.bench import BENCHES

ROOT = Path(__file__).parents[3]
MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in (ROOT / "benchmarks").rglob("*.py")
    if path.stem != "__main__"
)
PEERS = {"mujoco"}
"""Packages that a user's installation may lack."""


@pytest.mark.parametrize("name", MODULES)
def test_every_module_is_imported(name: str) -> None:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as e:
        assert e.name in PEERS, e


@pytest.mark.parametrize("name", sorted(BENCHES))
def test_every_bench_of_the_command_has_a_measure(name: str) -> None:
    assert callable(importlib.import_module(f"benchmarks.{name}").measure)


def test_the_journal_is_measured_beside_a_text_file_and_an_unsynced_database() -> None:
    figures = journal.measure(lambda line: None, lines=5)
    for name in ("journal", "synced_text_file", "unsynced_database"):
        assert figures[f"{name}_line_ms_p99"] >= figures[f"{name}_line_ms_median"] > 0.0
    assert figures["journal_over_text_file"] > 0.0
