"""Check the installation and give hints for repair. The checks change nothing."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from importlib import import_module, metadata
from pathlib import Path

from foldcell.cell.support.files.paths import free_bytes, journal_path, repository_root, user_cache
from foldcell.cell.view.viewer import find_viewer
from foldcell.robots.errors import CellError
from foldcell.robots.registry import find_robot, list_robots
from foldcell.robots.ros.installation import PACKAGES, find_ros

REPAIR = "make setup" if repository_root() else "pip install --force-reinstall foldcell"
"""The command that installs everything again."""
LEAST_MEMORY = 3 * 2**30
LEAST_DISK = 2**30


class Verdict(StrEnum):
    GOOD = "good"
    WARNING = "warning"
    """The cell can run, but it differs from the tested installation or lacks something that a run does not
    need."""
    BAD = "bad"


@dataclass(frozen=True)
class Check:
    """The result of one check: the finding, and a hint unless the verdict is GOOD."""

    name: str
    verdict: Verdict
    found: str
    hint: str = ""


def examine(logs: Path) -> list[Check]:
    """Perform all checks. A check that raises an exception counts as bad."""
    loading = [_loading(*group) for group in NATIVE]  # beside the other checks
    checks: list[Callable[[], Iterable[Check]]] = [
        _python,
        _packages,
        *(partial(_robot_model, name) for name in list_robots()),
        _compile_cache,
        _user_cache,
        partial(_logs, logs),
        partial(_disk, logs),
        _memory,
        _cores,
        _garments,
        _viewer,
        _ros,
        partial(_native_modules, loading),
    ]
    return [check for work in checks for check in _safely(work)]


def _safely(work: Callable[[], Iterable[Check]]) -> list[Check]:
    try:
        return list(work())
    except Exception as e:
        hint = e.hint if isinstance(e, CellError) else f"{REPAIR} installs everything again"
        function = work.func if isinstance(work, partial) else work
        name = getattr(function, "__name__", "check").strip("_").replace("_", " ")
        return [Check(name, Verdict.BAD, f"{type(e).__name__}: {e}", hint)]


def _judged(name: str, good: bool, found: str, hint: str, otherwise: Verdict = Verdict.WARNING) -> Check:
    return Check(name, Verdict.GOOD, found) if good else Check(name, otherwise, found, hint)


def _python() -> Iterable[Check]:
    found = f"{'.'.join(map(str, sys.version_info[:3]))} ({sys.executable})"
    hint = "foldcell needs Python 3.11: make setup PYTHON=/path/to/python3.11"
    yield _judged("python", sys.version_info[:2] == (3, 11), found, hint, Verdict.BAD)


# packages


def required_packages() -> list[str]:
    """Return the names of the packages that foldcell requires, without its optional extras."""
    lines = metadata.requires("foldcell") or []
    names = [line.split(";")[0].strip() for line in lines if "extra ==" not in line]
    return [_name(n) for n in names]


def pinned_versions(text: str) -> dict[str, str]:
    """Parse the text of `constraints.txt`, pins with hashes. Returns name -> version."""
    pins = (line.split(" ")[0].partition("==") for line in text.splitlines())
    return {_name(name): version for name, _, version in pins if version}


def _name(text: str) -> str:
    for c in "<>=!~[ ;":
        text = text.split(c)[0]
    return text.strip().lower().replace("_", "-")


def _packages() -> Iterable[Check]:
    root = repository_root()
    pins: Mapping[str, str] = {}
    if root is not None and (root / "constraints.txt").is_file():
        pins = pinned_versions((root / "constraints.txt").read_text(encoding="utf-8"))
    for name in required_packages():
        yield _package(name, pins.get(name))


def _package(name: str, pin: str | None) -> Check:
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return Check(
            name, Verdict.BAD, "not installed", f"pip install {name}{f'=={pin}' if pin else ''} (or {REPAIR})"
        )
    if pin is not None and version != pin:
        hint = f"tested with {pin}: make setup, or pip install -c constraints.txt {name}"
        return Check(name, Verdict.WARNING, version, hint)
    return Check(name, Verdict.GOOD, version + (" as pinned" if pin else ""))


NATIVE = (
    ("pinocchio", "coal", "numba", "scipy.linalg", "toppra"),
    ("rerun", "cv2", "pybullet", "ruckig", "shapely"),
)
"""Modules with compiled parts, which may fail to load although they are installed. Those of a group share
packages and are loaded together."""


def _loading(*modules: str) -> subprocess.Popen[str]:
    """Start to import modules in a separate process, because an import may crash its process."""
    plain = "from foldcell.skills.motion.timing.without_plots import without_plots\nwith without_plots():\n"
    return subprocess.Popen(
        [sys.executable, "-c", f"{plain} import {', '.join(modules)}"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def _errors(process: subprocess.Popen[str]) -> str | None:
    """Wait for the imports. Returns the last line of the error; None if all modules load."""
    _, errors = process.communicate()
    return (errors.strip().splitlines() or [f"crashed ({process.returncode})"])[-1] if process.returncode else None


def _native_modules(groups: Sequence[subprocess.Popen[str]]) -> Iterable[Check]:
    """groups: the processes that import the groups of NATIVE. The modules of a group that fails are imported
    one by one, for the names of those that fail."""
    failed = [group for group, process in zip(NATIVE, groups, strict=True) if _errors(process) is not None]
    alone = {name: _loading(name) for group in failed for name in group}
    broken = {name: why for name, process in alone.items() if (why := _errors(process)) is not None}
    hint = f"{REPAIR} installs it again; the message may name a missing system library"
    for name, why in broken.items():
        yield Check(f"import {name}", Verdict.BAD, why, hint)
    if not broken:
        yield Check("compiled modules", Verdict.GOOD, f"all {sum(map(len, NATIVE))} load")


# files that a run reads and writes


def _robot_model(name: str) -> Iterable[Check]:
    robot = find_robot(name)
    robot.load_model()
    if robot.driver is not None and find_ros() is not None:
        robot.driver.check()
    yield Check(f"{robot.title} model", Verdict.GOOD, str(robot.model_file()))


COMPILED = (
    "foldcell.cell.report.pictures.mesh_raster",
    "foldcell.skills.cloth.intersections.crossings",
    "foldcell.skills.cloth.kernel", "foldcell.skills.fold_figures.fold_figures",
    "foldcell.skills.motion.kinematics.ik",
    "foldcell.skills.perception.registration.energy", "foldcell.skills.perception.segmentation.colour_model",
)  # fmt: skip
"""Modules with functions whose compiled code is kept on disk."""


def _compile_cache() -> Iterable[Check]:
    """Load every entry, and check that the folder of the cloth simulation can be written: NUMBA_CACHE_DIR, or
    `__pycache__` beside the sources, or the user's cache of numba."""
    from foldcell.skills.compiled import FallibleCache

    for module in COMPILED:
        import_module(module)
    loaded, damaged = 0, []
    for cache in FallibleCache.caches:
        try:
            loaded += cache.check()
        except Exception:  # damaged bytes raise anything
            damaged.append(cache.index)
    folder = next(c.index for c in FallibleCache.caches if c.index.name.startswith("kernel.")).parent
    for check in _writable("compile cache", folder, "compiled again at every start, about a minute"):
        if damaged and check.verdict is Verdict.GOOD:
            hint = "these functions are compiled again when they are used next"
            yield Check(check.name, Verdict.WARNING, f"damaged: {', '.join(map(str, damaged))}", hint)
        elif check.verdict is Verdict.GOOD:
            yield replace(check, found=f"{folder}; all {loaded} compiled functions load")
        else:
            yield replace(check, hint=check.hint + "; or name another folder with NUMBA_CACHE_DIR")


def _user_cache() -> Iterable[Check]:
    yield from _writable("user cache", user_cache(), "robot meshes are converted again at every start")


def _writable(name: str, folder: Path, without: str) -> Iterable[Check]:
    problem = _write_problem(folder)
    yield _judged(name, not problem, f"{folder}{problem}", f"make it writable; otherwise: {without}")


def _logs(logs: Path) -> Iterable[Check]:
    problem, journal_file = _write_problem(logs), journal_path(logs)
    hint = "choose another folder: --logs DIR or FOLDCELL_LOGS"
    yield _judged("logs", not problem, f"{logs}{problem}", hint, Verdict.BAD)
    if problem or not journal_file.exists():
        return
    from foldcell.cell.journal.journal import Journal

    with Journal.open(journal_file, readonly=True) as journal:
        state = journal.check()
        found = f"{len(journal.runs())} runs" if state == "ok" else state
        hint = f"keep a copy of {journal_file} and move it aside"
        yield _judged("journal", state == "ok", found, hint, Verdict.BAD)


def _write_problem(folder: Path) -> str:
    """Return why the folder cannot be written, as an addition to its name; empty if it can. For a missing folder,
    the nearest existing parent is checked."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        return f": {folder} is not a folder"
    try:
        with tempfile.TemporaryFile(dir=folder):
            return ""
    except OSError as e:
        return f": {e.strerror}"


def _disk(logs: Path) -> Iterable[Check]:
    free = free_bytes(logs)
    hint = "a run takes up to 100 MB: remove old runs, or choose another --logs DIR"
    yield _judged("disk", free >= LEAST_DISK, f"{free / 2**30:.1f} GiB free at {logs}", hint)


def _memory() -> Iterable[Check]:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        yield Check("memory", Verdict.GOOD, "not measured on this system")
        return
    free = 1024 * next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    hint = f"a run needs about {LEAST_MEMORY / 2**30:.0f} GiB: close other programs"
    yield _judged("memory", free >= LEAST_MEMORY, f"{free / 2**30:.1f} GiB free", hint)


def _cores() -> Iterable[Check]:
    cores = len(os.sched_getaffinity(0))
    hint = "two cores halve the time of an optimisation"
    yield _judged("processor", cores >= 2, f"{cores} cores; no GPU is needed", hint)


def _garments() -> Iterable[Check]:
    from foldcell.cell.config.cell_settings import load_settings
    from foldcell.cell.config.garments.garment_file import list_garments, load_garment

    surface = load_settings().surface
    names = list_garments()
    for name in names:
        load_garment(name, surface)
    yield _judged("garments", bool(names), ", ".join(names) or "none", REPAIR, Verdict.BAD)


def _viewer() -> Iterable[Check]:
    found = find_viewer()
    hint = "pip install rerun-sdk; without it recordings are written but cannot be opened here"
    yield _judged("viewer", found is not None, str(found or "no rerun program"), hint)


def _ros() -> Iterable[Check]:
    """Check for ROS 1, which only the drivers `ros` and `emulator` need."""
    folder, uri = find_ros(), os.environ.get("ROS_MASTER_URI", "not set: no robot is named")
    found = "not installed" if folder is None else f"{folder}; ROS_MASTER_URI {uri}"
    hint = f"only for --driver ros and emulator: apt-get install {PACKAGES}"
    yield _judged("ROS 1", folder is not None, found, hint)
