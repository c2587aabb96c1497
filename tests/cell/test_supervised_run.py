"""A whole run supervised from the operator's page: approve, pause, resume, abort."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from queue import Queue
from types import SimpleNamespace
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from foldcell.cell.runs.fold_run import fold_once
from tests.runs import decided_again, fold_request

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


PACE = 4.0
"""Seconds of the cell in a second of this test."""


class Operator(threading.Thread):
    """Approves the first fold, pauses and resumes it during its motion, and aborts the run before the second
    fold."""

    def __init__(self, addresses: Queue[str]) -> None:
        super().__init__(daemon=True)
        self._addresses = addresses
        self.boards: list[dict[str, Any]] = []
        self.answers: list[dict[str, Any]] = []

    def run(self) -> None:
        address = self._addresses.get(timeout=120.0)
        origin = "/".join(address.split("/")[:3])
        said: set[str] = set()
        with connect(address.replace("http", "ws") + "link", origin=origin) as link:  # type: ignore[arg-type]
            try:
                while True:
                    message = json.loads(link.recv(timeout=120.0))
                    if "run_status" not in message:
                        self.answers.append(message)
                        continue
                    self.boards.append(message["run_status"])
                    word = self._word(message["run_status"])
                    number = (message["run_status"]["question"] or {}).get("number")
                    if word is not None and word not in said:
                        said.add(word)
                        link.send(json.dumps({"say": word, "question": number}))
            except ConnectionClosed:
                pass

    def _word(self, board: dict[str, Any]) -> str | None:
        if board["question"]:
            return "approve" if board["question"]["number"] == 1 else "abort"
        if board["state"] != "folding" or board["note"] == "resumed":
            return None
        return "resume" if board["note"].startswith("paused") else "pause"


def test_an_operator_approves_pauses_resumes_and_aborts_on_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    addresses: Queue[str] = Queue()
    pages = "operator's page: "
    monkeypatch.setattr(
        "foldcell.cell.runs.run_observers.say",
        lambda text: addresses.put(text.split()[-1]) if pages in text else None,
    )
    clock = SimpleNamespace(monotonic=lambda: PACE * time.monotonic(), sleep=lambda s: time.sleep(s / PACE))
    monkeypatch.setattr("foldcell.cell.simulation.world.time", clock)
    operator = Operator(addresses)
    operator.start()
    request = fold_request(tmp_path, approve=True, terminal=False, page=True, realtime=True, record=True)
    result = fold_once(request)
    operator.join(10.0)
    assert not operator.is_alive()
    assert (result.state, result.exit_code, result.failure.kind) == ("not_folded", 2, "aborted")
    assert [step.done for step in result.steps] == [True, False], "the paused fold was completed"
    noted = [answer["noted"] for answer in operator.answers if "noted" in answer]
    assert noted == ["approve", "pause", "resume", "abort"]
    states = [board["state"] for board in operator.boards]
    first = states.index("approaching")
    assert "awaiting_approval" in states[:first] and states.index("folding") > first
    assert operator.boards[-1]["end"]["result"] == "not_folded"
    remarks = [remark["title"] for remark in operator.boards[-1]["remarks"]]
    assert remarks == ["approve", "paused", "resumed", "aborted while awaiting approval"]
    again = decided_again(request.logs)
    assert again.same and again.broken_off is None, (
        "approval, pause, resume and abort are replayed in their places"
    )
    assert again.wall_time_s < 0.5 * result.wall_time_s, "the replay does not wait for a person"
