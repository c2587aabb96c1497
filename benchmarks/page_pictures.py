"""Makes the pictures of the pages for docs/do: `python -m benchmarks.page_pictures [NAME...]`.

Chromium (without a window) opens the page of two supervised runs of a simulated towel. In the first one the left
hand misses its grasp until the cell asks, then the run is stopped. The second one is approved, paused, watched by
a second browser, and ends. It also opens the page of the key points of a drawn photograph. Without a NAME all
pictures are renewed.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from benchmarks.operator.chromium import Chromium, Tab, keep_picture
from benchmarks.photographs.real.photograph import draw
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.driver import OpenCell
from foldcell.cell.runs import run_observers
from foldcell.cell.runs.fold_run import fold_once
from foldcell.cell.simulation import Fault, FaultKind
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.robots.ports import Side

FOLDER = Path(__file__).parents[1] / "docs" / "pictures"
GARMENT, SEED = "small_towel", 5
KEY_POINTS, PHOTOGRAPH = "page_key_points", 7
LIKE = ["--like", "long_sleeve_shirt_small", "--length", "0.40", "--between", "hem_right,hem_left"]
DRAGGED, DRAG = "cuff_lower_left", (-8.0, 42.0)
LONGEST_S = 900.0
MISSES = 4
"""Grasps that miss, until the recovery table has nothing left to try."""


def main() -> int:
    wanted = set(sys.argv[1:])

    def keep(name: str, tab: Tab) -> None:
        if not wanted or name in wanted:
            keep_picture(tab.screenshot(), FOLDER / f"{name}.webp")
            print(name, flush=True)

    if not wanted or KEY_POINTS in wanted:
        with Chromium() as browser, _edited() as address:
            _key_points(browser.open(address), keep)
        if wanted == {KEY_POINTS}:
            return 0
    with tempfile.TemporaryDirectory() as logs:
        with Chromium() as browser, _run(Path(logs, "failed"), _misses) as address:
            _failed(browser.open(address()), keep)
        with Chromium() as browser, Chromium() as other, _run(Path(logs, "folded")) as address:
            _folded(browser.open(address()), lambda: other.open(address()), keep)
    return 0


def _key_points(tab: Tab, keep: Callable[[str, Tab], None]) -> None:
    """One cuff is dragged along the sleeve, so that the page shows its magnifier and a doubt."""
    ready = "known && checked.folds.length > 0"
    _await(tab, f"typeof edit !== 'undefined' && at('zoom').textContent && {ready}")
    corner = tab.evaluate("(({ x, y }) => [x, y])(at('picture').getBoundingClientRect())")
    x, y = np.add(tab.evaluate(f"toScreen(points.{DRAGGED})"), corner)
    to = x + DRAG[0], y + DRAG[1]
    for kind, (column, row) in (("Pressed", (x, y)), ("Moved", to)):
        tab.call(
            "Input.dispatchMouseEvent", type=f"mouse{kind}", x=column, y=row, button="left", buttons=1,
            clickCount=1,
        )  # fmt: skip
    _await(tab, f"checked.findings.length > 0 && {ready}")
    time.sleep(0.3)
    keep(KEY_POINTS, tab)
    tab.evaluate("at('cancel').click()")
    _await(tab, "ended")


@contextmanager
def _edited() -> Iterator[str]:
    """Edit the key points of a drawn photograph. Yields the address of the page."""
    with tempfile.TemporaryDirectory() as folder:
        cv2.imwrite(str(Path(folder, "my_shirt.png")), draw(PHOTOGRAPH).picture[..., ::-1])
        command = [
            sys.executable,
            "-m",
            "foldcell.cell.commands.main",
            "garment",
            "new",
            "my_shirt.png",
            "--edit",
            *LIKE,
        ]
        with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=folder, text=True) as process:
            assert process.stdout is not None
            yield process.stdout.readline().split()[1]


def _failed(tab: Tab, keep: Callable[[str, Tab], None]) -> None:
    while _state(tab, "awaiting_approval", "asking") != "asking":
        _press(tab, "approve")
    keep("page_failure", tab)
    _press(tab, "retry")
    _state(tab, "awaiting_approval")
    _press(tab, "approve")
    _state(tab, "lifting", "folding", "asking")
    _press(tab, "stop")
    _until(tab, "runStatus.end !== null")
    time.sleep(0.3)
    keep("page_stopped", tab)


def _folded(tab: Tab, other: Callable[[], Tab], keep: Callable[[str, Tab], None]) -> None:
    _state(tab, "awaiting_approval")
    keep("operators_page", tab)
    tab.evaluate('document.querySelector("[data-key=m]").click()')
    time.sleep(0.5)
    keep("page_change_points", tab)
    _press(tab, "approve")
    _state(tab, "folding")
    _until(tab, "(picture?.progress ?? 0) > 0.4")
    keep("page_moving", tab)
    _press(tab, "pause")
    _until(tab, 'at("banner").className === "paused"')
    time.sleep(1.5)
    keep("page_paused", tab)
    second = other()
    _until(second, "shownTaken !== null")
    keep("page_watching", second)
    _press(tab, "resume")
    while _state(tab, "awaiting_approval", "folded", "not_folded") == "awaiting_approval":
        _press(tab, "approve")
    _until(tab, "runStatus.end !== null")
    keep("page_done", tab)


@contextmanager
def _run(
    logs: Path, on_open: Callable[[OpenCell, CommandQueue], None] | None = None
) -> Iterator[Callable[[], str]]:
    """Perform a supervised run on a thread. Yields a function that waits for the page's address."""
    addresses: list[str] = []
    served = threading.Event()

    def say(text: str) -> None:
        if text.startswith("operator's page: "):
            addresses.append(text.split(": ", 1)[1])
            served.set()

    def address() -> str:
        if not served.wait(LONGEST_S):
            raise TimeoutError("the run serves no page")
        return addresses[0]

    request = FoldRequest(
        GARMENT, SEED, "sim", load_settings(), logs, approve=True, terminal=False, page=True, realtime=True,
        quiet=True,
    )  # fmt: skip
    said = run_observers.say
    run_observers.say = say
    run = threading.Thread(target=fold_once, args=(request, on_open))
    run.start()
    try:
        yield address
    finally:
        run.join()
        run_observers.say = said


def _misses(opened: OpenCell, _: CommandQueue) -> None:
    assert opened.simulated is not None
    for k in range(MISSES):
        opened.simulated.faults.add(Fault(FaultKind.MISSED_GRASP, side=Side.LEFT, grasp=k + 1))


def _state(tab: Tab, *states: str) -> str:
    """Wait for one of these states, in which a picture can be approved if it is a question. Returns it."""
    _until(tab, f"{list(states)}.includes(runStatus?.state) && !unseen()")
    time.sleep(0.5)  # the buttons follow the state
    return str(tab.evaluate("runStatus.state"))


def _press(tab: Tab, button: str) -> None:
    number = tab.evaluate("runStatus.question?.number ?? null")
    _until(tab, f'!at("{button}").disabled')
    tab.evaluate(f'at("{button}").click()')
    if number is not None:
        _until(tab, f"runStatus.question?.number !== {number}")


def _until(tab: Tab, condition: str) -> None:
    _await(tab, f"typeof runStatus !== 'undefined' && runStatus !== null && ({condition})")


def _await(tab: Tab, condition: str) -> None:
    deadline = time.monotonic() + LONGEST_S
    while not tab.evaluate(condition):
        if time.monotonic() > deadline:
            raise TimeoutError(condition)
        time.sleep(0.05)


if __name__ == "__main__":
    sys.exit(main())
