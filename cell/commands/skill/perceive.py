"""`foldcell perceive IMAGE`: recognises the garment in a picture."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from foldcell.cell.commands.shared import answer, cell_option
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.photograph import in_unit, perceive_photograph, read_photograph
from foldcell.cell.support.files.encoded_picture import write_png
from foldcell.cell.support.files.whole_file import PNG_MARK, refuse_foreign
from foldcell.robots.errors import ConfigurationError, Failure
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.perception.drawing import draw_on_camera, draw_overlay, draw_sought
from foldcell.skills.perception.perceive import Perception, Sought
from foldcell.skills.vocabulary import Outcome

SURE = 0.7
"""From this confidence on, 60 of 63 accepted answers to fresh photographs were right; below it, 10 of 17
(docs/results/photographs.md)."""


@dataclass(frozen=True, eq=False)
class Look:
    """A picture and the result of the recognition in it. sought: what was taken for the garment; None if the
    picture was refused before the search for a garment."""

    outcome: Outcome[Perception]
    frame: CameraFrame
    sought: Sought | None

    @property
    def shows(self) -> str:
        """What the picture of a refusal shows, in words."""
        if self.sought is None:
            return "the picture as given"
        if self.sought.missing is None:
            return "what was taken for the garment"
        return f"what was taken for the garment, and where {self.sought.missing} was expected"

    def missing(self, unit: str) -> dict[str, Any] | None:
        """The key point that a refused garment lacks, and the place where it was expected; None if none was."""
        if self.sought is None or self.sought.missing is None:
            return None
        place = self.sought.places[self.sought.missing]
        return {
            "keypoint": self.sought.missing,
            "expected": place if unit == "m" else self.sought.view.to_image(place),
        }


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("image", type=Path, metavar="IMAGE", help="colour picture from the cell's camera")
    depth_options(parser)
    parser.add_argument("--garment", default="auto", metavar="G", help="the expected garment, or auto (auto)")
    parser.add_argument("--output", type=Path, metavar="PNG", help="the overlay (IMAGE-perceived.png)")
    parser.add_argument(
        "--unit", choices=["m", "px"], default="m", help="px: photographed from above by an unknown camera (m)"
    )
    cell_option(parser)


def depth_options(parser: argparse.ArgumentParser) -> None:
    """Add what may be given beside the image: its depth, and the empty table."""
    parser.add_argument(
        "--depth", type=Path, help="depth of the image: 16-bit PNG in millimetres, or .npy in metres"
    )
    parser.add_argument("--reference", type=Path, metavar="EMPTY", help="picture of the empty table")
    parser.add_argument("--reference-depth", type=Path, metavar="D", help="depth of the empty table")


def run(options: argparse.Namespace) -> int:
    """Recognise the garment and write the overlay, even if no garment is recognised. Returns 0 if a garment was
    recognised, 2 if none was. Raises ConfigurationError, StorageError."""
    if not options.image.name:  # ".", "/", or empty
        raise ConfigurationError(f"{options.image} is a folder", "name the file of a picture")
    output = options.output or options.image.with_name(f"{options.image.stem}-perceived.png")
    refuse_foreign(output, PNG_MARK)
    look = look_at(options, options.garment)
    notes = look.outcome.notes
    if (failure := look.outcome.failure) is not None:
        write_refused(output, look)
        figures = {**_refused(options, output, look, failure), "notes": notes}
        lines = [f"not recognised: {failure}", f"overlay  {output}   ({look.shows})"]
        return answer(options, figures, lines, 2)
    perception = look.outcome.unwrap()
    write_png(output, draw_on_camera(perception, look.frame.rgb))
    figures = {**_figures(options.image, perception, output, options.unit), "notes": notes}
    return answer(options, figures, _lines(perception, output, options.unit))


def look_at(options: argparse.Namespace, garment: str) -> Look:
    """Recognise the garment in the picture `options.image`. garment: the expected garment, or auto. Raises
    ConfigurationError for a file that cannot be used."""
    _check_reference(options)
    settings = load_settings(options.cell)
    picture, empty = read_photograph(options.image, options.depth), None
    if options.reference is not None:
        empty = read_photograph(options.reference, options.reference_depth)
    sought: list[Sought] = []
    outcome, frame = perceive_photograph(picture, empty, garment, options.unit, settings, sought.append)
    return Look(outcome, frame, sought[-1] if sought else None)


def _check_reference(options: argparse.Namespace) -> None:
    """Check that --reference and --reference-depth fit each other. Raises ConfigurationError for --reference-depth
    without --reference, and for --reference with --depth but without --reference-depth."""
    if options.reference is None and options.reference_depth is not None:
        raise ConfigurationError(
            "--reference-depth without --reference", "give the picture of the empty table too"
        )
    if None not in (options.reference, options.depth) and options.reference_depth is None:
        raise ConfigurationError(
            "--reference with --depth, but without --reference-depth",
            "give the depth of the empty table too, or leave out --reference or --depth",
        )


def write_refused(path: Path, look: Look) -> None:
    """Write the refused picture. What was taken for the garment, the expected key points and the kind of the
    refusal are drawn over it. Raises StorageError."""
    assert look.outcome.failure is not None
    title = f"refused: {str(look.outcome.failure.kind).replace('_', ' ')}"
    if look.sought is None:
        write_png(path, draw_overlay(look.frame.rgb, title=title))
    else:
        write_png(path, draw_sought(look.sought, look.frame.rgb, title))


def _refused(options: argparse.Namespace, overlay: Path, look: Look, failure: Failure) -> dict[str, Any]:
    return {
        "image": str(options.image), "recognised": False, "accepted": False, "reason": str(failure.kind),
        "category": None, "confidence": 0.0, "keypoints": {}, "contour": [], "unit": options.unit,
        "failure": failure, "missing": look.missing(options.unit), "overlay": str(overlay),
    }  # fmt: skip


def _figures(image: Path, perception: Perception, overlay: Path, unit: str) -> dict[str, Any]:
    state = perception.state
    metres = {"keypoints_m": state.keypoints} if unit == "m" else {}
    return {
        "image": str(image),
        "recognised": True,
        "accepted": True,
        "reason": None,
        "garment": perception.garment,
        "category": state.category,
        "confidence": state.confidence,
        "ambiguous": state.ambiguous,
        "second_best": perception.second and asdict(perception.second),
        "unit": unit,
        "keypoints": _keypoints(perception, unit),
        "contour": in_unit(perception, state.contour, unit),
        **metres,
        "overlay": str(overlay),
    }


def _keypoints(perception: Perception, unit: str) -> dict[str, Array]:
    return {name: in_unit(perception, p, unit) for name, p in perception.state.keypoints.items()}


def _lines(perception: Perception, overlay: Path, unit: str) -> Iterator[str]:
    state = perception.state
    yield f"{state.category} ({perception.garment}), confidence {state.confidence:.2f}"
    if (second := perception.second) is not None:
        yield f"second best {second.category} ({second.garment}), {second.behind:.2f} less alike"
    where = "in the table frame [m]" if unit == "m" else "in the picture [px, column and row]"
    yield f"key points {where}:"
    for name, (x, y) in _keypoints(perception, unit).items():
        yield f"  {name:<20} {x:+.3f} {y:+.3f}" if unit == "m" else f"  {name:<20} {x:8.1f} {y:8.1f}"
    yield f"overlay  {overlay}"
    yield from (f"doubt    {doubt}" for doubt in doubts(perception))


def doubts(perception: Perception) -> tuple[str, ...]:
    """Return what a person should look at, one text each; none if the key points are probably right."""
    confidence = perception.state.confidence
    if confidence >= SURE:
        return ()
    return (
        f"a key point may be off (confidence {confidence:.2f}; from {SURE:.2f} on they are seldom off): "
        "look at the overlay; 'foldcell garment new --edit' corrects it",
    )
