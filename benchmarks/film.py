"""Makes a short film of a whole run in the simulated cell for the README: `python -m benchmarks.film
[GARMENT] [SEED]`.

The film is docs/pictures/GARMENT_folded.webp. It shows the simulated garment and the tool centre points, faster
than in the cell. Moments at which no hand holds the garment are left out. The film of a report is of the same
kind, with captions and the pictures of the camera.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from cell.config.cell_settings import load_settings
from cell.hardware.driver import OpenCell
from cell.report.pictures.film import FilmFrame, encode_film
from cell.report.pictures.fold_pictures import KeyFrame, fold_strip
from cell.runs.fold_run import FoldRequest, fold_once
from cell.simulation.truth import Truth
from cell.states.commands import CommandQueue
from cell.support.files.whole_file import write_whole

FOLDER = Path(__file__).parents[1] / "docs" / "pictures"
SIZE = 560, 400
DEFAULT = ("long_sleeve_shirt_small", "1")
FRAME_MS, LAST_MS = 60, 1500
EVERY = 4
"""Every fourth recorded moment becomes a frame of the film: 12 frames per second of cell time."""


def main() -> int:
    garment, seed = (*sys.argv[1:], *DEFAULT[len(sys.argv) - 1 :])
    seen: list[Truth] = []

    def watch(opened: OpenCell, _: CommandQueue) -> None:
        assert opened.simulated is not None
        opened.simulated.truth.watch(seen.append)

    settings = load_settings()
    with tempfile.TemporaryDirectory() as logs:
        request = FoldRequest(
            garment, int(seed), "sim", settings, None, Path(logs), record=False, record_truth=False
        )
        result = fold_once(request, watch)
    moments = [truth for truth in seen if truth.garment is not None]
    held = [truth for truth in moments if any(truth.held.values())]
    chosen = [moments[0], *held[::EVERY], moments[-1]]
    frames = [KeyFrame(t.garment.vertices, dict(t.tools) if any(t.held.values()) else {}) for t in chosen]
    pictures = fold_strip(frames, chosen[-1].garment.triangles, table=settings.table, size=SIZE)
    durations = [LAST_MS, *[FRAME_MS] * (len(pictures) - 2), LAST_MS]
    path = FOLDER / f"{garment}_folded.webp"
    write_whole(path, encode_film([FilmFrame(p, ms) for p, ms in zip(pictures, durations, strict=True)]))
    print(f"{path}: {len(pictures)} frames, seed {seed}: {result.result}")
    return result.exit_code


if __name__ == "__main__":
    sys.exit(main())
