"""`import foldcell` is quick, and all its public names exist."""

from __future__ import annotations

import subprocess
import sys

import pytest

import foldcell


def test_importing_foldcell_loads_no_module_of_the_cell() -> None:
    code = "import sys; before = set(sys.modules); import foldcell; print(*sorted(set(sys.modules) - before))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names = set(answer.stdout.split())
    roots = {name.partition(".")[0] for name in names}
    assert "foldcell" in roots
    assert (roots | names) & {
        "foldcell.cell",
        "foldcell.skills",
        "numpy",
        "numba",
        "cv2",
        "pydantic",
        "yaml",
    } == set()


def test_every_public_name_exists() -> None:
    assert all(getattr(foldcell, name) for name in foldcell.__all__)
    with pytest.raises(AttributeError, match="no attribute 'unfold'"):
        _ = foldcell.unfold
