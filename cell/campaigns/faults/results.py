"""The results of a campaign of the table of faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from foldcell.cell.campaigns.faults.fault_table import DueEnd, FaultTable
from foldcell.cell.campaigns.faults.fault_trials import faults_of
from foldcell.cell.campaigns.faults.judge import Verdict, due_ends, judge
from foldcell.cell.campaigns.statistics.proportions import wilson_interval
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.support.json_values import to_json

SCHEMA = 1
TWO = " and another"
Judged = tuple[Trial, Verdict]


@dataclass(frozen=True)
class Group:
    """Numbers of runs of one row, one cell or one kind of due end. runs: runs in which the faults happened. due:
    runs among them that ended as due. interval: 95 % Wilson interval of the share of due ends. not_struck: runs in
    which a fault did not happen, which prove nothing. not_performed: runs without a result."""

    runs: int
    due: int
    interval: tuple[float, float]
    not_struck: int
    not_performed: int

    @classmethod
    def of(cls, judged: Sequence[Judged]) -> Group:
        performed = [verdict for trial, verdict in judged if trial.performed]
        struck = [verdict for verdict in performed if verdict.struck or not verdict.due]
        due = sum(verdict.good for verdict in struck)
        without, missing = len(performed) - len(struck), len(judged) - len(performed)
        return cls(len(struck), due, wilson_interval(due, len(struck)), without, missing)


@dataclass(frozen=True)
class FaultRow:
    """The runs with one fault, alone or with another one."""

    name: str
    due_ends: tuple[DueEnd, ...]
    all: Group
    by_garment: Mapping[str, Group]


@dataclass(frozen=True)
class FaultResults:
    """The results so far. rows: in the order of the table; rows of two faults come last. totals: one group for
    each due end of single faults, and one for all runs with two faults. runs: each run with its verdict, in order
    of fault, garment and seed."""

    garments: Sequence[str]
    rows: Sequence[FaultRow]
    totals: Mapping[str, Group]
    runs: Sequence[Judged]

    @classmethod
    def of(cls, table: FaultTable, trials: Sequence[Trial]) -> FaultResults:
        runs = [(trial, judge(table, trial)) for trial in sorted(trials, key=lambda t: t.request.key)]
        rows: dict[str, list[Judged]] = {}
        totals: dict[str, list[Judged]] = {}
        for run in runs:
            first, *others = faults_of(run[0].request)
            rows.setdefault(first + (TWO if others else ""), []).append(run)
            totals.setdefault("two faults" if others else " or ".join(due_ends(table, (first,))), []).append(run)
        garments = sorted({trial.request.garment for trial, _ in runs})
        order = [name + suffix for suffix in ("", TWO) for name in table.faults]
        return cls(
            garments,
            [
                FaultRow(
                    name,
                    due_ends(table, faults_of(rows[name][0][0].request)),
                    Group.of(rows[name]),
                    {g: Group.of([run for run in rows[name] if run[0].request.garment == g]) for g in garments},
                )
                for name in order
                if name in rows
            ],
            {name: Group.of(totals[name]) for name in sorted(totals, key=_place)},
            runs,
        )

    def as_json(self) -> dict[str, Any]:
        """Return the content of `faults.json`."""
        values = {
            "schema": SCHEMA,
            "simulated": True,
            "garments": self.garments,
            "faults": [
                {"name": row.name, "due_ends": row.due_ends, **asdict(row.all), "by_garment": row.by_garment}
                for row in self.rows
            ],
            "totals": self.totals,
            "runs": [_run(trial, verdict) for trial, verdict in self.runs],
        }
        return dict(to_json(values))


def _place(total: str) -> tuple[bool, bool, int]:
    """Return the sort key of a total. Totals of a single due end come first, then those of several ends, then two
    faults."""
    ends = [end.value for end in DueEnd]
    first = total.partition(" or ")[0]
    return first not in ends, " or " in total, ends.index(first) if first in ends else 0


def _run(trial: Trial, verdict: Verdict) -> dict[str, Any]:
    record = trial.record
    return {
        "faults": faults_of(trial.request),
        "garment": trial.request.garment,
        "seed": trial.request.seed,
        "end": verdict.end,
        "due": verdict.due,
        "struck": verdict.struck,
        "why": verdict.why,
        "robot_time_s": record.robot_time_s if record else None,
        "run_dir": record.run_dir if record else None,
    }
