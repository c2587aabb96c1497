"""Names that are no UTF-8 text are refused by every command with exit code 64, before anything is written."""

from __future__ import annotations

import argparse
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from foldcell.cell.commands import exit_codes
from foldcell.cell.commands.main import main
from foldcell.cell.config.yaml_file import parse_yaml
from foldcell.cell.support.files.paths import logs_directory, user_cache
from foldcell.cell.support.process.standard_streams import lasting_streams
from foldcell.robots.errors import ConfigurationError

LATIN = os.fsdecode(b"sh\xe9et")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FOLDCELL_LOGS", str(tmp_path / "logs"))
    return tmp_path


@pytest.mark.parametrize(
    "line",
    [
        ["fold", "small_towel", "--logs", LATIN],
        ["fold", f"{LATIN}.yaml"],
        ["fold", "small_towel", "--cell", f"{LATIN}.yaml"],
        ["perceive", f"{LATIN}.png"],
        ["perceive", "a.png", "--output", f"{LATIN}.png"],
        ["garment", "check", f"{LATIN}.yaml"],
        ["garment", "new", f"{LATIN}.jpg", "--like", "small_towel"],
        ["runs", f"--logs={LATIN}"],
        ["report", LATIN],
        ["hil", f"{LATIN}/"],
        [LATIN],
    ],
)
def test_every_command_refuses_a_name_on_its_line(
    line: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / LATIN).mkdir()
    assert main([*line, "--json"]) == 64
    out, err = capsys.readouterr()
    assert err.startswith("foldcell: command line: the name '") and "sh\\udce9et" in err and "Traceback" not in err
    assert json.loads(out)["exit_code"] == 64
    assert os.listdir(folder) == [LATIN] and not os.listdir(folder / LATIN)


def test_the_logs_folder_of_the_environment_is_checked(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FOLDCELL_LOGS", str(folder / LATIN))
    assert main(["fold", "small_towel"]) == 64
    assert capsys.readouterr().err.startswith("foldcell: logs folder: the name '")
    assert not os.listdir(folder)


def test_the_working_directory_is_checked(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / LATIN).mkdir()
    monkeypatch.chdir(folder / LATIN)
    assert main(["fold", "small_towel"]) == 64
    assert capsys.readouterr().err.startswith("foldcell: working directory: the name '")
    assert main(["--help"]) == 0


def test_scripts_in_a_folder_are_checked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "scripts").mkdir()
    (folder / "scripts" / f"{LATIN}.yaml").write_text("garment: small_towel\n", encoding="utf-8")
    assert main(["hil", "scripts"]) == 64
    assert "script: the name '" in capsys.readouterr().err
    assert os.listdir(folder) == ["scripts"]


def test_folders_of_logs_and_caches_are_checked(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / LATIN))
    with pytest.raises(ConfigurationError, match="user cache: the name"):
        user_cache()
    with pytest.raises(ConfigurationError, match="logs folder: the name"):
        logs_directory(Path(LATIN))


def test_a_text_of_a_file_that_no_record_can_hold_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"garment\.yaml:1") as error:
        parse_yaml('title: "sh\\uDCE9et"\n', Path("garment.yaml"))
    error.value.what.encode()


def test_the_writer_of_tracebacks_accepts_any_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["foldcell", "fold", LATIN])
    for logs in (folder / "logs", folder / LATIN, Path("a\0b")):
        try:
            raise KeyError(LATIN)
        except KeyError:
            path = exit_codes._write_traceback(argparse.Namespace(logs=logs))
        assert path is not None and "foldcell fold sh\\udce9et" in path.read_text(encoding="utf-8")
        path.unlink()


def test_a_bug_whose_message_holds_such_a_name_ends_with_exit_code_3(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_: argparse.Namespace) -> int:
        raise KeyError(LATIN)

    assert exit_codes.framed(lambda: argparse.Namespace(run=fail, json=True, logs=folder / LATIN), True) == 3
    assert json.loads(capsys.readouterr().out)["exit_code"] == 3


def test_a_stray_byte_typed_at_the_terminal_does_not_end_its_reading(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would count as a closed terminal."""
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"\xe9\na\n"), encoding="utf-8"))
    with lasting_streams():
        assert [line.strip() for line in sys.stdin] == ["\\xe9", "a"]


def test_the_installed_command_refuses_bytes_of_the_shell(folder: Path) -> None:
    line = [os.fsencode(sys.executable), b"-m", b"foldcell.cell.commands.main", b"perceive", b"sh\xe9et.png"]
    done = subprocess.run(line, capture_output=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    assert done.returncode == 64 and done.stderr.startswith(b"foldcell: command line: the name 'sh\\udce9et.png'")
