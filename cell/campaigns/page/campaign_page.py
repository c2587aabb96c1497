"""Write the results page of a campaign: rates with intervals, comparisons, distributions, failures with pictures,
all runs.

The page is one file: pictures are inlined, charts are SVG, and nothing is loaded from elsewhere. Links lead to the
reports of the runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np

from foldcell.cell.campaigns.page.charts import rate_chart, strip_chart
from foldcell.cell.campaigns.results import CampaignResults
from foldcell.cell.campaigns.statistics.summary import ALL
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.record.words import difference, figure, garment_name, length, percent, plain, seconds
from foldcell.cell.support.files.encoded_picture import data_uri, jpeg_file, shrunk
from foldcell.cell.support.files.html_page import page_template

PAGE = "campaign.html"
GALLERY = 60
"""Maximum number of failures that the page shows with a picture."""
THUMBNAIL = 240
"""Width of the picture of a failure [px]."""


def campaign_page(folder: CampaignFolder, results: CampaignResults) -> str:
    """Return the page as HTML text. It shows the runs so far."""
    trials, several = results.trials, len(results.variants) > 1
    rates = {
        _group(row.variant, row.garment, several): (row.folded / row.runs, *row.interval)
        for variant in results.variants for row in variant.rows
    }  # fmt: skip
    failures = [t for t in trials if not t.success]
    template = page_template(
        Path(__file__).with_name(PAGE), percent=percent, seconds=seconds, length_m=length, figure=figure,
        difference=difference, garment=garment_name, words=plain,
    )  # fmt: skip
    return template.render(
        name=folder.path.name,
        campaign=folder.campaign,
        results=results,
        performed=len(trials),
        folded=sum(t.success for t in trials),
        several=several,
        all=ALL,
        rates=rate_chart(rates, "share of folded garments with 95 % intervals"),
        times=strip_chart(
            _values(trials, several, lambda t: t.record.robot_time_s if t.record else None), "s",
            "robot times of the runs",
        ),
        heights=strip_chart(
            _values(trials, several, lambda t: None if t.height_m is None else 1e3 * t.height_m), "mm",
            "heights of the folded stacks",
        ),
        failures=[(t, folder.report(t), _thumbnail(folder, t)) for t in failures[:GALLERY]],
        more_failures=len(failures) - GALLERY,
        runs=[(t, folder.report(t)) for t in trials],
    )  # fmt: skip


def _group(variant: str, garment: str, several: bool) -> str:
    name = garment_name(garment)
    return f"{name}, {variant}" if several else name


def _values(
    trials: Iterable[Trial], several: bool, figure: Callable[[Trial], float | None]
) -> dict[str, list[tuple[float, bool]]]:
    """Return for each group (garment and variant) a list of (value, success), one item per run that has the
    figure."""
    groups: dict[str, list[tuple[float, bool]]] = {}
    for trial in sorted(trials, key=lambda t: (t.request.garment, t.request.variant, t.request.seed)):
        value = None if trial.result == "fault" else figure(trial)
        group = groups.setdefault(_group(trial.request.variant, trial.request.garment, several), [])
        if value is not None:
            group.append((value, trial.success))
    return groups


def _thumbnail(folder: CampaignFolder, trial: Trial) -> str:
    run = folder.run_folder(trial)
    if run is None or not (run / "last.jpg").is_file():
        return ""
    picture = cv2.imread(str(run / "last.jpg"), cv2.IMREAD_COLOR_RGB)
    if picture is None:
        return ""
    return data_uri(jpeg_file(shrunk(np.asarray(picture, np.uint8), THUMBNAIL), 80), "jpeg")
