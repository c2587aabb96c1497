"""Writes the paper's table of folding tests, with our results beside it, to docs/results/paper_table.md.

    python -m benchmarks.paper_table [CAMPAIGN_FOLDER]

Without a folder, the campaign benchmarks/campaigns/paper.yaml is performed first (about ten minutes on two cores).
The table of a campaign at the emulator or the robot is written into the campaign's folder, so that it never shares
a page with simulated results.
"""

from __future__ import annotations

import statistics
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.results_page import causes, origin, table
from foldcell.cell.campaigns.statistics.proportions import wilson_interval
from foldcell.cell.campaigns.statistics.summary import claims
from foldcell.cell.campaigns.trials.campaign import read_campaign
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.commands.run.perform import new_campaign, perform
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.record.words import interval, plain

ROOT = Path(__file__).resolve().parents[1]
CAMPAIGN = ROOT / "benchmarks" / "campaigns" / "paper.yaml"
PAGE = ROOT / "docs" / "results" / "paper_table.md"


@dataclass(frozen=True)
class PaperRow:
    """A row of the paper's last table: ten trials with a real Baxter. time_s: mean over the successful
    trials [s]."""

    folds: int
    successes: int
    time_s: int


TRIALS = 10
PAPER = {
    "long_sleeve_shirt_large": PaperRow(3, 10, 121),
    "long_sleeve_shirt_small": PaperRow(3, 10, 118),
    "jeans": PaperRow(2, 7, 88),
    "pants": PaperRow(2, 8, 88),
    "large_towel": PaperRow(2, 10, 90),
    "medium_towel": PaperRow(2, 10, 88),
    "small_towel": PaperRow(2, 10, 83),
}
COLUMNS = (
    "garment", "folds, paper", "folds, ours", "success, paper", "folded, ours", "interval, ours", "time, paper",
    "time, ours",
)  # fmt: skip
PAPERS = """# Results: the paper's table

Li et al. (IROS 2015) folded each garment ten times with a real Baxter and judged by eye. Our runs are
**{label}**. """
SCORED = """They are judged by the scorer on the simulated garment, which is stricter: overlap,
correspondence, edges, key points, drift and heights all have to pass. So the columns do not compare robots; they
show the same tasks side by side. "Folded" means that the executive claimed the fold and the scorer passed it.
"""
JUDGED = """The person at the cell looked at each garment and judged it before
reading the executive's claim. "Folded" means that the executive claimed the fold and the person passed it.
"""
READING = """Intervals: Wilson, 95 %. Times: average over the successful runs, from the first look to the parked
arms, without waiting for a person.
"""


def page(campaign: CampaignFolder, trials: Sequence[Trial]) -> str:
    """Write the page as Markdown."""
    rows = [_row(name, [t for t in trials if t.request.garment == name]) for name in PAPER]
    ours = [t for t in trials if t.performed]
    rows.append(_row("all", ours))
    seeds = sorted({t.request.seed for t in ours})
    found, about = claims(ours), campaign.campaign
    judged = JUDGED if about.attended else SCORED
    lines = [
        PAPERS.format(label=about.label) + judged + READING,
        origin(campaign.campaign),
        f"- Command: `python -m benchmarks.paper_table CAMPAIGN_FOLDER`; "
        f"{'runs' if about.attended else 'seeds'} {', '.join(map(str, seeds))}.",
        f"- Claims: {found.claimed_passed} true, {found.claimed_failed} false; {found.unclaimed_passed} good "
        "folds were not claimed.",
        "",
        table("Folding tests", COLUMNS, rows),
        "",
        *causes(ours),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _row(name: str, trials: Sequence[Trial]) -> tuple[str, ...]:
    times = [t.record.robot_time_s for t in trials if t.success and t.record]
    folds = sorted({len(t.record.steps) for t in trials if t.record})
    paper = PAPER.get(name)
    if paper is None:
        successes = sum(row.successes for row in PAPER.values())
        published = ("", f"{successes} of {TRIALS * len(PAPER)}", "97 s")
    else:
        published = (str(paper.folds), f"{paper.successes} of {TRIALS}", f"{paper.time_s} s")
    return (
        plain(name),
        published[0],
        "" if paper is None else ", ".join(map(str, folds)),
        published[1],
        f"{len(times)} of {len(trials)}",
        interval(wilson_interval(len(times), len(trials))),
        published[2],
        f"{statistics.mean(times):.0f} s" if times else "-",
    )


def main(arguments: Sequence[str]) -> int:
    if arguments:
        folder = CampaignFolder.open(Path(arguments[0]))
    else:
        options = Namespace(logs=None, workers=None, cluster=None, resume=None, json=False)
        folder = new_campaign(read_campaign(CAMPAIGN, load_settings()), "trials", options)
        perform(folder, options)
    finished = folder.finished()
    if len(finished) < len(folder.campaign.requests):
        print(f"unfinished: foldcell trials --resume {folder.path}", file=sys.stderr)
        return 2
    path = PAGE if folder.campaign.label == "simulated" else folder.path / PAGE.name
    path.write_text(page(folder, [t for t in finished if t.request.garment in PAPER]), encoding="utf-8")
    print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
