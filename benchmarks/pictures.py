"""The pictures of README and docs, made from one run: `python -m benchmarks.pictures` (`make docs`)."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from cell.config import load_settings
from cell.recorder.screenshot import screenshot
from cell.run import FoldRequest, fold_once

FOLDER = Path(__file__).parents[1] / "docs" / "pictures"
GARMENT, SEED = "medium_towel", 4
MOMENT = 15.2
"""Cell time of the view's picture: the first fold is half way [s]."""


def main() -> int:
    FOLDER.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as logs:
        result = fold_once(FoldRequest(GARMENT, SEED, "sim", load_settings(), None, Path(logs)))
        run = Path(result.run_dir)
        shutil.copy(run / "fold.png", FOLDER / f"{GARMENT}.png")
        screenshot(run / "run.rrd", FOLDER / "rerun.png", MOMENT)
    print(f"{FOLDER}: {GARMENT}.png, rerun.png (seed {SEED}: {result.result})")
    return result.exit_code


if __name__ == "__main__":
    sys.exit(main())
