"""Folds with the real robot's driver over ROS. The simulated cell runs in another process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.optional_parts import ROS
from tests.runs import decided_again, once_folded_towel

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(600),
    ROS.required,
]

SCRIPT = """
about: the stop is pressed while the fold is under way
garment: small_towel
seed: 1
do:
  - when: {state: folding, after_s: 0.5}
    stop: the button
expect:
  end: stopped
  parked: false
"""


def foldcell(*arguments: str) -> tuple[int, dict[str, Any]]:
    """Run a command in its own process, because a process can be a ROS node only once."""
    done = subprocess.run(
        [sys.executable, "-m", "foldcell.cell.commands.main", *arguments, "--driver", "emulator", "--json"],
        capture_output=True, text=True, timeout=500, cwd=Path(__file__).parents[2], check=False,
        env={**os.environ, "ROS_MASTER_URI": "http://192.0.2.1:11311"},  # a robot that must not be contacted
    )  # fmt: skip
    assert done.stdout.strip(), done.stderr
    assert "does not execute an order" not in done.stderr, done.stderr
    return done.returncode, json.loads(done.stdout.splitlines()[-1])


def test_a_towel_is_folded_over_ros(tmp_path: Path) -> None:
    """The run is in real time, so its quality depends on the machine. Trials measure how often it passes."""
    towel = once_folded_towel(tmp_path)
    code, result = foldcell("fold", towel, "--seed", "1", "--logs", str(tmp_path / "logs"))
    assert (result["driver"], result["simulated"], result["world"]) == ("emulator", True, "xpbd")
    assert code in (0, 2), result["failure"]
    assert result["steps"][0]["done"], "at least one fold was made and accepted"
    assert result["score"]["simulated"] and result["robot_time_s"] > 10.0
    again = decided_again(tmp_path / "logs")
    assert again.same and again.broken_off is None, "the decisions depend only on messages from the network"


def test_the_driver_over_ros_keeps_the_contract_of_the_ports() -> None:
    code, report = foldcell("robot", "check", "baxter")
    broken = {clause["name"]: clause["reason"] for clause in report["clauses"] if clause["state"] != "passed"}
    assert (code, broken) == (0, {})


def test_a_stop_reaches_the_robot_over_ros(tmp_path: Path) -> None:
    script = tmp_path / "stop.yaml"
    script.write_text(SCRIPT, encoding="utf-8")
    code, figures = foldcell("hil", str(script), "--logs", str(tmp_path / "logs"))
    assert code == 0, figures["scripts"][0]["broken"]
