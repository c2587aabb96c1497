"""Records a run: ports and commands that forward every call and record its question and its answer.

The executive calls from one thread, and its calls are recorded in that order. Triggering the stop is possible from
any thread and is not recorded. Two kinds of polls of the stop depend on the wall clock and are not recorded
either: polls from other threads, and polls while a skill computes (`Workcell.watched_stop`). They can only end a
computation early, and then its result is discarded.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from cell.states.commands import CommandQueue, QueuedCommand
from cell.states.plan_edit import PlanEdit
from cell.states.transition_table import Event
from cell.transcript.transcript import CellConstants, TranscriptWriter
from cell.transcript.transcript_codec import Channel, pack, pack_raised
from robots.ports import (
    Arms,
    Array,
    Attendant,
    BoardPlace,
    Camera,
    CameraFrame,
    Clock,
    Gripper,
    GripperState,
    Head,
    JointSetpoint,
    JointState,
    Ports,
    Side,
    Stop,
    StopState,
    Tactile,
    TactileReading,
)

__all__ = ["PortRecorder", "RecordedPorts", "wanted_names"]

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class RecordedPorts:
    """The ports and the command queue that the executive uses."""

    ports: Ports
    commands: CommandQueue


class PortRecorder:
    """Writes a run's transcript. Create it on the thread of the executive."""

    def __init__(self, folder: Path | None) -> None:
        """folder: the run's folder; None: nothing is recorded."""
        self._folder = folder
        self._writer: TranscriptWriter | None = None
        self._thread = threading.get_ident()

    def between(self, ports: Ports, commands: CommandQueue) -> RecordedPorts:
        """Begin the transcript. Returns the ports and commands for the executive. Raises StorageError."""
        if self._folder is None:
            return RecordedPorts(ports, commands)
        self._writer = TranscriptWriter(self._folder, CellConstants.of(ports))
        recorded = replace(
            ports,
            clock=_Clock(self, ports.clock),
            arms=_Arms(self, ports.arms),
            head=_Head(self, ports.head),
            grippers={side: _Gripper(self, gripper, side) for side, gripper in ports.grippers.items()},
            tactile={side: _Tactile(self, tactile, side) for side, tactile in ports.tactile.items()},
            camera=_Camera(self, ports.camera),
            stop=_Stop(self, ports.stop),
            attendant=_Attendant(self, ports.attendant),
        )
        return RecordedPorts(recorded, _Commands(self, commands))

    def end(self) -> None:
        """Record the end of the run."""
        self.record(Channel.END, (), lambda: None)

    def close(self) -> str | None:
        """Close the transcript. Returns None if it is complete, else the reason why it ends before the run."""
        if self._writer is None:
            return None
        trouble = self._writer.close()
        return trouble and f"the transcript ends early: {trouble}"

    @property
    def on_its_thread(self) -> bool:
        return threading.get_ident() == self._thread

    def record(
        self, channel: Channel, question_values: tuple[object, ...], call: Callable[..., T], *arguments: object
    ) -> T:
        """Call `call(*arguments)` and record what it returns or raises as the answer to `question_values`."""
        question = self._packed(channel, question_values)  # before the call: a driver may change its arguments
        try:
            answer = call(*arguments)
        except Exception as e:
            self._note(channel, question, pack_raised(e))
            raise
        self._note(channel, question, answer if isinstance(answer, CameraFrame) else self._packed(channel, answer))
        return answer

    def _packed(self, channel: Channel, value: object) -> bytes:
        """Pack a value. A value of a wrong type ends the transcript, but not the run, which does its own check."""
        try:
            return pack(value)
        except Exception as e:
            if self._writer is not None:
                self._writer.fail(f"{channel.value}: {e}")
            return b""

    def _note(self, channel: Channel, question: bytes, answer: bytes | CameraFrame) -> None:
        if self._writer is not None:
            self._writer.note(channel, question, answer)


class _Clock:
    def __init__(self, port_recorder: PortRecorder, clock: Clock) -> None:
        self._port_recorder, self._clock = port_recorder, clock

    def now(self) -> float:
        return self._port_recorder.record(Channel.NOW, (), self._clock.now)

    def sleep_until(self, t: float) -> None:
        self._port_recorder.record(Channel.SLEEP, (t,), self._clock.sleep_until, t)


class _Arms:
    def __init__(self, port_recorder: PortRecorder, arms: Arms) -> None:
        self._port_recorder, self._arms = port_recorder, arms
        self.command_timeout = arms.command_timeout

    def state(self) -> JointState:
        return self._port_recorder.record(Channel.ARMS, (), self._arms.state)

    def enable(self) -> None:
        self._port_recorder.record(Channel.ENABLE, (), self._arms.enable)

    def command(self, q: Array, qd: Array) -> JointSetpoint:
        return self._port_recorder.record(Channel.SET_POINT, (q, qd), self._arms.command, q, qd)


class _Head:
    def __init__(self, port_recorder: PortRecorder, head: Head) -> None:
        self._port_recorder, self._head = port_recorder, head

    def command_pan(self, angle: float) -> None:
        self._port_recorder.record(Channel.HEAD, (angle,), self._head.command_pan, angle)


class _Gripper:
    def __init__(self, port_recorder: PortRecorder, gripper: Gripper, side: Side) -> None:
        self._port_recorder, self._gripper = port_recorder, gripper
        self.side, self.max_opening = side, gripper.max_opening

    def calibrate(self) -> None:
        self._port_recorder.record(Channel.CALIBRATE, (self.side,), self._gripper.calibrate)

    def command(self, opening: float, force: float) -> None:
        self._port_recorder.record(
            Channel.GRIP, (self.side, opening, force), self._gripper.command, opening, force
        )

    def state(self) -> GripperState:
        return self._port_recorder.record(Channel.GRIPPER, (self.side,), self._gripper.state)


class _Tactile:
    def __init__(self, port_recorder: PortRecorder, tactile: Tactile, side: Side) -> None:
        self._port_recorder, self._tactile = port_recorder, tactile
        self.side = side

    def reading(self) -> TactileReading:
        return self._port_recorder.record(Channel.TACTILE, (self.side,), self._tactile.reading)


class _Camera:
    def __init__(self, port_recorder: PortRecorder, camera: Camera) -> None:
        self._port_recorder, self._camera = port_recorder, camera

    def capture(self) -> CameraFrame:
        return self._port_recorder.record(Channel.CAPTURE, (), self._camera.capture)

    def glimpse(self) -> CameraFrame | None:
        return self._port_recorder.record(Channel.GLIMPSE, (), self._camera.glimpse)


class _Stop:
    def __init__(self, port_recorder: PortRecorder, stop: Stop) -> None:
        self._port_recorder, self._stop = port_recorder, stop

    def trigger(self, reason: str) -> None:
        self._stop.trigger(reason)

    def state(self) -> StopState:
        if not self._port_recorder.on_its_thread:
            return self._stop.state()
        return self._port_recorder.record(Channel.STOP, (), self._stop.state)

    def reset(self) -> None:
        self._stop.reset()


class _Attendant:
    def __init__(self, port_recorder: PortRecorder, attendant: Attendant) -> None:
        self._port_recorder, self._attendant = port_recorder, attendant

    def lay_garment(self) -> None:
        self._port_recorder.record(Channel.LAY, (), self._attendant.lay_garment)

    def bring_board(self, place: BoardPlace) -> None:
        self._port_recorder.record(Channel.BOARD, (place,), self._attendant.bring_board, place)


class _Commands(CommandQueue):
    """Forwards commands to the cell's queue, and records the commands that the executive takes from it."""

    def __init__(self, port_recorder: PortRecorder, queue: CommandQueue) -> None:
        super().__init__()
        self._port_recorder, self._all = port_recorder, queue

    def put(self, command: Event, edit: PlanEdit | None = None) -> QueuedCommand:
        return self._all.put(command, edit)

    def edit(self) -> str:
        return self._port_recorder.record(Channel.EDIT, (), self._all.edit)

    def drop(self, void: Set[Event]) -> None:
        self._all.drop(void)

    def take(self, wanted: Set[Event]) -> Event | None:
        return self._port_recorder.record(Channel.TAKE, (wanted_names(wanted),), self._all.take, wanted)

    def wait(self, wanted: Set[Event], seconds: float) -> Event | None:
        return self._port_recorder.record(Channel.WAIT, (wanted_names(wanted),), self._all.wait, wanted, seconds)


def wanted_names(wanted: Set[Event]) -> tuple[str, ...]:
    """Names of the wanted commands, sorted."""
    return tuple(sorted(command.value for command in wanted))
