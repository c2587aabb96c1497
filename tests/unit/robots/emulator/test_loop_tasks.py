"""Work for the loop's thread: when it is done, when its future tells, and what becomes of it at the end."""

from __future__ import annotations

import pytest

from robots.baxter.emulator.loop_tasks import SETTLE, LoopTasks


def test_is_done_at_the_next_tick_and_told_when_the_topics_know() -> None:
    errands, done = LoopTasks(), []
    future = errands.ask(lambda: done.append(1) or "answer")
    assert not done
    assert errands.run() and done == [1]
    for _ in range(SETTLE - 1):
        assert not errands.run()
        assert not future.done()
    errands.run()
    assert future.result(0) == "answer" and done == [1]


def test_an_exception_is_the_futures() -> None:
    errands = LoopTasks()
    future = errands.ask(lambda: 1 // 0)
    for _ in range(SETTLE + 1):
        errands.run()
    with pytest.raises(ZeroDivisionError):
        future.result(0)


def test_work_that_was_cancelled_is_not_done() -> None:
    errands, done = LoopTasks(), []
    assert errands.ask(lambda: done.append(1)).cancel()
    assert not errands.run() and not done


def test_at_the_end_what_was_done_is_told_and_the_rest_is_cancelled() -> None:
    errands = LoopTasks()
    done = errands.ask(lambda: 3)
    errands.run()
    waiting = errands.ask(lambda: 4)
    errands.end()
    assert done.result(0) == 3
    assert waiting.cancelled() and errands.ask(lambda: 5).cancelled()


def test_work_asked_for_by_work_waits_for_the_next_tick() -> None:
    errands, done = LoopTasks(), []
    errands.ask(lambda: errands.ask(lambda: done.append(1)))
    errands.run()
    assert not done
    errands.run()
    assert done
