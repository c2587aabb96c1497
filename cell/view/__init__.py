"""The Rerun view of a run (see recorder.py)."""

from cell.view.recorder import Recorder, RecorderReport

__all__ = ["Recorder", "RecorderReport"]
