"""`foldcell garment list|check|show`: the garment files. A new one: new_garment.py."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from cell.commands.options import Commands, add_command, cell_option, json_option
from cell.commands.output import print_json, print_table
from cell.config.cell_settings import load_settings
from cell.config.garments.garment_file import list_garments, load_garment
from cell.config.garments.new_garment import check_plan
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError
from skills.garments.garment import Garment

__all__ = ["add_actions", "run"]


def add_actions(actions: Commands) -> None:
    listed = add_command(actions, "list", "names, sizes and folds", run)
    check = add_command(actions, "check", "say whether garment files are good, and draw them", run)
    check.add_argument("garments", nargs="+", metavar="FILE", help="files or names")
    show = add_command(actions, "show", "all that is known of one garment", run)
    show.add_argument("garments", nargs=1, metavar="GARMENT", help="name or file")
    for action in (check, show):
        action.add_argument(
            "--draw", type=Path, metavar="DIR", help="draw outline and folds as PNG into this folder"
        )
    for action, name in ((listed, "list"), (check, "check"), (show, "show")):
        action.set_defaults(action=name)
        cell_option(action)
        json_option(action)


def run(options: argparse.Namespace) -> int:
    surface = load_settings(options.cell).surface
    if options.action == "list":
        return _list(options.json, [load_garment(name, surface) for name in list_garments()])
    if options.action == "check":
        return _check(options, surface)
    return _show(options, load_garment(options.garments[0], surface))


def _list(as_json: bool, garments: list[Garment]) -> int:
    if as_json:
        print_json({"garments": [_figures(g) for g in garments]})
        return 0
    rows = [(g.name, g.title, g.category, _size(g), g.layers, len(g.plan)) for g in garments]
    print_table(("name", "title", "category", "x by y [m]", "layers", "folds"), rows)
    return 0


def _check(options: argparse.Namespace, surface: str) -> int:
    """Every file is checked and told, then the worst decides. A plan that cannot be made is a fault too."""
    checked, bad = [], 0
    for name in options.garments:
        try:
            garment = load_garment(name, surface)
            check_plan(name, garment)
            drawing = _draw(garment, options.draw)
            checked.append({"file": name, "good": True, "drawing": drawing})
            _say(
                options, f"{name}: good, {len(garment.plan)} folds" + (f", drawn in {drawing}" if drawing else "")
            )
        except ConfigurationError as e:
            bad += 1
            checked.append({"file": name, "good": False, "error": e.what, "hint": e.hint})
            _say(options, str(e) if str(e).startswith(name) else f"{name}: {e}")
    if options.json:
        print_json({"checked": checked})
    return 64 if bad else 0


def _show(options: argparse.Namespace, garment: Garment) -> int:
    drawing = _draw(garment, options.draw)
    if options.json:
        print_json({**_figures(garment), "drawing": drawing})
        return 0
    m = garment.material
    layers = "1 layer" if garment.layers == 1 else f"{garment.layers} layers"
    print(f"{garment.name}: {garment.title} ({garment.category}), {_size(garment)} m, {layers}")
    print("key points (as it is laid, centre at 0) [m]:")
    for name, (x, y) in zip(garment.keypoints, garment.template, strict=True):
        print(f"  {name:<20} {x:+.3f} {y:+.3f}")
    print(f"material on {garment.surface} (assumed: {', '.join(m.assumed) or 'nothing'}):")
    print(
        f"  {1e3 * m.areal_mass:.0f} g/m2, {1e3 * m.thickness:.1f} mm thick,"
        f" bending length {1e3 * m.bending_length:.0f} mm"
    )
    print(f"  stretch {100 * m.stretch_fraction:.1f} % (strip of 0.6 m), friction {m.friction_static:.2f} static, "
          f"{m.friction_dynamic:.2f} dynamic, {m.friction_layers:.2f} between layers")  # fmt: skip
    print("folds:")
    for step in garment.plan:
        ways = "; ".join(f"{v.name} ({len(v.grasps)} grasps)" for v in step.variants)
        print(f"  {step.name}: {ways}")
    low, high = (math.degrees(a) for a in garment.poses.angle)
    print(
        f"lies at x {garment.poses.x[0]:g} to {garment.poses.x[1]:g} m, y {garment.poses.y[0]:g} to "
        f"{garment.poses.y[1]:g} m, turned {low:.0f} to {high:.0f} degrees"
    )
    if drawing:
        print(f"drawing  {drawing}")
    return 0


def _say(options: argparse.Namespace, text: str) -> None:
    if not options.json:
        print(text)


def _size(garment: Garment) -> str:
    return "{:.2f} x {:.2f}".format(*garment.size_m)


def _figures(garment: Garment) -> dict[str, Any]:
    return {
        "name": garment.name,
        "title": garment.title,
        "category": garment.category,
        "layers": garment.layers,
        "size_m": garment.size_m,
        "keypoints_m": dict(zip(garment.keypoints, garment.template.tolist(), strict=True)),
        "material": garment.material,
        "surface": garment.surface,
        "folds": [step.name for step in garment.plan],
        "poses": garment.poses,
    }


def _draw(garment: Garment, folder: Path | None) -> str | None:
    """A PNG of outline, key points, fold lines and grasps; its path."""
    if folder is None:
        return None
    if not folder.is_dir():
        raise ConfigurationError(f"{folder}: there is no such folder", "make it, or give another one with --draw")
    import cv2

    from cell.config.garments.drawing import draw_garment

    done, png = cv2.imencode(".png", draw_garment(garment)[:, :, ::-1])
    if not done:
        raise AssertionError("a drawing could not be encoded")
    path = folder / f"{garment.name}.png"
    write_whole(path, png.tobytes())
    return str(path)
