"""The scripts of tests/hil/faults, which are made from the table of faults."""

from __future__ import annotations

import pytest

from benchmarks.fault_scripts import FOLDER, NAMES, script
from foldcell.cell.campaigns.faults.fault_table import DueEnd, read_fault_table
from foldcell.cell.campaigns.hil.script import read_script
from foldcell.cell.campaigns.hil.script_run import check_script
from foldcell.cell.config.cell_settings import load_settings
from foldcell.robots.errors import ConfigurationError

TABLE = read_fault_table()


def test_each_script_is_the_one_that_the_table_gives() -> None:
    assert {path.stem: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()} == {
        name: script(TABLE, name) for name in NAMES
    }
    ends = {end for name in NAMES for end in TABLE.faults[name].end}
    assert len(NAMES) > 20 and ends == set(DueEnd)


@pytest.mark.parametrize("name", NAMES)
def test_a_script_has_the_fault_of_its_name_and_is_for_simulated_cells(name: str) -> None:
    read = read_script(FOLDER / f"{name}.yaml")
    check_script(read, load_settings(), "sim")
    (action,) = read.do
    assert action.fault is not None and action.fault.kind is TABLE.faults[name].kind
    with pytest.raises(ConfigurationError, match="only a simulated cell has faults"):
        check_script(read, load_settings(), "ros")
