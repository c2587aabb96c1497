"""Writes the results of a campaign of all garments to docs/results/garments.md.

foldcell trials benchmarks/campaigns/garments.yaml
python -m benchmarks.garment_table CAMPAIGN_FOLDER
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.results_page import causes, origin, table
from foldcell.cell.campaigns.statistics.proportions import wilson_interval
from foldcell.cell.campaigns.statistics.summary import claims
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.record.words import interval, plain

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "garments.md"
NEAR = 0.002
"""A run counts as near the limit if its height differs by less than this from the score's limit [m]."""
COLUMNS = (
    "garment", "runs", "passed", "interval", "claimed", "false claims", "good, not claimed",
    "near the height limit", "robot time, s", "wall time, s",
)  # fmt: skip
INTRODUCTION = """# Results: all garments

Simulated. "Passed" is the verdict of the scorer, which sees the true shape: shape, and flatness against the
ideal fold of the same fabric. "Claimed" means that the executive ended the run as folded, from the camera
alone. Each seed draws another fabric from the class of the garment, another outline, and another cell. Runs
whose height is within 2 mm of its limit are counted apart. Intervals: Wilson, 95 %. Times: means over all runs.

The bending lengths of the fabrics are assumed, or taken from few published figures; the height of the creases
depends on them. The simulated cell draws them from the whole range of their class
(`skills/garments/fabrics/fabrics.yaml`).

![A long-sleeve shirt, predicted (upper rows) and in the cell (lower rows)](../pictures/long_sleeve_shirt.webp)
"""


def page(campaign: CampaignFolder, trials: Sequence[Trial]) -> str:
    """Write the page as Markdown."""
    names = sorted({t.request.garment for t in trials})
    rows = [_row(name, [t for t in trials if t.request.garment == name]) for name in names]
    rows.append(_row("all", trials))
    seeds = sorted({t.request.seed for t in trials})
    lines = [
        INTRODUCTION,
        origin(campaign.campaign),
        f"- Command: `foldcell trials benchmarks/campaigns/garments.yaml`; seeds {', '.join(map(str, seeds))}.",
        "",
        table("Runs", COLUMNS, rows),
        "",
        *causes(trials),
    ]
    return "\n".join(lines) + "\n"


def _row(name: str, trials: Sequence[Trial]) -> tuple[str, ...]:
    passed = [t for t in trials if t.passed]
    found = claims(trials)
    records = [t.record for t in trials if t.record]
    return (
        plain(name),
        str(len(trials)),
        str(len(passed)),
        interval(wilson_interval(len(passed), len(trials))),
        str(sum(t.claimed for t in trials)),
        str(found.claimed_failed),
        str(found.unclaimed_passed),
        str(sum(_near_limit(t) for t in trials)),
        f"{statistics.mean(r.robot_time_s for r in records):.0f}" if records else "-",
        f"{statistics.mean(r.wall_time_s for r in records):.0f}" if records else "-",
    )


def _near_limit(trial: Trial) -> bool:
    height = trial.score.judged.get("height_m") if trial.score else None
    return height is not None and abs(height.value - height.limit) < NEAR


def main(arguments: Sequence[str]) -> int:
    if len(arguments) != 1:
        print(__doc__, file=sys.stderr)
        return 64
    campaign = CampaignFolder.open(Path(arguments[0]))
    PAGE.write_text(page(campaign, campaign.finished()), encoding="utf-8")
    print(PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
