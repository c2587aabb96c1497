"""Rerun's viewer: the program that opens recordings, and the files of its web viewer for the operator's page.

Rerun's own server for these files answers on every network interface and reports to its makers, and its page loads
fonts from elsewhere. The files are inside the `rerun` program only. It has to serve them once: on this machine
only, with its reports turned off and without data. They are kept in the user's cache.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

from foldcell.cell.support.files.paths import user_cache
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.errors import StorageError

HOST, PORT = "127.0.0.1", 9876
FILES = ("re_viewer.js", "re_viewer_bg.wasm")
WAIT_S = 20.0
"""Longest time until the program answers [s]. It takes less than one second on an idle computer."""
HINT = "the 3-D view is not offered; `foldcell replay` opens the recording"


def find_viewer() -> Path | None:
    """Return the viewer's path: beside this interpreter, or on the PATH; None if it is not installed."""
    beside = Path(sys.executable).parent / "rerun"
    if beside.is_file():
        return beside
    found = shutil.which("rerun")
    return Path(found) if found else None


def silent_environment() -> dict[str, str]:
    """Return the environment in which the viewer does not report its use to its makers. With CI set, it takes its
    run for an automatic test."""
    return {**os.environ, "CI": "1"}


def free_port(wanted: int = PORT) -> int:
    """Return the port `wanted` (by default Rerun's usual port) if it is free, else any free port."""
    for port in (wanted, 0):
        with socket.socket() as s:
            try:
                s.bind((HOST, port))
            except OSError:
                continue
            return int(s.getsockname()[1])
    return PORT


def web_viewer_files(cache: Path | None = None) -> Path:
    """Return the folder with FILES, in the user's cache. The first call for a version of Rerun creates it (1 s).

    Raises StorageError if the files cannot be read or stored.
    """
    cache = user_cache() if cache is None else cache
    folder = cache / f"rerun-web-viewer-{version('rerun-sdk')}"
    if all((folder / name).is_file() for name in FILES):
        return folder
    try:
        with tempfile.TemporaryDirectory() as home:
            _from_program(folder, Path(home))
    except OSError as e:
        raise StorageError(f"the files of Rerun's web viewer cannot be read: {e}", HINT) from e
    return folder


def _from_program(folder: Path, home: Path) -> None:
    """Let the `rerun` program serve FILES on this machine, and store them in `folder`. home: folder in
    which the program keeps its own files. Raises OSError, StorageError."""
    program = find_viewer()
    if program is None:
        raise FileNotFoundError("the program `rerun` is not installed")
    folder.mkdir(parents=True, exist_ok=True)
    port = free_port(0)
    command = [
        str(program), "--serve-web", "--bind", "127.0.0.1", "--port", str(free_port(0)),
        "--web-viewer-port", str(port),
    ]  # fmt: skip
    with subprocess.Popen(
        command, env=silent_environment() | {"HOME": str(home)}, start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        try:
            for name in FILES:
                write_whole(folder / name, _fetched(f"http://127.0.0.1:{port}/{name}", process))
        finally:  # `rerun` may be a script that starts the program
            os.killpg(process.pid, 9)


def _fetched(address: str, process: subprocess.Popen[bytes]) -> bytes:
    import urllib.request

    deadline = time.monotonic() + WAIT_S
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    while True:
        try:
            with opener.open(address, timeout=WAIT_S) as answer:
                return bytes(answer.read())
        except OSError:
            if process.poll() is not None or time.monotonic() > deadline:
                raise
            time.sleep(0.05)
