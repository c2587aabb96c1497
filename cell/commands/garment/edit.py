"""`foldcell garment new IMAGE --edit`: serves the page on which a person places the key points."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from foldcell.cell.commands.shared import teller
from foldcell.cell.commands.skill.perceive import Look
from foldcell.cell.config.garments.key_points_file import key_points_text, read_key_points
from foldcell.cell.hardware.photograph import Photograph
from foldcell.cell.operator.key_points.editing import KeyPointEdit, template_over
from foldcell.cell.operator.key_points.server import edit_key_points
from foldcell.cell.operator.local_server import open_listener
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.ports import Array
from foldcell.skills.garments.garment import Garment
from foldcell.skills.garments.picture_measure import PictureMeasure


def edited(
    options: argparse.Namespace,
    title: str,
    like: Garment,
    photograph: Photograph,
    measure: PictureMeasure,
    look: Look,
    kept: Path,
    save: Callable[[Mapping[str, Array]], str],
) -> bool:
    """Serve the page until the person has saved the garment or cancelled. Returns whether it was saved.

    look: result of the recognition in the photograph. kept: file for the key points. save: see `edit_key_points`.
    Raises ConfigurationError for a file of key points that cannot be used, StorageError if the page cannot be
    served.
    """
    outline, start, origin = _seen(look, like)
    if options.key_points is not None:
        start, origin = read_key_points(options.key_points, like).data, f"from {options.key_points}"
    about = (
        ("picture", f"{options.image.name}, {measure.columns} x {measure.rows} px"),
        ("folds as", f"{like.title} ({', '.join(step.name.replace('_', ' ') for step in like.plan)})"),
        ("measured", _measured(measure, like)),
        ("start", origin),
    )

    def announce(address: str) -> None:
        port = address.split(":")[2].split("/")[0]
        teller(options.json)(
            f"page     {address}\n"
            f"         from another machine, open it after: ssh -L {port}:127.0.0.1:{port} THIS_MACHINE\n"
            "This command waits until you press Save or Cancel on the page. Ctrl-C ends it without writing."
        )

    def keep(points: Mapping[str, Array]) -> str:
        write_key_points(kept, points, options.image)
        return f"{kept} (--key-points {kept} --edit goes on with it)"

    edit = KeyPointEdit(title, photograph.rgb, like, measure, outline, start, about)
    return edit_key_points(edit, open_listener(options.page_port), announce, keep, save, options.page_origin or "")


def write_key_points(path: Path, points: Mapping[str, Array], image: Path) -> None:
    """Write a file of key points, name -> (2,) [px]. Raises StorageError."""
    write_whole(path, key_points_text(points, f"Key points in {image.name}: [column, row] in pixels"))


def _seen(look: Look, like: Garment) -> tuple[Array | None, Mapping[str, Array], str]:
    """Return the outline (n, 2) [px] of the region taken for the garment, the key points that the page shows
    first, and the origin of these points in words."""
    if look.outcome.ok:
        seen = look.outcome.unwrap()
        points = {name: seen.view.to_image(place) for name, place in seen.state.keypoints.items()}
        outline = seen.view.to_image(seen.view.to_table(seen.segmentation.contour))
        return outline, points, f"as recognised, confidence {seen.state.confidence:.2f}"
    assert look.outcome.failure is not None
    why = f"not recognised: {look.outcome.failure.what}"
    if (sought := look.sought) is None or not sought.segmentation.found:
        return None, {}, f"no points; {why}"
    outline = sought.view.to_image(sought.view.to_table(sought.segmentation.contour))
    if like.keypoints == tuple(name for name in like.keypoints if name in sought.places):
        points = {name: sought.view.to_image(sought.places[name]) for name in like.keypoints}
        return outline, points, f"as a {like.category} of this outline would have them; {why}"
    return outline, template_over(outline, like), f"the shape of {like.title}, laid over what was seen; {why}"


def _measured(measure: PictureMeasure, like: Garment) -> str:
    if measure.measured is None:
        return "by the cell's camera"
    a, b = (like.keypoints[i].replace("_", " ") for i in measure.measured)
    return f"{measure.length:g} m from {a} to {b}"
