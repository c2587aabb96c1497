"""The folder of a campaign: its requests, the versions of the program that performs them, and the finished runs.

`campaign.json` states the requests and the program's versions. Each run has its own folder, which contains
`trial.json` once the run is finished. The campaign's folder therefore holds every finished run, even if a process
was killed.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from typing import Any, get_args

from cell.campaigns.trials.campaign import Campaign, Keep, TrialRequest
from cell.campaigns.trials.trial import MANIFEST, Trial, load_trial
from cell.config.trajectory_library.library_file import user_library_path
from cell.runs.ownership import VERSIONED
from cell.support.files.paths import repository_root
from cell.support.files.whole_file import write_whole
from cell.support.json_values import to_json
from cell.support.process.lock import OwnerLock
from robots.errors import ConfigurationError, StorageError

__all__ = ["CampaignFolder", "cpu_model", "is_campaign", "program_versions"]

SCHEMA = 1
LOCK = ".campaign.lock"


@dataclass(frozen=True)
class CampaignFolder:
    path: Path
    campaign: Campaign

    @classmethod
    def create(cls, path: Path, campaign: Campaign, logs: Path) -> CampaignFolder:
        """Write the campaign and a copy of the user's library into the empty folder `path`. Raises
        StorageError."""
        source = user_library_path(logs)
        try:
            if source.is_file():
                shutil.copyfile(source, user_library_path(path))
        except OSError as error:
            raise StorageError(
                f"{source} cannot be copied to {path}: {error.strerror}",
                "check the permissions of both folders and whether the disk is full",
            ) from None
        content = {
            "schema": SCHEMA,
            "about": campaign.about,
            "begun": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
            "commit": commit(),
            "keep": campaign.keep,
            "variants": campaign.variants,
            "program": {**program_versions(), "library": _library_digest(path)},
            "machine": {"cpu": cpu_model(), "cores": _cores()},
            "requests": [asdict(request) for request in campaign.requests],
        }
        write_whole(path / MANIFEST, json.dumps(to_json(content), indent=1) + "\n")
        return cls(path, campaign)

    @classmethod
    def open(cls, path: Path) -> CampaignFolder:
        """Open an existing campaign. Raises ConfigurationError if the folder holds none."""
        content = _read(path)
        try:
            if content["keep"] not in get_args(Keep):
                raise ValueError(content["keep"])
            requests = tuple(
                TrialRequest(**{**request, "actions": tuple(request["actions"])})
                for request in content["requests"]
            )
            root = path.resolve()
            outside = [r.folder for r in requests if not (root / r.folder).resolve().is_relative_to(root)]
            if outside:
                raise ValueError(f"the run folder {outside[0]} is outside the campaign")
            campaign = Campaign(content["about"], content["keep"], requests, content["variants"])
        except (LookupError, TypeError, ValueError) as e:
            raise ConfigurationError(f"{path / MANIFEST} is damaged: {e}", "start a new campaign") from None
        return cls(path, campaign)

    def check_program(self) -> None:
        """Check that the program that began the campaign also continues it, because runs of different programs
        cannot be compared.

        Raises ConfigurationError if the program has changed.
        """
        began = _read(self.path)["program"]
        now = {**program_versions(), "library": _library_digest(self.path)}
        names = [name for name in sorted({*began, *now}) if began.get(name) != now.get(name)]
        changed = [f"{name} {began.get(name)} -> {now.get(name)}" for name in names]
        if changed:
            raise ConfigurationError(
                f"the program has changed since the campaign {self.path.name} began: {', '.join(changed)}",
                "continue it with the same version, or start a new campaign",
            )

    @cached_property
    def origin(self) -> dict[str, Any]:
        """Where and how the campaign began: begun (UTC), commit (None for an installed program), program (package
        -> version), machine."""
        content = _read(self.path)
        return {name: content.get(name) for name in ("begun", "commit", "program", "machine")}

    @contextmanager
    def owned(self) -> Iterator[None]:
        """Own the campaign, so that no other process continues it meanwhile. Raises CellBusyError."""
        with OwnerLock(self.path / LOCK, "the campaign", ""):
            yield

    def folder(self, request: TrialRequest) -> Path:
        return self.path / request.folder

    def finished(self) -> list[Trial]:
        """Return the finished runs, in the order of the requests."""
        return [trial for request in self.campaign.requests if (trial := self._trial(request)) is not None]

    def missing(self, finished: Sequence[Trial]) -> list[TrialRequest]:
        done = {trial.request.key for trial in finished}
        return [request for request in self.campaign.requests if request.key not in done]

    def _trial(self, request: TrialRequest) -> Trial | None:
        done = load_trial(self.folder(request), request)
        return None if done is None else Trial(request, done["figures"], done["error"])


def is_campaign(path: Path) -> bool:
    return (path / MANIFEST).is_file()


def program_versions() -> dict[str, str]:
    """Return the versions of the packages that a run depends on, and a hash of the program's own sources."""
    versions = {name: metadata.version(name) for name in VERSIONED}
    return {"python": platform.python_version(), **versions, "sources": _sources_digest()}


@cache
def _sources_digest() -> str:
    """Return a hash of the program's own files, because the version number does not change between two
    releases."""
    root = Path(__file__).resolve().parents[3]
    digest = sha256()
    for package in ("calibration", "cell", "robots", "skills"):
        for path in sorted((root / package).rglob("*")):
            if path.suffix in (".py", ".yaml", ".json"):
                digest.update(str(path.relative_to(root)).encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def commit() -> str | None:
    """Return the commit of the checkout, with `+` appended if files differ from it; None if the program is
    installed."""
    root = repository_root()
    if root is None:
        return None
    try:
        run = [
            subprocess.run(
                ["git", "-C", str(root), *line], capture_output=True, text=True, check=True
            ).stdout.strip()
            for line in (["rev-parse", "--short", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])
        ]
    except (OSError, subprocess.CalledProcessError):
        return None
    return run[0] + ("+" if run[1] else "")


def cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration, IndexError):
        return platform.processor() or platform.machine()


def _cores() -> int:
    return len(os.sched_getaffinity(0))


def _library_digest(path: Path) -> str:
    library = user_library_path(path)
    return sha256(library.read_bytes()).hexdigest()[:12] if library.is_file() else "shipped"


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            raise ValueError(f"schema {content['schema']}")
        return dict(content)
    except FileNotFoundError:
        raise ConfigurationError(
            f"{path} is no campaign: it has no {MANIFEST}", "name the folder that `foldcell trials` printed"
        ) from None
    except (OSError, ValueError, LookupError, TypeError) as e:
        raise ConfigurationError(f"{path / MANIFEST} cannot be read: {e}", "start a new campaign") from None
