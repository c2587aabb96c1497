"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from robots.errors import StorageError

__all__ = ["write_whole"]


def write_whole(
    path: Path, data: bytes | str, hint: str = "make room or make its folder writable, or choose another place"
) -> None:
    """Write the whole file or none of it; what stood there before stays until then. Raises StorageError."""
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
                with suppress(FileNotFoundError):  # it has its name, and what failed came after
                    os.unlink(file.name)
                raise
    except OSError as e:
        raise StorageError(f"{path} cannot be written: {e.strerror}", hint, path=str(path)) from e


def _sync(folder: Path) -> None:
    """Put the name on disk too: else power that fails may leave the old file."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
