"""Functions of `foldcell` that are called from several threads at once give the results of one thread."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier, Event
from typing import Any

import cv2
import numpy as np
import pytest

import foldcell
from foldcell import folding
from foldcell.cell.support.files.picture_file import read_picture
from foldcell.cell.support.process.library_messages import captured_messages

THREADS = 8


def at_once(work: Callable[[int], Any]) -> list[Any]:
    """The results of `work(0)` to `work(THREADS - 1)`, begun at the same moment. An exception is a result."""
    together = Barrier(THREADS)

    def begun(number: int) -> Any:
        together.wait()
        try:
            return work(number)
        except foldcell.ConfigurationError as error:
            return error

    with ThreadPoolExecutor(THREADS) as threads:
        return list(threads.map(begun, range(THREADS)))


def picture() -> np.ndarray:
    rgb = np.random.default_rng(0).normal(170, 2, (480, 640, 3)).clip(0, 255).astype(np.uint8)
    rgb[120:345, 180:480] = (150, 90, 60)
    return rgb


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A good JPEG, and one that ends in its middle. Only a message on standard error tells that it is damaged."""
    data = bytes(cv2.imencode(".jpg", picture())[1])
    good, cut = tmp_path / "good.jpg", tmp_path / "cut.jpg"
    good.write_bytes(data)
    half = len(data) // 2
    cut.write_bytes(data[:half] + b"\xff\xd9" + data[half + 2 :])
    return good, cut


def test_damaged_pictures_are_told_from_good_ones_in_several_threads(files: tuple[Path, Path]) -> None:
    before = os.fstat(2)

    def read(number: int) -> int:
        """How often the answer was wrong."""
        wrong = 0
        for turn in range(25):
            damaged = (number + turn) % 2
            try:
                read_picture(files[damaged])
                wrong += damaged
            except foldcell.ConfigurationError:
                wrong += not damaged
        return wrong

    assert at_once(read) == [0] * THREADS
    after = os.fstat(2)
    assert (after.st_dev, after.st_ino) == (before.st_dev, before.st_ino)


def test_perceive_in_several_threads_gives_the_results_of_one(files: tuple[Path, Path]) -> None:
    alone = foldcell.perceive(files[0], unit="px")
    results = at_once(lambda number: foldcell.perceive(files[number % 4 == 3], unit="px"))
    for number, seen in enumerate(results):
        if number % 4 == 3:
            assert isinstance(seen, foldcell.ConfigurationError) and "damaged" in seen.what
        else:
            assert seen.confidence == alone.confidence and np.array_equal(seen.contour, alone.contour)


def test_a_second_run_in_the_same_process_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    begun, end = Event(), Event()

    def run(_: Any) -> str:
        begun.set()
        end.wait()
        return "folded"

    monkeypatch.setattr(folding, "fold_once", run)
    with ThreadPoolExecutor(1) as threads:
        first = threads.submit(foldcell.fold, "small_towel", logs=tmp_path / "first")
        begun.wait()
        try:
            with pytest.raises(foldcell.ConfigurationError, match="another thread of this process performs a run"):
                foldcell.fold("small_towel", logs=tmp_path / "second")
        finally:
            end.set()
        assert first.result() == "folded"
    assert foldcell.fold("small_towel", logs=tmp_path / "second") == "folded"


def test_captures_may_be_nested(capfd: pytest.CaptureFixture[str]) -> None:
    with captured_messages() as outer:
        os.write(2, b"outer")
        with captured_messages() as inner:
            os.write(2, b"inner")
            assert inner() == "inner"
        assert outer() == "outer"
    assert capfd.readouterr().err == ""


FORKED = """
import os, threading
from foldcell.cell.support.process.library_messages import captured_messages
captured, end = threading.Event(), threading.Event()
def capture():
    with captured_messages():
        captured.set()
        end.wait()
thread = threading.Thread(target=capture)
thread.start()
captured.wait()
threading.Timer(0.2, end.set).start()
child = os.fork()  # waits until nothing is captured
if child == 0:
    with captured_messages() as messages:
        pass
    os.write(2, b"of the child")
    os._exit(0)
os.waitpid(child, 0)
thread.join()
"""


def test_a_forked_process_has_the_standard_error_of_its_parent() -> None:
    run = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, check=True)
    assert run.stderr.endswith("of the child")
