"""The durable writes of a run, reported one by one as they are acknowledged, and a kill after a chosen one.

    python -m benchmarks.kills.durable_writes REPORT AFTER COMMAND...

performs `foldcell COMMAND...` in this process. After each durable write it appends one line of JSON to the file
REPORT. After the write with the number AFTER (from 1; 0: none) the process kills itself with SIGKILL, before it
does anything else. Lines in REPORT survive this, because the kernel holds them.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any

from foldcell.cell.journal.journal import Journal, RunJournal
from foldcell.cell.runs import checkpoint_writer
from foldcell.cell.support.json_values import to_json


@dataclass(frozen=True)
class DurableWrite:
    """One write that was acknowledged, i.e. the function that made it has returned.

    what: `run` (the run's row in the journal), `entry` (of the journal), `world` and `context` (the two files of a
    checkpoint, in this order), or `end` (the run's result in the journal). The other values are those of a journal
    entry, and empty for other writes.
    """

    what: str
    sequence: int = 0
    kind: str = ""
    state: str = ""
    name: str = ""
    payload: Mapping[str, Any] = field(default_factory=dict)

    @property
    def place(self) -> tuple[str, int, str, str, str]:
        """Where in the run this write is made. The same in each run with the same seed."""
        return self.what, self.sequence, self.kind, self.state, self.name


def read_writes(path: Path) -> list[DurableWrite]:
    """Read the file of reported writes."""
    return [DurableWrite(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


def watch(report: Callable[[DurableWrite], None]) -> None:
    """Have every durable write of this process's runs reported when it is acknowledged."""

    def after(
        owner: Any, name: str, written: Callable[[tuple[Any, ...], dict[str, Any], Any], DurableWrite]
    ) -> None:
        function = getattr(owner, name)

        @wraps(function)
        def reported(*values: Any, **named: Any) -> Any:
            answer = function(*values, **named)
            report(written(values, named, answer))
            return answer

        setattr(owner, name, reported)

    def appended(values: tuple[Any, ...], named: dict[str, Any], sequence: int) -> DurableWrite:
        _, kind, _, state, name, payload = (*values, *named.values())[:6]
        return DurableWrite("entry", sequence, kind, str(state), str(name), to_json(payload or {}))

    after(Journal, "begin_run", lambda values, named, run: DurableWrite("run"))
    after(RunJournal, "_append", appended)
    after(RunJournal, "end", lambda values, named, none: DurableWrite("end"))
    after(checkpoint_writer, "write_whole", lambda values, named, none: DurableWrite("world"))
    after(checkpoint_writer, "write_checkpoint", lambda values, named, none: DurableWrite("context"))


def main(arguments: Sequence[str]) -> int:
    report, last, command = arguments[0], int(arguments[1]), list(arguments[2:])
    file = os.open(report, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    count = 0

    def reported(write: DurableWrite) -> None:
        nonlocal count
        count += 1
        os.write(file, json.dumps(asdict(write)).encode() + b"\n")
        if count == last:
            os.kill(os.getpid(), signal.SIGKILL)

    from foldcell.cell.commands.main import main as foldcell

    watch(reported)
    return foldcell(command)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
