"""The request for a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from foldcell.cell.config.cell_settings import CellSettings


@dataclass(frozen=True)
class FoldRequest:
    """The request for a run.

    garment: a name, a file, or 'auto'. approve: an operator approves each fold and is asked after failures.
    terminal: letters typed in the terminal are commands. page: serve the operator's page, with the live view, on
    page_port (0: a free port), also to a browser that opens it at page_origin.
    quiet: no progress lines. record: write recording, transcript and report.
    record_truth: record and score the true state of a simulated cell, which does not change the run's decisions.
    """

    garment: str
    seed: int
    driver: str
    settings: CellSettings
    logs: Path
    live: bool = False
    approve: bool = False
    terminal: bool = True
    page: bool = False
    page_port: int = 0
    page_origin: str = ""
    realtime: bool = False
    world: str = "xpbd"
    quiet: bool = False
    record: bool = True
    record_truth: bool = True
