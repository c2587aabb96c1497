"""The examples of docs/learn/python.md, run in their order in an empty folder."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.config.garments.garment_file import load_garment
from tests.runs import PLAIN

PAGE = Path(__file__).resolve().parents[3] / "docs" / "learn" / "python.md"


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.M | re.S)


@pytest.mark.slow
def test_the_examples_of_the_api_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for number, block in enumerate(blocks(), 1):
        exec(compile(block, f"docs/learn/python.md, block {number}", "exec"), names)
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
    own = load_garment(names["file"])
    assert np.ptp(own.template[:, 1]) == pytest.approx(0.40, abs=0.005) and names["first"].garment == "my_towel"
    assert names["seen"].category == "towel"
    assert "'best'" in capsys.readouterr().out


def test_the_api_page_describes_every_function() -> None:
    import foldcell

    text = PAGE.read_text(encoding="utf-8")
    functions = [name for name in foldcell.__all__ if name.islower()]
    assert functions == ["export", "fold", "load_run", "new_garment", "optimise", "perceive"]
    assert all(f"foldcell.{name}(" in text for name in functions)
