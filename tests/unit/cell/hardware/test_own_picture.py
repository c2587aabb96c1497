"""A garment that `foldcell garment check` calls good is recognised where it lies as its file states."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from foldcell.cell.commands.main import main
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.hardware.own_picture import own_picture_refused
from foldcell.robots.errors import FailureKind


@pytest.mark.parametrize("name", list_garments())
def test_every_shipped_garment_is_recognised_in_its_own_picture(name: str) -> None:
    assert own_picture_refused(load_garment(name), load_settings()) is None


@pytest.mark.parametrize(
    ("cell", "refused"),
    [
        ("camera: {width: 160, height: 120}", False),  # confidence 0.59: a run accepts 0.3
        ("perception: {least_confidence: 0.95}", True),  # confidence 0.91
    ],
)
def test_the_check_is_as_strict_as_a_run(cell: str, refused: bool, tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(cell)
    failure = own_picture_refused(load_garment("jeans"), load_settings(tmp_path / "cell.yaml"))
    assert (failure is not None) is refused
    if failure:
        assert failure.kind is FailureKind.LOW_CONFIDENCE and 0.85 < failure.values["confidence"] < 0.95


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
