"""Recognises a picture that the camera has delivered before, whatever its stamp says.

Noise makes any two pictures of one scene differ, so equal pixels mean an old picture: a frozen sensor, or a driver
that sends its buffer again with a fresh stamp.
"""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from skills.vocabulary import CameraFrame, Failure, FailureKind

__all__ = ["picture_digests", "repeated"]


def picture_digests(frame: CameraFrame) -> tuple[str, ...]:
    """Return a digest of the colours and one of the depth. A picture of one colour, or without depth, has none:
    such pictures are alike, and other checks refuse them."""
    digests = []
    if frame.rgb.min() != frame.rgb.max():
        digests.append(_digest(frame.rgb))
    if np.isfinite(frame.depth).any():
        digests.append(_digest(frame.depth))
    return tuple(digests)


def repeated(frame: CameraFrame, earlier: Iterable[str]) -> Failure | None:
    """Return CAMERA_FAULT if colours or depth are those of an earlier picture, else None. earlier: the digests of
    all earlier pictures."""
    if not set(picture_digests(frame)) & set(earlier):
        return None
    return Failure(
        FailureKind.CAMERA_FAULT,
        "the camera sends an old picture again, with a new stamp",
        "check the camera's cable and driver, then look again",
        {"sequence": frame.sequence, "stamp_s": frame.stamp},
    )


def _digest(pixels: NDArray) -> str:
    return blake2b(np.ascontiguousarray(pixels).tobytes(), digest_size=12).hexdigest()
