"""`foldcell dashboard` as a process: its address, its end by a signal, its refusals."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from foldcell.cell.commands.main import main
from foldcell.cell.operator.local_server import open_listener


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_page_is_served_until_a_signal_ends_the_command(
    tmp_path: Path, number: signal.Signals, code: int
) -> None:
    line = [sys.executable, "-m", "foldcell.cell.commands.main", "dashboard", "--logs", str(tmp_path), "--json"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            said = json.loads(process.stdout.readline())
            with urllib.request.urlopen(said["address"]) as answer:
                assert "no runs in this folder yet" in answer.read().decode()
            process.send_signal(number)
            assert process.wait(timeout=30) == code
        finally:
            process.kill()
    assert said["logs"] == str(tmp_path) and list(tmp_path.iterdir()) == []


def test_a_folder_that_does_not_exist_is_refused_and_not_created(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["dashboard", "--logs", str(tmp_path / "none")]) == 64
    assert f"there is no logs folder {tmp_path / 'none'}" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_a_port_in_use_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open_listener() as listener:
        port = listener.getsockname()[1]
        assert main(["dashboard", "--logs", str(tmp_path), "--port", str(port)]) == 64
    assert f"cannot be served on port {port}" in capsys.readouterr().err
