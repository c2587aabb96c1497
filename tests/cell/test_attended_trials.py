"""A campaign with a person. A scripted person lays the garment and judges the fold. The program is killed while it
waits for the verdict, and the campaign goes on later."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.optional_parts import ROS
from tests.runs import once_folded_towel

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ROOT = Path(__file__).parents[2]
APPROVE, VERDICT = "then approve", "y if the garment is folded well"


def trials(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "foldcell.cell.commands.main", "trials", *arguments, "--json"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip


def asked(command: subprocess.Popen[str], answers: dict[str, str]) -> list[str]:
    """Answer the questions until one has no answer, or the command ends. Returns what was asked."""
    assert command.stderr and command.stdin
    questions = []
    for line in command.stderr:
        for question in (APPROVE, VERDICT):
            if question in line:
                questions.append(line)
                if question not in answers:
                    return questions
                command.stdin.write(answers[question] + "\n")
                command.stdin.flush()
    return questions


@pytest.mark.parametrize(
    ("driver", "label"),
    [
        ("sim", "simulated, judged by a person"),
        pytest.param(
            "emulator", "simulated (emulator), judged by a person", marks=[pytest.mark.hil, ROS.required]
        ),
    ],
)
def test_a_person_attends_a_campaign_and_judges_a_run_after_the_program_was_killed(
    driver: str, label: str, tmp_path: Path
) -> None:
    towel, logs = once_folded_towel(tmp_path), tmp_path / "logs"
    first = trials("--attended", "--driver", driver, "--garments", towel, "--n", "1", "--logs", str(logs))
    begin, lay, verdict = asked(first, {APPROVE: "a"})
    assert "run 1 of 1, small_towel" in begin and "lay the small_towel flat" in lay and "folded well" in verdict
    first.send_signal(signal.SIGKILL)
    first.communicate()
    (folder,) = logs.glob("trials-*")
    (stored,) = folder.glob("*/trial.json")
    before = json.loads(stored.read_text())
    assert before["judgement"] is None and before["record"]["driver"] == driver
    assert before["record"]["score"] is None, "the simulated truth does not judge beside the person"
    assert before["record"]["robot_time_s"] > 10.0

    second = trials("--resume", str(folder))
    (question,) = asked(second, {VERDICT: "n the edges are apart"})
    assert "seed 1" in question, "the run is judged, and not performed again"
    out, _ = second.communicate()
    results = json.loads(out.splitlines()[-1])
    (run,) = results["runs"]
    assert run["judgement"] == {"passed": False, "why": "the edges are apart"} and not run["success"]
    assert run["record"] == before["record"]
    assert (results["label"], results["not_performed"]) == (label, [])
    assert label in (folder / "campaign.html").read_text()
