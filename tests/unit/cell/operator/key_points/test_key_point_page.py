"""The page on which key points are placed: its routes, what it writes, and the mouse in a browser."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from http.client import HTTPConnection
from queue import Queue
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from benchmarks.operator.chromium import Chromium, Tab
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.operator.key_points.editing import KeyPointEdit, template_over
from foldcell.cell.operator.key_points.server import edit_key_points
from foldcell.cell.operator.local_server import open_listener
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.garments.garment import Garment
from foldcell.skills.garments.picture_measure import PictureMeasure
from tests import optional_parts

COLUMNS, ROWS, METRE = 640, 480, 300.0
TOWEL = load_garment("small_towel")


def pixels(garment: Garment, angle: float = 0.0) -> np.ndarray:
    """The key points in a picture from above, (k, 2), with the laid garment turned by `angle`."""
    c, s = np.cos(angle), np.sin(angle)
    xy = garment.template @ np.array([[c, s], [-s, c]])
    return np.array([COLUMNS / 2, ROWS / 2]) - METRE * xy[:, ::-1]


def named(garment: Garment, places: np.ndarray) -> dict[str, list[float]]:
    return dict(zip(garment.keypoints, places.tolist(), strict=True))


def an_edit(start: Mapping[str, Any]) -> KeyPointEdit:
    picture = np.full((ROWS, COLUMNS, 3), 200, np.uint8)
    corners = pixels(TOWEL)
    cv2.fillPoly(picture, [np.round(corners).astype(np.int32)], (150, 90, 60))
    measure = PictureMeasure(COLUMNS, ROWS, (0, 1), float(np.linalg.norm(TOWEL.template[0] - TOWEL.template[1])))
    return KeyPointEdit("My towel", picture, TOWEL, measure, corners, start, (("picture", "towel.png"),))


@dataclass
class Session:
    """One editing on a thread. written: what keep and save were given. refuse: what the next save raises."""

    address: str = ""
    written: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    refuse: list[ConfigurationError] = field(default_factory=list)
    ended: Queue[bool] = field(default_factory=Queue)

    def keep(self, points: Mapping[str, Any]) -> str:
        self.written.append(("keep", dict(points)))
        return "points.yaml"

    def save(self, points: Mapping[str, Any]) -> str:
        if self.refuse:
            raise self.refuse.pop()
        self.written.append(("save", dict(points)))
        return "towel.yaml"

    def ask(
        self, method: str, path: str = "", body: Any = None, secret: bool = True, **headers: str
    ) -> tuple[int, bytes]:
        where = urlsplit(self.address)
        link = HTTPConnection(where.netloc, timeout=30.0)
        origin = {"Origin": f"http://{where.netloc}"} | headers
        link.request(
            method, (where.path if secret else "/") + path, None if body is None else json.dumps(body), origin
        )
        answer = link.getresponse()
        return answer.status, answer.read()

    def post(self, points: Mapping[str, Any], then: str) -> dict[str, Any]:
        status, content = self.ask("POST", "points", {"points": points, "then": then})
        assert status == 200, content
        return dict(json.loads(content))


Started = Callable[[Mapping[str, Any]], Session]


@pytest.fixture
def started() -> Iterator[Started]:
    sessions: list[tuple[Session, threading.Thread]] = []

    def start(points: Mapping[str, Any]) -> Session:
        session, served = Session(), threading.Event()

        def announce(address: str) -> None:
            session.address = address
            served.set()

        def work() -> None:
            edit = an_edit(points)
            session.ended.put(edit_key_points(edit, open_listener(), announce, session.keep, session.save))

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        sessions.append((session, thread))
        assert served.wait(30.0)
        return session

    yield start
    for session, thread in sessions:
        if thread.is_alive():
            session.post({}, "cancel")


def test_the_page_shows_what_is_edited_and_loads_nothing_from_elsewhere(started: Started) -> None:
    session = started(named(TOWEL, pixels(TOWEL)))
    status, page = session.ask("GET")
    assert status == 200 and b"http" not in page.replace(b"http://www.w3.org/2000/svg", b"")
    edited = json.loads(session.ask("GET", "edit")[1])
    assert tuple(edited["names"]) == TOWEL.keypoints and edited["size"] == [COLUMNS, ROWS]
    assert edited["points"] == named(TOWEL, pixels(TOWEL))
    picture = cv2.imdecode(np.frombuffer(session.ask("GET", "picture.jpg")[1], np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None and picture.shape == (ROWS, COLUMNS, 3)


def test_the_page_needs_its_secret_its_origin_and_a_valid_message(started: Started) -> None:
    session = started({})
    body = {"points": {}, "then": "cancel"}
    assert (
        session.ask("GET", secret=False)[0] == 404 and session.ask("POST", "points", body, secret=False)[0] == 404
    )
    assert session.ask("POST", "points", body, Origin="http://example.org")[0] == 403
    assert session.ask("GET", Host="example.org")[0] == 400
    for wrong in ({}, body | {"then": "shout"}, body | {"points": {"a": [1]}}, body | {"more": 1}, "cancel"):
        assert session.ask("POST", "points", wrong)[0] == 400
    assert session.ask("POST", "points", body | {"points": {"n" * 2**16: [0, 0]}})[0] == 413
    assert session.ended.empty()


def test_each_change_is_checked_and_its_folds_are_drawn(started: Started) -> None:
    session, corners = started({}), pixels(TOWEL)
    points = named(TOWEL, corners)
    shown = session.post(points, "check")
    assert shown["findings"] == [] and shown["size_m"] == pytest.approx(TOWEL.size_m, rel=1e-3)
    (half, quarter) = shown["folds"]
    middles = np.array([(a + b) / 2 for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    ends = np.array(half["creases"]).reshape(-1, 2)
    assert all(np.linalg.norm(middles - end, axis=1).min() < 1.0 for end in ends), "from edge to opposite edge"
    assert len(quarter["creases"]) == 2, "one in each layer"
    a, b, *_ = TOWEL.keypoints
    shown = session.post(points | {a: points[b], b: points[a]}, "check")
    assert shown["folds"] == [] and "exchanged" in shown["findings"][0]["what"]
    again = json.loads(session.ask("GET", "edit")[1])
    assert again["points"][a] == points[b], "a page that is loaded again goes on where it was"


def test_saving_ends_the_editing_and_implausible_points_cannot_be_saved(started: Started) -> None:
    session, points = started({}), named(TOWEL, pixels(TOWEL))
    missing = {name: points[name] for name in TOWEL.keypoints[1:]}
    assert "no garment can be made" in session.post(missing, "save")["refused"]
    assert session.post(missing, "keep")["written"] == "points.yaml"
    session.refuse.append(ConfigurationError("its folds cannot be planned", "move the points"))
    refused = session.post(points, "save")
    assert refused["refused"] == "its folds cannot be planned" and refused["hint"] == "move the points"
    saved = session.post(points, "save")
    assert saved["written"] == "towel.yaml" and saved["ended"]
    assert session.ended.get(timeout=30.0)
    assert [(what, list(given)) for what, given in session.written] == [
        ("keep", list(missing)), ("save", list(points))
    ]  # fmt: skip


def test_cancelling_writes_nothing(started: Started) -> None:
    session = started(named(TOWEL, pixels(TOWEL)))
    assert session.post({}, "cancel")["ended"]
    assert not session.ended.get(timeout=30.0) and session.written == []


@pytest.mark.parametrize("name", ["t_shirt", "pants", "medium_towel"])
def test_a_template_is_laid_over_an_outline(name: str) -> None:
    garment = load_garment(name)
    true = pixels(garment, angle=0.3)
    edges = zip(true, np.roll(true, -1, axis=0), strict=True)
    outline = np.concatenate([np.linspace(a, b, 60, endpoint=False) for a, b in edges])
    found = template_over(outline, garment)
    assert tuple(found) == garment.keypoints
    assert np.linalg.norm(np.array(list(found.values())) - true, axis=1).max() < 0.03 * METRE


def until(tab: Tab, condition: str) -> None:
    deadline = time.monotonic() + 60.0
    while not tab.evaluate(condition):
        assert time.monotonic() < deadline, (condition, tab.evaluate("document.body.innerText"))
        time.sleep(0.05)


SCREEN = """(() => { const box = at("picture").getBoundingClientRect(), [x, y] = toScreen(%s);
return [x + box.x, y + box.y]; })()"""


@optional_parts.BROWSER.required
def test_points_are_placed_dragged_nudged_taken_back_and_saved_in_a_browser(started: Started) -> None:
    corners = named(TOWEL, pixels(TOWEL))
    last = TOWEL.keypoints[-1]
    session = started({name: corners[name] for name in TOWEL.keypoints[:-1]})

    def place(spot: list[float]) -> tuple[float, float]:
        until(tab, "!drawing")  # findings change the size of the picture's frame
        x, y = tab.evaluate(SCREEN % json.dumps(spot))
        return x, y

    with Chromium() as browser:
        tab = browser.open(session.address)
        until(tab, "typeof edit !== 'undefined' && at('zoom').textContent && checked.findings.length === 1")
        assert last.replace("_", " ") in tab.evaluate("at('state').textContent") and tab.evaluate(
            "at('save').disabled"
        )
        beside = [corners[last][0] - 25.0, corners[last][1] + 10.0]
        tab.press(*place(beside))
        until(tab, "known && !at('save').disabled && checked.findings[0]?.refused === false")  # off the outline
        for kind, spot in (("Pressed", beside), ("Moved", [300.0, 300.0]), ("Moved", corners[last])):
            x, y = place(spot)
            tab.call(
                "Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, button="left", buttons=1, clickCount=1
            )
        tab.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, button="left", clickCount=1)
        until(tab, "known && checked.findings.length === 0 && checked.folds.length === 2")
        arrow = {"key": "ArrowRight", "windowsVirtualKeyCode": 39, "modifiers": 8}  # with Shift: ten pixels
        for kind in ("keyDown", "keyUp"):
            tab.call("Input.dispatchKeyEvent", type=kind, **arrow)
        moved = tab.evaluate(f"points.{last}")
        assert moved == pytest.approx(np.add(corners[last], (10.0, 0.0)), abs=1.0)
        tab.evaluate("at('undo').click()")
        assert tab.evaluate(f"points.{last}") == pytest.approx(np.subtract(moved, (10.0, 0.0)), abs=0.02)
        until(tab, "!at('save').disabled")
        tab.evaluate("at('save').click()")
        until(tab, "saved")
        assert "towel.yaml" in tab.evaluate("at('end').textContent")
        assert tab.outside(session.address.rsplit("/", 2)[0]) == []
    assert session.ended.get(timeout=30.0)
    assert session.written[0][1][last] == pytest.approx(corners[last], abs=1.0)
