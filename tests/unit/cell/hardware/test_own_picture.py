"""A garment that `foldcell garment check` calls good is recognised where it lies as its file states."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cell.commands.main import main
from cell.config.cell_settings import load_settings
from cell.config.garments.garment_file import list_garments, load_garment
from cell.hardware.own_picture import own_picture_refused


@pytest.mark.parametrize("name", list_garments())
def test_every_shipped_garment_is_recognised_in_its_own_picture(name: str) -> None:
    assert own_picture_refused(name, load_garment(name), load_settings()) is None


def test_a_garment_that_the_camera_cannot_tell_from_the_table_is_not_called_good(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The settings of this cell accept only an overlap that no camera delivers."""
    cell = tmp_path / "cell.yaml"
    cell.write_text("schema: 1\nperception: {min_template_iou: 1.0}\n", encoding="utf-8")
    line = ["garment", "check", "small_towel", "--no-predictions", "--cell", str(cell)]
    assert main([*line, "--json"]) == 2
    (found,) = json.loads(capsys.readouterr().out.splitlines()[-1])["checked"]
    assert not found["good"] and found["unrecognised"]["kind"] == "unknown_garment"
    assert main(line) == 2
    assert "not recognised in a drawing of itself" in capsys.readouterr().out
