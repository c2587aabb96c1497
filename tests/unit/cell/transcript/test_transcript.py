"""Writing and reading transcripts: truncated ones are readable, and no run waits for them or fails because of
them."""

from __future__ import annotations

import gzip
import json
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from foldcell.cell.journal.frame_store import FRAMES, FrameStore
from foldcell.cell.transcript.channels import CellConstants, Channel
from foldcell.cell.transcript.transcript import LAYOUT, TRANSCRIPT, Transcript, TranscriptWriter
from foldcell.cell.transcript.transcript_codec import Exchange, Picture, pack
from foldcell.robots.errors import StorageError
from foldcell.robots.ports import CameraFrame, Intrinsics
from tests.builders.transcripts import write_transcript
from tests.fakes import FakeCell

CONSTANTS = CellConstants.of(FakeCell().ports())


def sleeps(n: int) -> list[Exchange]:
    return [Exchange(Channel.SLEEP, pack((0.01 * k,)), None) for k in range(n)]


def picture() -> CameraFrame:
    rgb = np.random.default_rng(1).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    return CameraFrame(1.0, 3, rgb, np.ones((48, 64), np.float32), Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0))


def test_a_transcript_reads_back_as_written(tmp_path: Path) -> None:
    writer = TranscriptWriter(tmp_path, CONSTANTS)
    for e in sleeps(500):
        writer.note(e.channel, e.question, pack(e.answer))
    writer.note(Channel.CAPTURE, pack(()), picture())
    writer.note(Channel.END, pack(()), pack(None))
    assert writer.close() is None
    read = Transcript(tmp_path / TRANSCRIPT)
    assert read.constants == CONSTANTS
    exchanges = list(read)
    assert exchanges[:500] == sleeps(500)
    assert [e.channel for e in exchanges[500:]] == [Channel.CAPTURE, Channel.END]
    named = exchanges[500].answer
    assert isinstance(named, Picture)
    assert np.array_equal(FrameStore(tmp_path / FRAMES).get(named.name).rgb, picture().rgb)


def test_exchanges_are_on_disk_without_closing_the_transcript(tmp_path: Path) -> None:
    """A killed process leaves a transcript in which only the last moment is missing."""
    writer = TranscriptWriter(tmp_path, CONSTANTS)
    for e in sleeps(3):
        writer.note(e.channel, e.question, pack(e.answer))
    deadline = time.monotonic() + 5.0
    while list(Transcript(tmp_path / TRANSCRIPT)) != sleeps(3):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    writer.close()


def test_a_truncated_transcript_is_read_up_to_its_end(tmp_path: Path) -> None:
    path = write_transcript(tmp_path, CONSTANTS, sleeps(100))
    first = path.stat().st_size
    (tmp_path / "more").mkdir()
    more = write_transcript(tmp_path / "more", CONSTANTS, sleeps(50)).read_bytes()
    with path.open("ab") as file:
        file.write(more[more.index(gzip.compress(b"")[:3], 1) :])  # without the head
    assert list(Transcript(path)) == sleeps(100) + sleeps(50)
    data = path.read_bytes()
    for size in (first, first + 1, first + 9, len(data) - 1):
        path.write_bytes(data[:size])
        assert list(Transcript(path)) == sleeps(100)


def test_a_damaged_transcript_is_refused(tmp_path: Path) -> None:
    path = write_transcript(tmp_path, CONSTANTS, sleeps(100))
    data = bytearray(path.read_bytes())
    for at in (-1, -40):
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[len(data) + at + 1 :])
        with pytest.raises(StorageError, match="damaged after 0 exchanges"):
            list(Transcript(path))


def test_a_missing_transcript_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="has no transcript") as caught:
        Transcript(tmp_path / TRANSCRIPT)
    assert caught.value.hint


def head_with(**changes: object) -> bytes:
    return gzip.compress(json.dumps({**LAYOUT, "cell": asdict(CONSTANTS), **changes}).encode())


@pytest.mark.parametrize(
    "data",
    [
        head_with(schema="foldcell transcript 1"),
        head_with(records={**LAYOUT["records"], "JointState": ["stamp", "temperature"]}),
        head_with(questions={**LAYOUT["questions"], "OVEN": "oven.state"}),
        head_with(cell={"driver": "sim"}),
        gzip.compress(b"[1, 2]", mtime=0),
        gzip.compress(b"not JSON", mtime=0),
        b"foldcell transcript 1\n{}\n",
        b"",
        b"\x00\xff" * 400,
    ],
)
def test_a_transcript_of_another_version_is_refused(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / TRANSCRIPT
    path.write_bytes(head_with())
    assert Transcript(path).constants == CONSTANTS
    path.write_bytes(data)
    with pytest.raises(StorageError, match="no transcript of this version") as caught:
        Transcript(path)
    assert "version" in caught.value.hint


def test_an_unwritable_folder_is_reported_before_the_run(lockable) -> None:
    with lockable.read_only(), pytest.raises(StorageError, match="cannot be written"):
        TranscriptWriter(lockable.folder, CONSTANTS)


def test_a_storage_error_ends_the_transcript_and_not_the_run(tmp_path: Path) -> None:
    (tmp_path / FRAMES).write_text("no folder")
    writer = TranscriptWriter(tmp_path, CONSTANTS)
    for e in sleeps(5):
        writer.note(e.channel, e.question, pack(e.answer))
    writer.note(Channel.CAPTURE, pack(()), picture())
    for e in sleeps(5):
        writer.note(e.channel, e.question, pack(e.answer))
    trouble = writer.close()
    assert trouble is not None and FRAMES in trouble
    writer.note(Channel.END, pack(()), pack(None))
    assert list(Transcript(tmp_path / TRANSCRIPT)) == sleeps(5)


def test_a_blocked_disk_does_not_fill_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foldcell.cell.transcript.transcript.PENDING", 1000)
    monkeypatch.setattr("foldcell.cell.transcript.transcript.EVERY_S", 30.0)
    writer = TranscriptWriter(tmp_path, CONSTANTS)
    for e in sleeps(200):
        writer.note(e.channel, e.question, pack(e.answer))
    assert len(writer._pending) < 100
    assert "too slow" in (writer.close() or "")
