"""Transcripts for tests, written with the production writer."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from foldcell.cell.transcript.channels import CellConstants
from foldcell.cell.transcript.transcript import TRANSCRIPT, TranscriptWriter
from foldcell.cell.transcript.transcript_codec import Exchange, pack


def write_transcript(folder: Path, constants: CellConstants, exchanges: Iterable[Exchange]) -> Path:
    """Write a transcript into the run's folder and return its path."""
    writer = TranscriptWriter(folder, constants)
    for exchange in exchanges:
        writer.note(exchange.channel, exchange.question, pack(exchange.answer))
    assert writer.close() is None
    return folder / TRANSCRIPT
