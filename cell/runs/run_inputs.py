"""What a run decides by and what may change after it, kept in its folder: the user's library, calibrations, and
what a run that goes on with another one believed at its beginning.

What comes with the program (the shipped library, garments, models) is not kept: whether another version of it
would have decided the same is what somebody wants to know who has a run decided again.
"""

from __future__ import annotations

from pathlib import Path

import yaml

from cell.config.library.library_file import user_library_path
from cell.config.yaml_file import read_yaml
from cell.recording.checkpoint.run_checkpoint import read_checkpoint, write_checkpoint
from cell.recording.frame_store import FRAMES, FrameStore
from cell.runs.request_file import SETTINGS, load_request
from cell.states.fold_request import FoldRequest
from cell.states.run_context import RunContext
from cell.support.files.whole_file import write_whole
from robots.errors import StorageError

__all__ = ["BEGAN_WITH", "CALIBRATIONS", "initial_checkpoint", "keep_surroundings", "restored_request"]

CALIBRATIONS, BEGAN_WITH = "calibrations", "began_with"
GROUPS = ("table", "camera", "grasp")
"""Of the settings: each may name a calibration file."""


def keep_surroundings(folder: Path, request: FoldRequest, checkpoint: RunContext | None = None) -> None:
    """Copy them into the run's folder when it begins. checkpoint: of the run that this one resumes. Raises
    StorageError."""
    if checkpoint is not None:
        write_checkpoint(folder / BEGAN_WITH, checkpoint, FrameStore(folder / FRAMES))
    _copy_library(request.logs, folder)
    for group, source in request.settings.calibrations.items():
        try:
            (folder / CALIBRATIONS).mkdir(exist_ok=True)
            write_whole(folder / CALIBRATIONS / f"{group}.yaml", source.read_bytes())
        except OSError as e:
            raise StorageError(f"{source} cannot be kept with the run: {e.strerror}", "check path and disk") from e


def restored_request(folder: Path, logs: Path) -> FoldRequest:
    """The request of the run in `folder`, by the files as they were then, for a run in the empty folder `logs`.

    Raises ConfigurationError where the run does not say what it was asked for, or settings, garment or calibration
    are refused by now, and StorageError.
    """
    _copy_library(folder, logs)
    settings = folder / SETTINGS
    kept = {group: folder / CALIBRATIONS / f"{group}.yaml" for group in GROUPS}
    kept = {group: path for group, path in kept.items() if path.is_file()}
    if kept:
        told = dict(read_yaml(settings, "cell settings file").data)
        for group, path in kept.items():
            told[group] = {**told.get(group, {}), "calibration": str(path.resolve())}
        settings = logs / SETTINGS
        write_whole(settings, yaml.safe_dump(told, sort_keys=False, allow_unicode=True))
    return load_request(folder, logs, settings, quiet=True, record=False, record_truth=False, terminal=False)


def initial_checkpoint(folder: Path) -> RunContext | None:
    """What the run in `folder` believed at its beginning; None: nothing, it began from START.

    Raises StorageError where it is damaged, ConfigurationError where another version wrote it.
    """
    if not (folder / BEGAN_WITH).is_dir():
        return None
    return read_checkpoint(folder / BEGAN_WITH, FrameStore(folder / FRAMES))


def _copy_library(source: Path, target: Path) -> None:
    """The user's library of one folder into another. One that cannot be read is none, for the run as well."""
    try:
        content = user_library_path(source).read_bytes()
    except OSError:
        return
    write_whole(user_library_path(target), content)
