"""Write the results of a campaign of the table of faults: `faults.json` and `faults.html`."""

from __future__ import annotations

from pathlib import Path

from foldcell.cell.campaigns.faults.fault_table import FaultTable
from foldcell.cell.campaigns.faults.fault_trials import faults_of
from foldcell.cell.campaigns.faults.results import FaultResults
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.record.words import garment_name, percent, plain, seconds
from foldcell.cell.support.files.html_page import page_template
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.cell.support.json_values import write_json

RESULTS, PAGE = "faults.json", "faults.html"


def write_fault_results(table: FaultTable, folder: CampaignFolder, trials: list[Trial]) -> None:
    """Write the results so far and their page. Raises StorageError."""
    results = FaultResults.of(table, trials)
    write_json(folder.path / RESULTS, results.as_json())
    template = page_template(
        Path(__file__).with_name(PAGE), garment=garment_name, percent=percent, words=plain, seconds=seconds
    )
    page = template.render(
        name=folder.path.name,
        campaign=folder.campaign,
        performed=len(results.runs),
        good=sum(total.due for total in results.totals.values()),
        struck=sum(total.runs for total in results.totals.values()),
        results=results,
        runs=[
            (trial, verdict, faults_of(trial.request), folder.report(trial))
            for trial, verdict in sorted(results.runs, key=lambda run: run[1].due)
        ],
        why={name: entry.why for name, entry in table.faults.items()},
    )
    write_whole(folder.path / PAGE, page)
