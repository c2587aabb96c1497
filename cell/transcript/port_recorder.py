"""Records a run: ports and commands that forward every call and record its question and its answer.

The executive calls from one thread, and its calls are recorded in that order. Triggering the stop is possible from
any thread and is not recorded. Two kinds of polls of the stop depend on the wall clock and are not recorded
either: polls from other threads, and polls while a skill computes (`Workcell.watched_stop`). They can only end a
computation early, and then its result is discarded.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Set
from functools import partial
from pathlib import Path
from typing import Any

from foldcell.cell.journal.frame_store import FrameStore
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.transition_table import Event
from foldcell.cell.support.forwarding import forwarding
from foldcell.cell.transcript.channels import CellConstants, Channel, build_ports
from foldcell.cell.transcript.transcript import TranscriptWriter
from foldcell.cell.transcript.transcript_codec import pack
from foldcell.robots.ports import CameraFrame, Ports, Side


class PortRecorder:
    """Writes a run's transcript. Create it on the thread of the executive."""

    def __init__(self, folder: Path | None, frames: FrameStore | None = None) -> None:
        """folder: the run's folder; None: nothing is recorded. frames: as for TranscriptWriter."""
        self._folder, self._frames = folder, frames
        self._writer: TranscriptWriter | None = None
        self._thread = threading.get_ident()

    def between(self, ports: Ports, commands: CommandQueue) -> tuple[Ports, CommandQueue]:
        """Begin the transcript. Returns the ports and commands for the executive. Raises StorageError."""
        if self._folder is None:
            return ports, commands
        constants = CellConstants.of(ports)
        self._writer = TranscriptWriter(self._folder, constants, self._frames)

        def method(channel: Channel, sides: tuple[Side, ...]) -> Callable[..., Any]:
            port = getattr(ports, channel.port)
            asked = port[sides[0]] if sides else port
            return lambda *given: self.record(channel, (*sides, *given), getattr(asked, channel.method), *given)

        def take(wanted: Set[Event]) -> Any:
            return self.record(Channel.TAKE, (sorted(wanted),), commands.take, wanted)

        def wait(wanted: Set[Event], seconds: float) -> Any:
            return self.record(Channel.WAIT, (sorted(wanted),), commands.wait, wanted, seconds)

        edit = partial(self.record, Channel.EDIT, (), commands.edit)
        heard = forwarding(commands, take=take, wait=wait, edit=edit)
        return build_ports(constants, method, ports.stop), heard

    def end(self) -> None:
        """Record the end of the run."""
        self.record(Channel.END, (), lambda: None)

    def close(self) -> str | None:
        """Close the transcript. Returns None if it is complete, else the reason why it ends before the run."""
        if self._writer is None:
            return None
        trouble = self._writer.close()
        return trouble and f"the transcript ends early: {trouble}"

    def record(
        self, channel: Channel, question: tuple[object, ...], call: Callable[..., Any], *arguments: object
    ) -> Any:
        """Call `call(*arguments)` and record what it returns or raises as the answer to `question`."""
        if channel is Channel.STOP and threading.get_ident() != self._thread:
            return call(*arguments)
        asked = self._packed(channel, question)  # before the call: a driver may change its arguments
        try:
            answer = call(*arguments)
        except Exception as e:
            self._note(channel, asked, self._packed(channel, e))
            raise
        self._note(channel, asked, answer if isinstance(answer, CameraFrame) else self._packed(channel, answer))
        return answer

    def _packed(self, channel: Channel, value: object) -> str:
        """Pack a value. A value of a wrong type ends the transcript, but not the run, which does its own check."""
        try:
            return pack(value)
        except Exception as e:
            if self._writer is not None:
                self._writer.fail(f"{channel.call}: {e}")
            return ""

    def _note(self, channel: Channel, question: str, answer: str | CameraFrame) -> None:
        if self._writer is not None:
            self._writer.note(channel, question, answer)
