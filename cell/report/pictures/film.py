"""Films: pictures with captions and durations as an animated WebP, and the film of a run: the garment before, the
folds as drawn or as seen by the camera, and the last picture.

The recorded frames of a simulated garment are divided into holds: the times during which a hand held the garment.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.report.camera_pictures.projected_drawing import Picture
from foldcell.cell.report.pictures.fold_pictures import KeyFrame, Scenery, View, fold_strip
from foldcell.cell.states.stages import FoldNote
from foldcell.robots.ports import Array, Side

CAPTION = 26
"""Height of the strip for the caption below a picture [px]."""
QUALITY = 60
_FONT = cv2.FONT_HERSHEY_SIMPLEX
SIZE = 480, 360
"""Width and height of drawn pictures [px]."""
FRAMES = 60
"""Largest number of drawn pictures in a film."""
SPEED = 2.0
"""The film is faster than the cell by this factor."""
SHORTEST_MS, LONGEST_MS = 40, 250
FIRST_MS, LAST_MS, STILL_MS, END_OF_HOLD_MS = 1200, 2500, 600, 700
TrueFrame = tuple[float, Array, Mapping[Side, Array]]
"""(cell time [s], vertices (n, 3), tool positions (3,)) of a simulated garment, for pictures only."""

BREAK_S = 3.0
"""If the time between two frames of the held garment is longer than this [s], the frames belong to different
attempts."""


def holds(frames: Sequence[TrueFrame]) -> list[list[TrueFrame]]:
    """Divide the frames at the breaks. Every part is one attempt at a fold."""
    parts: list[list[TrueFrame]] = []
    last = -np.inf
    for frame in frames:
        if frame[0] - last > BREAK_S:
            parts.append([])
        parts[-1].append(frame)
        last = frame[0]
    return parts


def held_during(note: FoldNote, frames: Sequence[TrueFrame]) -> list[TrueFrame]:
    """Return the recorded frames of the attempt during which the fold's pictures were taken. The frames of other
    attempts are left out, because those attempts failed."""
    taken = [p.stamp for p in note.attempt.pictures]
    parts = holds(frames)
    return next((h for h in parts if taken and h[0][0] <= max(taken) and min(taken) <= h[-1][0]), [])


def spread(count: int, most: int) -> list[int]:
    """Return up to `most` indices below `count`, evenly spaced, with the first and the last."""
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(count, most)).round())] if count else []


@dataclass(frozen=True, eq=False)
class FilmFrame:
    """rgb: (H, W, 3); shown for duration_ms."""

    rgb: Picture
    duration_ms: int


def captioned(picture: Picture, text: str, size: tuple[int, int]) -> Picture:
    """Return the picture in the given size (width, height) [px], with a caption in a strip below."""
    if picture.shape[1::-1] != size:
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    strip = np.full((CAPTION, size[0], 3), 255, dtype=np.uint8)
    cv2.putText(strip, text, (6, CAPTION - 8), _FONT, 0.45, (40, 42, 48), 1, cv2.LINE_AA)
    return np.concatenate([picture, strip])


def encode_film(frames: Sequence[FilmFrame], quality: int = QUALITY) -> bytes:
    """Return the file of an animated WebP that repeats without end. All frames have the same size."""
    film = cv2.Animation()
    film.frames = [cv2.cvtColor(np.ascontiguousarray(f.rgb), cv2.COLOR_RGB2BGR) for f in frames]
    film.durations = [f.duration_ms for f in frames]
    ok, data = cv2.imencodeanimation(".webp", film, [cv2.IMWRITE_WEBP_QUALITY, quality])
    if not ok:
        raise ValueError(f"a film of {len(frames)} frames cannot be encoded")
    return bytes(data.tobytes())


@dataclass(frozen=True, eq=False)
class CaptionedPicture:
    """A picture (H, W, 3) and its caption."""

    rgb: Picture
    caption: str = ""


@dataclass(frozen=True, eq=False)
class DrawnHold:
    """One attempt at a fold, drawn from the recorded garment: cell times [s] and pictures (H, W, 3)."""

    name: str
    times: tuple[float, ...]
    pictures: tuple[Picture, ...]


def draw_hold(
    name: str,
    hold: Sequence[TrueFrame],
    share: float,
    triangles: NDArray[np.integer],
    view: View,
    scenery: Scenery,
) -> DrawnHold:
    """Draw a hold. share: the hold's part of all recorded frames, and so of the film (0..1)."""
    chosen = [hold[i] for i in spread(len(hold), max(6, round(FRAMES * share)))]
    frames = [KeyFrame(vertices, tools) for _, vertices, tools in chosen]
    pictures = fold_strip(frames, triangles, view, scenery)
    return DrawnHold(name, tuple(t for t, *_ in chosen), tuple(pictures))


def film_file(
    before: CaptionedPicture | None,
    holds: Sequence[DrawnHold],
    stills: Sequence[CaptionedPicture],
    after: CaptionedPicture | None,
) -> bytes:
    """Return the film as the file of an animated WebP; empty if nothing moved. stills: the camera's pictures of
    the folds, which are shown if no hold was recorded."""
    if not holds and not stills:
        return b""
    frames = [FilmFrame(captioned(before.rgb, before.caption, SIZE), FIRST_MS)] if before else []
    if holds:
        frames += [frame for hold in holds for frame in _moving(hold)]
    else:
        frames += [FilmFrame(captioned(s.rgb, s.caption, SIZE), STILL_MS) for s in stills]
    if after:
        frames.append(FilmFrame(captioned(after.rgb, after.caption, SIZE), LAST_MS))
    return encode_film(frames)


def _moving(hold: DrawnHold) -> Iterator[FilmFrame]:
    waits = np.clip(1e3 * np.diff(hold.times) / SPEED, SHORTEST_MS, LONGEST_MS)
    for t, picture, wait in zip(hold.times, hold.pictures, [*waits, END_OF_HOLD_MS], strict=True):
        yield FilmFrame(captioned(picture, f"{t:.1f} s   {hold.name} (drawn)", SIZE), round(wait))
