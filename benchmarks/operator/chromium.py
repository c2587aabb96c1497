"""Chromium without a window, driven over its DevTools protocol."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
from websockets.sync.client import ClientConnection, connect

from foldcell.robots.errors import ConfigurationError

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
SIZE = 1600, 1000
"""Size of the window [px]."""
START_S, ANSWER_S = 60.0, 120.0
QUALITY = 82
"""Of the pictures of docs."""


def keep_picture(png: bytes, path: Path) -> None:
    """Write the content of a PNG file as the WebP picture `path`."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])


class Tab:
    """One tab. requests: addresses that the page asked for, blocked: those that the browser did not let out."""

    def __init__(self, address: str) -> None:
        self._link: ClientConnection = connect(address, max_size=None, compression=None, ping_interval=None)
        self._count = 0
        self._asked: dict[str, str] = {}
        self.requests: list[str] = []
        self.blocked: list[str] = []
        for domain in ("Network", "Page", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol. Returns its result. Raises RuntimeError if the browser refuses."""
        self._count += 1
        self._link.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        deadline = time.monotonic() + ANSWER_S
        while time.monotonic() < deadline:
            message = json.loads(self._link.recv(timeout=ANSWER_S))
            if message.get("id") != self._count:
                self._note(message)
            elif "error" in message:
                raise RuntimeError(f"{method}: {message['error']}")
            else:
                return dict(message["result"])
        raise TimeoutError(method)

    def evaluate(self, expression: str) -> Any:
        """Evaluate JavaScript, and wait for its promise. Returns its value."""
        result = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in result:
            raise RuntimeError(str(result["exceptionDetails"]))
        return result["result"].get("value")

    def press(self, x: float, y: float) -> None:
        """Press and release the mouse's button at a place of the page [px]."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def screenshot(self) -> bytes:
        """Return what the tab shows now, as the content of a PNG file."""
        return base64.b64decode(self.call("Page.captureScreenshot")["data"])

    def resize(self, width: int, height: int) -> None:
        """Give the tab a window of this size [px]."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )

    def outside(self, origin: str) -> list[str]:
        """Return the requests that left for another place than `origin` (http://HOST:PORT)."""
        own = (origin, origin.replace("http", "ws", 1), "data:", "blob:", "about:", "chrome")
        out = [address for address in self.requests if not address.startswith(own)]
        return [address for address in out if address not in self.blocked]

    def close(self) -> None:
        self._link.close()

    def _note(self, message: dict[str, Any]) -> None:
        method, values = message.get("method", ""), message.get("params", {})
        if method == "Network.requestWillBeSent":
            self._asked[values["requestId"]] = values["request"]["url"]
            self.requests.append(values["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.requests.append(values["url"])
        elif method == "Network.loadingFailed" and values.get("blockedReason") == "csp":
            self.blocked.append(self._asked.get(values["requestId"], "?"))
        elif method == "Log.entryAdded" and "Content Security Policy" in values["entry"]["text"]:
            self.blocked.append(values["entry"]["text"].split("'")[1])


class Chromium:
    """A browser of its own profile. It ends with the context."""

    def __init__(self, graphics: bool = False) -> None:
        """graphics: whether pages can use WebGL, drawn by the processor."""
        program = next(filter(None, map(shutil.which, PROGRAMS)), None)
        if program is None:
            raise ConfigurationError("chromium is not installed", "apt-get install chromium")
        gl = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
        self._profile = tempfile.mkdtemp()
        self._process = subprocess.Popen(
            [
                program, "--headless=new", "--no-sandbox", "--no-first-run", "--disable-background-networking",
                "--disable-component-update", "--disable-sync", "--remote-debugging-port=0",
                f"--window-size={SIZE[0]},{SIZE[1]}", f"--user-data-dir={self._profile}",
                *(gl if graphics else ["--disable-gpu"]), "about:blank",
            ],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._tabs: list[Tab] = []

    def __enter__(self) -> Chromium:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for tab in self._tabs:
            tab.close()
        self._process.terminate()
        self._process.wait()
        shutil.rmtree(self._profile, ignore_errors=True)

    def open(self, address: str) -> Tab:
        """Open a tab in front, with the page at `address`."""
        request = urllib.request.Request(f"http://127.0.0.1:{self._port()}/json/new?about:blank", method="PUT")
        with urllib.request.urlopen(request) as answer:
            tab = Tab(json.load(answer)["webSocketDebuggerUrl"])
        self._tabs.append(tab)
        tab.call("Page.bringToFront")
        tab.call("Page.navigate", url=address)
        return tab

    def _port(self) -> int:
        path, deadline = Path(self._profile, "DevToolsActivePort"), time.monotonic() + START_S
        while not path.exists() or len(path.read_text().split()) < 2:
            if time.monotonic() > deadline:
                raise TimeoutError("the browser does not start")
            time.sleep(0.1)
        return int(path.read_text().split()[0])
