"""The examples of docs/learn/python.md and its notebook, run in their order in an empty folder."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import foldcell
from foldcell.cell.config.garments.garment_file import load_garment
from tests.notebooks import performed
from tests.runs import PLAIN, once_folded_towel

PAGE = Path(__file__).resolve().parents[3] / "docs" / "learn" / "python.md"


@dataclass(frozen=True)
class PageRun:
    """calls: the arguments of each call of `foldcell.fold`."""

    folder: Path
    names: dict[str, Any]
    output: str
    calls: list[Any]


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.M | re.S)


@pytest.fixture(scope="module")
def page_run(tmp_path_factory: pytest.TempPathFactory) -> PageRun:
    """The page performed once, in an empty folder. The towel in its run is folded once."""
    folder, calls, real = tmp_path_factory.mktemp("page"), [], foldcell.fold

    def noted(garment: str, **named: Any) -> Any:
        calls.append(((garment,), named))
        assert garment == "small_towel"
        return real(once_folded_towel(folder), **named)

    names: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as output:
        patch.chdir(folder)
        patch.setattr(foldcell, "fold", noted)
        for number, block in enumerate(blocks(), 1):
            exec(compile(block, f"docs/learn/python.md, block {number}", "exec"), names)
    return PageRun(folder, names, output.getvalue(), calls)


@pytest.mark.slow
def test_the_examples_of_the_api_page_run(page_run: PageRun) -> None:
    names, tmp_path = page_run.names, page_run.folder
    result = names["result"]
    assert isinstance(result, names["foldcell"].RunRecord) and names["quick"] == PLAIN
    assert (result.result, result.failure) == ("folded", None)
    for step in result.steps:
        assert step.done and step.accepted is not None and step.source == "optimised"
    assert names["run"].folder == Path(names["result"].run_dir)
    assert names["run"].record == names["result"]
    assert names["sent"].q.shape == (len(names["sent"].t), 14)
    assert names["half"].simulations == 1
    poses = names["half"].tool_poses["left"]
    assert np.allclose(np.linalg.norm(poses[:, 4:], axis=1), 1.0) and np.all(np.diff(poses[:, 0]) > 0)
    assert {p.suffix for p in tmp_path.glob("half.*")} == {".csv", ".json", ".yaml"}
    message = names["message"]
    assert len(message["points"]) == len(names["sent"].t) and len(set(message["joint_names"])) == 14
    own = load_garment(tmp_path / names["file"])
    assert np.ptp(own.template[:, 1]) == pytest.approx(0.40, abs=0.005) and names["first"].garment == "my_towel"
    assert names["seen"].category == "towel"
    assert "'best'" in page_run.output


@pytest.mark.slow
def test_the_notebook_folds_a_towel_and_plots_its_forces_and_heights(
    page_run: PageRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its run is that of the page, which is a function of the same arguments, and is not performed twice."""

    def again(*given: Any, **named: Any) -> Any:
        assert (given, named) in page_run.calls
        return page_run.names["result"]

    monkeypatch.chdir(page_run.folder)
    monkeypatch.setattr(foldcell, "fold", again)
    names = performed("fold_and_look")
    assert names["seen"].category == "towel" and names["run"].record == names["result"]
    for felt in names["run"].grips().values():
        assert len(felt) > 100 and np.all(np.diff(felt[:, 0]) >= 0.0)
        assert felt[:, 1].max() > 1.0, "cloth was held"
    assert np.isfinite(names["heights"]).all() and len(names["heights"]) == 1


def test_the_api_page_describes_every_function() -> None:
    text = PAGE.read_text(encoding="utf-8")
    functions = [name for name in foldcell.__all__ if name.islower()]
    assert functions == ["export", "fold", "load_run", "new_garment", "optimise", "perceive"]
    assert all(f"foldcell.{name}(" in text for name in functions)
