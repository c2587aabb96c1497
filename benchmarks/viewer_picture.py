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

MENU_BAR = 36
"""Height of the viewer's menu, which is cut off [px]."""
SETTLE_S = 2.0
"""Time to wait before a picture is taken [s]. Without it, meshes that are still being uploaded would be
missing."""


def screenshot(recording: Path, picture: Path, t: float) -> None:
    """Draw `recording` at cell time t [s] into the PNG `picture`. Raises CellError if the viewer or a
    graphics driver is missing."""
    executable = find_viewer()
    if executable is None:
        raise CellError("the Rerun viewer is not installed", "pip install rerun-sdk")
    try:
        with ViewerClient.spawn(headless=True, port=free_port(), executable_path=str(executable)) as viewer:
            viewer.open(str(recording))
            time.sleep(SETTLE_S)
            viewer.set_time(TIMELINE, duration=t, play_state="paused")
            time.sleep(SETTLE_S)
            data = viewer.take_screenshot()
    except (RuntimeError, ConnectionError) as error:  # the viewer may end without an answer
        raise CellError(
            f"the viewer could not draw {recording}: {error}",
            "a graphics driver is needed: apt-get install mesa-vulkan-drivers",
        ) from error
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if pixels is None or not cv2.imwrite(str(picture), pixels[MENU_BAR:]):
        raise CellError(f"the picture {picture} cannot be written", "choose a writable .png")
