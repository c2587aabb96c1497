"""Encoded entries of a recording. The recorder writes each entry to the file and to live viewers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from foldcell.robots.ports import Array

TIMELINE = "cell_time"


@dataclass(frozen=True, eq=False)
class Log:
    """Archetypes of Rerun at one entity path and cell time t [s]. If t is None, they are valid at all times."""

    path: str
    t: float | None
    parts: tuple[Any, ...]
    essential: bool = False

    def write(self, stream: rr.RecordingStream) -> None:
        if self.t is None:
            stream.log(self.path, *self.parts, static=True)
        else:
            stream.set_time(TIMELINE, duration=self.t)
            stream.log(self.path, *self.parts)


@dataclass(frozen=True, eq=False)
class Columns:
    """A batch of rows for one entity: t (n,) [s] and component columns of n rows."""

    path: str
    t: Array
    columns: tuple[Any, ...]
    essential: bool = False

    def write(self, stream: rr.RecordingStream) -> None:
        times = rr.TimeColumn(TIMELINE, duration=np.asarray(self.t, dtype=np.float64))
        stream.send_columns(self.path, indexes=[times], columns=list(self.columns))


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot's meshes and fixed frames, from a `rerun.urdf.UrdfTree`."""

    tree: Any
    essential: bool = True

    def write(self, stream: rr.RecordingStream) -> None:
        self.tree.log_urdf_to_recording(stream)


Entry = Log | Columns | Robot
"""One entry. essential: a viewer without this entry cannot show later entries correctly."""
