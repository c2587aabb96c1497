"""The foldcell commands of README.md, performed in its order with one logs folder."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from foldcell.cell.commands.main import main
from tests.cell.test_shipped_scripts import SCRIPTS

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ROOT = Path(__file__).parents[2]
ENDING = (
    "fold medium_towel --seed 3",
    "report last",
    "replay last",
    "replay last --decide",
)
"""Commands that end by themselves, with success."""
SERVING = ("supervise medium_towel", "resume last")
"""Commands that serve the operator's page until a person ends them. `resume last` continues the supervised run."""
ELSEWHERE = "hil tests/hil"
"""Each of its scripts is performed by test_shipped_scripts.py."""


def shown() -> list[str]:
    """The foldcell commands in the code blocks of README, in their order."""
    blocks = re.split(r"^```.*$", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.M)[1::2]
    lines = (line.split("#")[0].strip() for block in blocks for line in block.splitlines())
    return [line.removeprefix("foldcell ") for line in lines if line.startswith("foldcell ")]


def test_every_command_that_readme_shows_does_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    commands = shown()
    assert {*commands} == {*ENDING, *SERVING, ELSEWHERE}, "this test performs other commands than README shows"
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("FOLDCELL_LOGS", str(tmp_path / "logs"))
    for screen in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(screen, raising=False)
    for command in commands:
        if command in ENDING:
            code = main(command.split())
            told = capsys.readouterr()
            assert code == 0, f"{command}: {told.out}{told.err}"
        elif command in SERVING:
            serve_and_interrupt(command)
    assert ELSEWHERE.split()[1] == str(SCRIPTS.relative_to(ROOT))


def serve_and_interrupt(command: str) -> None:
    """Start the command, fetch its page, and interrupt it as Ctrl-C does."""
    line = [sys.executable, "-m", "foldcell.cell.commands.main", *command.split()]
    output = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(line, text=True, **output) as program:  # type: ignore[call-overload]
        told = []
        for text in program.stdout:
            told.append(text)
            page = re.search(r"operator's page: (http\S+)", text)
            if page:
                with urllib.request.urlopen(page[1], timeout=60) as answer:
                    assert answer.status == 200
                program.send_signal(signal.SIGINT)
        assert program.wait() == 130, f"{command}: {''.join(told)}"
