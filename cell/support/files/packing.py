"""Compress arrays fast into an .npz file, for data that is written while the arms wait."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray


def packed(**arrays: NDArray[Any]) -> bytes:
    """Return the arrays as an .npz file, like numpy's savez_compressed, but two to three times faster and up to a
    fifth larger."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            np.save(member, array, allow_pickle=False)
            archive.writestr(f"{name}.npy", member.getvalue())
    return stream.getvalue()
