"""The optimiser's benchmark: its worst figures against hand calculation, and its saved results."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.kept import Kept, fingerprint
from benchmarks.optimise import _worst, cases
from benchmarks.optimise.lookups import summary_of_lookups
from benchmarks.optimise.results import page
from foldcell.cell.config.garments.garment_file import shipped_garment_path
from foldcell.skills.vocabulary import GraspId


def row(step: str, method: str, d: float | None, initial: float = 10.0, relaxed: float = 5.0, **more: Any) -> dict:
    figures = {"D_initial_mm": initial, "D_relax_mm": relaxed, "D_mm": d, "seconds": 3.0, "cpu_seconds": 5.0}
    return {"garment": "towel", "step": step, "method": method, "layers": 1, **figures, **more}


def test_the_worst_figures_agree_with_hand_calculation() -> None:
    rows = [
        row("a", "default", 6.0), row("a", "two_parameter", 6.5), row("a", "paper", 5.5),
        row("b", "default", 4.2, 4.0, 3.0, seconds=4.5), row("b", "two_parameter", 4.1), row("b", "paper", None),
        row("c", "default", 7.0, layers=2, seconds=9.0), row("d", "default", None),
    ]  # fmt: skip
    worst = _worst(rows)
    assert worst["steps_optimised"] == 3 and worst["steps_failed"] == 1 and worst["steps_with_gap"] == 2
    assert worst["gap_closed_min"] == pytest.approx(0.6) and worst["gap_closed_median"] == pytest.approx(0.7)
    assert worst["worse_than_initial_mm_max"] == pytest.approx(0.2)
    assert worst["worse_than_initial_without_gap_mm_max"] == pytest.approx(0.2)
    assert worst["worse_than_two_parameter_mm_max"] == pytest.approx(0.1)
    assert worst["worse_than_paper_mm_max"] == pytest.approx(0.5)
    assert worst["towel_step_s_max"] == 4.5 and worst["two_layer_step_s_max"] == 9.0


def test_the_page_lists_every_step_and_every_unmet_target() -> None:
    more = {"simulations": 15, "cpu_seconds": 33.0}
    rows = [
        row("a", "default", 8.0, **more), row("a", "two_parameter", 6.5), row("a", "paper", None),
        row("b", "default", 3.0, 4.0, 3.0, **more), row("c", "default", None, **more),
    ]  # fmt: skip
    told = {"garment": "towel", "step": "a", "case": "size x0.8", "accepted": False, "D_initial_mm": 9.96,
            "D_mm": 4.0, "D_relax_mm": 3.0}  # fmt: skip
    text = page({**_worst(rows), "steps": rows, "lookups_told": [told], "machine": {"cpu": "C", "cores": 2}})
    assert "| towel | a | 5.0 | 10.0 | 8.0 | 6.5 | - | 40 % | 15 | 3.0 | 33.0 |" in text
    assert "| towel | b | 3.0 | 4.0 | 3.0 | - | - | - | 15 | 3.0 | 33.0 |" in text
    assert "| towel | c | 5.0 | 10.0 | - | - | - | - | 15 | 3.0 | 33.0 |" in text
    assert "0.4 | at least 0.6: **not met** |" in text and "1.5 mm | at most 0.5: **not met** |" in text
    assert "| steps in which no trajectory was found | 1 | at most 0: **not met** |" in text
    assert "| towel | a | size x0.8 | 3 | 10 | 4 | optimised |" in text and "on C, 2 cores" in text


def test_only_accepted_look_ups_with_a_large_gap_count() -> None:
    def told(d: float, initial: float, accepted: bool = True) -> dict[str, Any]:
        return {"accepted": accepted, "D_initial_mm": initial, "D_mm": d, "D_relax_mm": 4.0, "closed_at_home": 0.8}

    figures = summary_of_lookups([told(6.0, 14.0), told(12.0, 14.0, False), told(6.5, 6.0)])
    assert figures["lookups"] == 3 and figures["lookups_accepted"] == 2 and figures["lookups_with_large_gap"] == 1
    assert figures["scaled_gap_kept_min"] == pytest.approx(1.0)
    assert figures["scaled_worse_than_initial_mm_max"] == pytest.approx(0.5)
    assert summary_of_lookups([])["scaled_gap_kept_min"] is None


def test_an_arcs_figure_is_the_median_over_all_fine_meshes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fold's distance from its target is 1, 2 and 6 m on the three meshes."""
    seen: list[float] = []

    def distance(mesh: float, lines: Any, material: Any, after: Any) -> float:
        seen.append(mesh)
        return mesh

    monkeypatch.setattr(cases, "predict_fold", lambda *_: SimpleNamespace(vertices=None))
    monkeypatch.setattr(cases, "distance_to_target", distance)
    case: Any = SimpleNamespace(
        fine=((1.0, None), (2.0, None), (6.0, None)),
        garment=SimpleNamespace(material=None),
        step=SimpleNamespace(lines=(), grasps={GraspId.LEFT: SimpleNamespace(heading=0.0)}),
    )
    arc = {GraspId.LEFT: np.array([[0.5, 0.2, 0.0], [0.5, 0.1, 0.2], [0.5, -0.1, 0.2], [0.5, -0.2, 0.0]])}
    with ThreadPoolExecutor(1) as pool:
        assert cases.judge(case, arc, 1.0, pool) == pytest.approx(2.0)
    assert sorted(seen) == [1.0, 1.0, 2.0, 2.0, 6.0, 6.0]


def test_figures_are_reused_until_their_inputs_change(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "kept.json"
    towel, other = (shipped_garment_path(name) for name in ("small_towel", "medium_towel"))
    folders = ("skills/garments",)
    key = fingerprint(folders, towel, budget=25)
    Kept(path).put(key, "0/default", {"D_mm": 1.5})
    assert Kept(path).get(key, "0/default") == {"D_mm": 1.5}
    assert Kept(path).get(key, "1/default") is None
    assert len({key, fingerprint(folders, towel, budget=10), fingerprint(folders, other, budget=25)}) == 3
    assert fingerprint(folders, towel, budget=25) == key != fingerprint((), towel, budget=25)
    path.write_text("{ not JSON")
    assert Kept(path).get(key, "0/default") is None
    Kept(None).put(key, "0/default", {})
