"""Pictures of a recording in the viewer.

This runs Rerun's viewer without a window. It needs a graphics driver; a software driver is enough (Debian:
mesa-vulkan-drivers).
"""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
from rerun.experimental import ViewerClient

from foldcell.cell.view.entries.entry import TIMELINE
from foldcell.cell.view.viewer import find_viewer, free_port
from foldcell.robots.errors import CellError

__all__ = ["screenshot"]

MENU_BAR = 36
"""Height of the viewer's menu, which is cut off [px]."""
SETTLE_S = 2.0
"""Time to wait before a picture is taken [s]. Without it, meshes that are still being uploaded would be
missing."""


def screenshot(recording: Path, picture: Path, t: float | None = None, view: str | None = None) -> None:
    """Draw `recording` at cell time t [s] (None: its end) into the PNG `picture`.

    view: name of one view of the layout; None: the whole window. Raises CellError if the viewer, a graphics driver
    or the view is missing.
    """
    executable = find_viewer()
    if executable is None:
        raise CellError("the Rerun viewer is not installed", "pip install rerun-sdk")
    try:
        with ViewerClient.spawn(headless=True, port=free_port(), executable_path=str(executable)) as viewer:
            viewer.open(str(recording))
            time.sleep(SETTLE_S)
            viewer.set_time(TIMELINE, duration=_end(viewer) if t is None else t, play_state="paused")
            time.sleep(SETTLE_S)
            data = viewer.take_screenshot(_view_id(viewer, view) if view else None)
    except (RuntimeError, ConnectionError) as error:  # the viewer may end without an answer
        raise CellError(
            f"the viewer could not draw {recording}: {error}",
            "a graphics driver is needed: apt-get install mesa-vulkan-drivers",
        ) from error
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if pixels is None or not cv2.imwrite(str(picture), pixels[0 if view else MENU_BAR :]):
        raise CellError(f"the picture {picture} cannot be written", "choose a writable .png")


def _end(viewer: ViewerClient) -> float:
    """Return the last cell time of the open recording [s]."""
    timelines = viewer.get_state().recordings[0].timelines
    return max(float(line.end or 0) / 1e9 for line in timelines if line.name == TIMELINE)


def _view_id(viewer: ViewerClient, name: str) -> str:
    views = {v.name: v.view_id for v in viewer.get_state().views}
    if name not in views:
        raise CellError(f"the recording has no view {name!r}", f"views: {', '.join(views)}")
    return str(views[name])
