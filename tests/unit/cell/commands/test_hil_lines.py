"""The lines of `foldcell hil` for a person."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from foldcell.cell.campaigns.hil.script_run import ScriptResult
from foldcell.cell.commands.main import main
from foldcell.cell.commands.run import hil


@pytest.mark.parametrize("broken", [(), ("the run did not fold",)])
def test_the_report_of_every_run_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, broken: tuple[str, ...]
) -> None:
    def performed(script: Any, *_: Any, **__: Any) -> ScriptResult:
        run: Any = SimpleNamespace(
            run_dir="/logs/run", state="folded", robot_time_s=61.5, signal=None, result="folded"
        )
        return ScriptResult(script, broken, run, 1.0)

    monkeypatch.setattr(hil, "run_script", performed)
    script = tmp_path / "towel.yaml"
    script.write_text(
        yaml.safe_dump({"about": "a towel", "garment": "small_towel", "expect": {"end": "folded"}}),
        encoding="utf-8",
    )
    assert main(["hil", str(script), "--logs", str(tmp_path / "logs")]) == (2 if broken else 0)
    assert "/logs/run/report.html" in capsys.readouterr().out
