"""Read and write the files of the trajectory library: the shipped file and the user's file."""

from __future__ import annotations

import fcntl
import itertools
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import metadata, resources
from pathlib import Path

from foldcell.cell.support.files.whole_file import make_folder, write_whole
from foldcell.robots.errors import StorageError
from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.arcs.frame import frames_of
from foldcell.skills.trajectory.trajectory_library import (
    Library,
    LibraryEntry,
    Refusal,
    from_json,
    to_json,
)
from foldcell.skills.vocabulary import FoldStep, GraspTrajectory, frozen

_HINT = "free disk space or make the library's folder writable, or choose another folder with --logs"


@dataclass(frozen=True)
class LoadedLibrary:
    """A library as loaded from its files. library: the valid entries. refused: file and reason of each invalid
    entry, for the operator."""

    library: Library
    refused: tuple[tuple[Path, Refusal], ...] = ()


def shipped_library_path() -> Path:
    return Path(str(resources.files("foldcell.cell.config.trajectory_library") / "library.json"))


def user_library_path(logs: Path) -> Path:
    """Return the path of the user's library of optimised folds."""
    return logs / "library.json"


def user_heights_path(library: Path) -> Path:
    """Return the path of the heights of ideal folds that belong to a library's file."""
    return library.with_name("ideal_heights.json")


def user_files(logs: Path) -> tuple[Path, Path]:
    """Return the paths of the user's library and of its heights."""
    library = user_library_path(logs)
    return library, user_heights_path(library)


def copy_library(source: Path, target: Path, skip_unreadable: bool = False) -> None:
    """Copy the user's library and its heights from one logs folder to another, each if it exists. skip_unreadable:
    a file that cannot be read counts as missing, as in a run. Raises StorageError."""
    for path in user_files(source):
        try:
            content = path.read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            if skip_unreadable:
                continue
            hint = "make it readable, or move it away to use the shipped one"
            raise StorageError(f"{path} cannot be read: {error.strerror}", hint, path=str(path)) from None
        write_whole(target / path.name, content)


def load_library(logs: Path | None = None) -> LoadedLibrary:
    """Load the user's library and the shipped one; the user's entries come first. A missing file counts as empty.
    A broken file is listed in `LoadedLibrary.refused`."""
    library, refused = Library(), []
    paths = [] if logs is None else [user_library_path(logs)]
    for path in (*paths, shipped_library_path()):
        part, bad = _load(path)
        library = library.merged(part)
        refused += [(path, refusal) for refusal in bad]
    return LoadedLibrary(library, tuple(refused))


def entry_of(
    garment: Garment, step: FoldStep, trajectory: GraspTrajectory, method: str, dissimilarity_initial: float
) -> LibraryEntry:
    """Make the library entry of a fold. dissimilarity_initial: dissimilarity of the initial arc of the search
    [m]."""
    frames = frames_of(step, garment.material.thickness)
    return LibraryEntry(
        category=garment.category,
        step=step.name,
        variant=step.variant,
        garment=garment.name,
        material=garment.material,
        size_m=garment.size_m,
        inner={i: frozen(frames[i].normalise(c)) for i, c in trajectory.control_points.items()},
        edge_length=garment.mesh_edge_m,
        method=method,
        dissimilarity=trajectory.dissimilarity,
        dissimilarity_initial=dissimilarity_initial,
        simulations=trajectory.simulations,
        max_tool_speed=garment.max_tool_speed,
        version=metadata.version("foldcell"),
    )


def add_entry(logs: Path, entry: LibraryEntry) -> Path:
    """Add a fold to the user's library. A broken library is renamed first. Raises StorageError."""
    path = user_library_path(logs)
    _change(path, lambda there: there.with_entry(entry))
    return path


def put_garments(path: Path, library: Library, garments: Iterable[str]) -> None:
    """Replace the entries of these garments in the file by those of `library`. Entries of other garments stay.

    A broken library is renamed first. Raises StorageError.
    """
    built = set(garments)

    def changed(there: Library) -> Library:
        return library.merged(Library(tuple(e for e in there.entries if e.garment not in built)))

    _change(path, changed)


def _change(path: Path, changed: Callable[[Library], Library]) -> None:
    with alone_with(path):
        library, refused = _load(path)
        if refused:
            _set_aside(path)
        write_library(path, changed(library))


def write_library(path: Path, library: Library) -> None:
    """Write the library to a file atomically. Raises StorageError."""
    write_text(path, to_json(library))


def write_text(path: Path, text: str) -> None:
    """Write the file atomically, and create its folder if necessary. Raises StorageError."""
    make_folder(path.parent, _HINT)
    write_whole(path, text, _HINT)


@contextmanager
def alone_with(path: Path) -> Iterator[None]:
    """Lock a library file for reading and writing, so that a run and a build do not overwrite each other's
    entries. Raises StorageError.

    The lock is on the file's folder (`flock`). If the file system does not support such locks, the file is not
    locked.
    """
    folder = make_folder(path.absolute().parent, _HINT)
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        raise StorageError(f"{folder} cannot be read: {error.strerror}", _HINT, path=str(folder)) from None
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _load(path: Path) -> tuple[Library, tuple[Refusal, ...]]:
    try:
        text = path.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        return Library(), ()
    except (OSError, UnicodeDecodeError) as error:
        return Library(), (Refusal(-1, f"cannot be read: {error}"),)
    return from_json(text)


def _set_aside(path: Path) -> None:
    """Rename a broken library to an unused name. Does nothing if another program has already moved it."""
    names = itertools.chain([".refused"], (f".refused-{k}" for k in itertools.count(2)))
    there = next(p for name in names if not (p := path.with_name(path.name + name)).exists())
    try:
        os.replace(path, there)
    except FileNotFoundError:
        return
    except OSError as error:
        raise StorageError(
            f"{path}: a broken library cannot be renamed: {error.strerror}", "Remove it by hand.", path=str(path)
        ) from None
