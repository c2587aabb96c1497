"""Whole runs of the shipped ablations: each part of the method can be left out, and the run still ends."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from foldcell.cell.campaigns.trials.campaign import read_campaign
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.yaml_file import merge
from foldcell.cell.runs.fold_run import fold_once
from tests.runs import PLAIN, fold_request, once_folded_towel

pytestmark = pytest.mark.slow

CAMPAIGN = Path(__file__).parents[2] / "benchmarks" / "campaigns" / "ablations.yaml"


def settings_of(variant: str) -> Any:
    """The groups of settings of a variant; the other keys are those of every cell."""
    requests = read_campaign(CAMPAIGN, load_settings()).requests
    settings = next(r.settings for r in requests if r.variant == variant)
    return {key: value for key, value in settings.items() if isinstance(value, Mapping)}


@pytest.mark.parametrize("variant", ["no_tactile", "one_look"])
def test_a_small_towel_is_folded_without_a_part_of_the_method(variant: str, tmp_path: Path) -> None:
    request = fold_request(tmp_path, settings_of(variant), garment=once_folded_towel(tmp_path), record=False)
    result = fold_once(request)
    assert (result.result, result.failure) == ("folded", None)
    assert all(step.done for step in result.steps)
    inspected = [step.accepted is not None for step in result.steps]
    assert not any(inspected) if variant == "one_look" else all(inspected)
    assert {step.source for step in result.steps} == {"library"}


def test_the_settings_for_initial_arcs_are_those_of_the_run_on_the_api_page() -> None:
    """tests/unit/foldcell/test_api_page.py folds a small towel with them."""
    assert settings_of("initial_arcs") == merge(settings_of("shipped"), PLAIN)
