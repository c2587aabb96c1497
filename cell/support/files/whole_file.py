"""Write files whole or not at all, and never over files that foldcell did not make."""

from __future__ import annotations

import errno
import os
import struct
import tempfile
import zlib
from contextlib import suppress
from pathlib import Path

from foldcell.robots.errors import ConfigurationError, StorageError

HINT = "free some disk space, make its folder writable, or choose another one"
PROBE_BYTES = 2**16
"""Space that a file needs at least, for `refuse_unwritable`."""
PNG_MARK = b"tEXtSoftware\0foldcell"
_IHDR_END = 33
"""Length of a PNG file's signature and first chunk [bytes]. Further chunks are inserted after them."""


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


def make_folder(folder: Path, hint: str = HINT, above: bool = True) -> Path:
    """Create the folder unless it exists, and return it. above: create those above it too. Raises
    StorageError."""
    try:
        folder.mkdir(parents=above, exist_ok=True)
    except OSError as e:
        raise StorageError(f"{folder} cannot be created: {e.strerror}", hint, path=str(folder)) from e
    return folder


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


def refuse_foreign(path: Path, mark: bytes) -> None:
    """Raise StorageError if no file can be written to `path`, and ConfigurationError if something is there that is
    not a file with `mark` in it. mark: text that every file of this kind contains that foldcell makes. Called
    before the file's content is computed."""
    refuse_unwritable(path)
    try:
        own = not path.exists() or (path.is_file() and mark in path.read_bytes())
    except OSError as e:
        raise ConfigurationError(f"{path} cannot be read: {e.strerror}", "choose another file") from e
    if not own:
        raise ConfigurationError(
            f"{path} exists and was not made by this command", "move it away, or give another file or folder"
        )


def marked_png(png: bytes, chunk: bytes = PNG_MARK) -> bytes:
    """Return the PNG file with a further chunk. chunk: its type and data."""
    whole = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return png[:_IHDR_END] + whole + png[_IHDR_END:]
