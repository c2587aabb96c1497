"""The 3-D view is served by the page's own server, behind its secret, and its page can reach nothing else."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from foldcell.cell.operator.console.live_view import LiveView
from foldcell.cell.operator.console.server import operators_page
from foldcell.cell.operator.console.viewer_routes import growing_file
from foldcell.cell.operator.local_server import open_listener
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.view.viewer import FILES
from tests.builders.records import run_status
from tests.fakes import FakeCell
from tests.scenes import camera

LISTENING = "0A"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "run.rrd"
    path.write_bytes(b"begun ")
    return path


@pytest.fixture
def address(tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setattr("foldcell.cell.operator.console.server.LAST_WORD_S", 0.0)
    for name in FILES:
        (tmp_path / name).write_text(f"content of {name}")
    board = run_status()
    stop = FakeCell().ports().stop
    with operators_page(
        board, LiveView(camera()), CommandQueue(), stop, (tmp_path, recording), open_listener()
    ) as address:
        yield address


def listening() -> set[str]:
    """The addresses at which this process listens."""
    own = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # the descriptor of this listing
            own.add(os.readlink(descriptor))
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == LISTENING and f"socket:[{fields[9]}]" in own:
                host, port = fields[1].split(":")
                quad = ".".join(str(byte) for byte in bytes.fromhex(host)[::-1]) if len(host) == 8 else host
                found.add(f"{quad}:{int(port, 16)}")
    return found


def test_a_growing_file_is_sent_to_its_end(recording: Path) -> None:
    async def read() -> list[bytes]:
        pieces: list[bytes] = []
        async for piece in growing_file(recording, lambda: len(pieces) == 3):
            pieces.append(piece)
            if len(pieces) < 3:
                with recording.open("ab") as file:
                    file.write(b"more ")
        return pieces

    assert b"".join(asyncio.run(read())) == recording.read_bytes() == b"begun more more "


def test_the_server_gives_the_viewer_its_program_and_the_recording(address: str, recording: Path) -> None:
    with urllib.request.urlopen(address) as answer:
        assert 'const VIEWER = "viewer/"' in answer.read().decode()
    for name in FILES:
        with urllib.request.urlopen(f"{address}viewer/{name}") as answer:
            assert answer.read().decode() == f"content of {name}"
    with urllib.request.urlopen(f"{address}viewer/run.rrd") as answer:
        assert answer.read(6) == b"begun "
        with recording.open("ab") as file:
            file.write(b"later ")
        assert answer.read(6) == b"later "


def test_the_viewer_can_reach_nothing_but_its_server(address: str) -> None:
    with urllib.request.urlopen(f"{address}viewer/") as answer:
        text, policy = answer.read().decode(), answer.headers["Content-Security-Policy"]
    assert not re.findall(r"https?://|preconnect|stylesheet", text)
    sources = {source for rule in policy.split(";") for source in rule.split()[1:]}
    assert sources <= {"'none'", "'self'", "'unsafe-inline'", "'wasm-unsafe-eval'", "data:", "blob:"}
    assert policy.startswith("default-src 'none'") and answer.headers["Referrer-Policy"] == "no-referrer"


def test_the_page_itself_can_reach_nothing_but_its_server(address: str) -> None:
    with urllib.request.urlopen(address) as answer:
        policy = answer.headers["Content-Security-Policy"]
    port = address.split(":")[2].split("/")[0]
    rules = {rule.split()[0]: rule.split()[1:] for rule in policy.split(";")}
    assert rules["default-src"] == ["'none'"]
    assert rules["connect-src"] == ["'self'", f"ws://127.0.0.1:{port}", f"ws://localhost:{port}"]


@pytest.mark.parametrize("path", ["viewer/", "viewer/re_viewer.js", "viewer/run.rrd"])
def test_the_view_needs_the_secret(address: str, path: str) -> None:
    origin = "/".join(address.split("/")[:3])
    with pytest.raises(urllib.error.HTTPError) as error:
        urllib.request.urlopen(f"{origin}/{path}")
    assert error.value.code == 404


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs the table of sockets of Linux")
def test_nothing_else_listens(tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foldcell.cell.operator.console.server.LAST_WORD_S", 0.0)
    before = listening()
    page = operators_page(
        run_status(), LiveView(camera()), CommandQueue(),
        FakeCell().ports().stop, (tmp_path, recording), open_listener(),
    )  # fmt: skip
    with page as address:
        port = address.split(":")[2].split("/")[0]
        assert listening() - before == {f"127.0.0.1:{port}"}
