"""The runs of the table of faults: each fault with each garment and seed, alone or with a second fault."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from zlib import crc32

import numpy as np

from foldcell.cell.campaigns.faults.fault_table import FaultEntry, FaultTable
from foldcell.cell.campaigns.hil.script import Action
from foldcell.cell.campaigns.trials.campaign import Campaign, Keep, TrialRequest
from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.simulation import TRAITS
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Side

AND = "+"
"""Separates the names of the two faults of a run."""


def fault_campaign(
    table: FaultTable,
    garments: Sequence[str],
    seeds: Sequence[int],
    settings: CellSettings,
    *,
    driver: str = "sim",
    world: str = "xpbd",
    pairs: bool = False,
    keep: Keep = "failures",
) -> Campaign:
    """Return the campaign, with one run for each fault, garment and seed. pairs: adds runs with two faults. Each
    fault that should be recovered then gets a second run together with a random fault of another kind that should
    also be recovered.

    Raises ConfigurationError for an unknown garment.
    """
    for garment in garments:
        load_garment(garment, settings.surface)
    values = settings.model_dump(mode="json", by_alias=True)
    requests = []
    for seed in seeds:
        for garment in garments:
            for names in _faults(table, garment, seed, pairs):
                actions = tuple(
                    drawn_action(table, name, garment, seed).model_dump(mode="json", exclude_defaults=True)
                    for name in names
                )
                requests.append(TrialRequest(AND.join(names), garment, seed, driver, world, values, actions))
    about = {request.variant: "; ".join(table.faults[n].why for n in faults_of(request)) for request in requests}
    return Campaign("the table of faults, each at a random moment", keep, tuple(requests), about)


def faults_of(request: TrialRequest) -> tuple[str, ...]:
    """Return the names of the run's faults."""
    return tuple(request.variant.split(AND))


def chosen_faults(table: FaultTable, names: Sequence[str]) -> FaultTable:
    """Return the table with the named faults only, in its own order. A name may also be a kind. Raises
    ConfigurationError for an unknown name."""
    kinds = {entry.kind.value for entry in table.faults.values()}
    for name in names:
        if name not in table.faults and name not in kinds:
            raise ConfigurationError(
                f"the table has no fault '{name}'", f"its faults are {', '.join(table.faults)}", fault=name
            )
    chosen = {n: entry for n, entry in table.faults.items() if n in names or entry.kind.value in names}
    return FaultTable(chosen, table.stages)


def drawn_action(table: FaultTable, name: str, garment: str, seed: int) -> Action:
    """Return the fault of one run as an action of a script. Its moment, side and direction depend on the names of
    fault and garment, and on the seed."""
    draw = int(crc32(f"{name}/{garment}/{seed}".encode()))
    rng = np.random.default_rng(draw)
    entry = table.faults[name]
    drawn = _drawn(entry, rng)
    return Action.model_validate({"when": table.moment(name).drawn(draw, 0), "fault": entry.fault(drawn)})


def _drawn(entry: FaultEntry, rng: np.random.Generator) -> dict[str, str | int]:
    drawn: dict[str, str | int] = {"seed": int(rng.integers(2**31 - 1))}
    if TRAITS[entry.kind].sided:
        drawn["side"] = list(Side)[int(rng.integers(2))].value
    return drawn


def _faults(table: FaultTable, garment: str, seed: int, pairs: bool) -> Iterator[tuple[str, ...]]:
    """Yield, for each run with this garment and seed, the names of its faults."""
    for name in table.faults:
        yield (name,)
    curable = [name for name, entry in table.faults.items() if entry.recoverable]
    if pairs and len(curable) > 1:
        for name in curable:
            rng = np.random.default_rng(crc32(f"{name}/{garment}/{seed}/second".encode()))
            others = [other for other in curable if table.faults[other].kind is not table.faults[name].kind]
            if others:
                yield name, others[int(rng.integers(len(others)))]
