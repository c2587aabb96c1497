"""Runs the notebooks of docs/learn without Jupyter."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib

LEARN = Path(__file__).resolve().parents[1] / "docs" / "learn"


def performed(name: str) -> dict[str, Any]:
    """Run the cells of a notebook in their order, in the present folder. Returns its names."""
    names: dict[str, Any] = {}
    cells = json.loads((LEARN / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    with matplotlib.rc_context({"backend": "Agg"}):
        for number, cell in enumerate(cells):
            if cell["cell_type"] == "code":
                assert cell["outputs"] == [], "outputs are of an older program: clear them"
                exec(compile("".join(cell["source"]), f"{name}, cell {number}", "exec"), names)
    return names
