"""What libraries write past the program does not reach the output of a command."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from foldcell.cell.support.files.picture_file import read_picture
from foldcell.cell.support.process.library_messages import QUIET, captured_messages, quiet_libraries
from foldcell.robots.errors import ConfigurationError

SILENT = {name: value for name, value in os.environ.items() if name not in QUIET}


def damaged(kind: str) -> bytes:
    """A picture of which bytes in the middle are wrong (of a JPEG the mark of its end stands there), or of which
    the second half is missing."""
    name, _, how = kind.partition(" ")
    noise = np.random.default_rng(0).integers(0, 255, (120, 160, 3)).astype(np.uint8)
    data = bytes(cv2.imencode(f".{name}", cv2.GaussianBlur(noise, (0, 0), 2))[1])
    half = len(data) // 2
    wrong = b"\xff\xd9" if name == "jpg" else bytes(255 - b for b in data[half : half + 40])
    return data[:half] if how == "cut" else data[:half] + wrong + data[half + len(wrong) :]


KINDS = ["png cut", "png wrong", "jpg cut", "jpg wrong", "tiff cut", "bmp cut", "webp cut"]


@pytest.mark.parametrize(("command", "kind"), [("perceive", "png cut"), ("garment new", "jpg wrong")])
def test_a_command_with_a_damaged_picture_writes_only_its_own_message(
    tmp_path: Path, command: str, kind: str
) -> None:
    path = tmp_path / f"picture.{kind.split()[0]}"
    path.write_bytes(damaged(kind))
    more = ["--like", "small_towel"] if command == "garment new" else []
    run = subprocess.run(
        [sys.executable, "-m", "foldcell.cell.commands.main", *command.split(), str(path), "--unit", "m", *more],
        capture_output=True, text=True, env=SILENT, check=False,
    )  # fmt: skip
    assert run.returncode == 64 and run.stdout == ""
    first, hint = run.stderr.splitlines()
    assert first.startswith(f"foldcell: {path}: ") and "picture" in first
    assert hint.strip() == "export or copy it anew"


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_picture_is_refused_without_a_message_of_its_codec(
    tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Whatever OpenCV's log level was when it was loaded, and though libjpeg makes up what is missing."""
    path = tmp_path / "picture"
    path.write_bytes(damaged(kind))
    with pytest.raises(ConfigurationError, match="picture") as refused:
        read_picture(path)
    assert str(path) in refused.value.what and refused.value.hint == "export or copy it anew"
    assert capfd.readouterr().err == ""


LOUD = """
import argparse, socket, sys, time, warnings
from foldcell.cell.commands.exit_codes import framed

def run(options):
    import cv2, numpy as np, rerun as rr
    warnings.warn("a warning of a package")
    cv2.imread("/nowhere/at/all.png")
    stream = rr.RecordingStream("loud")
    stream.log("points", rr.Points3D(["a", "b"]))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        stream.set_sinks(rr.GrpcServerSink(bind_ip="127.0.0.1", port=port, server_memory_limit="1MiB"))
        time.sleep(0.3)
    print("done")
    return 0

sys.exit(framed(lambda: argparse.Namespace(run=run), False))
"""


def test_opencv_rerun_and_python_warnings_stay_out_of_a_commands_output() -> None:
    run = subprocess.run(
        [sys.executable, "-c", LOUD], capture_output=True, text=True, env=SILENT, check=False, timeout=120
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "done\n", "")


def test_what_the_user_has_asked_for_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RUST_LOG", "debug")
    monkeypatch.delenv("OPENCV_LOG_LEVEL", raising=False)
    with quiet_libraries():
        assert os.environ["RUST_LOG"] == "debug" and os.environ["OPENCV_LOG_LEVEL"] == "SILENT"
    assert "OPENCV_LOG_LEVEL" not in os.environ
    monkeypatch.setattr(sys, "warnoptions", ["error"])
    with quiet_libraries(), warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        warnings.warn("asked for", stacklevel=1)
    assert len(heard) == 1


def test_messages_of_c_libraries_are_kept_back_and_then_written_again(capfd: pytest.CaptureFixture[str]) -> None:
    with captured_messages() as messages:
        os.write(2, b"kept back")
        assert messages() == "kept back"
    os.write(2, b"written")
    assert capfd.readouterr().err == "written"


def test_a_closed_standard_error_keeps_nothing_back() -> None:
    code = (
        "import os; os.close(2)\n"
        "from foldcell.cell.support.process.library_messages import captured_messages\n"
        "with captured_messages() as messages: print(repr(messages()))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout) == (0, "''\n")
