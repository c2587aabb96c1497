"""A script as a YAML file: the run, the actions during it, and the expected results.

about: a corner slips out of the left hand; the garment is laid down, recognised again, and folded
garment: small_towel
seed: 1
do:
  - when: {state: lifting}
    fault: {kind: dropped_corner, side: left}
  - when: {state: folding, visit: 2, after_s: 1.5}
    say: pause
  - when: {time_s: 60}
    tell: put the lamp out
  - when: {during: {lifting: 1.0, folding: 3.0}, visits: 2}    # drawn by the seed
    fault: {kind: slip}
expect:
  end: [folded, not_folded]
  failures: [dropped_corner]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, model_validator

from foldcell.cell.config.yaml_file import Key, did_you_mean, read_yaml, validated
from foldcell.cell.simulation import TRAITS, Fault, FaultKind
from foldcell.cell.states.commands import OPERATOR_EVENTS
from foldcell.cell.states.transition_table import TERMINAL, Event, State
from foldcell.robots.errors import ConfigurationError, FailureKind
from foldcell.robots.ports import Side

LIMIT_S = 600.0
"""Cell time after which a run is aborted, unless its script states another limit [s]."""
_LONGEST_S = 36_000.0
_ENTERED = frozenset(State) - {State.IDLE}
"""States that a run can enter: all except IDLE, in which it starts."""
ENTERED_ONCE = frozenset(
    {
        State.PREPARING,
        State.PHOTOGRAPHING,
        State.AWAITING_GARMENT,
        State.LOOKING,
        State.RECOGNISING,
        State.PLANNING,
    }
)
"""States that a run without failures enters once, before its first fold."""


def one_of(kind: Any, known: Any = None) -> Any:
    """Return the type of a field that holds a value of the enumeration `kind`, or of its members `known` only. The
    error message for any other value lists the allowed ones."""
    choices = [member for member in kind if known is None or member in known]

    def convert(value: Any) -> Any:
        if value in choices:
            return kind(value)
        raise ValueError(f"{did_you_mean(value, choices)}allowed is one of {', '.join(choices)}")

    return Annotated[kind, BeforeValidator(convert)]


def as_list(value: Any) -> Any:
    """Treat a single value as a list of one value."""
    return value if isinstance(value, list | tuple) else [value]


def _seconds(about: str, **more: Any) -> Any:
    low: dict[str, Any] = {} if "gt" in more else {"ge": 0.0}
    return Field(le=_LONGEST_S, strict=True, allow_inf_nan=False, description=about, **low, **more)


class Group(BaseModel):
    """A group of keys in a file of campaigns, faults or scripts. Unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Moment(Group):
    """A moment of the run: a time since its start, a delay after the n-th entry into a state, or a random moment.

    A random moment is drawn by the script's seed, evenly over the stays in the states of `during`.
    """

    time_s: Annotated[float, _seconds("cell time since the start of the run")] | None = None
    state: one_of(State, _ENTERED) | None = Field(None, description="a state of the state machine")  # type: ignore[valid-type]
    visit: int = Field(1, ge=1, le=1000, strict=True, description="the state's n-th visit, from 1")
    after_s: Annotated[float, _seconds("delay after the state was entered")] = 0.0
    at_latest: bool = Field(False, strict=True, description="not missed if the state ends before: then at its end")
    during: dict[one_of(State, _ENTERED), Annotated[float, _seconds("usual length of a stay")]] = Field(  # type: ignore[valid-type]
        {}, description="states, each with the usual length of a stay in it; one moment is drawn"
    )
    visits: int = Field(1, ge=1, le=1000, strict=True, description="draw among the first n visits of a state")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum((self.time_s is not None, self.state is not None, bool(self.during))) != 1:
            raise ValueError(
                "a moment is either `time_s` or `state` (with `visit`, `after_s`) or `during` (with `visits`)"
            )
        if self.state is None and (self.visit != 1 or self.after_s or self.at_latest):
            raise ValueError("`visit`, `after_s` and `at_latest` need `state`")
        if not self.during and self.visits != 1:
            raise ValueError("`visits` needs `during`")
        return self

    def drawn(self, seed: int, index: int) -> Moment:
        """Return the moment that the seed draws for the script's action number `index`. A moment that is not
        random is returned unchanged. If the stay in the state ends before the drawn moment, the action is due at
        its end."""
        if not self.during:
            return self
        rng = np.random.default_rng((seed, index))
        stays = [
            (state, visit, span)
            for state, span in self.during.items()
            for visit in range(1, 1 + (1 if state in ENTERED_ONCE else self.visits))
        ]
        spans = np.array([span for _, _, span in stays])
        share = spans / spans.sum() if spans.any() else np.full(len(stays), 1.0 / len(stays))
        state, visit, span = stays[int(rng.choice(len(stays), p=share))]
        return Moment.model_validate(
            {"state": state, "visit": visit, "after_s": round(float(rng.uniform(0.0, span)), 3), "at_latest": True}
        )

    def __str__(self) -> str:
        if self.during:
            return f"at a random moment of {', '.join(state.value for state in self.during)}"
        if self.state is None:
            return f"at {self.time_s:g} s"
        visit = "" if self.visit == 1 else f", visit {self.visit}"
        return f"{self.after_s:g} s into {self.state.value}{visit}"


class FaultSpec(Group):
    """A fault of the simulated cell (cell/simulation/faults/kinds.py)."""

    kind: one_of(FaultKind) = Field(description="kind of fault")  # type: ignore[valid-type]
    side: one_of(Side) | None = Field(None, description="left or right; default: the first to which it applies")  # type: ignore[valid-type]
    grasp: int | None = Field(
        None, ge=1, strict=True, description="n-th time that this side closes on cloth, from 1"
    )
    fold: int | None = Field(None, ge=0, strict=True, description="during the n-th fold, from 0")
    size: float | None = Field(
        None, ge=-100.0, le=100.0, strict=True, allow_inf_nan=False, description="size in the unit of the kind"
    )
    size_m: float | None = Field(None, gt=0.0, le=1.0, strict=True, description="size in metres")
    duration_s: float | None = Field(None, gt=0.0, le=_LONGEST_S, strict=True, description="duration")
    turn_deg: float | None = Field(
        None, ge=-180.0, le=180.0, strict=True, description="angle by which a garment is turned"
    )
    seed: int = Field(0, ge=0, le=2**31 - 1, strict=True, description="draws what the fault leaves open")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.size is not None and self.size_m is not None:
            raise ValueError("give `size` or `size_m`, not both")
        if self.size_m is not None and TRAITS[self.kind].unit not in ("", "m"):
            raise ValueError(f"the size of {self.kind} is no length but in {TRAITS[self.kind].unit}: use `size`")
        try:
            self.at(0.0)
        except ConfigurationError as e:
            raise ValueError(f"{e.what} ({e.hint})") from e
        return self

    def at(self, t: float) -> Fault:
        """Return the fault with its start at cell time t [s]."""
        size = self.size if self.size is not None else self.size_m
        turn = 0.0 if self.turn_deg is None else math.radians(self.turn_deg)
        return Fault(self.kind, self.side, t, self.grasp, self.fold, size, self.duration_s, turn, self.seed)


START = Moment.model_validate({"time_s": 0.0})


class Action(Group):
    """One action during the run: a fault, a command, a stop, or a line for the person at the cell."""

    when: Moment = Field(START, description="time_s, or state with visit and after_s")
    fault: FaultSpec | None = Field(None, description="causes a fault in the simulated cell")
    say: one_of(Event, OPERATOR_EVENTS) | None = Field(None, description="an operator's command")  # type: ignore[valid-type]
    stop: str | None = Field(None, min_length=1, description="triggers the stop circuit, with this reason")
    tell: str | None = Field(None, min_length=1, description="a line for the person at the cell")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(x is not None for x in (self.fault, self.say, self.stop, self.tell)) != 1:
            raise ValueError("an action has exactly one of fault, say, stop and tell")
        return self

    def __str__(self) -> str:
        if self.fault is not None:
            return f"fault {self.fault.kind.value}"
        return f"say {self.say.value}" if self.say else "stop" if self.stop else "tell"


class Expectation(Group):
    """Expected results of the run. The items of a list must occur in the order of the list, but other items may
    occur between them."""

    end: Annotated[tuple[one_of(State, TERMINAL), ...], BeforeValidator(as_list)] = Field(  # type: ignore[valid-type]
        min_length=1, description="the state, or one of the states, in which the run may end"
    )
    failures: tuple[one_of(FailureKind), ...] = Field((), description="kinds of failure that occur")  # type: ignore[valid-type]
    only_failures: bool = Field(False, strict=True, description="no other kinds of failure occur")
    through: tuple[one_of(State, _ENTERED), ...] = Field((), description="states that are entered")  # type: ignore[valid-type]
    not_through: tuple[one_of(State, _ENTERED), ...] = Field((), description="states that are never entered")  # type: ignore[valid-type]
    folds: int | None = Field(None, ge=0, strict=True, description="number of folds made")
    within_s: Annotated[float, _seconds("robot time of the whole run")] | None = None
    passed: bool | None = Field(
        None, strict=True, description="whether the scorer passes the run; simulated cells only"
    )
    parked: bool | None = Field(None, strict=True, description="arms at rest and hands open at the end")


class Script(Group):
    """The content of one script file."""

    about: str = Field(min_length=1, description="what happens and what is expected, in one sentence")
    garment: str = Field(min_length=1, description="name or file of the garment, or auto")
    seed: int = Field(0, ge=0, le=2**31 - 1, strict=True, description="seed of the simulated cell")
    attended: bool = Field(False, strict=True, description="folds are approved, failures may be asked about")
    limit_s: Annotated[
        float, _seconds("cell time after which the run is aborted and the script fails", gt=0.0)
    ] = LIMIT_S
    cell: dict[str, Any] = Field({}, description="settings that override those of the cell")
    do: Annotated[tuple[Action, ...], BeforeValidator(lambda value: () if value is None else value)] = Field(
        (), description="actions during the run"
    )
    expect: Expectation = Field(description="expected results")
    _path: Path = PrivateAttr(default=Path())
    _setting_lines: dict[Key, int] = PrivateAttr(default_factory=dict)

    @property
    def path(self) -> Path:
        """The script's file."""
        return self._path

    @property
    def setting_lines(self) -> Mapping[Key, int]:
        """Line numbers of the keys in `cell`."""
        return self._setting_lines

    @property
    def name(self) -> str:
        return self.path.stem

    @property
    def needs_simulation(self) -> bool:
        """Whether the script causes a fault or expects a verdict of the scorer."""
        return any(action.fault is not None for action in self.do) or self.expect.passed is not None

    @property
    def garment_named(self) -> str:
        """The garment's name, or the path of its file. A path is relative to the folder of the script."""
        is_file = self.garment.endswith((".yaml", ".yml")) or "/" in self.garment
        return str(self.path.parent / self.garment) if is_file else self.garment


def read_script(path: Path) -> Script:
    """Read a script. Raises ConfigurationError with file, line, key and allowed values."""
    document = read_yaml(path, "HIL script")
    script = validated(document, Script)
    commands = {action.say for action in script.do}
    if not script.attended and commands & {Event.APPROVE, Event.RETRY, Event.SKIP}:
        raise ConfigurationError(
            f"{document.where(('do',))}: approve, retry and skip are answers, but this run asks no questions",
            "add `attended: true`: the cell then asks for approval of folds and about failures",
            path=str(path),
        )
    script._path = path
    script._setting_lines.update({key[1:]: line for key, line in document.lines.items() if key[:1] == ("cell",)})
    return script
