"""What a run was asked for, kept in its folder, so that it can be gone on with and decided again.

`cell.yaml` holds the exact settings, `request.json` the rest; a garment given as a file is copied beside them.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from cell.config import load_settings
from cell.garments import garment_path, list_garments
from cell.requests import FoldRequest
from cell.whole_file import write_whole
from robots.errors import ConfigurationError, StorageError

__all__ = ["SETTINGS", "keep_request", "load_request"]

SETTINGS, REQUEST, GARMENT = "cell.yaml", "request.json", "garment"
SCHEMA = 1
KEPT = ("garment", "seed", "driver", "world", "approve", "page", "realtime", "record", "witness")


def keep_request(folder: Path, request: FoldRequest) -> None:
    """Write the request into a run's folder. Raises StorageError."""
    write_whole(folder / SETTINGS, request.settings.as_yaml())
    kept: dict[str, Any] = {"schema": SCHEMA} | {name: getattr(request, name) for name in KEPT}
    if request.garment != "auto" and request.garment not in list_garments():
        source = garment_path(request.garment)
        kept["garment"] = f"{GARMENT}/{source.name}"  # its stem is the garment's name
        try:
            (folder / GARMENT).mkdir()
            write_whole(folder / GARMENT / source.name, source.read_bytes())
        except OSError as e:
            raise StorageError(f"{source} cannot be kept with the run: {e.strerror}", "check path and disk") from e
    write_whole(folder / REQUEST, json.dumps(kept, indent=1) + "\n")


def load_request(folder: Path, logs: Path, settings: Path | None = None, **changes: Any) -> FoldRequest:
    """The request of the run in `folder`, with `changes`. settings: a file to be read in place of the kept one.
    Raises ConfigurationError where there is no request, or the settings cannot be read any more."""
    path = folder / REQUEST
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept.pop("schema") != SCHEMA or set(kept) != set(KEPT):
            raise ValueError("it was written by another version of foldcell")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as e:
        why = e.strerror if isinstance(e, OSError) else e
        raise ConfigurationError(
            f"the run {folder.name} does not say what it was asked for ({path}: {why})",
            "older runs did not keep it: start a new one",
        ) from None
    if kept["garment"].startswith(f"{GARMENT}/"):
        kept["garment"] = str(folder / kept["garment"])
    settings = settings or folder / SETTINGS
    request = FoldRequest(settings=load_settings(settings), settings_path=settings, logs=logs, **kept)
    return replace(request, **changes)
