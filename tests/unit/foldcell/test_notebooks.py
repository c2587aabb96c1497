"""The notebook that reads a campaign runs. The other one of docs/learn runs in test_api_page.py."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from foldcell.cell.campaigns.perform_campaign import Workers, perform_campaign
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.robots.errors import FailureKind
from tests.builders.campaigns import record, trials_campaign
from tests.notebooks import performed
from tests.optional_parts import PANDAS


@PANDAS.required
def test_the_notebook_reads_a_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "logs" / "trials-20261128T120000Z"
    path.mkdir(parents=True)
    opened = CampaignFolder.create(path, trials_campaign((1, 2), ("towel", "shirt")), tmp_path / "logs")

    def folded(request: Any, folder: Path) -> Trial:
        failed = {"result": "not_folded", "passed": False, "failure": FailureKind.SLIPPED}
        return Trial(request, record(**failed if request.key[-1] == 2 else {}))

    with ThreadPoolExecutor(1) as pool:
        perform_campaign(opened, Workers(pool, 1), lambda trial: None, folded)
    monkeypatch.chdir(tmp_path)
    names = performed("campaign")
    assert list(names["table"]["runs"]) == [2, 2] and list(names["table"]["success"]) == [1, 1]
    assert dict(names["causes"]) == {"slipped": 2}
    assert dict(names["recovered"]) == {"half": 8, "quarter": 0}
