"""Write the file of a user's garment so that this cell can fold it."""

from __future__ import annotations

from pathlib import Path

from cell.config.cell_settings import CellSettings
from cell.config.garments.garment_file import load_garment
from cell.config.garments.new_garment import new_garment_text
from cell.hardware.placement import fitting_poses
from cell.hardware.robot_model import load_robot
from cell.support.files.whole_file import write_whole
from robots.ports import Array
from skills.garments.picture_measure import fitted_template

__all__ = ["write_own_garment"]


def write_own_garment(
    path: Path,
    like: str,
    title: str,
    points: Array,
    measured: tuple[int, int] | None,
    length: float | None,
    origin: str,
    settings: CellSettings,
) -> Array:
    """Write the file of a garment with the folds and the fabric of the garment `like`, and with poses at which
    this cell can fold it. Returns its template (k, 2) [m].

    points: (k, 2) observed key points in the laid pose, in the order of `like`, in any unit. measured: indices of
    the two key points that lie `length` [m] apart; None if the points are in metres. origin: of the outline.
    Raises ConfigurationError if the folds cannot be planned on this outline, StorageError if the file cannot be
    written.
    """
    model = load_robot(settings)
    template = fitted_template(points, load_garment(like, settings.surface).template, measured, length)
    text = new_garment_text(
        like, path.stem, title, template, origin, settings.surface,
        lambda garment: fitting_poses(garment, settings, model),
    )  # fmt: skip
    write_whole(path, text)
    return template
