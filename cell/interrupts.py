"""Ctrl-C and a termination signal trigger the stop circuit: the run then ends by its own rules."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from robots.ports import Ports

__all__ = ["stop_on_signals"]


@contextmanager
def stop_on_signals(ports: Ports) -> Iterator[list[int]]:
    """SIGINT and SIGTERM trigger the stop; gives the signals received. Off the main thread it does nothing."""
    received: list[int] = []

    def stop(number: int, _: Any) -> None:
        received.append(number)
        ports.stop.trigger(signal.Signals(number).name)

    try:
        before = {n: signal.signal(n, stop) for n in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:
        before = {}
    try:
        yield received
    finally:
        for n, handler in before.items():
            signal.signal(n, handler)
