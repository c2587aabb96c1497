"""Kills a run after each of its durable writes, resumes it, and writes docs/results/kill_points.md.

    python -m benchmarks.kill_points [GARMENT] [--seed 5] [--every 1] [--at N ...] [--workers 1] [--folder DIR]

The run is performed once without a kill, which gives its durable writes: the entries of the journal, and the
two files of the checkpoint before each result. For each of them (each boundary) the same run is started again in
a process of its own, which kills itself with SIGKILL as soon as the write is acknowledged. Then the journal must
hold every acknowledged entry, and `foldcell resume last` must fold the garment.

Outcomes stay in the folder, so that an interrupted command goes on where it was, and one with other boundaries
adds to them. The exit code is 0 if nothing was lost and at least 95 % of the resumed runs passed, else 2.
"""

from __future__ import annotations

import argparse
import json
import platform
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, replace
from pathlib import Path

import yaml

from benchmarks.kills.durable_writes import DurableWrite, read_writes
from benchmarks.kills.outcome import Outcome, Resumed, resume_event
from benchmarks.results_page import table
from foldcell.cell.campaigns.statistics.proportions import wilson_interval
from foldcell.cell.campaigns.trials.store import commit
from foldcell.cell.journal.journal import Journal
from foldcell.cell.support.files.paths import journal_path
from foldcell.robots.errors import InternalError

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "kill_points.md"
FOLDER = Path.home() / ".cache" / "foldcell" / "kill_points"
NEEDED = 0.95
"""Required share of the resumed runs that pass."""
LONGEST_S = 1800.0
"""Wall time after which a process counts as hung."""
SETTINGS = {"recorder": {"key_frames": 2}}
"""The least number of pictures of a fold. No decision depends on them."""


def boundaries(count: int, every: int) -> list[int]:
    """Return each `every`-th of the numbers 1 to count, from 1, and the last one."""
    return sorted({*range(1, count + 1, every), count})


def met(outcomes: Sequence[Outcome]) -> bool:
    """Whether nothing was lost and enough of the resumed runs passed."""
    resumed = [o for o in outcomes if o.passed is not None]
    kept = all(not o.lost for o in outcomes)
    return kept and bool(resumed) and sum(bool(o.passed) for o in resumed) >= NEEDED * len(resumed)


class Killer:
    """Performs, kills and resumes runs of one garment and seed in `folder`."""

    def __init__(self, folder: Path, garment: str, seed: int) -> None:
        self._folder, self._line = folder, ["fold", garment, "--seed", str(seed), "--json"]
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "cell.yaml").write_text(yaml.safe_dump(SETTINGS), encoding="utf-8")

    def writes(self) -> list[DurableWrite]:
        """The durable writes of the run without a kill. Raises InternalError if that run does not pass."""
        kept = self._folder / "writes.jsonl"
        if not kept.exists():
            place = self._fresh("whole")
            code, figures, said = self._fold(place, 0)
            if not Resumed(code, figures).passed:
                raise InternalError(f"the run without a kill did not pass (exit code {code}): {said}")
            (place / "writes").rename(kept)
            shutil.rmtree(place)
        return read_writes(kept)

    def outcome(self, number: int, whole: Sequence[DurableWrite]) -> Outcome:
        """Kill the run after its durable write `number`, and resume it."""
        began, place = time.monotonic(), self._fresh(f"boundary_{number}")
        code, _, said = self._fold(place, number)
        problems = [] if code == -signal.SIGKILL else [f"the run ended with {code} before the kill: {said}"]
        acknowledged = read_writes(place / "writes")
        if [w.place for w in acknowledged] != [w.place for w in whole[:number]]:
            problems.append("the run took another course than the run without a kill")
        logs = place / "logs"
        with Journal.open(journal_path(logs), readonly=True) as journal:
            problems += [] if (check := journal.check()) == "ok" else [f"SQLite's check of the journal: {check}"]
            run = journal.run("last")
            entries = journal.entries(run.id)
        code, figures, said = _foldcell(
            ["foldcell.cell.commands.main", "resume", "last", "--json", "--logs", str(logs)]
        )
        event = ""
        if figures:
            with Journal.open(journal_path(logs), readonly=True) as journal:
                event = resume_event(journal.entries(journal.run("last").id))
        resumed = Resumed(code, figures, event, said)
        found = Outcome.of(number, acknowledged, run, entries, problems, resumed, time.monotonic() - began)
        if found.passed is not False and not found.lost:
            shutil.rmtree(place)  # the others are kept, to find the cause
        return found

    def _fresh(self, name: str) -> Path:
        shutil.rmtree(self._folder / name, ignore_errors=True)
        (self._folder / name).mkdir()
        return self._folder / name

    def _fold(self, place: Path, last: int) -> tuple[int, dict[str, object], str]:
        cell = ["--cell", str(self._folder / "cell.yaml"), "--logs", str(place / "logs")]
        child = ["benchmarks.kills.durable_writes", str(place / "writes"), str(last)]
        return _foldcell([*child, *self._line, *cell])


def _foldcell(line: Sequence[str]) -> tuple[int, dict[str, object], str]:
    """Run a module of this program. Returns its exit code, the JSON object in its last line, and its last line of
    errors."""
    command = [sys.executable, "-m", *line]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S, check=False)
    except subprocess.TimeoutExpired:
        return -signal.SIGALRM, {}, f"it did not end within {LONGEST_S:.0f} s"
    try:
        figures = json.loads(ended.stdout.rstrip("\n").rpartition("\n")[2])
    except ValueError:
        figures = {}
    said = " ".join(ended.stderr.split("\n")[-3:]).strip() or ended.stdout.strip()[-200:]
    return ended.returncode, figures if isinstance(figures, dict) and "result" in figures else {}, said


def all_outcomes(
    killer: Killer, numbers: Sequence[int], whole: Sequence[DurableWrite], workers: int
) -> Iterator[Outcome]:
    """Yield the outcomes of these boundaries, as they end."""
    with ThreadPoolExecutor(workers) as pool:
        for future in as_completed([pool.submit(killer.outcome, number, whole) for number in numbers]):
            yield future.result()


def page(outcomes: Sequence[Outcome], whole: Sequence[DurableWrite], about: str, command: str) -> str:
    """Write the results page. about: the garment and its seed."""
    resumed = [o for o in outcomes if o.passed is not None]
    kept, passed = sum(not o.lost for o in outcomes), sum(bool(o.passed) for o in resumed)
    commits = ", ".join(sorted({o.commit for o in outcomes}))
    kinds = Counter(write.what for write in whole)
    by_event = Counter(o.event or "none" for o in resumed)
    rows = [
        [
            str(o.number), o.place, o.state, "yes" if not o.lost else "**NO**: " + "; ".join(o.lost),
            o.event or "-", o.end,
        ]
        for o in outcomes
    ]  # fmt: skip
    return "\n".join(
        [
            "# Results: runs that are killed and resumed",
            "",
            f"Simulated: {about}, two folds. The run makes {len(whole)} durable writes: {kinds['entry']}",
            f"entries of the journal, {kinds['context']} checkpoints of two files each (the simulated world, then",
            "the context), the run's row and its result. At each boundary below, the run was started anew in a",
            "process that killed itself with SIGKILL as soon as that write was acknowledged. Then the journal was",
            "compared with all writes that had been acknowledged, and `foldcell resume last` was run. A boundary",
            "passes if the resumed run ends as folded and the scorer passes the fold. Intervals: Wilson, 95 %.",
            "",
            f"{time.strftime('%Y-%m-%d')}, commit {commits}, {platform.machine()}: `{command}`.",
            "",
            f"- Boundaries: {len(outcomes)} of {len(whole)}.",
            f"- Nothing lost: {_share(kept, len(outcomes))}. Required: 100 %.",
            f"- Resumed and passed: {_share(passed, len(resumed))}. Required: {100 * NEEDED:.0f} %.",
            f"- Nothing to resume: {len(outcomes) - len(resumed)}.",
            f"- Resumed with: {', '.join(f'{event} {count}' for event, count in sorted(by_event.items()))}.",
            "",
            "After a kill the simulated world is the one of the last checkpoint: a motion that was under way is",
            "not in it. Between the checkpoint's two files, the world is newer than the context, as on hardware.",
            "The run has no injected fault, so no kill falls into `laying_back`, `clearing` or `recovering`.",
            "",
            table(
                "Boundaries",
                ("write", "killed after", "state", "nothing lost", "resumed with", "end"),
                rows,
            ),
            "",
        ]
    )


def _share(count: int, total: int) -> str:
    low, high = wilson_interval(count, total)
    return f"{count} of {total} ({100.0 * low:.1f} to {100.0 * high:.1f} %)"


def _read_outcomes(path: Path) -> list[Outcome]:
    if not path.exists():
        return []
    return [Outcome(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("garment", nargs="?", default="small_towel", help="a garment with two folds (small_towel)")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--every", type=int, default=1, help="kill after each K-th durable write (1)")
    parser.add_argument("--at", type=int, nargs="+", help="kill after these durable writes only")
    parser.add_argument("--again", action="store_true", help="repeat the boundaries that did not pass")
    parser.add_argument("--workers", type=int, default=1, help="runs at the same time (1)")
    parser.add_argument("--folder", type=Path, help=f"folder of the outcomes ({FOLDER}/GARMENT-SEED)")
    parser.add_argument("--page", type=Path, default=PAGE, help="the results page")
    options = parser.parse_args()
    folder = options.folder or FOLDER / f"{options.garment}-{options.seed}"
    killer, file = Killer(folder, options.garment, options.seed), folder / "outcomes.jsonl"
    whole = killer.writes()
    print(f"{len(whole)} durable writes", flush=True)
    outcomes = {o.number: o for o in _read_outcomes(file)}
    if options.again:
        outcomes = {n: o for n, o in outcomes.items() if o.passed is not False and not o.lost}
    wanted = options.at or boundaries(len(whole), options.every)
    left = [number for number in wanted if number not in outcomes]
    for done, found in enumerate(all_outcomes(killer, left, whole, options.workers), 1):
        outcomes[found.number] = replace(found, commit=commit() or "unknown")
        file.write_text(
            "".join(json.dumps(asdict(o)) + "\n" for _, o in sorted(outcomes.items())), encoding="utf-8"
        )
        print(
            f"{done}/{len(left)} write {found.number}, {found.place}:"
            f" {'; '.join(found.lost) or 'nothing lost'}; {found.event or 'not resumed'}; {found.end}"
            f" ({found.seconds:.0f} s)",
            flush=True,
        )
    chosen = [o for _, o in sorted(outcomes.items())]
    numbers = [o.number for o in chosen]
    regular = numbers == boundaries(len(whole), options.every)
    which = f"--every {options.every}" if regular else f"--at {' '.join(map(str, numbers))}"
    command = f"python -m benchmarks.kill_points {options.garment} --seed {options.seed} {which}"
    options.page.write_text(
        page(chosen, whole, f"{options.garment}, seed {options.seed}", command), encoding="utf-8"
    )
    print(options.page)
    return 0 if met(chosen) else 2


if __name__ == "__main__":
    sys.exit(main())
