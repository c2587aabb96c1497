"""The operator's page in a browser, where there is one: what can be pressed when nothing is heard any more."""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
import subprocess
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Queue
from threading import Thread

import pytest

from cell.console.board import Board
from cell.console.server import PAGE

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="there is no browser")
ACCEPT = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
PRESS_STOP_WHEN_LOST = """
<script>setInterval(() => { if (!at("lost").hidden && !at("stop").disabled) at("stop").click(); }, 100);</script>
"""


class Silent(BaseHTTPRequestHandler):
    """Serves the page, tells the board over its first link, and then neither says nor answers anything: a program
    that hangs. What is said on that link is put into `said`."""

    said: Queue[str]
    links: list[object]

    def do_GET(self) -> None:
        if not self.path.endswith("link"):
            page = PAGE.read_text(encoding="utf-8").replace("{{viewer}}", "null") + PRESS_STOP_WHEN_LOST
            self.send_response(200)
            self.end_headers()
            self.wfile.write(page.encode())
            return
        self.links.append(self)
        key = self.headers["Sec-WebSocket-Key"].encode()
        if len(self.links) == 1:
            accepted = base64.b64encode(hashlib.sha1(key + ACCEPT).digest())
            self.wfile.write(
                b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                b"Sec-WebSocket-Accept: " + accepted + b"\r\n\r\n"
            )
            board = Board("run-1", "small_towel", 3, simulated=True).snapshot()
            told = json.dumps({"board": board, "stopped": False}).encode()
            self.wfile.write(b"\x81\x7e" + len(told).to_bytes(2, "big") + told)
        while frame := self._frame():
            if self is self.links[0]:
                self.said.put(frame)

    def _frame(self) -> str:
        """The next short frame of a browser, unmasked; empty at the link's end."""
        head = self.rfile.read(2)
        if len(head) < 2:
            return ""
        length = head[1] & 0x7F
        mask, body = self.rfile.read(4), self.rfile.read(length)
        text = bytes(byte ^ mask[k % 4] for k, byte in enumerate(body))
        return text.decode() if head[0] & 0x0F == 1 else f"<frame {head[0] & 0x0F}>"

    def log_message(self, *_: object) -> None: ...


@pytest.fixture
def said(tmp_path: Path) -> Iterator[Queue[str]]:
    """What a browser's page says to a program that hangs."""
    handler = type("Handler", (Silent,), {"said": Queue(), "links": []})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    Thread(target=server.serve_forever, daemon=True).start()
    assert BROWSER is not None
    command = [
        BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--remote-debugging-port=0",
        f"--user-data-dir={tmp_path / 'profile'}", f"http://127.0.0.1:{server.server_port}/secret/",
    ]  # fmt: skip
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield handler.said  # type: ignore[attr-defined]
    finally:
        browser.terminate()
        browser.wait()
        server.shutdown()
        server.server_close()


def test_stop_can_be_pressed_when_nothing_is_heard_and_goes_by_the_link_that_may_carry_it(
    said: Queue[str],
) -> None:
    """A program that hangs for a moment hears of it as soon as it goes on."""
    assert json.loads(said.get(timeout=60.0)) == {"stop": True}
