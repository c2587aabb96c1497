"""The operator's page in a browser: stop without a link, fixed positions of the buttons, keys, and no approval
before the picture is on the screen."""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Queue
from threading import Event as Event_
from threading import Thread
from typing import ClassVar

import numpy as np
import pytest

from foldcell.cell.operator.console.run_status import RunStatus
from foldcell.cell.operator.console.server import PAGE
from foldcell.cell.record.run_record import FailureRecord
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.cell.support.files.encoded_picture import jpeg_file
from foldcell.robots.errors import FailureKind
from tests import optional_parts
from tests.builders.contexts import context_with
from tests.builders.records import run_record, run_status
from tests.scenes import Scene, camera, render

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = optional_parts.BROWSER.required
ACCEPT = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
PRESS_STOP_WHEN_LOST = """
<script>setInterval(() => { if (!at("lost").hidden && !at("stop").disabled) at("stop").click(); }, 100);</script>
"""
TELL_PLACES = """
<script>
let told = null;
const middle = (r) => [r.x + r.width / 2, r.y + r.height / 2];
setInterval(() => {
  if (runStatus === null || runStatus.state === told) return;
  told = runStatus.state;
  const all = [...Object.keys(KEYS), "stop"];
  say(Object.fromEntries(all.map((id) => [id, middle(at(id).getBoundingClientRect())])));
}, 50);
</script>
"""


class Silent(BaseHTTPRequestHandler):
    """A server that hangs. It serves the page and sends the boards' statuses over the first link, each after the
    page has answered the previous one. Then it sends nothing more.

    said: the page's messages on the first link. script: the test's script, appended to the page.
    """

    boards: Sequence[RunStatus]
    script: str
    said: Queue[str]
    links: list[object]
    picture: ClassVar[dict[str, object]] = {
        "number": 1,
        "age_s": 0.1,
        "question": True,
        "progress": None,
        "grip_n": {},
    }
    shutter: Event_

    def do_GET(self) -> None:
        if "picture.jpg" in self.path:
            self.shutter.wait(60.0)
            self.send_response(200)
            self.end_headers()
            self.wfile.write(jpeg_file(np.full((48, 64, 3), 90, np.uint8)))
            return
        if "link?" not in self.path:
            page = (
                PAGE.read_text(encoding="utf-8").replace("{{viewer}}", "null").replace("{{origins}}", "null")
                + self.script
            )
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
            for board in self.boards:
                news = {"stopped": False, "control": "yours", "picture": self.picture}
                told = json.dumps({"run_status": board.snapshot(), **news}).encode()
                self.wfile.write(b"\x81\x7e" + len(told).to_bytes(2, "big") + told)
                self.said.put(self._frame())
        while frame := self._frame():
            if self is self.links[0]:
                self.said.put(frame)

    def _frame(self) -> str:
        """The browser's next frame, unmasked. Empty at the end of the link."""
        head = self.rfile.read(2)
        if len(head) < 2:
            return ""
        length = head[1] & 0x7F
        length = length if length < 126 else int.from_bytes(self.rfile.read(2), "big")
        mask, body = self.rfile.read(4), self.rfile.read(length)
        text = bytes(byte ^ mask[k % 4] for k, byte in enumerate(body))
        return text.decode() if head[0] & 0x0F == 1 else f"<frame {head[0] & 0x0F}>"

    def log_message(self, *_: object) -> None: ...


Page = Callable[..., "Queue[str]"]


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """Opens the page in a browser. Returns the page's messages to a server that sends these statuses and then
    hangs."""
    with ExitStack() as closing:

        def opened(boards: Sequence[RunStatus], script: str, shutter: Event_ | None = None) -> Queue[str]:
            said: Queue[str] = Queue()
            if shutter is None:  # pictures come at once
                shutter = Event_()
                shutter.set()
            handler = type("Handler", (Silent,), {
                "boards": boards, "script": script, "said": said, "links": [], "shutter": shutter
            })  # fmt: skip
            server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
            server.daemon_threads = True
            closing.callback(server.server_close)
            Thread(target=server.serve_forever, daemon=True).start()
            closing.callback(server.shutdown)
            assert BROWSER is not None
            command = [
                BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run",
                "--remote-debugging-port=0", f"--user-data-dir={tmp_path / 'profile'}",
                f"http://127.0.0.1:{server.server_port}/secret/",
            ]  # fmt: skip
            browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            closing.callback(browser.wait)
            closing.callback(browser.terminate)
            return said

        yield opened


def entered(board: RunStatus, state: State) -> RunStatus:
    board.entered(1.0, Step(State.IDLE, Event.DONE, state, Effect.NOTHING))
    return board


def test_stop_works_on_a_page_that_lost_its_link(page: Page) -> None:
    """A program that hangs for a moment gets the stop as soon as it continues."""
    said = page([run_status()], PRESS_STOP_WHEN_LOST)
    assert json.loads(said.get(timeout=60.0)) == {"stop": True}


def test_buttons_keep_their_place_in_every_state(page: Page) -> None:
    """Otherwise a click meant for STOP could hit the approve button of a question that opens at this moment."""
    computing, asking, ended = (
        entered(run_status(), State.OPTIMISING),
        run_status(),
        entered(run_status(), State.FAULT),
    )
    computing.computing(3, 25, "simulations at most, best D 2.1 mm")
    computing.note("coming to rest on the way")
    asking.ask("lay the garment flat on the table and step back")
    entered(asking, State.AWAITING_APPROVAL)
    failure = FailureRecord(
        FailureKind.GRIPPER_FAULT, "the left gripper does not open", "free the garment by hand"
    )
    ended.finish(run_record(state=State.FAULT, failure=failure))
    said = page([run_status(), computing, asking, ended], TELL_PLACES)
    places = [json.loads(said.get(timeout=60.0)) for _ in range(4)]
    assert places[0]["stop"][1] > 0 and places[1:] == places[:1] * 3


TELL_APPROVE = """
<script>
let before = null;
setInterval(() => {
  const now = { approve: !at("approve").disabled, shown: !at("shown").hidden, retry: !at("retry").disabled };
  if (runStatus !== null && JSON.stringify(now) !== before) { before = JSON.stringify(now); say(now); }
}, 30);
</script>
"""
PRESS_A_WHEN_POSSIBLE = """
<script>
setInterval(() => {
  if (!at("approve").disabled) document.dispatchEvent(new KeyboardEvent("keydown", { key: "a" }));
}, 100);
</script>
"""
PRESS_ESCAPE = """
<script>
setInterval(() => {
  if (!at("stop").disabled) document.dispatchEvent(new KeyboardEvent("keydown", { key: "Escape" }));
}, 100);
</script>
"""


def asking() -> RunStatus:
    """A status in which a plan waits for approval."""
    board = run_status()
    step = Step(State.PLANNING_MOTION, Event.APPROVAL_NEEDED, State.AWAITING_APPROVAL, Effect.ASK_APPROVAL)
    board.performed(1.0, step, Result(Event.APPROVAL_NEEDED, context_with(frame=render(Scene(), camera()))))
    return entered(board, State.AWAITING_APPROVAL)


def test_nobody_approves_a_plan_that_was_not_on_the_screen(page: Page) -> None:
    shutter = Event_()
    said = page([asking()], TELL_APPROVE, shutter)
    first = json.loads(said.get(timeout=60.0))
    assert first == {"approve": False, "shown": False, "retry": True}, "without the picture, only a new look"
    shutter.set()
    while not (later := json.loads(said.get(timeout=60.0)))["approve"]:
        pass
    assert later["shown"]


def test_a_key_approves_the_shown_plan(page: Page) -> None:
    said = page([asking()], PRESS_A_WHEN_POSSIBLE)
    assert json.loads(said.get(timeout=60.0)) == {"say": "approve", "question": 1}


MOVE_THE_LEFT_GRASP = """
<script>
const key = (target, name) => target.dispatchEvent(new KeyboardEvent("keydown", { key: name, bubbles: true }));
setInterval(() => {
  const handle = document.getElementById("mark-grasp-left");
  if (document.querySelector('[data-key="m"]:enabled') && !handle) return key(document, "m");
  if (!handle || handle.disabled || handle.classList.contains("sent")) return;
  key(handle, "ArrowRight");
  key(handle, "Enter");
}, 100);
</script>
"""


def test_a_grasp_is_moved_with_the_keyboard(page: Page) -> None:
    """The page sends the new place, as shares of the picture. The mouse drags in the same way."""
    board, changes = asking(), {"points": [{"kind": "grasp", "name": "left", "at": [0.5, 0.25]}], "variants": []}
    snapshot = board.snapshot
    board.snapshot = lambda: {**snapshot(), "changes": {**changes, "variant": ""}}  # type: ignore[method-assign]
    said = page([board], MOVE_THE_LEFT_GRASP)
    message = json.loads(said.get(timeout=60.0))
    assert message["question"] == 1 and message["edit"]["grasp"] == "left"
    assert message["edit"]["to"] == pytest.approx([0.503, 0.25])


def test_escape_stops(page: Page) -> None:
    said = page([run_status()], PRESS_ESCAPE)
    assert json.loads(said.get(timeout=60.0)) == {"stop": True}


GIVE_A_REASON = """
<script>
setTimeout(() => {
  const early = at("not-passed").disabled;  // the reason is missing
  at("why").value = " a sleeve lies open ";
  at("why").oninput();
  at("why").dispatchEvent(new KeyboardEvent("keydown", { key: "q", bubbles: true }));  // a letter of the reason
  if (early && at("end").hidden) at("not-passed").click();
}, 1000);
</script>
"""


def test_a_person_judges_with_a_reason_and_without_the_claim_of_the_cell(page: Page) -> None:
    board = run_status(simulated=False)
    board.finish(run_record(driver="ros", simulated=False))
    board.judge(lambda judgement: None)
    said = page([board], GIVE_A_REASON)
    verdict = {"passed": False, "why": " a sleeve lies open "}
    assert json.loads(said.get(timeout=30.0)) == {"judge": verdict, "question": board.snapshot()["judging"]}
