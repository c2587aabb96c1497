"""The frame store: the camera frames that a run used. Each frame is a file, named by the hash of its content."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from threading import Lock
from weakref import WeakKeyDictionary

import numpy as np

from foldcell.cell.support.files.packing import packed
from foldcell.cell.support.files.whole_file import make_folder, write_whole
from foldcell.robots.errors import StorageError
from foldcell.robots.ports import CameraFrame, Intrinsics, frozen

FRAMES = "frames"
"""Name of the frame store's folder in a run's folder."""


class FrameStore:
    """A folder of camera frames, stored bit for bit. Several threads may use it: a frame is packed once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: WeakKeyDictionary[CameraFrame, str] = WeakKeyDictionary()  # compared by identity
        self._lock = Lock()

    def put(self, frame: CameraFrame) -> str:
        """Store a frame and return its name. The frame is on disk when the call returns. Raises StorageError."""
        with self._lock:
            if frame in self._known:
                return self._known[frame]
            name = _name(frame)
            path = self._path(name)
            if not path.exists():
                make_folder(self._folder, above=False)  # a run's folder that vanished is not made again
                write_whole(path, packed(plain=np.array(_plain(frame)), rgb=frame.rgb, depth=frame.depth))
            self._known[frame] = name
            return name

    def get(self, name: str) -> CameraFrame:
        """The frame with this name. Raises StorageError if it is missing or damaged."""
        path = self._path(name)
        try:
            with np.load(path, allow_pickle=False) as data:
                plain = json.loads(str(data["plain"]))
                frame = CameraFrame(
                    plain["stamp"],
                    plain["sequence"],
                    frozen(data["rgb"]),
                    frozen(data["depth"]),
                    Intrinsics(**plain["intrinsics"]),
                )
            if _name(frame) != name:
                raise ValueError("its hash does not match")
        except Exception as e:  # a damaged archive can raise anything
            raise StorageError(f"the picture {path} is missing or damaged", str(e), path=str(path)) from e
        self._known[frame] = name
        return frame

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.npz"


def _name(frame: CameraFrame) -> str:
    """Return the frame's name: the SHA-256 of its pixels, depth, stamp, sequence and intrinsics."""
    digest = hashlib.sha256(_plain(frame).encode())
    for pixels in (frame.rgb, frame.depth):
        digest.update(np.ascontiguousarray(pixels).tobytes())
    return digest.hexdigest()


def _plain(frame: CameraFrame) -> str:
    """Return the fields that are not arrays, as JSON."""
    fields = {"stamp": frame.stamp, "sequence": frame.sequence, "intrinsics": asdict(frame.intrinsics)}
    return json.dumps(fields, sort_keys=True)
