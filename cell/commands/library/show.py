"""`foldcell library show`: lists the entries of the library."""

from __future__ import annotations

import argparse
from typing import Any

from foldcell.cell.commands.shared import Commands, add_command, answer, cell_option, logs_option, table
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.trajectory_library.library_file import load_library
from foldcell.cell.support.files.paths import logs_directory
from foldcell.skills.trajectory.trajectory_library import LibraryEntry


def add_options(actions: Commands) -> None:
    action = add_command(actions, "show", "list the entries of the library", _run)
    cell_option(action)
    logs_option(action)


def _run(options: argparse.Namespace) -> int:
    load_settings(options.cell)  # the library is the same for every cell, but a wrong file is refused
    loaded = load_library(logs_directory(options.logs))
    entries = loaded.library.entries
    refused = [f"{path}, entry {r.index}: {r.reason}" for path, r in loaded.refused]
    lines = ["the library is empty; 'foldcell library build' fills it"]
    if entries:
        head = ("garment", "fold", "variant", "method", "D first [mm]", "D [mm]", "simulations", "arms")
        rows = [
            (e.garment, e.step, e.variant, e.method, 1e3 * e.dissimilarity_initial, 1e3 * e.dissimilarity,
             e.simulations, len(e.inner))
            for e in entries
        ]  # fmt: skip
        lines = [*table(head, rows)]
    lines += [f"not used: {line}" for line in refused]
    return answer(options, {"entries": [figures(e) for e in entries], "refused": refused}, lines)


def figures(entry: LibraryEntry) -> dict[str, Any]:
    """The printed figures of an entry."""
    return {
        "garment": entry.garment,
        "category": entry.category,
        "step": entry.step,
        "variant": entry.variant,
        "size_m": entry.size_m,
        "method": entry.method,
        "dissimilarity_initial_m": entry.dissimilarity_initial,
        "dissimilarity_m": entry.dissimilarity,
        "simulations": entry.simulations,
        "version": entry.version,
    }
