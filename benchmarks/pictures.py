"""Makes the pictures of README and docs from two runs: `python -m benchmarks.pictures` (`make docs`)."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.runs.fold_run import FoldRequest, fold_once
from foldcell.cell.view.viewing.screenshot import screenshot

FOLDER = Path(__file__).parents[1] / "docs" / "pictures"
GARMENT, SEED = "medium_towel", 4
PRESSED = "pants", 1
MOMENT = 15.2
"""Cell time at which the viewer's picture is taken [s]: the first fold is half done."""


def main() -> int:
    FOLDER.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as logs:
        result = fold_once(FoldRequest(GARMENT, SEED, "sim", load_settings(), None, Path(logs)))
        run = Path(result.run_dir)
        shutil.copy(run / "fold.png", FOLDER / f"{GARMENT}.png")
        screenshot(run / "run.rrd", FOLDER / "rerun.png", MOMENT)
        pressed = fold_once(FoldRequest(*PRESSED, "sim", load_settings(), None, Path(logs)))
        shutil.copy(Path(pressed.run_dir) / "pressing.png", FOLDER / "pressing.png")
    print(f"{FOLDER}: {GARMENT}.png, rerun.png (seed {SEED}: {result.result}), pressing.png ({pressed.result})")
    return max(result.exit_code, pressed.exit_code)


if __name__ == "__main__":
    sys.exit(main())
