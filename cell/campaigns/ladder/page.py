"""The report page of a ladder: its steps with their figures, and the joints that moved in each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from markupsafe import Markup

from foldcell.cell.campaigns.ladder.climb import Climbed
from foldcell.cell.campaigns.ladder.rung import Curve
from foldcell.cell.campaigns.ladder.steps import STEPS
from foldcell.cell.support.files.html_page import page_template
from foldcell.cell.support.files.whole_file import write_whole

PAGE = "ladder.html"
WIDTH, HEIGHT, POINTS = 460, 110, 400
MOVED_DEG = 0.5
"""Joints that turned by less are not drawn [degrees]."""


def write_page(folder: Path, climbed: Climbed, driver: str, simulated: bool, speed: str) -> Path:
    """Write the page into the folder and return its path. Raises StorageError."""
    tried = {result.of.name: result for result in climbed.results}
    template = page_template(Path(__file__).with_name(PAGE))
    text = template.render(
        rows=[(step, tried.get(step.name)) for step in STEPS],
        curves={name: drawn for name, result in tried.items() if (drawn := curve_chart(result.curve)) is not None},
        passed=sum(result.passed for result in climbed.results),
        climbed=climbed, driver=driver, simulated=simulated, speed=speed,
    )  # fmt: skip
    write_whole(folder / PAGE, text)
    return folder / PAGE


def curve_chart(curve: Curve | None) -> Markup | None:
    """Draw the turn of each joint that moved, from its first position. Returns None if none did."""
    if curve is None:
        return None
    step = max(1, len(curve.t) // POINTS)
    t, turned = curve.t[::step] - curve.t[0], np.rad2deg(curve.q - curve.q[0])[::step]
    moved = np.flatnonzero(np.abs(turned).max(axis=0) > MOVED_DEG)
    if not len(moved):
        return None
    most = float(np.abs(turned).max())
    x, y = WIDTH * t / max(t[-1], 1e-9), 0.5 * HEIGHT * (1.0 - turned / (1.05 * most))
    lines = [" ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y[:, k], strict=True)) for k in moved]
    paths = [f'<polyline points="{line}"/>' for line in lines]
    about = f"turn of {len(moved)} joints, up to {most:.1f} degrees, in {t[-1]:.1f} s"
    box = f'viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{about}"'
    return Markup(f"<svg {box}>{''.join(paths)}</svg><p class='soft'>{about}</p>")  # only figures
