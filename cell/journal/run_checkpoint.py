"""The checkpoint: a run's context, written after each effect so that an interrupted run can be resumed from it.

A checkpoint is a folder with a file `context`, which is replaced as a whole. Its first line is JSON with version,
schema, the fields of all dataclasses that follow, and hash. The rest is a pickle of the context. Reading the
pickle can create only arrays and values of this program's types. Each large array is stored in a separate file,
named by the hash of its content. Pictures are stored in the run's frame store (cell/journal/frame_store.py).
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import io
import json
import pickle
from enum import Enum
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foldcell.cell.journal.checkpoint_file import CONTEXT
from foldcell.cell.journal.frame_store import FrameStore
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.support.files.whole_file import make_folder, write_whole
from foldcell.robots.errors import ConfigurationError, InternalError, StorageError
from foldcell.robots.ports import CameraFrame, frozen

SCHEMA = 4
LARGE = 2**16
"""Arrays of at least this size [bytes] get separate files, because most of them do not change between effects."""
_OURS = ("foldcell.cell.", "foldcell.robots.", "foldcell.skills.")
_ARRAYS = frozenset(
    {
        ("numpy", "dtype"),
        ("numpy", "ndarray"),
        ("numpy._core.multiarray", "_reconstruct"),
        ("numpy._core.multiarray", "scalar"),
        ("numpy._core.numeric", "_frombuffer"),
    }
)
"""The functions and types that a pickle of a numpy array refers to."""


def write_checkpoint(folder: Path, context: RunContext, frames: FrameStore) -> None:
    """Write the context. It is on disk when the call returns. Raises StorageError."""
    stream = io.BytesIO()
    pickler = _Pickler(stream, make_folder(folder, above=False), frames)
    try:
        pickler.dump(context)
    except (pickle.PicklingError, TypeError, AttributeError) as e:
        raise InternalError(f"a value of the context cannot be written: {e}") from e
    body = stream.getvalue()
    head = {"foldcell": _version(), "schema": SCHEMA, "fields": pickler.fields, "sha256": _hash(body)}
    write_whole(folder / CONTEXT, json.dumps(head).encode() + b"\n" + body)


def read_checkpoint(folder: Path, frames: FrameStore) -> RunContext:
    """Read the context. Raises StorageError if a file or picture is missing or damaged, ConfigurationError if
    another version of this program wrote it."""
    path = folder / CONTEXT
    try:
        head_line, _, body = path.read_bytes().partition(b"\n")
        head = json.loads(head_line)
        version, schema, digest = head["foldcell"], head["schema"], head["sha256"]
        same = (version, schema) == (_version(), SCHEMA) and _same_fields(head["fields"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as e:
        raise _damaged(path, e) from None
    if not same:
        raise ConfigurationError(
            f"{path} was written by another foldcell (version {version}, this is {_version()})",
            "resume with the version that began the run, or start a new run",
        )
    if digest != _hash(body):
        raise _damaged(path, "its hash does not match")
    try:
        context = _Unpickler(io.BytesIO(body), folder, frames).load()
    except StorageError:
        raise
    except Exception as e:  # a damaged pickle can raise anything
        raise _damaged(path, e) from e
    if not isinstance(context, RunContext):
        raise _damaged(path, "it does not contain a run's context")
    return context


@lru_cache(maxsize=1)
def _version() -> str:
    return metadata.version("foldcell")


def _same_fields(stored: dict[str, list[str]]) -> bool:
    """Whether the dataclasses of a checkpoint still have the fields that they had when it was written. In a
    checkout of the source they can change while the version stays the same."""
    try:
        return all(_fields(_our_type(*name.rsplit(".", 1))) == fields for name, fields in stored.items())
    except (ImportError, AttributeError, TypeError, pickle.UnpicklingError):  # such a type is no longer there
        return False


def _fields(kind: Any) -> list[str]:
    return [f.name for f in dataclasses.fields(kind)]


def _hash(body: bytes) -> str:
    return hashlib.sha256(body).hexdigest()


def _damaged(path: Path, why: object) -> StorageError:
    return StorageError(f"{path} is missing or damaged: {why}", "start a new run", path=str(path))


class _Pickler(pickle.Pickler):
    def __init__(self, stream: io.BytesIO, folder: Path, frames: FrameStore) -> None:
        super().__init__(stream, protocol=5)
        self._folder, self._frames = folder, frames
        self.fields: dict[str, list[str]] = {}
        """The fields of each dataclass that was written, by module and name."""

    def persistent_id(self, obj: Any) -> tuple[str, str] | None:
        if isinstance(obj, CameraFrame):
            return "frame", self._frames.put(obj)
        if type(obj) is np.ndarray and obj.nbytes >= LARGE and not obj.dtype.hasobject:
            return "array", self._put(obj)
        return None

    def reducer_override(self, obj: Any) -> Any:
        if dataclasses.is_dataclass(obj) and not isinstance(obj, type):
            self.fields[f"{type(obj).__module__}.{type(obj).__name__}"] = _fields(obj)
        # Python 3.11.0 to 3.11.3 pickle an Enum member as a call of getattr, which _Unpickler refuses
        return (type(obj), (obj.value,)) if isinstance(obj, Enum) else NotImplemented

    def _put(self, array: NDArray[Any]) -> str:
        stream = io.BytesIO()
        np.save(stream, array, allow_pickle=False)
        name = _hash(stream.getvalue())
        path = _array_path(self._folder, name)
        if not path.exists():
            write_whole(path, stream.getvalue())
        return name


def _array_path(folder: Path, name: str) -> Path:
    return folder / f"{name}.npy"


def _is_value(kind: type) -> bool:
    """Whether a pickle may create this type. All types of the package `skills` are allowed, because that package
    contains only pure functions and values. Of the other packages, only dataclasses and enums are allowed."""
    return (
        kind.__module__.startswith("foldcell.skills.") or dataclasses.is_dataclass(kind) or issubclass(kind, Enum)
    )


def _our_type(module: str, name: str) -> type:
    """Return a type of this program that a checkpoint may contain. Raises UnpicklingError for any other name."""
    if module.startswith(_OURS) and "." not in name:
        found = getattr(importlib.import_module(module), name)
        if isinstance(found, type) and _is_value(found):
            return found
    raise pickle.UnpicklingError(f"it refers to {module}.{name}, which is not allowed")


class _Unpickler(pickle.Unpickler):
    """An unpickler that creates only arrays and values of this program's types. A general pickle could call any
    function."""

    def __init__(self, stream: io.BytesIO, folder: Path, frames: FrameStore) -> None:
        super().__init__(stream)
        self._folder, self._frames = folder, frames

    def persistent_load(self, pid: tuple[str, str]) -> CameraFrame | NDArray[Any]:
        kind, name = pid
        if kind == "frame":
            return self._frames.get(name)
        content = _array_path(self._folder, name).read_bytes()
        if _hash(content) != name:
            raise pickle.UnpicklingError(f"the hash of its array {name} does not match")
        return frozen(np.load(io.BytesIO(content), allow_pickle=False))

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _ARRAYS:
            return super().find_class(module, name)
        return _our_type(module, name)
