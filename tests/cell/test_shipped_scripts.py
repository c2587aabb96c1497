"""The scripts of tests/hil, which `make hil` and README show: each ends as it expects in the simulated cell."""

from __future__ import annotations

from pathlib import Path

import pytest

from cell.commands.main import main

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

SCRIPTS = Path(__file__).parents[1] / "hil"
IN_THE_TEST_OF_THE_COMMAND = {"no_garment", "abort_with_cloth_in_the_hands"}
"""Performed by test_hil_command.py."""


@pytest.mark.parametrize(
    "name", sorted({path.stem for path in SCRIPTS.glob("*.yaml")} - IN_THE_TEST_OF_THE_COMMAND)
)
def test_a_shipped_script_ends_as_it_expects(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["hil", str(SCRIPTS / f"{name}.yaml"), "--logs", str(tmp_path)])
    assert code == 0, capsys.readouterr().out
