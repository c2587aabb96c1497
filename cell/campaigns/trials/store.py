"""The folder of a campaign: its requests, the versions of the program that performs them, and the finished runs.

`campaign.json` states the requests and the program's versions. Each run has its own folder, which contains
`trial.json` once the run is finished. The campaign's folder therefore holds every finished run, even if a process
was killed.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from urllib.parse import quote

from pydantic import TypeAdapter

from foldcell.cell.campaigns.trials.campaign import Campaign, TrialRequest
from foldcell.cell.campaigns.trials.trial import Trial, read_trial
from foldcell.cell.config.trajectory_library.library_file import copy_library, user_files
from foldcell.cell.runs.ownership import VERSIONED
from foldcell.cell.support.files.paths import repository_root
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.cell.support.json_values import to_json
from foldcell.cell.support.process.lock import OwnerLock
from foldcell.robots.errors import ConfigurationError

MANIFEST = "campaign.json"
"""File with the requests of a campaign, in its folder."""
SCHEMA = 2
LOCK = ".campaign.lock"


@dataclass(frozen=True)
class Machine:
    """The machine on which a campaign began."""

    cpu: str
    cores: int


@dataclass(frozen=True)
class BegunCampaign(Campaign):
    """A campaign, with the time at which it began, the machine and the versions of the program. begun: time (UTC).
    commit: commit of the checkout; None if the program is installed. program: package -> version."""

    begun: str
    commit: str | None
    program: Mapping[str, str]
    machine: Machine


_MANIFEST = TypeAdapter(BegunCampaign)


@dataclass(frozen=True)
class CampaignFolder:
    path: Path
    campaign: BegunCampaign

    @classmethod
    def create(cls, path: Path, campaign: Campaign, logs: Path) -> CampaignFolder:
        """Write the campaign and a copy of the user's library, with its heights of ideal folds, into the empty
        folder `path`. Raises StorageError."""
        copy_library(logs, path)
        begun = BegunCampaign(
            campaign.about,
            campaign.keep,
            campaign.requests,
            campaign.variants,
            time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
            commit(),
            {**program_versions(), "library": _library_digest(path)},
            Machine(cpu_model(), len(os.sched_getaffinity(0))),
        )
        write_whole(path / MANIFEST, json.dumps({"schema": SCHEMA, **to_json(begun)}, indent=1) + "\n")
        return cls(path, begun)

    @classmethod
    def open(cls, path: Path) -> CampaignFolder:
        """Open an existing campaign. Raises ConfigurationError if the folder holds none."""
        try:
            content = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
            if content["schema"] != SCHEMA:
                raise ValueError(f"schema {content['schema']}")
            campaign = _MANIFEST.validate_python(content)
            root = path.resolve()
            outside = [r.folder for r in campaign.requests if not (root / r.folder).resolve().is_relative_to(root)]
            if outside:
                raise ValueError(f"the run folder {outside[0]} is outside the campaign")
        except FileNotFoundError:
            raise ConfigurationError(
                f"{path} is no campaign: it has no {MANIFEST}", "name the folder that `foldcell trials` printed"
            ) from None
        except (OSError, LookupError, TypeError, ValueError) as e:
            what = str(e).partition("\n")[0]
            raise ConfigurationError(f"{path / MANIFEST} cannot be read: {what}", "start a new campaign") from None
        return cls(path, campaign)

    def check_program(self) -> None:
        """Check that the program that began the campaign also continues it, because runs of different programs
        cannot be compared.

        Raises ConfigurationError if the program has changed.
        """
        changed = changed_versions(
            self.campaign.program, {**program_versions(), "library": _library_digest(self.path)}
        )
        if changed:
            raise ConfigurationError(
                f"the program has changed since the campaign {self.path.name} began: {', '.join(changed)}",
                "continue it with the same version, or start a new campaign",
            )

    @contextmanager
    def owned(self) -> Iterator[None]:
        """Own the campaign, so that no other process continues it meanwhile. Raises CellBusyError."""
        with OwnerLock(self.path / LOCK, "the campaign", ""):
            yield

    def folder(self, request: TrialRequest) -> Path:
        return self.path / request.folder

    def run_folder(self, trial: Trial) -> Path | None:
        """Return the folder of the trial's run; None if it has none. Only the last part of the stored path is
        used, because the campaign may have been moved since."""
        return self.folder(trial.request) / Path(trial.record.run_dir).name if trial.record else None

    def report(self, trial: Trial) -> str:
        """Return the path of the run's report as a link relative to the campaign's folder; empty if there is no
        report."""
        run = self.run_folder(trial)
        report = run / "report.html" if run else None
        return quote(os.path.relpath(report, self.path)) if report and report.is_file() else ""

    def finished(self) -> list[Trial]:
        """Return the finished runs, in the order of the requests. A run that waits for a person's verdict is not
        finished."""
        found = (read_trial(self.folder(request), request) for request in self.campaign.requests)
        return [trial for trial in found if trial is not None and not trial.unjudged]

    def missing(self, finished: Sequence[Trial]) -> list[TrialRequest]:
        done = {trial.request.key for trial in finished}
        return [request for request in self.campaign.requests if request.key not in done]


def changed_versions(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Return the packages whose versions differ, each with both versions."""
    names = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
    return [f"{name} {before.get(name)} -> {now.get(name)}" for name in names]


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
    described = ["git", "-C", str(root), "describe", "--always", "--exclude=*", "--dirty=+"]
    try:
        return subprocess.run(described, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration, IndexError):
        return platform.processor() or platform.machine()


def _library_digest(path: Path) -> str:
    content = b"".join(file.read_bytes() for file in user_files(path) if file.is_file())
    return sha256(content).hexdigest()[:12] if content else "shipped"
