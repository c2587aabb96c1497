"""Keep commands from writing over files that foldcell did not make, and from computing what they cannot write."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from foldcell.cell.support.files.whole_file import refuse_unwritable
from foldcell.robots.errors import ConfigurationError

__all__ = ["PNG_MARK", "marked_png", "refuse_foreign"]

PNG_MARK = b"tEXtSoftware\0foldcell"
_IHDR_END = 33
"""Length of a PNG file's signature and first chunk [bytes]. Further chunks are inserted after them."""


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
