"""The result of a clause of the contract, or of a step of the ladder that is built on clauses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from foldcell.cell.hardware.contract.rig import BrokenError, UnprovenError
from foldcell.cell.support.junit import JUnitCase
from foldcell.robots.errors import CellError, StorageError

Figures = Mapping[str, float]
WORDS = {"passed": "PASS", "failed": "FAIL", "not_run": "not run"}
UNITS = {"s": "s", "m": "m", "n": "N", "nm": "Nm", "deg": "degrees", "hz": "Hz"}
"""Last part of a figure's name -> its unit."""


class Provable(Protocol):
    """What a result is about. proves: what is known if it passes. remedy: what helps if it fails. moves: what may
    move."""

    @property
    def name(self) -> str: ...

    @property
    def proves(self) -> str: ...

    @property
    def remedy(self) -> str: ...

    @property
    def moves(self) -> str: ...


P = TypeVar("P", bound=Provable)
A = TypeVar("A")


@dataclass(frozen=True, eq=False)
class Result(Generic[P]):
    """state: passed, failed or not_run. reason: why it did not pass. seconds: wall time. figures: what was
    measured. reports: folders of its runs."""

    of: P
    state: str
    reason: str = ""
    seconds: float = 0.0
    figures: Figures = field(default_factory=dict)
    reports: Sequence[str] = ()

    @property
    def passed(self) -> bool:
        return self.state == "passed"

    @property
    def failed(self) -> bool:
        return self.state == "failed"

    @property
    def measured(self) -> tuple[str, ...]:
        """The figures in words, for example 'rest 0.02 s'."""
        return tuple(_in_words(name, value).replace("_", " ") for name, value in self.figures.items())

    def __str__(self) -> str:
        remedy = f"remedy: {self.of.remedy}" if self.failed else ""
        lines = [f"{WORDS[self.state]:8} {self.of.name:16} {self.of.proves}"]
        return "\n".join(
            lines + [f"{'':25} {line}" for line in (", ".join(self.measured), self.reason, remedy) if line]
        )

    def as_json(self) -> dict[str, Any]:
        of = self.of
        return {
            "name": of.name, "proves": of.proves, "moves": of.moves, "state": self.state, "reason": self.reason,
            "remedy": of.remedy, "figures": dict(self.figures), "wall_time_s": self.seconds,
            "runs": list(self.reports),
        }  # fmt: skip

    def as_case(self) -> JUnitCase:
        broken = (self.reason, self.of.remedy) if self.failed else ()
        skipped = self.reason if self.state == "not_run" else ""
        output = "\n".join([self.of.proves, *self.reports])
        return JUnitCase(self.of.name, broken, skipped, self.seconds, output=output)


def _in_words(name: str, value: float) -> str:
    about, _, last = name.rpartition("_")
    return f"{about} {value:.4g} {UNITS[last]}" if last in UNITS else f"{name} {value:g}"


def judged(check: Callable[[A], Figures | None], at: A) -> tuple[str, str, Figures]:
    """Perform a check. Returns state, reason and figures of its result. Raises StorageError."""
    try:
        return "passed", "", check(at) or {}
    except BrokenError as broken:
        return "failed", str(broken), {}
    except UnprovenError as unproven:
        return "not_run", str(unproven), {}
    except StorageError:
        raise
    except CellError as error:
        return "failed", error.what, {}
    except Exception as error:  # the code of another package
        return "failed", f"{type(error).__name__}: {error}", {}
