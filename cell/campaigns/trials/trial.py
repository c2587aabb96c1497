"""One run of a campaign and its result file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from cell.campaigns.trials.campaign import TrialRequest
from cell.support.json_values import to_json

__all__ = ["MANIFEST", "TRIAL", "Trial", "digest", "load_trial"]

MANIFEST = "campaign.json"
"""File with the requests of a campaign, in its folder."""
TRIAL = "trial.json"
"""File with the result of a run, in the run's own folder."""


@dataclass(frozen=True)
class Trial:
    """One run of a campaign with its result. figures: output of `foldcell fold --json`; error: reason why there
    are no figures. performed: False for a run that did not end because its worker process died."""

    request: TrialRequest
    figures: Mapping[str, Any] | None
    error: str = ""
    performed: bool = True

    @property
    def result(self) -> str:
        if not self.performed:
            return "not_performed"
        return str(self.figures.get("result")) if self.figures else "fault"

    @property
    def claimed(self) -> bool:
        """Whether the executive claims that the garment is folded."""
        return self.result == "folded"

    @property
    def passed(self) -> bool | None:
        """The scorer's verdict on the garment, whether folding was claimed or not. None: the run was not
        scored."""
        score = (self.figures or {}).get("score")
        return bool(score.get("passed")) if score else None

    def part(self, name: str) -> tuple[bool, bool] | None:
        """Return a part of the claim ('shape', 'flat') and the scorer's verdict on it. None if the last fold was
        not inspected, or if the score does not judge this part."""
        figures = self.figures or {}
        claimed, judged = ((figures.get(key) or {}).get(name) for key in ("claim", "score"))
        return (claimed, judged) if isinstance(claimed, bool) and isinstance(judged, bool) else None

    @property
    def success(self) -> bool:
        """Whether the run was claimed and passed. If the run was not scored, the claim alone counts."""
        return self.claimed and self.passed is not False

    @property
    def cause(self) -> str:
        """Why the run is not a success: the kind of failure, or the figures of the score that are beyond their
        limits."""
        if self.success:
            return ""
        if not self.performed:
            return "not performed"
        if self.figures is None:
            return "error"
        failure = self.figures.get("failure")
        if failure:
            return str(failure.get("kind"))
        return "score: " + ", ".join(failed_figures(self.figures.get("score") or {}))


def failed_figures(score: Mapping[str, Any]) -> list[str]:
    """Return the names of the figures of a score that are beyond their limits. For `iou` the limit is a minimum,
    for all others a maximum."""
    limits = score.get("limits") or {}
    failed = [n for n, limit in limits.items() if _beyond(n, score.get(n), limit)]
    flawed = ["ideal"] if not (score.get("ideal") or {"valid": True})["valid"] else []
    return [name.removesuffix("_m").removesuffix("_rad") for name in failed] + flawed


def _beyond(name: str, value: float | None, limit: float | None) -> bool:
    """A figure that is unknown counts as beyond its limit."""
    if value is None or limit is None:
        return True
    return value < limit if name == "iou" else value > limit


def load_trial(folder: Path, request: TrialRequest) -> dict[str, Any] | None:
    """Return the result in `folder` if it is complete and belongs to this request, else None."""
    try:
        done = json.loads((folder / TRIAL).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return done if isinstance(done, dict) and done.get("request") == digest(request) else None


def digest(request: TrialRequest) -> str:
    """Return a hash of everything that the run depends on, except the program and the library."""
    canonical = json.dumps(to_json(asdict(request)), sort_keys=True)
    return sha256(canonical.encode()).hexdigest()[:16]
