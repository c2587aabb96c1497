"""The progress bar: one line on a terminal, few plain lines elsewhere, no error on a closed stream."""

from __future__ import annotations

import io
import re

import pytest

from foldcell.cell.operator.progress.bar import EVERY_S, ProgressBar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_a_terminal_shows_progress_in_one_line_that_is_overwritten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    out, clock = Terminal(), Clock()
    bar = ProgressBar(out, clock)
    for done in range(1, 11):
        clock.now += 10.0
        bar.update(done, 40, "simulations  half: best D 2.5 mm")
    text = out.getvalue()
    assert "\n" not in text and text.count("\r[") == 10
    last = text.split("\r")[-1]
    assert "10/40" in last and "best D 2.5 mm" in last and "5 min 0 s left" in last
    assert re.search(r"\[(#{6})(\.{18})\]", last), "a quarter of the bar is full"
    bar.line("half: done")
    assert out.getvalue().endswith("\r\x1b[Khalf: done\n")
    bar.clear()
    assert out.getvalue().endswith("half: done\n"), "a bar that is not shown is not cleared"


def test_the_progress_bar_fits_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    out = Terminal()
    ProgressBar(out).update(3, 9, "a remark that is much too long for this")
    assert len(out.getvalue().removeprefix("\r").removesuffix("\x1b[K")) <= 30


def test_progress_without_a_terminal_is_a_few_plain_lines() -> None:
    out, clock = io.StringIO(), Clock()
    bar = ProgressBar(out, clock)
    for done in range(1, 101):
        clock.now += EVERY_S / 10
        bar.update(done, 100, "simulations")
    lines = out.getvalue().splitlines()
    assert 9 <= len(lines) <= 10
    assert all(re.fullmatch(r"\d+/100  simulations(  (\d+ min )?\d+ s left)?", line) for line in lines)


def test_the_time_left_follows_the_mean_pace_and_a_reduced_total() -> None:
    out, clock = Terminal(), Clock()
    bar = ProgressBar(out, clock)
    clock.now += 2.0
    bar.update(2, 10)
    assert "left" not in out.getvalue(), "two values give no estimate yet"
    clock.now += 2.0
    bar.update(4, 10)
    assert "  6 s left" in out.getvalue()
    bar.update(4, 4)
    assert out.getvalue().split("\r")[-1].count("left") == 0


def test_each_task_is_timed_from_its_own_start() -> None:
    out, clock = Terminal(), Clock()
    bar = ProgressBar(out, clock)
    clock.now += 1000.0
    bar.restart()
    clock.now += 4.0
    bar.update(4, 10)
    assert "  6 s left" in out.getvalue()


def test_a_closed_stream_is_ignored() -> None:
    out = Terminal()
    bar = ProgressBar(out)
    out.close()
    bar.update(1, 2)
    bar.line("still here")
    bar.clear()
