"""Make the file of a new garment from a picture in which the garment was recognised."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foldcell.arguments import number, own_numeric_state, path, plain, text
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.hardware.placement import write_own_garment
from foldcell.perceiving import PerceivedGarment
from foldcell.robots.errors import ConfigurationError
from foldcell.settings import Settings, cell_settings
from foldcell.skills.garments.picture_measure import as_laid


@own_numeric_state
def new_garment(
    seen: PerceivedGarment,
    file: str | Path,
    *,
    like: str | Path,
    length: float | None = None,
    between: tuple[str, str] | None = None,
    title: str | None = None,
    settings: Settings = None,
) -> Path:
    """Write the file of a new garment, which `fold`, `optimise` and `perceive` take as their garment. Its poses
    are such that the cell of the settings can fold it. Returns the file's path.

    seen: the garment as `perceive(..., garment=like)` found it. like: name or file of a garment with the same
    folds. length [m]: measured on the garment between the two key points `between`; None for a picture by the
    cell's camera (unit 'm'), which measures sizes itself. title: None for the file's name in words.

    Raises ConfigurationError if nothing was recognised, for a wrong argument, for a file that exists, and if the
    folds cannot be planned on this outline; StorageError if the file cannot be written.
    """
    if not isinstance(seen, PerceivedGarment):
        raise ConfigurationError(f"seen: is a {type(seen).__name__}", "give what foldcell.perceive returned")
    cell, file, like = cell_settings(settings), path(file, "file"), str(path(like, "like"))
    title = None if title is None else text(title, "title")
    length = None if length is None else number(length, "length")
    pair = plain(between)
    known = load_garment(like, cell.surface)
    if seen.failure is not None:
        raise ConfigurationError(f"seen: no garment was recognised ({seen.failure.what})", seen.failure.hint)
    if set(seen.keypoints) != set(known.keypoints):
        raise ConfigurationError(
            f"seen: has not the key points of {known.name}", f"call perceive with garment={like!r}"
        )
    if file.suffix not in (".yaml", ".yml"):
        raise ConfigurationError(f"file: {file}", "a garment file ends in .yaml")
    if file.exists():
        raise ConfigurationError(f"file: {file} exists", "give another name, or remove it first")
    measured = None
    if seen.unit == "px":
        if length is None or pair is None or not 0.05 <= length <= 3.0:
            raise ConfigurationError(
                f"length: {length}, between: {between}",
                "a photograph shows no sizes: measure 0.05 to 3 m between two key points of the garment",
            )
        known_pair = isinstance(pair, list) and len(pair) == 2 and all(name in known.keypoints for name in pair)
        if not known_pair or pair[0] == pair[1]:
            raise ConfigurationError(f"between: {between}", f"give two of {', '.join(known.keypoints)}")
        measured = known.keypoints.index(pair[0]), known.keypoints.index(pair[1])
    elif length is not None or pair is not None:
        raise ConfigurationError(
            "length: the cell's camera knows the garment's size", "leave length and between out"
        )
    points = np.array([seen.keypoints[name] for name in known.keypoints])
    named = title or file.stem.replace("_", " ").capitalize()
    write_own_garment(
        file, like, named, as_laid(points) if seen.unit == "px" else points, measured, length,
        "Outline from a picture, made by foldcell.new_garment", cell,
    )  # fmt: skip
    return file
