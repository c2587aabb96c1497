"""The trajectory library's files: the shipped one, the user's own beside the logs, and how the first is built."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import metadata, resources
from pathlib import Path

from robots.errors import StorageError
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.garments.garment import Garment
from skills.planning.plan import plan_folds
from skills.trajectory.library import Library, LibraryEntry, Refusal, entry_from, from_json, to_json
from skills.trajectory.optimise import ClothPredictor, optimise_fold
from skills.trajectory.paths import tool_paths
from skills.trajectory.problem import Predictor
from skills.vocabulary import Array, Failure, FoldStep, GraspTrajectory, Outcome

__all__ = [
    "BuiltStep",
    "LoadedLibrary",
    "add_entry",
    "build_garment",
    "build_library",
    "load_library",
    "shipped_library_path",
    "user_library_path",
    "write_library",
]


@dataclass(frozen=True)
class LoadedLibrary:
    """library: what can be used. refused: file and reason of what cannot, for the operator to see."""

    library: Library
    refused: tuple[tuple[Path, Refusal], ...] = ()


@dataclass(frozen=True)
class BuiltStep:
    """What became of one step while a library was built: its entry, or why there is none."""

    garment: str
    step: str
    entry: LibraryEntry | None
    failure: Failure | None


def shipped_library_path() -> Path:
    return Path(str(resources.files("cell") / "data" / "library.json"))


def user_library_path(logs: Path) -> Path:
    """Where this user's own optimised folds are kept."""
    return logs / "library.json"


def load_library(logs: Path | None = None) -> LoadedLibrary:
    """The user's library, then the shipped one. A file that is missing is empty; a broken one is refused."""
    library, refused = Library(), []
    paths = [] if logs is None else [user_library_path(logs)]
    for path in (*paths, shipped_library_path()):
        part, bad = _load(path)
        library = library.merged(part)
        refused += [(path, refusal) for refusal in bad]
    return LoadedLibrary(library, tuple(refused))


def add_entry(logs: Path, entry: LibraryEntry) -> Path:
    """Keep one more fold in the user's library. Raises StorageError; a broken library is set aside, not lost."""
    path = user_library_path(logs)
    library, refused = _load(path)
    if refused:
        _set_aside(path)
    write_library(path, library.with_entry(entry))
    return path


def write_library(path: Path, library: Library) -> None:
    """Write the whole file or none of it. Raises StorageError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", dir=path.parent, prefix=f".{path.name}.", delete=False
        ) as file:
            try:
                file.write(to_json(library))
                file.flush()
                os.fsync(file.fileno())
                os.chmod(file.name, 0o644)
                os.replace(file.name, path)
            except BaseException:
                os.unlink(file.name)
                raise
    except OSError as error:
        raise StorageError(
            f"{path}: the trajectory library cannot be written: {error.strerror}",
            "Make its folder writable, or put the logs elsewhere with --logs.",
            path=str(path),
        ) from None


def build_library(
    garments: Iterable[Garment],
    method: str = "default",
    predict: Predictor | None = None,
    report: Callable[[BuiltStep], None] | None = None,
) -> Library:
    """Optimise every step of every garment, laid in the middle of its poses, each after the steps before it."""
    library = Library()
    for garment in garments:
        for built in build_garment(garment, method, predict):
            if report is not None:
                report(built)
            if built.entry is not None:
                library = library.with_entry(built.entry)
    return Library(library.entries[::-1])


def build_garment(garment: Garment, method: str = "default", predict: Predictor | None = None) -> list[BuiltStep]:
    """The entries for one garment's plan. It ends at the first step that cannot be optimised."""
    predict = predict or ClothPredictor()
    state = garment.flat_state(*garment.poses.middle)
    mesh = mesh_from_contour(state.contour, garment.mesh_edge_m, garment.layers)
    positions: Array = mesh.lay_flat(garment.material.thickness)
    built: list[BuiltStep] = []
    for step in plan_folds(state, garment).unwrap():
        outcome = optimise_fold(
            step, mesh, positions, garment.material, method,
            predict=predict, max_tool_speed=garment.max_tool_speed,
        )  # fmt: skip
        if outcome.value is None:
            built.append(BuiltStep(garment.name, step.name, None, outcome.failure))
            break
        entry = _entry(garment, step, outcome, method)
        built.append(BuiltStep(garment.name, step.name, entry, None))
        positions = _folded(mesh, positions, garment, step, outcome.value, predict)
    return built


def _folded(
    mesh: ClothMesh,
    positions: Array,
    garment: Garment,
    step: FoldStep,
    trajectory: GraspTrajectory,
    predict: Predictor,
) -> Array:
    return predict(mesh, positions, garment.material, tool_paths(trajectory, step))


def _entry(garment: Garment, step: FoldStep, outcome: Outcome[GraspTrajectory], method: str) -> LibraryEntry:
    return entry_from(
        outcome.unwrap(),
        step,
        category=garment.category,
        variant=garment.plan[step.index].variants[0].name,
        garment=garment.name,
        material=garment.material,
        size_m=garment.size_m,
        edge_length=garment.mesh_edge_m,
        method=method,
        dissimilarity_initial=float(outcome.notes["dissimilarity_initial_m"]),
        max_tool_speed=garment.max_tool_speed,
        version=metadata.version("foldcell"),
    )


def _load(path: Path) -> tuple[Library, tuple[Refusal, ...]]:
    try:
        text = path.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        return Library(), ()
    except (OSError, UnicodeDecodeError) as error:
        return Library(), (Refusal(-1, f"cannot be read: {error}"),)
    return from_json(text)


def _set_aside(path: Path) -> None:
    try:
        os.replace(path, path.with_name(path.name + ".refused"))
    except OSError as error:
        raise StorageError(
            f"{path}: a broken library cannot be set aside: {error.strerror}", "Remove it by hand.", path=str(path)
        ) from None
