"""Only the simulation itself imports modules that lead to its world."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[4]
INNER = {"camera", "garment", "hands", "port_worlds", "ports", "robot", "world", "world_camera"}


@cache
def imported(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def sources(*folders: str) -> list[Path]:
    return [p for folder in folders for p in (ROOT / folder).rglob("*.py") if "simulation" not in p.parts]


def test_only_the_simulation_imports_its_inner_modules() -> None:
    def inside(names: set[str]) -> set[str]:
        return {n for n in names if n.startswith("foldcell.cell.simulation.") and n.split(".")[3] in INNER}

    files = sources("cell", "calibration", "skills", "robots")
    found = {str(p.relative_to(ROOT)): inside(imported(p)) for p in files}
    assert len(found) > 20
    assert {path: names for path, names in found.items() if names} == {}


def test_skills_calibration_and_robots_do_not_import_the_cell() -> None:
    for path in sources("calibration", "skills", "robots"):
        assert not any(name.startswith("foldcell.cell") for name in imported(path)), path


def test_the_search_for_imports_finds_an_import_of_the_world() -> None:
    assert "foldcell.cell.simulation.port_worlds" in imported(ROOT / "cell" / "simulation" / "ports.py")


def test_the_render_process_starts_without_solver_and_compiler() -> None:
    """Each simulated cell with a camera starts one, and these imports would take most of its time to start."""
    line = "import sys, foldcell.cell.simulation.camera.render_server; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", line], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert "pybullet" in loaded
    assert not {"numba", "scipy", "foldcell.cell.simulation.world", "foldcell.skills.cloth.mesh"} & set(loaded)
