"""Makes the pictures of docs from runs of the simulated cell: `python -m benchmarks.pictures` (`make docs`).

A long-sleeve shirt and a medium towel are folded, and two scripts and a campaign of two runs are performed, so
that report, dashboard and comparison have something to show.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlencode

from benchmarks.operator.chromium import Chromium, keep_picture
from benchmarks.viewer_picture import screenshot

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "pictures"
PROGRAM = [sys.executable, "-m", "foldcell.cell.commands.main"]
SHIRT, TOWEL = ("long_sleeve_shirt_small", "2"), ("medium_towel", "4")
SCRIPTS = ("dropped_corner", "missed_grasp")
MOMENT = 15.2
"""Cell time at which the viewer's picture is taken [s]: the first fold is half done."""
LOADED = "new Promise(done => { if (document.readyState === 'complete') done(); else onload = done })"
REPORT, HISTORY = (1000, 1150), (1500, 950)
"""Sizes of the browser's window [px]."""


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        logs = Path(folder, "logs")
        shirt, towel = (_performed(logs, "fold", garment, "--seed", seed) for garment, seed in (SHIRT, TOWEL))
        script, *_ = _performed(logs, "hil", *(str(ROOT / "tests" / "hil" / f"{name}.yaml") for name in SCRIPTS))
        _performed(logs, "trials", "--garments", "small_towel", "--n", "2")
        keep_picture((shirt[0] / "fold.png").read_bytes(), FOLDER / "long_sleeve_shirt.webp")
        pair = urlencode([("first", str(towel[0].relative_to(logs))), ("second", str(script.relative_to(logs)))])
        with Chromium() as browser, _dashboard(logs) as address:
            for name, page, size in (
                ("report", (script / "report.html").as_uri(), REPORT),
                ("dashboard", address, HISTORY),
                ("two_runs", f"{address}compare?{pair}", HISTORY),
            ):
                tab = browser.open(page)
                tab.resize(*size)
                tab.evaluate(
                    "new Promise(done => { if (document.readyState === 'complete') done(); else onload = done })"
                )
                keep_picture(tab.screenshot(), FOLDER / f"{name}.webp")
        screenshot(towel[0] / "run.rrd", Path(folder, "rerun.png"), MOMENT)
        keep_picture(Path(folder, "rerun.png").read_bytes(), FOLDER / "rerun.webp")
    return 0


def _performed(logs: Path, *command: str) -> list[Path]:
    """Perform a command. Returns the folders of its runs."""
    before = set(logs.rglob("report.html"))
    subprocess.run([*PROGRAM, *command, "--logs", str(logs)], check=True)
    return sorted(report.parent for report in set(logs.rglob("report.html")) - before)


@contextmanager
def _dashboard(logs: Path) -> Iterator[str]:
    """Serve the dashboard. Yields its address."""
    with subprocess.Popen(
        [*PROGRAM, "dashboard", "--logs", str(logs)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            yield next(line.split()[1] for line in process.stdout if line.startswith("page"))
        finally:
            process.terminate()


if __name__ == "__main__":
    sys.exit(main())
