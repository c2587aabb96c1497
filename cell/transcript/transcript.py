"""The transcript: all exchanges between the executive and its cell in a run, in order, in one gzip file.

The first line is JSON with the schema, the constants of the cell, and the names of all questions and fields. Each
other line is an exchange: name of its channel, question and answer (transcript_codec.py), separated by tabs.

A separate thread writes the file every 0.2 s, each time as a complete gzip member with its checksum. Therefore
neither disk nor compression delays the arms, and a killed process loses only the last exchanges. A write error
ends the transcript, not the run. Pictures are in the frame store beside the transcript
(cell/journal/frame_store.py), and the transcript contains their names.
"""

from __future__ import annotations

import dataclasses
import gzip
import json
import os
import threading
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from foldcell.cell.journal.frame_store import FRAMES, FrameStore
from foldcell.cell.transcript.channels import CellConstants, Channel
from foldcell.cell.transcript.transcript_codec import RECORDS, Exchange, Picture, pack, unpack
from foldcell.robots.errors import StorageError
from foldcell.robots.ports import CameraFrame, Side

TRANSCRIPT = "run.transcript"
LAYOUT: dict[str, Any] = {
    "schema": "foldcell transcript 2",
    "questions": {channel.name: channel.call for channel in Channel},
    "records": {name: [f.name for f in dataclasses.fields(kind)] for name, kind in RECORDS.items()},
}
"""A transcript with another layout belongs to another version of foldcell."""
EVERY_S = 0.2
"""Period of writing [s]."""
PENDING = 256 << 20
"""Largest amount of data that may wait to be written [bytes]. If more data waits, the transcript ends."""
CLOSE_S = 60.0
BLOCK = 1 << 16
"""The file is read in blocks of this size [bytes]."""


class TranscriptWriter:
    """Writes a transcript. Call `note` from one thread only. It returns immediately."""

    def __init__(self, folder: Path, constants: CellConstants, frames: FrameStore | None = None) -> None:
        """Create the file in the run's folder. frames: the run's frame store, if others write to it too. Raises
        StorageError."""
        self._frames = frames or FrameStore(folder / FRAMES)
        self._file = _create(folder / TRANSCRIPT, constants)
        self._pending: list[tuple[Channel, str, str | CameraFrame]] = []
        self._size = 0
        self._mutex = threading.Lock()
        self._closing = threading.Event()
        self.trouble: str | None = None
        """Why the transcript ends before the run; None while it is complete."""
        self._thread = threading.Thread(target=self._work, name="transcript", daemon=True)
        self._thread.start()

    def note(self, channel: Channel, question: str, answer: str | CameraFrame) -> None:
        """Record one exchange. The writing thread stores a picture later. Never raises."""
        if self.trouble is not None:
            return
        size = answer.nbytes if isinstance(answer, CameraFrame) else len(answer)
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

    def _write(self, file: BinaryIO, exchanges: list[tuple[Channel, str, str | CameraFrame]]) -> None:
        """Write exchanges. If a picture cannot be stored, only the exchanges before it are written."""
        lines = []
        try:
            for channel, question, answer in exchanges:
                if isinstance(answer, CameraFrame):
                    answer = pack(Picture(self._frames.put(answer)))
                lines.append(f"{channel.name}\t{question}\t{answer}")
        finally:
            if lines:
                _write_member(file, lines)


class Transcript:
    """Reads a transcript. `constants` are the constants of the recorded cell. Iteration yields the exchanges."""

    def __init__(self, path: Path) -> None:
        """Open a transcript. Raises StorageError if the file is missing or belongs to another version of
        foldcell."""
        self.path = path
        try:
            with path.open("rb") as file:
                head = json.loads(next(_members(file)))
            cell = head.pop("cell")
            if head != LAYOUT:
                raise ValueError("its layout is another one")
            openings = {Side(side): opening for side, opening in cell.pop("max_opening").items()}
            self.constants = CellConstants(**cell, max_opening=openings)
        except OSError as e:
            raise StorageError(
                f"the run {path.parent.name} has no transcript {path}: {e.strerror}",
                "runs of older versions and runs without a recording have none: start a new run",
            ) from None
        except (ValueError, KeyError, TypeError, AttributeError, StopIteration, zlib.error) as e:
            raise StorageError(
                f"{path} is no transcript of this version of foldcell: {e}",
                "decide the run with the version that recorded it (see foldcell runs --json)",
            ) from None

    def __iter__(self) -> Iterator[Exchange]:
        """Yield the exchanges. If the file is truncated, iteration ends there. Raises StorageError if the file is
        damaged."""
        count = 0
        with self.path.open("rb") as file:
            members = _members(file)
            next(members)
            while True:
                try:
                    exchanges = [_exchange(line) for line in next(members, b"").decode("ascii").splitlines()]
                except (ValueError, LookupError, zlib.error) as e:
                    raise StorageError(
                        f"the transcript {self.path} is damaged after {count} exchanges: {e}",
                        "use a copy from a backup, or another run",
                    ) from None
                if not exchanges:
                    return
                count += len(exchanges)
                yield from exchanges


def _exchange(line: str) -> Exchange:
    name, question, answer = line.split("\t")
    return Exchange(Channel[name], question, unpack(answer))


def _create(path: Path, constants: CellConstants) -> BinaryIO:
    """Create the file and write its head. The file is unbuffered, so that a killed process loses no finished
    write."""
    try:
        file = path.open("wb", buffering=0)
        _write_member(file, [json.dumps(LAYOUT | {"cell": dataclasses.asdict(constants)})])
    except OSError as e:
        raise StorageError(
            f"{path} cannot be written: {e.strerror}", "free some disk space", path=str(path)
        ) from e
    return file


def _write_member(file: BinaryIO, lines: list[str]) -> None:
    """Write lines as a gzip member. Write in a loop, because a full disk first accepts a part and raises OSError
    only at the next write."""
    left = memoryview(gzip.compress("".join(f"{line}\n" for line in lines).encode("ascii"), 1))
    while left:
        left = left[file.write(left) :]


def _members(file: BinaryIO) -> Iterator[bytes]:
    """Yield the data of the complete gzip members of a file. Raises zlib.error for a damaged member."""
    block = b""
    while True:
        member, parts = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS), []
        while not member.eof:
            block = block or file.read(BLOCK)
            if not block:
                return
            parts.append(member.decompress(block))
            block = member.unused_data
        yield b"".join(parts)
