"""Write files whole or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from contextlib import suppress
from pathlib import Path

from foldcell.robots.errors import StorageError

__all__ = ["refuse_unwritable", "write_whole"]

HINT = "free some disk space, make its folder writable, or choose another one"
PROBE_BYTES = 2**16
"""Space that a file needs at least, for `refuse_unwritable`."""


def refuse_unwritable(path: Path) -> None:
    """Raise StorageError if `write_whole` cannot write to `path`. Called before the file's content is computed.
    Nothing is left in the folder."""
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        with tempfile.NamedTemporaryFile(dir=path.absolute().parent, prefix=f".{path.name}.") as file:
            file.write(bytes(PROBE_BYTES))
            file.flush()
    except OSError as e:
        raise _unwritable(path, e, HINT) from e


def write_whole(path: Path, data: bytes | str, hint: str = HINT) -> None:
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
        raise _unwritable(path, e, hint) from e


def _unwritable(path: Path, e: OSError, hint: str) -> StorageError:
    reason = "no such folder" if isinstance(e, FileNotFoundError) else e.strerror
    return StorageError(f"{path} cannot be written: {reason}", hint, path=str(path))


def _sync(folder: Path) -> None:
    """Flush the folder to disk. Without this, the old file may be back after a power failure."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
