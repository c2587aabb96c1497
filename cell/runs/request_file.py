"""Save the request of a run in the run's folder, so that the run can be resumed and decided again.

`cell.yaml` holds the exact settings. `request.json` holds the rest, with the hashes of the calibration files that
the settings name. A garment that was given as a file is copied beside them.

Other inputs that may change later are copied, too: user library, calibrations, and the initial checkpoint of a run
that resumes another one. Inputs that come with the program (shipped library, garments, models) are not copied.
Deciding a run again therefore shows whether another version of them leads to the same decisions.
"""

from __future__ import annotations

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import yaml

from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.config.garments.garment_file import garment_path, list_garments
from foldcell.cell.config.trajectory_library.library_file import copy_library
from foldcell.cell.config.yaml_file import read_yaml
from foldcell.cell.journal.frame_store import FRAMES, FrameStore
from foldcell.cell.journal.run_checkpoint import read_checkpoint, write_checkpoint
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.support.files.whole_file import make_folder, write_whole
from foldcell.cell.support.json_values import write_json
from foldcell.robots.errors import ConfigurationError, StorageError

SETTINGS, REQUEST, GARMENT = "cell.yaml", "request.json", "garment"
SCHEMA = 1
KEPT: dict[str, type] = {
    "garment": str, "seed": int, "driver": str, "world": str, "approve": bool, "page": bool, "page_port": int,
    "page_origin": str, "realtime": bool, "record": bool, "record_truth": bool,
}  # fmt: skip
CALIBRATIONS, BEGAN_WITH = "calibrations", "began_with"
GROUPS = ("table", "camera", "grasp")
"""Settings groups that may name a calibration file."""


def keep_request(folder: Path, request: FoldRequest) -> None:
    """Write the request into a run's folder. Raises StorageError."""
    write_whole(folder / SETTINGS, request.settings.as_yaml())
    kept: dict[str, Any] = {"schema": SCHEMA} | {name: getattr(request, name) for name in KEPT}
    kept["calibrations"] = _hashes(request.settings)
    if request.garment != "auto" and request.garment not in list_garments():
        source = garment_path(request.garment)
        kept["garment"] = f"{GARMENT}/{source.name}"  # the file's stem is the garment's name
        _copy(source, folder / GARMENT / source.name)
    write_json(folder / REQUEST, kept)


def load_request(folder: Path, logs: Path, restored: Path | None = None, **changes: Any) -> FoldRequest:
    """Read the request of the run in `folder`, with `changes`. restored: settings file to read instead of the
    saved one; the calibrations that it names are not checked.

    Raises ConfigurationError if the request cannot be read, or if the settings or a calibration have changed.
    """
    path = folder / REQUEST
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        schema, calibrations = kept.pop("schema"), kept.pop("calibrations")
        kept = {"page_origin": "", **kept}  # not in the requests of earlier versions
        if schema != SCHEMA or {name: type(value) for name, value in kept.items()} != KEPT:
            raise ValueError("it was changed, or written by another version of foldcell")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as e:
        reason = e.strerror if isinstance(e, OSError) else e
        raise ConfigurationError(
            f"the request of the run {folder.name} cannot be read ({path}: {reason})",
            "start a new one: foldcell fold",
        ) from None
    if kept["garment"].startswith(f"{GARMENT}/"):
        kept["garment"] = str(folder / kept["garment"])
    path = restored or folder / SETTINGS
    settings = load_settings(path)
    now = {} if restored else _hashes(settings)
    changed = [name for name in now if now[name] != calibrations.get(name)]
    if changed:
        raise ConfigurationError(
            f"the calibration has changed since the run {folder.name}: {', '.join(changed)}",
            "its observations and plans are void: start a new run",
        )
    request = FoldRequest(settings=settings, logs=logs, **kept)
    return replace(request, **changes)


def _hashes(settings: CellSettings) -> dict[str, str]:
    """Return path -> hash for the calibration files that the settings name. Raises StorageError."""
    try:
        return {str(path): sha256(path.read_bytes()).hexdigest() for path in settings.calibrations.values()}
    except OSError as e:
        raise StorageError(f"the calibration {e.filename} cannot be read: {e.strerror}", "check the path") from e


def keep_run_inputs(folder: Path, request: FoldRequest, checkpoint: RunContext | None = None) -> None:
    """Copy the inputs into the run's folder when the run begins. checkpoint: context from which this run resumes
    another one, else None. Raises StorageError."""
    if checkpoint is not None:
        write_checkpoint(folder / BEGAN_WITH, checkpoint, FrameStore(folder / FRAMES))
    copy_library(request.logs, folder, skip_unreadable=True)  # the run tells the operator and goes on
    for group, source in request.settings.calibrations.items():
        _copy(source, folder / CALIBRATIONS / f"{group}.yaml")


def restored_request(folder: Path, logs: Path) -> FoldRequest:
    """Prepare a run with the inputs that the run in `folder` had. Its logs go to the empty folder `logs`. Returns
    its request.

    Raises ConfigurationError if the request cannot be read, or if its settings, garment or calibration are no
    longer valid, and StorageError if a file cannot be written.
    """
    copy_library(folder, logs)
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


def _copy(source: Path, target: Path) -> None:
    """Copy a file of the user into the run's folder. Raises StorageError."""
    try:
        content = source.read_bytes()
    except OSError as e:
        raise StorageError(f"{source} cannot be copied to the run: {e.strerror}", "check the path") from e
    make_folder(target.parent)
    write_whole(target, content)
