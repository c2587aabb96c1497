"""Endurance runs: reproducible, written at once, and their growth."""

from __future__ import annotations

from itertools import islice

from foldcell.cell.campaigns.hil.script import Action
from foldcell.cell.campaigns.trials.endurance import SETTLED, EnduranceRun, growths, random_requests
from foldcell.cell.config.cell_settings import load_settings


def run(process: int, number: int, threads: int = 8, handles: int = 12, memory: float = 600.0) -> EnduranceRun:
    return EnduranceRun("towel", 1, "", "folded", "", 10.0, process, number, threads, handles, memory)


def test_the_same_seed_gives_the_same_runs() -> None:
    settings = load_settings()
    first, again, other = (
        list(islice(random_requests(["towel", "shirt"], settings, seed), 200)) for seed in (1, 1, 2)
    )
    assert first == again and first != other
    assert {r.garment for r in first} == {"towel", "shirt"}
    assert 60 < sum(bool(r.actions) for r in first) < 140, "about every second run has a fault"


def test_every_drawn_fault_can_be_injected() -> None:
    for request in islice(random_requests(["towel"], load_settings(), 3), 300):
        for action in request.actions:
            Action.model_validate(action)


def test_growth_counts_from_the_run_in_which_a_process_has_settled() -> None:
    settled = [run(1, n, threads=8 + min(n, SETTLED), memory=500.0 + min(n, SETTLED)) for n in range(1, 31)]
    (growth,) = growths(settled)
    assert (growth.runs, growth.threads, growth.handles, growth.memory) == (30, 0, 0, 0.0)
    leaking = [run(2, n, threads=8 + n, handles=12 + 2 * n, memory=500.0 * 1.01**n) for n in range(1, 31)]
    (growth,) = growths(leaking)
    assert (growth.threads, growth.handles) == (20, 40) and growth.memory > 0.2


def test_a_process_with_few_runs_shows_no_growth() -> None:
    assert growths([run(1, n) for n in range(1, SETTLED + 1)]) == []
