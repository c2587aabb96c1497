"""The transcript: all exchanges between the executive and its cell in a run, in order, in one file.

    foldcell transcript 1       the schema, one line
    {"cell": ...}               the head, one line of JSON: constants of the cell, names of channels and fields
    size crc data               chunks until the end of the file: size and crc (4 bytes each), then data (zlib);
                                the data are whole exchanges, each with channel (1 byte), lengths of question and
                                answer (4 bytes each), question, answer

A separate thread writes the file every 0.2 s. Therefore neither disk nor compression delays the arms, and a killed
process loses only the last exchanges. A write error ends the transcript, not the run. Pictures are in the frame
store beside the transcript (cell/journal/frame_store.py), and the transcript contains their names.
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

from cell.journal.frame_store import FRAMES, FrameStore
from cell.transcript.transcript_codec import ENUMS, RECORDS, Channel, Exchange, Picture, pack
from robots.errors import StorageError
from robots.ports import CameraFrame, Ports, Side

__all__ = ["TRANSCRIPT", "CellConstants", "Transcript", "TranscriptWriter"]

TRANSCRIPT = "run.transcript"
SCHEMA = "foldcell transcript 1"
EVERY_S = 0.2
"""Period of writing [s]."""
PENDING = 256 << 20
"""Largest amount of data that may wait to be written [bytes]. If more data waits, the transcript ends."""
CLOSE_S = 60.0
LARGEST_CHUNK = 1 << 30

_CHUNK = struct.Struct("<II")
_EXCHANGE = struct.Struct("<BII")


@dataclass(frozen=True)
class CellConstants:
    """Constants of a cell's ports. command_timeout [s]; max_opening of each gripper [m]."""

    driver: str
    simulated: bool
    command_timeout: float
    max_opening: tuple[tuple[Side, float], ...]

    @classmethod
    def of(cls, ports: Ports) -> CellConstants:
        openings = tuple((side, float(gripper.max_opening)) for side, gripper in ports.grippers.items())
        return cls(ports.driver, ports.simulated, float(ports.arms.command_timeout), openings)


class TranscriptWriter:
    """Writes a transcript. Call `note` from one thread only. It returns immediately."""

    def __init__(self, folder: Path, constants: CellConstants) -> None:
        """Create the file in the run's folder. Raises StorageError."""
        self._frames = FrameStore(folder / FRAMES)
        self._file = _create(folder / TRANSCRIPT, constants)
        self._pending: list[tuple[Channel, bytes, bytes | CameraFrame]] = []
        self._size = 0
        self._mutex = threading.Lock()
        self._closing = threading.Event()
        self.trouble: str | None = None
        """Why the transcript ends before the run; None while it is complete."""
        self._thread = threading.Thread(target=self._work, name="transcript", daemon=True)
        self._thread.start()

    def note(self, channel: Channel, question: bytes, answer: bytes | CameraFrame) -> None:
        """Record one exchange. The writing thread stores a picture later. Never raises."""
        if self.trouble is not None:
            return
        size = answer.rgb.nbytes + answer.depth.nbytes if isinstance(answer, CameraFrame) else len(answer)
        with self._mutex:
            self._pending.append((channel, question, answer))
            self._size += size + len(question)
            if self._size > PENDING:
                self._pending.clear()
                self.trouble = "the disk is too slow for the run's data"

    def fail(self, why: str) -> None:
        """End the transcript at this point. why: the reason."""
        self.trouble = self.trouble or why

    def close(self) -> str | None:
        """Write the remaining exchanges. Returns `trouble`."""
        self._closing.set()
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            self.fail(f"the disk did not write the run's data within {CLOSE_S:.0f} s")
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
                except Exception as e:  # an error in this program ends the transcript, never the run
                    self.fail(f"{type(e).__name__}: {e}")
            with suppress(OSError):
                os.fsync(file.fileno())

    def _write(self, file: BinaryIO, exchanges: list[tuple[Channel, bytes, bytes | CameraFrame]]) -> None:
        """Write exchanges. If a picture cannot be stored, only the exchanges before it are written."""
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
    """Reads a transcript. `constants` are the constants of the recorded cell. Iteration yields the exchanges."""

    def __init__(self, path: Path) -> None:
        """Open a transcript. Raises StorageError if the file is missing or belongs to another version of
        foldcell."""
        self.path = path
        try:
            with path.open("rb") as file:
                head = self._head(file)
                self._begin = file.tell()
        except OSError as e:
            raise StorageError(
                f"the run {path.parent.name} has no transcript {path}: {e.strerror}",
                "runs of older versions and runs without a recording have none: start a new run",
            ) from None
        try:
            self.constants = _constants_from(head["cell"])
            self._channels = [Channel(name) for name in head["channels"]]
            if head["records"] != _fields() or head["enums"] != [kind.__name__ for kind in ENUMS]:
                raise ValueError("its records have other fields")
        except (ValueError, KeyError, TypeError) as e:
            raise self._of_other_version(str(e)) from None

    def __iter__(self) -> Iterator[Exchange]:
        """Yield the exchanges. If the file is truncated, iteration ends there. Raises StorageError if the file is
        damaged."""
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
                        "use a copy from a backup, or another run",
                    ) from None
                count += len(exchanges)
                yield from exchanges

    def _head(self, file: BinaryIO) -> dict[str, Any]:
        if file.readline(200).decode("ascii", "replace").rstrip("\n") != SCHEMA:
            raise self._of_other_version("its first line is another one")
        try:
            return dict(json.loads(file.readline(100_000)))
        except (ValueError, TypeError):
            raise self._of_other_version("its head cannot be read") from None

    def _of_other_version(self, why: str) -> StorageError:
        return StorageError(
            f"{self.path} is no transcript of this version of foldcell: {why}",
            "decide the run with the version that recorded it (see foldcell runs --json)",
        )

    def _exchanges(self, data: bytes) -> Iterator[Exchange]:
        at = 0
        while at < len(data):
            channel, question_size, answer_size = _EXCHANGE.unpack_from(data, at)
            at += _EXCHANGE.size
            middle, end = at + question_size, at + question_size + answer_size
            if end > len(data):
                raise ValueError("an exchange is truncated")
            yield Exchange(self._channels[channel], data[at:middle], data[middle:end])
            at = end


def _create(path: Path, constants: CellConstants) -> BinaryIO:
    """Create the file and write its head. The file is unbuffered, so that a killed process loses no finished
    write."""
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
        raise StorageError(
            f"{path} cannot be written: {e.strerror}", "free some disk space", path=str(path)
        ) from e
    return file


def _write_all(file: BinaryIO, data: bytes) -> None:
    """Write in a loop, because a full disk first accepts a part and raises OSError only at the next write."""
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


def _constants_from(cell: dict[str, Any]) -> CellConstants:
    openings = tuple((Side(side), float(opening)) for side, opening in cell["max_opening"])
    return CellConstants(str(cell["driver"]), bool(cell["simulated"]), float(cell["command_timeout"]), openings)
