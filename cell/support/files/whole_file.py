"""Write files whole or not at all."""

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
    """Replace the file in one step: at any time, a reader finds either the old content or the new content. Raises
    StorageError."""
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
                with suppress(FileNotFoundError):  # the file was already renamed
                    os.unlink(file.name)
                raise
    except OSError as e:
        raise StorageError(f"{path} cannot be written: {e.strerror}", hint, path=str(path)) from e


def _sync(folder: Path) -> None:
    """Flush the folder to disk. Without this, the old file may be back after a power failure."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
