"""README.md is one screen, and its figures are those of the results pages."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from foldcell.cell.campaigns.statistics.proportions import wilson_interval
from foldcell.cell.record.words import interval

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
FIGURES = re.findall(r"^\| ([^|]+) \| (\d+) of (\d+) \(([^)]+)\) \| \[[^]]+\]\(([^)]+)\) \|$", README, flags=re.M)
"""(about, number, of how many, interval, link) of each row of the table."""
PLACES = {
    "docs/results/garments.md": r"^\| all \| (?P<of>\d+) \| (?P<n>\d+) \| ",
    "docs/results/paper_table.md": r"^\| all \|.*\| (?P<n>\d+) of (?P<of>\d+) \| \d+ to ",
    "docs/results/grasps.md": r"^\| all \|  \| (?P<n>\d+) of (?P<of>\d+) \|",
    "docs/results/garments.md#runs": r"^\| all \| \d+ \| \d+ \| [^|]+ \| (?P<of>\d+) \| (?P<n>\d+) \|",
    "docs/results/score.md": r"Wrong verdicts: (?P<n>\d+) of (?P<of>\d+)",
    "docs/results/faults.md#samples-of-all-kinds": r"At their first performance: (?P<n>\d+)\s+of (?P<of>\d+)",
    "docs/results/faults.md#cloth-on-a-finger": r"^Recovered: (?P<n>\d+) of (?P<of>\d+)",
    "docs/results/state_estimate.md": r"^Right: (?P<n>\d+) of (?P<of>\d+)",
    "docs/results/kill_points.md": r"Nothing lost: (?P<n>\d+) of (?P<of>\d+)",
    "docs/results/own_garments.md": r"\*\*(?P<n>\d+) of (?P<of>\d+) passed",
}
"""Link of a row -> where its figures are on the results page."""


def test_the_readme_is_short_and_has_ten_figures_with_one_number_each() -> None:
    assert len(README.splitlines()) <= 80
    table = README.split("## Measured")[1].split("## Three uses")[0]
    assert len(FIGURES) == len(re.findall(r"^\| [^-]", table, flags=re.M)) - 1 == 10


@pytest.mark.parametrize(("about", "n", "of", "ends", "link"), FIGURES)
def test_a_figure_is_that_of_its_page(about: str, n: str, of: str, ends: str, link: str) -> None:
    path, _, anchor = link.partition("#")
    page = (ROOT / path).read_text(encoding="utf-8")
    if anchor:
        page = page.split(f"# {anchor.replace('-', ' ').capitalize()}\n")[1].split("\n#")[0]
    found = re.search(PLACES[link], page, flags=re.M)
    assert found is not None and (found["n"], found["of"]) == (n, of)
    assert ends == interval(wilson_interval(int(n), int(of)))


def test_the_film_lasts_about_ten_seconds_and_is_small() -> None:
    (path,) = re.findall(r"!\[[^]]*\]\(([^)]+)\)", README)
    data = (ROOT / path).read_bytes()
    good, film = cv2.imdecodeanimation(np.frombuffer(data, np.uint8))
    assert good and 8e3 <= np.sum(film.durations) <= 12e3 and len(data) <= 2e6


def test_the_times_of_both_commands_are_those_of_their_page() -> None:
    page = (ROOT / "docs" / "results" / "time.md").read_text(encoding="utf-8")
    page = page.split("## Before and now")[1].split("\n## ")[0]
    now = dict(re.findall(r"^\| (\w[\w ]*?)(?: \([^|]*| )?\|[^|]*\|[^|]*\| (\d+)", page, flags=re.M))
    words = re.findall(r"\((\d+) (?:s|minutes)[^)]*\)", README.split("```")[1])
    suite = round(int(now["the suite"]) / 60)
    assert words == [now["first fold"], str(suite)]
