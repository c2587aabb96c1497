"""Signals that end a command."""

from __future__ import annotations

import signal
import time

import pytest

from foldcell.cell.support.process.signals import Terminated, unwinding


class Signalling:
    """An object while whose end a signal arrives: Python discards what its handler raises there."""

    def __init__(self, number: signal.Signals) -> None:
        self.number = number

    def __del__(self) -> None:
        signal.raise_signal(self.number)


@pytest.mark.parametrize(
    ("number", "raised"),
    [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated), (signal.SIGHUP, Terminated)],
)
def test_a_signal_that_python_has_forgotten_ends_the_command(
    number: signal.Signals, raised: type[BaseException], capsys: pytest.CaptureFixture[str]
) -> None:
    found = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it is ignored
    interrupt = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a shell's background
    try:
        with pytest.raises(raised), unwinding():
            Signalling(number)
            time.sleep(60.0)
    finally:
        signal.signal(signal.SIGHUP, found)
        signal.signal(signal.SIGINT, interrupt)
    assert capsys.readouterr().err == "", "no traceback reaches the user"
