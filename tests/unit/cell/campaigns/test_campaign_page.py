"""The campaign's page: complete, self-contained, with links to the runs."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from foldcell.cell.campaigns.page.campaign_page import campaign_page
from foldcell.cell.campaigns.page.charts import axis, rate_chart, strip_chart
from foldcell.cell.campaigns.results import CampaignResults
from foldcell.cell.campaigns.trials.campaign import Campaign
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from tests.builders.campaigns import record, request, trial, trials_campaign


def page(tmp_path: Path, trials: list[Trial]) -> str:
    campaign = trials_campaign([1, 2, 3], ("towel", "shirt"), ("shipped", "no_pressing"))
    folder = CampaignFolder.create(tmp_path, campaign, tmp_path / "logs")
    return campaign_page(folder, CampaignResults.of(folder.campaign, trials))


def test_failures_have_their_picture_and_a_link_to_the_report(tmp_path: Path) -> None:
    run = tmp_path / "no_pressing" / "towel-seed2" / "run"
    run.mkdir(parents=True)
    (run / "report.html").write_text("the report")
    cv2.imwrite(str(run / "last.jpg"), np.full((480, 640, 3), 128, np.uint8))
    failed = record(passed=False, height_m=0.03, run_dir="/elsewhere/run")
    text = page(
        tmp_path,
        [
            trial(1),
            Trial(request(2, variant="no_pressing"), failed),
            trial(2),
            Trial(request(3, "shirt"), None, "<crashed>"),
        ],
    )
    assert 'href="no_pressing/towel-seed2/run/report.html"' in text, "relative: a campaign may be moved"
    assert "data:image/jpeg;base64," in text
    assert "&lt;crashed&gt;" in text and "<crashed>" not in text
    assert "unfinished: 4 of 12 runs" in text
    assert "only no_pressing 0, only shipped 1" in text


def test_a_garment_given_as_a_file_is_shown_by_its_name(tmp_path: Path) -> None:
    file = "/home/anyone/garments of the lab/my_shirt_of_a_very_long_name.yaml"
    requests = tuple(request(seed, file) for seed in (1, 2))
    campaign = Campaign("", "all", requests, {"shipped": ""})
    folder = CampaignFolder.create(tmp_path, campaign, tmp_path / "logs")
    failed = Trial(requests[1], record(passed=False, garment=file))
    trials = [Trial(requests[0], record(garment=file)), failed]
    text = campaign_page(folder, CampaignResults.of(folder.campaign, trials))
    assert f'<td title="{file}">my_shirt_of_a_very_long_name</td>' in text
    assert "<title>my_shirt_of_a_very_long_name</title>my_shirt_of_a_very_long_n…</text>" in text
    assert "/home" not in re.sub(r' title="[^"]*"', "", text)


def test_the_page_fetches_nothing(tmp_path: Path) -> None:
    text = page(tmp_path, [trial()])
    assert not re.search(r'(src|href)="(https?:)?//|@import|<script', text)


def test_a_campaign_without_runs_has_a_page(tmp_path: Path) -> None:
    assert "0 of 0 garments folded" in page(tmp_path, [])


def test_each_run_is_a_mark_in_its_row() -> None:
    svg = strip_chart({"towel": [(30.0, True), (31.0, False)], "shirt": [(45.0, True)], "none": []}, "s", "times")
    assert svg is not None
    tree = ElementTree.fromstring(str(svg))
    assert len(tree.findall(".//circle")) == 2, "folded"
    assert len([g for g in tree.findall(".//g") if g.get("class") == "bad"]) == 1
    assert len([p for p in tree.findall(".//path") if p.get("class") == "median"]) == 2


def test_names_in_charts_are_escaped() -> None:
    svg = rate_chart({"<towel> & 'shirt'": (0.5, 0.2, 0.8)}, 'a "title"')
    assert svg is not None and ElementTree.fromstring(str(svg)) is not None


@given(st.floats(-1e6, 1e6), st.floats(0.0, 1e6))
def test_an_axis_contains_its_values_with_few_round_ticks(low: float, span: float) -> None:
    first, last, step = axis(low, low + span)
    slack = 1e-6 * step
    assert first <= low + slack and low + span <= last + slack
    assert 1 <= round((last - first) / step) <= 8
    assert round(step / 10.0 ** np.floor(np.log10(step) + 1e-9), 6) in (1.0, 2.0, 5.0)
