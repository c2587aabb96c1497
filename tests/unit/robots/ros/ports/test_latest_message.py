"""Which message of a topic counts, without a network or a clock."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from wire import Wire

from foldcell.robots.baxter.ros.ports.latest_message import LatestMessage


class Topic:
    """A topic whose messages are (stamp of the sender, value)."""

    def __init__(self, in_order: bool = True) -> None:
        self.wire = Wire()
        self.latest: LatestMessage[tuple[float, int]] = LatestMessage(
            self.wire, self.wire, "topic", object,  # type: ignore[arg-type]
            lambda message, arrival: (arrival, message.value), in_order=in_order,
        )  # fmt: skip

    def tell(self, sent: float, value: int) -> tuple[float, int] | None:
        self.wire.time += 1.0
        stamp = SimpleNamespace(to_sec=lambda: sent)
        self.wire.heard(SimpleNamespace(header=SimpleNamespace(stamp=stamp), value=value))
        return self.latest.newest


def test_an_overtaken_or_repeated_message_does_not_replace_a_newer_one() -> None:
    """It would look fresh, because the driver knows only when it arrived."""
    topic = Topic()
    assert topic.tell(50.00, 1) == (1.0, 1)
    assert topic.tell(50.02, 2) == (2.0, 2)
    assert topic.tell(50.01, 3) == (2.0, 2)
    assert topic.tell(50.02, 2) == (2.0, 2), "a repetition is as old as the original"
    assert topic.tell(50.03, 4) == (5.0, 4)


def test_a_senders_clock_may_be_set() -> None:
    topic = Topic()
    topic.tell(50.0, 1)
    assert topic.tell(47.0, 2) == (2.0, 2)
    assert topic.tell(47.01, 3) == (3.0, 3)
    assert topic.tell(3e9, 4) == (4.0, 4)


@pytest.mark.parametrize(("in_order", "stamp"), [(True, 0.0), (False, 50.0)])
def test_messages_without_a_stamp_or_an_order_count_as_they_arrive(in_order: bool, stamp: float) -> None:
    topic = Topic(in_order)
    assert [topic.tell(stamp, k) for k in range(3)] == [(1.0, 0), (2.0, 1), (3.0, 2)]
