"""Random inputs and surroundings of all commands: a part of those of `python -m benchmarks.inputs`."""

from __future__ import annotations

import subprocess
import sys


def test_no_random_input_ends_in_a_traceback_a_hang_or_a_half_written_file() -> None:
    line = [sys.executable, "-m", "benchmarks.inputs", "--cases", "40", "--seed", "7", "--patience", "0.3"]
    ended = subprocess.run(line, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert " cases of " in ended.stdout and ", 0 bad, " in ended.stdout
