"""Tasks for the loop's thread: when they run, when they complete, and their end."""

from __future__ import annotations

from foldcell.robots.baxter.emulator.loop_tasks import LoopTasks


def test_a_cancelled_task_is_not_executed() -> None:
    errands, done = LoopTasks(), []
    assert errands.ask(lambda: done.append(1)).cancel()
    assert not errands.run() and not done


def test_closing_completes_done_tasks_and_cancels_the_rest() -> None:
    errands = LoopTasks()
    done = errands.ask(lambda: 3)
    errands.run()
    waiting = errands.ask(lambda: 4)
    errands.end()
    assert done.result(0) == 3
    assert waiting.cancelled() and errands.ask(lambda: 5).cancelled()


def test_a_task_added_by_a_task_waits_for_the_next_tick() -> None:
    errands, done = LoopTasks(), []
    errands.ask(lambda: errands.ask(lambda: done.append(1)))
    errands.run()
    assert not done
    errands.run()
    assert done
