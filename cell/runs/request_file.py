"""Save the request of a run in the run's folder, so that the run can be resumed and decided again.

`cell.yaml` holds the exact settings. `request.json` holds the rest, with the hashes of the calibration files that
the settings name. A garment that was given as a file is copied beside them.
"""

from __future__ import annotations

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.config.garments.garment_file import garment_path, list_garments
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.errors import ConfigurationError, StorageError

__all__ = ["SETTINGS", "keep_request", "load_request"]

SETTINGS, REQUEST, GARMENT = "cell.yaml", "request.json", "garment"
SCHEMA = 1
KEPT: dict[str, type] = {
    "garment": str, "seed": int, "driver": str, "world": str, "approve": bool, "page": bool, "page_port": int,
    "page_origin": str, "realtime": bool, "record": bool, "record_truth": bool,
}  # fmt: skip


def keep_request(folder: Path, request: FoldRequest) -> None:
    """Write the request into a run's folder. Raises StorageError."""
    write_whole(folder / SETTINGS, request.settings.as_yaml())
    kept: dict[str, Any] = {"schema": SCHEMA} | {name: getattr(request, name) for name in KEPT}
    kept["calibrations"] = _hashes(request.settings)
    if request.garment != "auto" and request.garment not in list_garments():
        source = garment_path(request.garment)
        kept["garment"] = f"{GARMENT}/{source.name}"  # the file's stem is the garment's name
        try:
            (folder / GARMENT).mkdir()
            write_whole(folder / GARMENT / source.name, source.read_bytes())
        except OSError as e:
            raise StorageError(f"{source} cannot be copied to the run: {e.strerror}", "check path and disk") from e
    write_whole(folder / REQUEST, json.dumps(kept, indent=1) + "\n")


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
    request = FoldRequest(settings=settings, settings_path=path, logs=logs, **kept)
    return replace(request, **changes)


def _hashes(settings: CellSettings) -> dict[str, str]:
    """Return path -> hash for the calibration files that the settings name. Raises StorageError."""
    try:
        return {str(path): sha256(path.read_bytes()).hexdigest() for path in settings.calibrations.values()}
    except OSError as e:
        raise StorageError(f"the calibration {e.filename} cannot be read: {e.strerror}", "check the path") from e
