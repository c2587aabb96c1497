"""Find the folders of logs and caches, and check names and the space for logs before anything moves."""

from __future__ import annotations

import os
import shlex
import shutil
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from foldcell.robots.errors import ConfigurationError, StorageError

JOURNAL_FILE = "journal.db"
MAX_SAME_NAME = 10_000
"""Limit of the number that is appended to a folder's name to make it unique."""
LEAST_FREE_BYTES = 200 * 2**20
"""Free space that a run requires [bytes]. Its recording and report take 35 to 110 MiB."""
KEPT_BYTES = 35 * 2**20
"""Free space that each further run requires whose recording is kept [bytes]."""


def checked_name(name: str, what: str) -> str:
    """Return `name` unchanged. what: the argument or variable that holds it, for the message.

    Raises ConfigurationError if it holds bytes that are no UTF-8 (which Python keeps as surrogates), or a zero
    byte. Journal, pages and JSON could not hold the former, and no file has the latter.
    """
    shown = name.encode("utf-8", "backslashreplace").decode().replace("\0", "\\0")
    if shown != name:
        raise ConfigurationError(
            f"{what}: the name '{shown}' is no UTF-8 text", "rename it, or take a copy with another name"
        )
    return name


def logs_directory(option: Path | None = None, environment: Mapping[str, str] | None = None) -> Path:
    """Return the folder of the journal and the runs: `--logs`, else FOLDCELL_LOGS, else the repository's `logs/`,
    else the user's data folder. The folder is not created. Raises ConfigurationError for a name that is no UTF-8
    text."""
    environment = os.environ if environment is None else environment
    if option is not None:
        folder = option.expanduser().absolute()
    elif from_environment := environment.get("FOLDCELL_LOGS"):
        folder = Path(from_environment).expanduser().absolute()
    elif (root := repository_root()) is not None:
        folder = root / "logs"
    else:
        import platformdirs

        folder = Path(platformdirs.user_data_dir("foldcell", appauthor=False)) / "logs"
    return Path(checked_name(str(folder), "logs folder"))


def logs_to_read(option: Path | None) -> Path:
    """Return the folder of `logs_directory`, which need not exist. Raises ConfigurationError if it is a file."""
    folder = logs_directory(option)
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(f"the logs folder {folder} is a file", "name its folder: --logs DIR")
    return folder


def command_for(words: str, logs: Path) -> str:
    """Return the command line `foldcell WORDS`, with --logs unless `logs` is the default folder."""
    option = "" if logs == logs_directory() else f" --logs {shlex.quote(str(logs))}"
    return f"foldcell {words}{option}"


def repository_root() -> Path | None:
    """Return the root of the checkout that this program runs from; None if it is installed as a package."""
    root = Path(__file__).resolve().parents[3]
    checkout = (root / "pyproject.toml").is_file() and (root / "logs" / "README.md").is_file()
    return root if checkout else None


def journal_path(logs: Path) -> Path:
    return logs / JOURNAL_FILE


def logs_of_run(name: str | Path, option: Path | None = None) -> Path:
    """Return the logs folder in which a run is sought: `--logs`, else the folder around `name` if that is a run's
    folder, else that of `logs_directory`. Raises ConfigurationError as `logs_directory`."""
    around = Path(name).absolute().parent
    if option is None and os.path.isdir(name) and journal_path(around).is_file():
        return around
    return logs_directory(option)


def user_cache() -> Path:
    """Return the user's cache folder for this program. Its content can always be created again."""
    import platformdirs

    return Path(checked_name(platformdirs.user_cache_dir("foldcell", appauthor=False), "user cache"))


def free_bytes(path: Path) -> int:
    """Return the free space [bytes] on the file system of `path`, or of the nearest existing folder above it."""
    while not path.exists() and path != path.parent:
        path = path.parent
    return shutil.disk_usage(path).free


def space_for(kept: int) -> int:
    """Return the free space that runs require [bytes]. kept: number of runs whose recordings are kept."""
    return LEAST_FREE_BYTES + max(kept - 1, 0) * KEPT_BYTES


def prepare_logs(logs: Path, least_free: int = LEAST_FREE_BYTES) -> Path:
    """Create the logs folder, check that it can be written, and return it.

    Raises StorageError if it cannot be written or has less than `least_free` bytes; the folders that were created
    are then removed.
    """
    elsewhere = "or choose another folder with --logs DIR or FOLDCELL_LOGS"
    created = _missing_folders(logs)
    try:
        logs.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=logs, prefix=".probe-") as probe:
            probe.write(b"foldcell")
            probe.flush()
            os.fsync(probe.fileno())
    except OSError as e:
        _remove(created)
        raise StorageError(
            f"the logs folder {logs} cannot be written: {e.strerror}",
            f"free some disk space or make it writable, {elsewhere}",
            path=str(logs),
            errno=e.errno,
        ) from e
    free, needs = free_bytes(logs), "a run needs" if least_free <= LEAST_FREE_BYTES else "the runs need"
    if free < least_free:
        _remove(created)
        raise StorageError(
            f"the logs folder {logs} has {free / 2**20:.0f} MiB left; {needs} {least_free / 2**20:.0f} MiB",
            f"free some space, {elsewhere}",
            path=str(logs),
            free_bytes=free,
        )
    return logs


def campaign_folder(logs: Path, kind: str) -> Path:
    """Create a folder `KIND-time` in the logs, for the runs of a campaign. Raises StorageError."""
    return new_folder(logs, f"{kind}-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}")


def new_folder(logs: Path, name: str) -> Path:
    """Create the folder `name` in the logs, or `name-2` and so on if it exists. `mkdir` makes this safe between
    processes. Raises StorageError."""
    for i in range(1, MAX_SAME_NAME):
        folder = logs / (name if i == 1 else f"{name}-{i}")
        try:
            folder.mkdir()
            return folder
        except FileExistsError:
            continue
        except OSError as e:
            raise StorageError(
                f"cannot create the folder {folder}: {e.strerror}",
                "choose another folder with --logs DIR or FOLDCELL_LOGS",
                path=str(folder),
            ) from e
    raise StorageError(f"too many folders named {name} in {logs}", "choose another --logs DIR", path=str(logs))


def _missing_folders(path: Path) -> list[Path]:
    """Return the folders that `mkdir(parents=True)` would create, deepest first."""
    missing = []
    while not path.exists() and path != path.parent:
        missing.append(path)
        path = path.parent
    return missing


def _remove(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return
