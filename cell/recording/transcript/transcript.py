"""The transcript: all that passed between the executive and its cell in a run, in order, in one file.

    foldcell transcript 1       the schema, one line
    {"cell": ...}               the head, one line of JSON: constants of the cell, names of channels and fields
    size crc data               chunks until the end: 4 and 4 bytes, then zlib; a chunk holds whole exchanges, each
                                channel (1), lengths of question and answer (4, 4), question, answer

It is written by a thread of its own, every fifth of a second: neither disk nor compression keeps the arms waiting,
and a process that is killed leaves all but its last moment. What cannot be written ends the transcript, not the
run. Pictures go into the frame store beside it (cell/recording/frame_store.py), their names into the transcript.
"""

from __future__ import annotations

import dataclasses
import json
import os
import struct
import threading
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from cell.recording.frame_store import FRAMES, FrameStore
from cell.recording.transcript.transcript_codec import ENUMS, RECORDS, Channel, Exchange, Picture, pack
from robots.errors import StorageError
from robots.ports import CameraFrame, Ports, Side

__all__ = ["TRANSCRIPT", "CellConstants", "Transcript", "TranscriptWriter"]

TRANSCRIPT = "run.transcript"
SCHEMA = "foldcell transcript 1"
EVERY_S = 0.2
"""How much of a run is written at a time [s]."""
PENDING = 256 << 20
"""More than this that the disk has not taken yet ends the transcript [bytes]."""
CLOSE_S = 60.0
LARGEST_CHUNK = 1 << 30

_CHUNK = struct.Struct("<II")
_EXCHANGE = struct.Struct("<BII")


@dataclass(frozen=True)
class CellConstants:
    """What never changes about a cell's ports. command_timeout [s], max_opening of each gripper [m]."""

    driver: str
    simulated: bool
    command_timeout: float
    max_opening: tuple[tuple[Side, float], ...]

    @classmethod
    def of(cls, ports: Ports) -> CellConstants:
        openings = tuple((side, float(gripper.max_opening)) for side, gripper in ports.grippers.items())
        return cls(ports.driver, ports.simulated, float(ports.arms.command_timeout), openings)


class TranscriptWriter:
    """Writes a transcript. `note` is for one thread, and returns at once."""

    def __init__(self, folder: Path, constants: CellConstants) -> None:
        """Raises StorageError when the run's folder takes no file."""
        self._frames = FrameStore(folder / FRAMES)
        self._file = _begun(folder / TRANSCRIPT, constants)
        self._pending: list[tuple[Channel, bytes, bytes | CameraFrame]] = []
        self._size = 0
        self._mutex = threading.Lock()
        self._closing = threading.Event()
        self.trouble: str | None = None
        """Why the transcript ends before the run, where it does."""
        self._thread = threading.Thread(target=self._work, name="transcript", daemon=True)
        self._thread.start()

    def note(self, channel: Channel, question: bytes, answer: bytes | CameraFrame) -> None:
        """One exchange; a picture is put into the frame store later. Never raises."""
        if self.trouble is not None:
            return
        size = answer.rgb.nbytes + answer.depth.nbytes if isinstance(answer, CameraFrame) else len(answer)
        with self._mutex:
            self._pending.append((channel, question, answer))
            self._size += size + len(question)
            if self._size > PENDING:
                self._pending.clear()
                self.trouble = "the disk is too slow for what the run reads"

    def fail(self, why: str) -> None:
        """End the transcript here: what comes could not be told."""
        self.trouble = self.trouble or why

    def close(self) -> str | None:
        """Write what is left; -> why the transcript ends before the run, where it does."""
        self._closing.set()
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            self.fail("the disk does not take what the run has read")
        return self.trouble

    def _work(self) -> None:
        with self._file as file:
            last = False
            while not last and self.trouble is None:
                last = self._closing.wait(EVERY_S)
                with self._mutex:
                    exchanges, self._pending, self._size = self._pending, [], 0
                try:
                    self._write(file, exchanges)
                except StorageError as e:
                    self.fail(e.what)
                except OSError as e:
                    self.fail(f"{e.strerror}: {file.name}")
                except Exception as e:  # a bug of ours ends the transcript, never the run
                    self.fail(f"{type(e).__name__}: {e}")
            with suppress(OSError):
                os.fsync(file.fileno())

    def _write(self, file: BinaryIO, exchanges: list[tuple[Channel, bytes, bytes | CameraFrame]]) -> None:
        """As far as it can be kept: what comes before a picture that cannot is written all the same."""
        written = []
        try:
            for channel, question, answer in exchanges:
                if isinstance(answer, CameraFrame):
                    answer = pack(Picture(self._frames.put(answer)))
                written.append(Exchange(channel, question, answer))
        finally:
            if written:
                _write_all(file, _chunk(written))


class Transcript:
    """A transcript to be read: `constants` of its cell, and its exchanges by iteration, as far as they go."""

    def __init__(self, path: Path) -> None:
        """Raises StorageError for a file that is missing, or is no transcript of this version of foldcell."""
        self.path = path
        try:
            with path.open("rb") as file:
                head = self._head(file)
                self._begin = file.tell()
        except OSError as e:
            raise StorageError(
                f"the run {path.parent.name} has no transcript {path}: {e.strerror}",
                "runs of older versions and those without a recording keep none: start a new one",
            ) from None
        try:
            self.constants = _constants_from(head["cell"])
            self._channels = [Channel(name) for name in head["channels"]]
            if head["records"] != _fields() or head["enums"] != [kind.__name__ for kind in ENUMS]:
                raise ValueError("its readings have other fields")
        except (ValueError, KeyError, TypeError) as e:
            raise self._of_other_version(str(e)) from None

    def __iter__(self) -> Iterator[Exchange]:
        """Raises StorageError where it is damaged. One that breaks off just ends."""
        count = 0
        with self.path.open("rb") as file:
            file.seek(self._begin)
            while len(head := file.read(_CHUNK.size)) == _CHUNK.size:
                size, crc = _CHUNK.unpack(head)
                data = file.read(size) if size <= LARGEST_CHUNK else b""
                if len(data) < size <= LARGEST_CHUNK:
                    return
                try:
                    if len(data) < size or zlib.crc32(data) != crc:
                        raise ValueError("its checksum differs")
                    exchanges = list(self._exchanges(zlib.decompress(data)))
                except (ValueError, LookupError, struct.error, zlib.error) as e:
                    raise StorageError(
                        f"the transcript {self.path} is damaged after {count} exchanges: {e}",
                        "decide a copy from a backup, or another run",
                    ) from None
                count += len(exchanges)
                yield from exchanges

    def _head(self, file: BinaryIO) -> dict[str, Any]:
        if file.readline(200).decode("ascii", "replace").rstrip("\n") != SCHEMA:
            raise self._of_other_version("it does not begin as one")
        try:
            return dict(json.loads(file.readline(100_000)))
        except (ValueError, TypeError):
            raise self._of_other_version("its head cannot be read") from None

    def _of_other_version(self, why: str) -> StorageError:
        return StorageError(
            f"{self.path} is no transcript of this version of foldcell: {why}",
            "decide the run with the version that made it (foldcell runs --json tells which)",
        )

    def _exchanges(self, data: bytes) -> Iterator[Exchange]:
        at = 0
        while at < len(data):
            channel, asked, answered = _EXCHANGE.unpack_from(data, at)
            at += _EXCHANGE.size
            if at + asked + answered > len(data):
                raise ValueError("an exchange is cut off")
            question, answer = data[at : at + asked], data[at + asked : at + asked + answered]
            yield Exchange(self._channels[channel], question, answer)
            at += asked + answered


def _begun(path: Path, constants: CellConstants) -> BinaryIO:
    """The file with its head. Every write reaches the system at once: a killed process leaves what was written."""
    head = {
        "cell": dataclasses.asdict(constants),
        "channels": [channel.value for channel in Channel],
        "records": _fields(),
        "enums": [kind.__name__ for kind in ENUMS],
    }
    try:
        file = path.open("wb", buffering=0)
        _write_all(file, f"{SCHEMA}\n{json.dumps(head)}\n".encode())
    except OSError as e:
        raise StorageError(f"{path} cannot be written: {e.strerror}", "make room", path=str(path)) from e
    return file


def _write_all(file: BinaryIO, data: bytes) -> None:
    """A disk that fills up takes a part first, and says why it takes no more at the next try."""
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


def _chunk(exchanges: list[Exchange]) -> bytes:
    parts = []
    for e in exchanges:
        parts += [_EXCHANGE.pack(_NUMBERS[e.channel], len(e.question), len(e.answer)), e.question, e.answer]
    data = zlib.compress(b"".join(parts), 1)
    return _CHUNK.pack(len(data), zlib.crc32(data)) + data


_NUMBERS = {channel: number for number, channel in enumerate(Channel)}


def _fields() -> dict[str, list[str]]:
    return {kind.__name__: [f.name for f in dataclasses.fields(kind)] for kind in RECORDS}


def _constants_from(told: dict[str, Any]) -> CellConstants:
    openings = tuple((Side(side), float(opening)) for side, opening in told["max_opening"])
    return CellConstants(str(told["driver"]), bool(told["simulated"]), float(told["command_timeout"]), openings)
