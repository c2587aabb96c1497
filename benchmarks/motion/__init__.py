"""Benchmarks of the arms: planning of folds, durations compared with the fastest motions, and inverse kinematics
compared with peers.

Times are CPU times of one thread, so that other work on the machine has little effect. The poses are drawn by seed
from the pose ranges of the shipped garments.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from benchmarks.motion.folds import measure_folds
from benchmarks.motion.kinematics import measure_kinematics
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import list_garments
from foldcell.robots.baxter.robot import load_model


def measure(tell: Callable[[str], None], *, peers: bool, quick: bool) -> dict[str, Any]:
    """Measure everything. Return one flat mapping of figures with units in the keys. quick: few samples."""
    del peers  # both peers, PyBullet and SciPy, are always installed
    began = time.process_time()
    model, settings = load_model(), load_settings()
    poses, measured, singles, peer_singles = (2, 1, 200, 15) if quick else (50, 12, 1000, 200)
    figures: dict[str, Any] = {
        "times_are": "CPU time of one thread",
        "garments": len(list_garments()),
        "poses": poses,
    }
    figures |= measure_folds(tell, model, settings, poses, measured)
    figures |= measure_kinematics(tell, model, singles, peer_singles)
    figures["bench_cpu_s"] = time.process_time() - began
    return figures
