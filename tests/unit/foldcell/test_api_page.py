"""The examples of docs/api.md, run in their order in an empty folder."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).resolve().parents[3] / "docs" / "api.md"


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.M | re.S)


@pytest.mark.slow
def test_the_examples_of_the_api_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for number, block in enumerate(blocks(), 1):
        exec(compile(block, f"docs/api.md, block {number}", "exec"), names)
    assert isinstance(names["result"], names["foldcell"].FoldResult) and names["result"].result == "folded"
    assert names["run"].folder == Path(names["result"].run_dir)
    assert names["run"].result == {"schema": 1, **names["result"].as_json()}
    assert names["sent"].q.shape == (len(names["sent"].t), 14)
    assert names["half"].simulations == 1
    assert names["seen"].category == "towel"
    assert "'best'" in capsys.readouterr().out


def test_the_api_page_describes_every_function() -> None:
    import foldcell

    text = PAGE.read_text(encoding="utf-8")
    functions = [name for name in foldcell.__all__ if name.islower()]
    assert functions == ["fold", "load_run", "optimise", "perceive"]
    assert all(f"foldcell.{name}(" in text for name in functions)
