"""`foldcell garment show`: shows one garment in detail."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator

from foldcell.cell.commands.garment.garment_drawing import draw_option, drawn, figures, size
from foldcell.cell.commands.shared import Commands, add_command, answer, cell_option
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.garments.garment import Garment


def add_options(actions: Commands) -> None:
    action = add_command(actions, "show", "show one garment in detail", _run)
    action.add_argument("garments", nargs=1, metavar="GARMENT", help="name or file")
    draw_option(action)
    cell_option(action)


def _run(options: argparse.Namespace) -> int:
    garment = load_garment(options.garments[0], load_settings(options.cell).surface)
    drawing = drawn(garment, options.draw)
    lines = [*_lines(garment), *([f"drawing  {drawing}"] if drawing else ())]
    return answer(options, {**figures(garment), "drawing": drawing}, lines)


def _lines(garment: Garment) -> Iterator[str]:
    m = garment.material
    layers = "1 layer" if garment.layers == 1 else f"{garment.layers} layers"
    yield f"{garment.name}: {garment.title} ({garment.category}), {size(garment)} m, {layers}"
    yield "key points (as it is laid, centre at 0) [m]:"
    for name, (x, y) in zip(garment.keypoints, garment.template, strict=True):
        yield f"  {name:<20} {x:+.3f} {y:+.3f}"
    yield f"material on {garment.surface} (assumed: {', '.join(m.assumed) or 'nothing'}):"
    yield (
        f"  {1e3 * m.areal_mass:.0f} g/m2, {1e3 * m.thickness:.1f} mm thick,"
        f" bending length {1e3 * m.bending_length:.0f} mm"
    )
    yield (
        f"  stretch {100 * m.stretch_fraction:.1f} % (strip of 0.6 m), friction {m.friction_static:.2f} static, "
        f"{m.friction_dynamic:.2f} dynamic, {m.friction_layers:.2f} between layers,"
        f" {100 * m.crease_set:.0f} % of a pressed crease set"
    )
    yield "folds:"
    for step in garment.plan:
        variants = "; ".join(f"{v.name} ({len(v.grasps)} grasps)" for v in step.variants)
        yield f"  {step.name}: {variants}"
    low, high = (math.degrees(a) for a in garment.poses.angle)
    yield (
        f"lies at x {garment.poses.x[0]:g} to {garment.poses.x[1]:g} m, y {garment.poses.y[0]:g} to "
        f"{garment.poses.y[1]:g} m, turned {low:.0f} to {high:.0f} degrees"
    )
