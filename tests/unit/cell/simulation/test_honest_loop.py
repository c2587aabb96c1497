"""Nobody but the simulation itself imports what leads to its world."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[4]
INNER = {
    "_registry", "camera", "cloth_body", "garment", "gripper", "mujoco_cloth", "ports", "robot", "tactile",
    "world",
}  # fmt: skip


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


def test_the_inside_of_the_simulation_is_imported_by_itself_only() -> None:
    forbidden = {f"cell.simulation.{name}" for name in INNER}
    files = sources("cell", "calibration", "skills", "robots")
    found = {str(p.relative_to(ROOT)): imported(p) & forbidden for p in files}
    assert len(found) > 20
    assert {path: names for path, names in found.items() if names} == {}


def test_skills_calibration_and_robots_do_not_know_the_simulation() -> None:
    for path in sources("calibration", "skills", "robots"):
        assert not any(name.startswith("cell") for name in imported(path)), path


def test_the_search_finds_what_it_looks_for() -> None:
    assert "cell.simulation._registry" in imported(ROOT / "cell" / "simulation" / "ports.py")
