"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from robots.errors import StorageError

__all__ = ["write_whole"]


def write_whole(
    path: Path,
    data: bytes | str,
    hint: str = "free some disk space, make its folder writable, or choose another one",
) -> None:
    """Replace the file in one step: a reader finds the old content or the new one. Raises StorageError."""
    content = data.encode() if isinstance(data, str) else data
    try:
        with tempfile.NamedTemporaryFile(
            dir=path.absolute().parent, prefix=f".{path.name}.", delete=False
        ) as file:
            try:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
                os.chmod(file.name, 0o644)
                os.replace(file.name, path)
                _sync(path.absolute().parent)
            except BaseException:
                with suppress(FileNotFoundError):  # already renamed: the failure came later
                    os.unlink(file.name)
                raise
    except OSError as e:
        raise StorageError(f"{path} cannot be written: {e.strerror}", hint, path=str(path)) from e


def _sync(folder: Path) -> None:
    """Flush the folder: without this, a power failure may leave the old file."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
