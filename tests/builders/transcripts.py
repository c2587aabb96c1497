"""Transcripts for tests, written by the program's own writer."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from cell.recording.transcript.transcript import TRANSCRIPT, CellConstants, TranscriptWriter
from cell.recording.transcript.transcript_codec import Exchange

__all__ = ["write_transcript"]


def write_transcript(folder: Path, constants: CellConstants, exchanges: Iterable[Exchange]) -> Path:
    """A transcript in the run's folder; -> its path."""
    writer = TranscriptWriter(folder, constants)
    for exchange in exchanges:
        writer.note(exchange.channel, exchange.question, exchange.answer)
    assert writer.close() is None
    return folder / TRANSCRIPT
