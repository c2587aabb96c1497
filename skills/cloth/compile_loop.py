"""Compiles the cloth simulation, if it is not compiled: `python -m foldcell.skills.cloth.compile_loop`."""

from __future__ import annotations

from typing import Any

import numpy as np

from foldcell.skills.cloth import kernel
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.vocabulary import Material


def is_compiled() -> bool:
    """Whether the code of the loop is on disk, perhaps for another computer."""
    loop: Any = kernel.run_frames
    return bool(loop._cache.index.exists())


def main() -> None:
    """Advance a small cloth by one frame. If another process compiles the loop already, this waits for it."""
    square = 0.1 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    ClothSimulation(mesh_from_contour(square, 0.03), Material(0.4, 0.03, 0.02, 0.002, 0.6, 0.55, 0.5)).advance()


if __name__ == "__main__":
    main()
