"""Draws the packages and their imports: `python -m benchmarks.architecture_picture`.

The packages are in the order of `[tool.importlinter]`, from top to bottom. The row of a square is the importing
package, its column the imported package; the darker the square, the more imports. An import of a higher package,
which is forbidden, would lie to the left of the diagonal. `grimp` is installed with import-linter
(the extra `dev`).
"""

from __future__ import annotations

import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "pictures" / "packages.svg"
ABOVE = ("foldcell",)
PREFIX = "foldcell.cell."
BELOW = ("foldcell.calibration", "foldcell.skills", "foldcell.robots")
CELL, LEFT, TOP = 30, 150, 118
SHADES = ((1, "#d6e4f7"), (5, "#8fb4e8"), (15, "#3f76c9"), (40, "#1d3f7a"))
"""For each shade: minimum number of imports, and colour."""


def packages() -> list[str]:
    """Return the packages from top to bottom: those above `cell`, those within it, those below it."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(c["layers"] for c in settings["contracts"] if c.get("containers") == ["foldcell.cell"])
    inner = [PREFIX + name for layer in layers for name in layer.split("|")]
    return [*ABOVE, *inner, *BELOW]


def imports(names: list[str]) -> Counter[tuple[str, str]]:
    """Count the imports between packages; the key is (importing package, imported package)."""
    import grimp

    graph = grimp.build_graph("foldcell")

    def package(module: str) -> str | None:
        return next((n for n in reversed(names) if module == n or module.startswith(n + ".")), None)

    return Counter(
        (a, b)
        for module in graph.modules
        for other in graph.find_modules_directly_imported_by(module)
        if (a := package(module)) and (b := package(other)) and a != b
    )


def draw(names: list[str], counts: Counter[tuple[str, str]]) -> str:
    n = len(names)
    width, height = LEFT + n * CELL + 20, TOP + n * CELL + 20
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
        ' font-family="sans-serif" font-size="13"><rect width="100%" height="100%" fill="#ffffff"/>'
    ]
    for i, name in enumerate(names):
        label, y, x = name.removeprefix(PREFIX).removeprefix("foldcell."), TOP + i * CELL, LEFT + i * CELL
        weight = "" if name.startswith(PREFIX) else ' font-weight="bold"'
        out.append(f'<text x="{LEFT - 8}" y="{y + 20}" text-anchor="end"{weight}>{label}</text>')
        out.append(f'<text transform="translate({x + 20} {TOP - 8}) rotate(-60)"{weight}>{label}</text>')
        for j, other in enumerate(names):
            many = counts[name, other]
            fill = "#1c2026" if i == j else next((c for least, c in reversed(SHADES) if many >= least), "#f6f7f9")
            tip = name if i == j else f"{name} imports {other}: {many}"
            box = f'x="{LEFT + j * CELL + 1}" y="{y + 1}" width="{CELL - 2}" height="{CELL - 2}" rx="4"'
            out.append(f'<rect {box} fill="{fill}"><title>{tip}</title></rect>')
    return "\n".join([*out, "</svg>"]) + "\n"


def main() -> None:
    names = packages()
    PICTURE.write_text(draw(names, imports(names)), encoding="utf-8")
    print(PICTURE)


if __name__ == "__main__":
    main()
