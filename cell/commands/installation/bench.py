"""`foldcell bench NAME`: measures one part of the program and comparable programs (peers). The JSON output also
describes the machine."""

from __future__ import annotations

import argparse
import importlib
import os
import platform
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from foldcell.cell.commands.shared import answer, table, teller
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.robots.errors import ConfigurationError

BENCHES = ("cell", "cloth", "motion", "optimise", "perception")
"""Names of the benchmarks: packages or modules of `benchmarks` that have a function `measure`."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", choices=BENCHES, metavar="NAME", help="%(choices)s")
    parser.add_argument(
        "--peers", action="store_true", help="also measure peers that take long or need extra packages"
    )
    parser.add_argument("--quick", action="store_true", help="few samples: a test of the benchmark itself")
    parser.add_argument("--only", metavar="PART,...", help="these parts only (cloth)")
    parser.add_argument(
        "--keep", type=Path, metavar="FILE", help="write each part's figures to FILE and continue from it (cloth)"
    )
    parser.add_argument("--garment", metavar="A,B", help="these garments only, by name or file (optimise)")


def run(options: argparse.Namespace) -> int:
    """Run the `measure` function of benchmarks/NAME and print its figures: measure(tell, *, peers, quick) ->
    figures, each with its unit in its name.

    Raises ConfigurationError if the benchmarks are not installed or a flag does not apply.
    """
    try:
        bench = importlib.import_module(f"benchmarks.{options.name}")
    except ModuleNotFoundError as e:
        if e.name not in ("benchmarks", f"benchmarks.{options.name}"):
            raise
        raise ConfigurationError(
            "the benchmarks are not installed", hint="run this command in a clone of the repository"
        ) from e
    more = _garments(options) | _parts(bench, options)
    figures: Mapping[str, Any] = bench.measure(
        teller(options.json), peers=options.peers, quick=options.quick, **more
    )
    return answer(options, {**figures, "quick": options.quick, "machine": _machine()}, _lines(figures))


def _lines(figures: Mapping[str, Any]) -> Iterator[str]:
    """Yield tables of the figures: one of the single figures, one of each list of rows. Other nested values appear
    only in the JSON output."""
    flat = [(key, _shown(value)) for key, value in figures.items() if not isinstance(value, list | dict)]
    if flat:
        yield from table(("figure", "value"), flat)
    for name, rows in figures.items():
        if isinstance(rows, list) and rows and all(isinstance(row, dict) for row in rows):
            columns = [key for key, value in rows[0].items() if not isinstance(value, list | dict)]
            yield f"\n{name}"
            yield from table(columns, [[_shown(row.get(key)) for key in columns] for row in rows])


def _garments(options: argparse.Namespace) -> dict[str, Any]:
    """Return the keyword argument of `measure` for --garment, which only `bench optimise` accepts."""
    if options.garment is None:
        return {}
    if options.name != "optimise":
        raise ConfigurationError(f"--garment does not apply to bench {options.name}", "bench optimise takes it")
    names = options.garment.split(",")
    for name in names:
        load_garment(name)
    return {"garments": names}


def _parts(bench: ModuleType, options: argparse.Namespace) -> dict[str, Any]:
    """Return the keyword arguments of `measure` for --only and --keep, which only benchmarks with PARTS accept."""
    if not (options.only or options.keep):
        return {}
    if not hasattr(bench, "PARTS"):
        raise ConfigurationError(f"bench {options.name} has no parts", "give neither --only nor --keep")
    return {"only": options.only.split(",") if options.only else (), "keep": options.keep}


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _machine() -> dict[str, Any]:
    from foldcell.cell.campaigns.trials.store import cpu_model

    return {
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
    }
