"""A script as a YAML file: the run, what is done to it, and what is expected of it.

about: a corner slips out of the left hand; the garment is laid down, looked at, and folded again
garment: small_towel
seed: 1
do:
  - when: {state: lifting}
    fault: {kind: dropped_corner, side: left}
  - when: {state: folding, visit: 2, after_s: 1.5}
    say: pause
  - when: {time_s: 60}
    tell: put the lamp out
expect:
  end: [folded, not_folded]
  failures: [dropped_corner]
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, model_validator

from cell.config.yaml_file import Key, read_yaml, validated
from cell.simulation import Fault, FaultKind
from cell.states.commands import OPERATOR_EVENTS
from cell.states.transition_table import TERMINAL, Event, State
from robots.errors import ConfigurationError, FailureKind
from robots.ports import Side

__all__ = ["Action", "Expectation", "FaultSpec", "Moment", "Script", "read_script"]

_LONGEST_S = 36_000.0
_ENTERED = frozenset(State) - {State.IDLE}
"""States that a run comes to: it begins in the other."""


def _one_of(kind: Any, known: Any = None) -> Any:
    """A value of an enumeration, with the whole list in the message when it is none."""
    choices = [member for member in kind if known is None or member in known]

    def convert(value: Any) -> Any:
        if value in choices:
            return kind(value)
        raise ValueError(f"allowed is one of {', '.join(choices)}")

    return Annotated[kind, BeforeValidator(convert)]


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


def _or_empty(value: Any) -> Any:
    """A key that is there with nothing behind it is an empty list."""
    return () if value is None else value


def _seconds(about: str, **more: Any) -> Any:
    low: dict[str, Any] = {} if "gt" in more else {"ge": 0.0}
    return Field(le=_LONGEST_S, strict=True, allow_inf_nan=False, description=about, **low, **more)


class _Group(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Moment(_Group):
    """A cell time of the run, or some time after a state was entered for the n-th time."""

    time_s: Annotated[float, _seconds("cell time since the run began")] | None = None
    state: _one_of(State, _ENTERED) | None = Field(None, description="a state of the machine")  # type: ignore[valid-type]
    visit: int = Field(1, ge=1, le=1000, strict=True, description="the state's n-th visit, from 1")
    after_s: Annotated[float, _seconds("so long after the state was entered")] = 0.0

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.time_s is None) == (self.state is None):
            raise ValueError("a moment is either `time_s` or `state` (with `visit` and `after_s`)")
        if self.state is None and (self.visit != 1 or self.after_s):
            raise ValueError("`visit` and `after_s` go with `state`; a `time_s` is complete by itself")
        return self

    def __str__(self) -> str:
        if self.state is None:
            return f"at {self.time_s:g} s"
        visit = "" if self.visit == 1 else f", visit {self.visit}"
        return f"{self.after_s:g} s into {self.state.value}{visit}"


class FaultSpec(_Group):
    """A fault of the simulated cell (cell/simulation/faults.py)."""

    kind: _one_of(FaultKind) = Field(description="what goes wrong")  # type: ignore[valid-type]
    side: _one_of(Side) | None = Field(None, description="left or right; else whichever comes first")  # type: ignore[valid-type]
    grasp: int | None = Field(None, ge=1, strict=True, description="that side's n-th closing on cloth, from 1")
    fold: int | None = Field(None, ge=0, strict=True, description="during the n-th fold, from 0")
    size_m: float | None = Field(None, gt=0.0, le=1.0, strict=True, description="how much, in metres")
    duration_s: float | None = Field(None, gt=0.0, le=_LONGEST_S, strict=True, description="how long")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        try:
            self.at(0.0)
        except ConfigurationError as e:
            raise ValueError(f"{e.what} ({e.hint})") from e
        return self

    def at(self, t: float) -> Fault:
        """The fault, from cell time t [s] on."""
        return Fault(self.kind, self.side, t, self.grasp, self.fold, self.size_m, self.duration_s)


START = Moment.model_validate({"time_s": 0.0})


class Action(_Group):
    """What is done to the run, once."""

    when: Moment = Field(START, description="time_s, or state with visit and after_s")
    fault: FaultSpec | None = Field(None, description="lets something go wrong in the simulated cell")
    say: _one_of(Event, OPERATOR_EVENTS) | None = Field(None, description="what an operator says")  # type: ignore[valid-type]
    stop: str | None = Field(None, min_length=1, description="triggers the stop circuit, with this reason")
    tell: str | None = Field(None, min_length=1, description="a line for the person at the cell")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(x is not None for x in (self.fault, self.say, self.stop, self.tell)) != 1:
            raise ValueError("an action is one of fault, say, stop and tell")
        return self

    def __str__(self) -> str:
        if self.fault is not None:
            return f"fault {self.fault.kind.value}"
        return f"say {self.say.value}" if self.say else "stop" if self.stop else "tell"


class Expectation(_Group):
    """What has to come of the run. Lists are met in this order, with others between them allowed."""

    end: Annotated[tuple[_one_of(State, TERMINAL), ...], BeforeValidator(_as_list)] = Field(  # type: ignore[valid-type]
        min_length=1, description="the state, or one of the states, in which the run may end"
    )
    failures: tuple[_one_of(FailureKind), ...] = Field((), description="kinds of failure that are met")  # type: ignore[valid-type]
    only_failures: bool = Field(False, strict=True, description="no other kinds of failure than these are met")
    through: tuple[_one_of(State, _ENTERED), ...] = Field((), description="states that are passed")  # type: ignore[valid-type]
    not_through: tuple[_one_of(State, _ENTERED), ...] = Field((), description="states that are never entered")  # type: ignore[valid-type]
    folds: int | None = Field(None, ge=0, strict=True, description="folds that are made")
    within_s: Annotated[float, _seconds("robot time of the whole run")] | None = None
    passed: bool | None = Field(None, strict=True, description="the scorer's verdict; simulated cells only")
    parked: bool | None = Field(None, strict=True, description="arms at rest, hands open at the end")


class Script(_Group):
    """One script."""

    about: str = Field(min_length=1, description="what happens and what should come of it, in a sentence")
    garment: str = Field(min_length=1, description="name or file of the garment, or auto")
    seed: int = Field(0, ge=0, le=2**31 - 1, strict=True, description="of the simulated cell")
    attended: bool = Field(False, strict=True, description="folds are approved, failures may be asked about")
    limit_s: Annotated[
        float, _seconds("cell time after which the run is aborted, and the script failed", gt=0.0)
    ] = 600.0
    cell: dict[str, Any] = Field({}, description="settings laid over those of the cell")
    do: Annotated[tuple[Action, ...], BeforeValidator(_or_empty)] = Field((), description="what is done")
    expect: Expectation = Field(description="what has to come of it")
    _path: Path = PrivateAttr(default=Path())
    _setting_lines: dict[Key, int] = PrivateAttr(default_factory=dict)

    @property
    def path(self) -> Path:
        """The file that it was read from."""
        return self._path

    @property
    def setting_lines(self) -> Mapping[Key, int]:
        """Lines of the keys in `cell`."""
        return self._setting_lines

    @property
    def name(self) -> str:
        return self.path.stem

    @property
    def needs_simulation(self) -> bool:
        """Whether it lets things go wrong, or asks for what only a scorer knows."""
        return any(action.fault is not None for action in self.do) or self.expect.passed is not None

    @property
    def garment_named(self) -> str:
        """The garment's name, or its file: a path counts from where the script lies."""
        is_file = self.garment.endswith((".yaml", ".yml")) or "/" in self.garment
        return str(self.path.parent / self.garment) if is_file else self.garment


def read_script(path: Path) -> Script:
    """Raises ConfigurationError, with file, line, key and what is allowed."""
    document = read_yaml(path, "HIL script")
    script = validated(document, Script)
    said = {action.say for action in script.do}
    if not script.attended and said & {Event.APPROVE, Event.RETRY, Event.SKIP}:
        raise ConfigurationError(
            f"{document.where(('do',))}: approve, retry and skip answer questions that nobody is asked",
            "add `attended: true`: then folds are approved, and failures may be asked about",
            path=str(path),
        )
    script._path = path
    script._setting_lines.update({key[1:]: line for key, line in document.lines.items() if key[:1] == ("cell",)})
    return script
