"""Records runs and compares the records, to prove that a change of the program leaves all runs unchanged.

    python -m benchmarks.regression_record record DIR [SCRIPT.yaml ...]
    python -m benchmarks.regression_record compare BEFORE AFTER

The record of a script is a folder with `events.json` (the journal's lines: cell time, state, kind, name, figures),
`commands.npz` (every set-point of the arms and every command to grippers and head, with its cell time), and
`score.json`. These files do not depend on the program's classes, so records of different versions can be compared.
Two records are the same if all numbers are equal to the last digit. All runs are simulated.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

SCRIPTS = Path(__file__).parent / "regression_runs"


class _Tap:
    """A port that forwards all calls and passes each command to `note`, which records it."""

    def __init__(self, port: Any, note: Callable[..., None]) -> None:
        self._port, self._note = port, note

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def command(self, *values: Any) -> Any:
        self._note(*values)
        return self._port.command(*values)

    def command_pan(self, angle: float) -> None:
        self._note(angle)
        self._port.command_pan(angle)


class _Commands:
    """Records all commands to the ports, in order. rows: port name -> rows of (cell time, values ...)."""

    def __init__(self) -> None:
        self.rows: dict[str, list[np.ndarray]] = {}

    def tapped(self, ports: Any) -> Any:
        def tap(name: str, port: Any) -> Any:
            rows = self.rows.setdefault(name, [])

            def note(*values: Any) -> None:
                rows.append(np.concatenate([np.ravel(v) for v in (ports.clock.now(), *values)]))

            return _Tap(port, note)

        grippers = {side: tap(f"gripper_{side.value}", g) for side, g in ports.grippers.items()}
        return replace(ports, arms=tap("arms", ports.arms), head=tap("head", ports.head), grippers=grippers)


def record(script: Path, folder: Path, tell: Callable[[str], None] = print) -> None:
    """Perform a script in the simulated cell and write its record into `folder`."""
    from foldcell.cell.campaigns.hil.director import Director
    from foldcell.cell.campaigns.hil.script import read_script
    from foldcell.cell.config.cell_settings import load_settings
    from foldcell.cell.hardware.robot_model import load_robot
    from foldcell.cell.journal.journal import Journal
    from foldcell.cell.runs.fold_run import fold_once
    from foldcell.cell.states.fold_request import FoldRequest
    from foldcell.cell.support.files.paths import journal_path

    own, commands = read_script(script), _Commands()
    settings = load_settings(None)
    director = Director(own.do, load_robot(settings).q_park, tell, own.seed, own.limit_s)
    with tempfile.TemporaryDirectory() as logs:
        request = FoldRequest(
            garment=own.garment_named, seed=own.seed, driver="sim", settings=settings,
            logs=Path(logs), approve=own.attended, terminal=False, quiet=True, record=False,
        )  # fmt: skip

        def begin(cell: Any, queue: Any) -> Any:
            return commands.tapped(director.begin(cell, queue))

        try:
            result = fold_once(request, begin, (director,))
        finally:
            director.close()
        with Journal.open(journal_path(Path(logs)), readonly=True) as journal:
            entries = journal.entries(Path(result.run_dir).name)
    lines = [[e.cell_time, e.state, e.kind, e.name, _plain(e.payload)] for e in entries]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "events.json").write_text(json.dumps(lines, indent=1) + "\n")
    (folder / "score.json").write_text(json.dumps(_score(result.as_json()), indent=1, sort_keys=True) + "\n")
    np.savez_compressed(folder / "commands.npz", **{name: np.array(rows) for name, rows in commands.rows.items()})
    passed = result.score.passed if result.score else None
    sent = len(commands.rows["arms"])
    tell(f"{script.stem}: {result.state}, passed {passed}, {len(lines)} lines, {sent} set-points")


def _score(figures: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a run with the keys of earlier records, so that all versions can be compared."""
    kept = ("result", "state", "failure", "score", "steps", "robot_time_s", "stage_times_s")
    failure = {k: v for k, v in (figures["failure"] or {}).items() if v or k != "setting"}
    later = ("simulations", "duration_s")
    steps = [
        {"predicted_iou": step["aligned_iou"], **{k: v for k, v in step.items() if k not in later}}
        for step in figures["steps"]
    ]
    return {key: figures[key] for key in kept} | {"failure": failure or None, "steps": steps}


def differences(before: Path, after: Path) -> list[str]:
    """Describe the differences between two records, one line per file or port; empty if there are none."""
    names = sorted({p.name for folder in (before, after) for p in folder.iterdir() if p.is_dir()})
    return [line for name in names for line in _differing(before / name, after / name)]


def _differing(before: Path, after: Path) -> list[str]:
    lines = []
    for file in ("events.json", "score.json"):
        a, b = ((folder / file).read_text().splitlines() if folder.is_dir() else [] for folder in (before, after))
        if a != b:
            n = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
            was, now = (rows[n].strip() if n < len(rows) else "(ends)" for rows in (a, b))
            lines.append(f"{before.name}/{file}, line {n + 1}: {was} -> {now}")
    if before.is_dir() and after.is_dir():
        with np.load(before / "commands.npz") as a, np.load(after / "commands.npz") as b:
            for port in sorted({*a.files, *b.files}):
                if port not in a or port not in b or not np.array_equal(a[port], b[port]):
                    lines.append(f"{before.name}/commands.npz: {port} differs")
    return lines


def _plain(value: Any) -> Any:
    """Remove from a value the keys that differ between processes: wall times and tracebacks."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in sorted(value.items()) if "wall" not in k and "traceback" not in k}
    return [_plain(v) for v in value] if isinstance(value, list) else value


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record")
    recording.add_argument("folder", type=Path)
    recording.add_argument("scripts", type=Path, nargs="*", help="default: the six of benchmarks/regression_runs")
    comparing = commands.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    options = parser.parse_args()
    if options.command == "record":
        for script in options.scripts or sorted(SCRIPTS.glob("*.yaml")):
            record(script, options.folder / script.stem)
        return 0
    lines = differences(options.before, options.after)
    print("\n".join(lines) or "the same to the last digit")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
