"""Short films: pictures with captions and durations, as an animated WebP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["FilmFrame", "captioned", "encode_film"]

Picture = NDArray[np.uint8]

CAPTION = 26
"""Height of the strip for the caption below a picture [px]."""
QUALITY = 60
_FONT = cv2.FONT_HERSHEY_SIMPLEX


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
