"""The Rerun view of a run (see recorder.py)."""

from cell.recording.rerun.recorder import Recorder, RecorderReport

__all__ = ["Recorder", "RecorderReport"]
