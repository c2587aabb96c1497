"""The workers of a campaign."""

from __future__ import annotations

from pathlib import Path

import pytest

from foldcell.cell.campaigns.executors import chosen_workers
from foldcell.robots.errors import ConfigurationError


def test_more_workers_than_the_memory_bears_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="--workers 9999: this machine has memory for"):
        chosen_workers(9999, None, Path())
    with chosen_workers(1, None, Path()) as workers:
        assert workers.count == 1
