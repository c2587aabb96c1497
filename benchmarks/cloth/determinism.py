"""Tests the determinism of the simulation."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from benchmarks.cloth import Tell
from benchmarks.cloth.scenes import (
    MATERIAL,
    RELEASE,
    SETTLE,
    Paths,
    shirt_folds,
    towel_half,
    towel_mesh,
)
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.vocabulary import Material


def digest() -> str:
    """Simulate a towel fold and a sleeve fold. Return a hash of all bits of the results."""
    mesh, material = towel_mesh(425)
    towel = _end(mesh, mesh.lay_flat(material.thickness), material, towel_half())
    shirt, folds = shirt_folds()
    sleeve = _end(shirt, shirt.lay_flat(MATERIAL.thickness), MATERIAL, folds[0])
    return hashlib.sha256(towel.tobytes() + sleeve.tobytes()).hexdigest()


def same_bits(quick: bool, tell: Tell) -> dict[str, Any]:
    here = digest()
    command = "from benchmarks.cloth.determinism import digest; print(digest())"
    there = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    with ThreadPoolExecutor(2) as pool:
        threads = set(pool.map(lambda _: digest(), range(2)))
    return {
        "same_bits_again": digest() == here,
        "same_bits_in_another_process": there.stdout.strip() == here,
        "same_bits_in_two_threads_at_once": threads == {here},
    }


def _end(mesh: ClothMesh, x: Array, material: Material, paths: Paths) -> Array:
    return predict_fold(mesh, x, material, paths, RELEASE, SETTLE).vertices
