"""The command `foldcell hil`: whole runs of the simulated cell, JSON and JUnit results."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from foldcell.cell.campaigns.hil.script import Script
from foldcell.cell.campaigns.hil.script_run import ScriptResult
from foldcell.cell.commands.main import main
from foldcell.cell.record.run_record import NOTHING_LOST, read_record
from tests.runs import decided_again

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

SHIPPED = Path(__file__).parents[1] / "hil"
STOPPED = """
about: the stop is pressed before anything is looked at
garment: small_towel
do:
  - when: {state: awaiting_garment}
    stop: the button
  - when: {state: folding}
    tell: this is never told
expect:
  end: [folded]
"""


def test_hil_reports_passing_scripts_and_a_failing_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "stopped.yaml"
    bad.write_text(STOPPED, encoding="utf-8")
    junit = tmp_path / "hil.xml"
    scripts = [str(SHIPPED / "no_garment.yaml"), str(bad), str(SHIPPED / "abort_with_cloth_in_the_hands.yaml")]
    code = main(["hil", *scripts, "--logs", str(tmp_path / "logs"), "--junit", str(junit), "--json"])
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (code, figures["passed"], figures["failed"], figures["not_performed"]) == (2, 2, 1, [])
    no_garment, stopped, aborted = figures["scripts"]
    assert no_garment["passed"] and no_garment["end"] == "not_folded"
    assert aborted["passed"] and aborted["end"] == "not_folded", "a script after a failed one still runs"
    assert stopped["end"] == "stopped" and len(stopped["broken"]) == 2
    assert "the button" in stopped["broken"][0] and "never happened" in stopped["broken"][1]
    for script in figures["scripts"]:
        folder = Path(script["run_dir"])
        files, record = {path.name for path in folder.iterdir()}, read_record(folder)
        assert {"cell.yaml", "report.html", "result.json", "run.rrd"} <= files, "every end of a run writes them"
        assert record is not None and record.recording == NOTHING_LOST
        again = decided_again(folder.parent, folder.name)
        assert again.same and again.broken_off is None, "replay repeats the actions of a script"
        if script is aborted:
            (half, *_) = record.steps
            assert not half.done and half.accepted is None, "the fold was not inspected"
            assert half.source, "the attempted trajectory is reported nevertheless"
    assert json.loads((Path(figures["directory"]) / "hil.json").read_text()) == {
        k: v for k, v in figures.items() if k != "directory"
    }
    suite = ElementTree.parse(junit).getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("3", "1")
    assert [case.find("failure") is None for case in suite] == [True, False, True]


def test_no_script_runs_if_one_of_them_is_invalid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text(STOPPED.replace("end:", "ends:"), encoding="utf-8")
    logs = tmp_path / "logs"
    code = main(["hil", str(SHIPPED / "no_garment.yaml"), str(bad), "--logs", str(logs)])
    assert code == 64 and "did you mean 'end'" in capsys.readouterr().err and not logs.exists()
    assert main(["hil", str(tmp_path / "nowhere"), "--logs", str(logs)]) == 64
    junit = ["--junit", str(tmp_path / "nowhere" / "hil.xml")]
    assert main(["hil", str(SHIPPED / "no_garment.yaml"), "--logs", str(logs), *junit]) == 64
    assert "no such folder" in capsys.readouterr().err and not logs.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_results_are_kept_when_a_signal_arrives_between_two_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    performed: list[str] = []
    kept: list[dict[str, Any]] = []

    def perform(script: Script, *_: Any, **__: Any) -> ScriptResult:
        performed.append(script.name)
        if len(performed) == 2:
            kept.extend(json.loads(path.read_text()) for path in (tmp_path / "logs").glob("hil-*/hil.json"))
            os.kill(os.getpid(), number)
        return ScriptResult(script, ("it did not pass",), None, 1.0)

    monkeypatch.setattr("foldcell.cell.commands.run.hil.run_script", perform)
    junit = tmp_path / "hil.xml"
    scripts = [str(path) for path in sorted(SHIPPED.glob("*.yaml"))[:3]]
    default = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
    handler = signal.signal(number, default)  # the signal may be ignored, as under nohup
    try:
        code = main(["hil", *scripts, "--logs", str(tmp_path / "logs"), "--junit", str(junit), "--json"])
    finally:
        signal.signal(number, handler)
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 128 + number and figures["failed"] == 1 and len(figures["not_performed"]) == 2
    suite = ElementTree.parse(junit).getroot()
    assert [suite.get(k) for k in ("tests", "failures", "skipped")] == ["3", "1", "2"]
    (before,) = kept  # what a kill during the second run would leave
    assert [script["name"] for script in before["scripts"]] == performed[:1] and len(before["not_performed"]) == 2
