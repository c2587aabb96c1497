"""Read the table of faults: each fault with its moment and the ends that are due.

faults:
  slip:
    kind: slip
    size: 0.02
    duration_s: 1.0
    place: world
    stage: hold
    end: recovered
    why: "the garment is seen where it fell, and the fold is made again"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from foldcell.cell.campaigns.hil.script import FaultSpec, Group, Moment, as_list, one_of
from foldcell.cell.config.yaml_file import read_yaml, validated
from foldcell.cell.simulation import TRAITS, FaultKind, Place
from foldcell.robots.errors import ConfigurationError

SHIPPED = Path(str(resources.files("foldcell.cell.campaigns.faults") / "fault_table.yaml"))
"""The table that is part of the program."""


class DueEnd(StrEnum):
    """How a run with a fault should end."""

    RECOVERED = "recovered"
    """Folded without a person, and the scorer passes the fold."""
    ASKED = "asked"
    """Parked, with a failure that says what a person can do. Without a person the run ends as not folded."""
    SAFE = "safe"
    """The cell no longer moves, and the run does not claim a fold."""


class Stage(Group):
    """A stage of a run. The moment of a fault is drawn within the fault's stage."""

    visits: int = Field(1, ge=1, le=100, strict=True, description="draw among the first n visits of a state")
    during: dict[str, Any] = Field(min_length=1, description="states, each with the usual length of a stay [s]")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        self.moment  # noqa: B018  # it validates the states
        return self

    @property
    def moment(self) -> Moment:
        """The random moment that a script draws."""
        return Moment.model_validate({"during": self.during, "visits": self.visits})


class FaultEntry(Group):
    """One row of the table."""

    kind: one_of(FaultKind) = Field(description="kind of fault")  # type: ignore[valid-type]
    size: float | None = Field(None, strict=True, description="size in the unit of the kind")
    turn_deg: float | None = Field(None, strict=True, description="angle by which a garment is turned")
    duration_s: float | None = Field(None, strict=True, description="duration; without it, at once or for good")
    place: one_of(Place) = Field(description="where it is injected: ports or world")  # type: ignore[valid-type]
    stage: str = Field(description="the stage of the run in which it strikes")
    end: Annotated[tuple[one_of(DueEnd), ...], BeforeValidator(as_list)] = Field(  # type: ignore[valid-type]
        min_length=1, description="the due end, or ends of which each is right"
    )
    why: str = Field(min_length=1, description="the reason for the due end, in one sentence")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.place is not TRAITS[self.kind].place:
            raise ValueError(f"{self.kind} is injected into the {TRAITS[self.kind].place}, not the {self.place}")
        if len(set(self.end)) != len(self.end):
            raise ValueError("the same end is stated twice")
        self.fault({})
        return self

    def fault(self, drawn: Mapping[str, Any]) -> FaultSpec:
        """Return the fault as scripts state it. drawn: the random `seed`, and the random `side` if the fault has
        one."""
        stated = {"size": self.size, "turn_deg": self.turn_deg, "duration_s": self.duration_s}
        return FaultSpec.model_validate(
            {"kind": self.kind, **{k: v for k, v in stated.items() if v is not None}, **drawn}
        )

    @property
    def recoverable(self) -> bool:
        """Whether the only right end is a fold."""
        return self.end == (DueEnd.RECOVERED,)

    @property
    def displaces(self) -> bool:
        """Whether the fault moves the garment. The cell is then not to blame for the drift."""
        return TRAITS[self.kind].turns


_Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]{0,35}$")]


class _File(Group):
    stages: dict[_Name, Stage] = Field(min_length=1, description="stages of a run")
    faults: dict[_Name, FaultEntry] = Field(min_length=1, description="faults by name")


@dataclass(frozen=True)
class FaultTable:
    """The faults by name, in the order of the file, and the stages that they refer to."""

    faults: Mapping[str, FaultEntry]
    stages: Mapping[str, Stage]

    def moment(self, name: str) -> Moment:
        """Return the random moment of a fault."""
        return self.stages[self.faults[name].stage].moment


def read_fault_table(path: Path = SHIPPED) -> FaultTable:
    """Read a table. Raises ConfigurationError with file, line, key and allowed values."""
    document = read_yaml(path, "table of faults")
    content = validated(document, _File)
    for name, entry in content.faults.items():
        if entry.stage not in content.stages:
            raise ConfigurationError(
                f"{document.where(('faults', name, 'stage'))}: there is no stage '{entry.stage}'",
                f"the stages are {', '.join(content.stages)}",
                path=str(path),
            )
    return FaultTable(content.faults, content.stages)
