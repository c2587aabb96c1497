"""Write the results page of a campaign: rates with intervals, comparisons, distributions, failures with pictures,
all runs.

The page is one file: pictures are inlined, charts are SVG, and nothing is loaded from elsewhere. Links lead to the
reports of the runs.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2

from cell.campaigns.page.charts import rate_chart, strip_chart
from cell.campaigns.statistics.comparison import Comparison, compare_trials
from cell.campaigns.statistics.summary import ALL, Claims, Row, claims, part_claims, summarise
from cell.campaigns.trials.store import CampaignFolder
from cell.campaigns.trials.trial import Trial
from cell.support.files.html_page import page_template

__all__ = ["PAGE", "campaign_page"]

PAGE = "campaign.html"
GALLERY = 60
"""Maximum number of failures that the page shows with a picture."""
THUMBNAIL = 240
"""Width of the picture of a failure [px]."""


@dataclass(frozen=True)
class RunLine:
    """One run on the page. report: path relative to the campaign's folder; picture: data URI or empty."""

    trial: Trial
    report: str
    picture: str = ""

    @property
    def name(self) -> str:
        r = self.trial.request
        return f"{r.garment}, seed {r.seed}" + ("" if r.variant == "shipped" else f", {r.variant}")

    @property
    def verdict(self) -> str:
        return "folded" if self.trial.success else "false claim" if self.trial.claimed else self.trial.result

    def figure(self, name: str) -> float | None:
        value = (self.trial.figures or {}).get(name)
        return value if value is not None else ((self.trial.figures or {}).get("score") or {}).get(name)


@dataclass(frozen=True)
class VariantPart:
    """The results of one variant on the page."""

    name: str
    about: str
    rows: Sequence[Row]
    claims: Claims
    part_claims: Mapping[str, Claims]


def campaign_page(folder: CampaignFolder, trials: Sequence[Trial]) -> str:
    """Return the page as HTML text. It shows the runs so far."""
    campaign = folder.campaign
    performed = sorted((t for t in trials if t.performed), key=lambda t: t.request.key)
    by_variant = {name: [t for t in performed if t.request.variant == name] for name in campaign.variants}
    several = len(by_variant) > 1
    parts = [
        VariantPart(name, campaign.variants[name], summarise(group), claims(group), part_claims(group))
        for name, group in by_variant.items()
    ]
    first, *others = by_variant
    rates = {
        _group(row.variant, row.garment, several): (row.folded / row.runs, *row.interval)
        for part in parts for row in part.rows
    }  # fmt: skip
    failures = [t for t in performed if not t.success]
    template = page_template(
        Path(__file__).with_name(PAGE), percent=_percent, number=_number, mm=_mm, signed=_signed
    )
    return template.render(
        name=folder.path.name,
        about=campaign.about,
        planned=len(campaign.requests),
        performed=len(performed),
        folded=sum(t.success for t in performed),
        several=several,
        all=ALL,
        parts=parts,
        comparisons=[_comparison(first, other, by_variant) for other in others],
        rates=rate_chart(rates, "share of folded garments with 95 % intervals"),
        times=strip_chart(
            _values(performed, several, lambda line: line.figure("robot_time_s")), "s", "robot times of the runs"
        ),
        heights=strip_chart(
            _values(performed, several, lambda line: _millimetres(line.figure("height_m"))), "mm",
            "heights of the folded stacks",
        ),
        failures=[RunLine(t, _report(folder, t), _thumbnail(folder, t)) for t in failures[:GALLERY]],
        more_failures=len(failures) - GALLERY,
        runs=[RunLine(t, _report(folder, t)) for t in performed],
        not_performed=[t for t in trials if not t.performed],
        **folder.origin,
    )  # fmt: skip


def _comparison(first: str, other: str, by_variant: dict[str, list[Trial]]) -> tuple[str, str, Comparison]:
    return first, other, compare_trials(by_variant[first], by_variant[other])


def _group(variant: str, garment: str, several: bool) -> str:
    return f"{garment}, {variant}" if several else garment


def _values(
    trials: Iterable[Trial], several: bool, figure: Callable[[RunLine], float | None]
) -> dict[str, list[tuple[float, bool]]]:
    """Return for each group (garment and variant) a list of (value, success), one item per run that has the
    figure."""
    groups: dict[str, list[tuple[float, bool]]] = {}
    for trial in sorted(trials, key=lambda t: (t.request.garment, t.request.variant, t.request.seed)):
        value = None if trial.result == "fault" else figure(RunLine(trial, ""))
        group = groups.setdefault(_group(trial.request.variant, trial.request.garment, several), [])
        if value is not None:
            group.append((value, trial.success))
    return groups


def _report(folder: CampaignFolder, trial: Trial) -> str:
    """Return the path of the run's report relative to the campaign's folder; empty if there is no report."""
    run = _run_folder(folder, trial)
    report = run / "report.html" if run else None
    return quote(os.path.relpath(report, folder.path)) if report and report.is_file() else ""


def _run_folder(folder: CampaignFolder, trial: Trial) -> Path | None:
    """Return the folder of the run. The path stored with the run is not used, except for its last part, because
    the campaign may have been moved since."""
    written = (trial.figures or {}).get("run_dir")
    return folder.folder(trial.request) / Path(written).name if written else None


def _thumbnail(folder: CampaignFolder, trial: Trial) -> str:
    run = _run_folder(folder, trial)
    picture = cv2.imread(str(run / "last.jpg")) if run and (run / "last.jpg").is_file() else None
    if picture is None:
        return ""
    size = (THUMBNAIL, round(picture.shape[0] * THUMBNAIL / picture.shape[1]))
    ok, data = cv2.imencode(
        ".jpg", cv2.resize(picture, size, interpolation=cv2.INTER_AREA), [cv2.IMWRITE_JPEG_QUALITY, 80]
    )
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii") if ok else ""


def _millimetres(value: float | None) -> float | None:
    return None if value is None else 1e3 * value


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.0f} %"


def _number(value: Any, digits: int = 1) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _mm(value: float | None) -> str:
    return "–" if value is None else f"{1e3 * value:.1f} mm"


def _signed(value: float | None, scale: float = 1.0, digits: int = 1) -> str:
    return "–" if value is None else f"{scale * value:+.{digits}f}"
