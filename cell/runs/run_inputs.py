"""Copy the inputs of a run that may change later into the run's folder: user library, calibrations, and the
initial checkpoint of a run that resumes another one.

Inputs that come with the program (shipped library, garments, models) are not copied. Deciding a run again
therefore shows whether another version of them leads to the same decisions.
"""

from __future__ import annotations

from pathlib import Path

import yaml

from foldcell.cell.config.trajectory_library.ideal_heights_file import user_heights_path
from foldcell.cell.config.trajectory_library.library_file import user_library_path
from foldcell.cell.config.yaml_file import read_yaml
from foldcell.cell.journal.frame_store import FRAMES, FrameStore
from foldcell.cell.journal.run_checkpoint import read_checkpoint, write_checkpoint
from foldcell.cell.runs.request_file import SETTINGS, load_request
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.errors import StorageError

__all__ = ["BEGAN_WITH", "CALIBRATIONS", "initial_checkpoint", "keep_run_inputs", "restored_request"]

CALIBRATIONS, BEGAN_WITH = "calibrations", "began_with"
GROUPS = ("table", "camera", "grasp")
"""Settings groups that may name a calibration file."""


def keep_run_inputs(folder: Path, request: FoldRequest, checkpoint: RunContext | None = None) -> None:
    """Copy the inputs into the run's folder when the run begins. checkpoint: context from which this run resumes
    another one, else None. Raises StorageError."""
    if checkpoint is not None:
        write_checkpoint(folder / BEGAN_WITH, checkpoint, FrameStore(folder / FRAMES))
    _copy_library(request.logs, folder)
    for group, source in request.settings.calibrations.items():
        try:
            (folder / CALIBRATIONS).mkdir(exist_ok=True)
            write_whole(folder / CALIBRATIONS / f"{group}.yaml", source.read_bytes())
        except OSError as e:
            raise StorageError(f"{source} cannot be copied to the run: {e.strerror}", "check path and disk") from e


def restored_request(folder: Path, logs: Path) -> FoldRequest:
    """Prepare a run with the inputs that the run in `folder` had. Its logs go to the empty folder `logs`. Returns
    its request.

    Raises ConfigurationError if the request cannot be read, or if its settings, garment or calibration are no
    longer valid, and StorageError if a file cannot be written.
    """
    _copy_library(folder, logs)
    settings = folder / SETTINGS
    kept = {group: folder / CALIBRATIONS / f"{group}.yaml" for group in GROUPS}
    kept = {group: path for group, path in kept.items() if path.is_file()}
    if kept:
        data = dict(read_yaml(settings, "cell settings file").data)
        for group, path in kept.items():
            data[group] = {**data.get(group, {}), "calibration": str(path.resolve())}
        settings = logs / SETTINGS
        write_whole(settings, yaml.safe_dump(data, sort_keys=False, allow_unicode=True))
    return load_request(folder, logs, settings, quiet=True, record=False, record_truth=False, terminal=False)


def initial_checkpoint(folder: Path) -> RunContext | None:
    """Return the initial context of the run in `folder`; None if the run did not resume another one.

    Raises StorageError if the checkpoint is damaged, ConfigurationError if another version of the program wrote
    it.
    """
    if not (folder / BEGAN_WITH).is_dir():
        return None
    return read_checkpoint(folder / BEGAN_WITH, FrameStore(folder / FRAMES))


def _copy_library(source: Path, target: Path) -> None:
    """Copy the user's library and its heights of ideal folds from one folder to another. An unreadable file is
    skipped, as in the run itself."""
    for path in (user_library_path, lambda logs: user_heights_path(user_library_path(logs))):
        try:
            content = path(source).read_bytes()
        except OSError:
            continue
        write_whole(path(target), content)
