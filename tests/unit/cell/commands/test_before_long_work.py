"""What makes a command's long work useless is found before the work begins: an output that cannot be written, a
cell or a garment that every run would refuse, too little space."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from test_foreign_files import SCRIPT, own_garment, photograph

from foldcell.cell.campaigns.trials.campaign import CampaignFile, campaign_of
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.commands.main import main
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.support.files import paths
from foldcell.cell.support.files.paths import KEPT_BYTES, LEAST_FREE_BYTES

TOO_LONG = "a" * 250
"""A file of this name and an ending can be made, but not beside it the one that it is renamed from."""

Line = Callable[[Path], str]
OUTPUTS: dict[str, tuple[str, Line]] = {
    "trajectories": (".csv", lambda out: f"optimise small_towel --export {out}"),
    "library": (".json", lambda out: f"library build small_towel --output {out}"),
    "calibration": (".yaml", lambda out: f"calibrate table --output {out}"),
    "fabric": (".yaml", lambda out: f"calibrate friction small_towel --height 0.3 --length 1.0 --output {out}"),
    "results": (".xml", lambda out: f"hil script.yaml --junit {out}"),
    "overlay": (".png", lambda out: f"perceive photo.png --output {out}"),
    "garment": (".yaml", lambda out: f"garment new photo.png --like small_towel --length 0.5 --output {out}"),
}


@pytest.fixture
def at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FOLDCELL_LOGS", str(tmp_path / "logs"))
    photograph(tmp_path / "photo.png")
    (tmp_path / "script.yaml").write_text(yaml.safe_dump(SCRIPT))
    return tmp_path


@pytest.mark.parametrize("kind", OUTPUTS)
@pytest.mark.parametrize("place", ["none", TOO_LONG, "folder"])
def test_an_output_that_cannot_be_written(
    kind: str, place: str, at: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ending, line = OUTPUTS[kind]
    path = {"none": at / "none" / f"a{ending}", "folder": at / f"folder{ending}"}.get(
        place, at / f"{place}{ending}"
    )
    if place == "folder":
        path.mkdir()
    before = sorted(at.rglob("*"))
    assert main(line(path).split()) == 64
    told = capsys.readouterr().err
    assert "cannot be written" in told or (place == "folder" and "exists" in told), told
    assert sorted(at.rglob("*")) == before, "nothing was begun, and nothing is left"


@pytest.mark.parametrize(
    "line",
    ["hil script.yaml", "trials --n 1 --garments small_towel", "trials --hours 1 --garments small_towel",
     "trials --faults --only dropped_corner --garments small_towel"],
)  # fmt: skip
def test_a_cell_that_every_run_would_refuse(line: str, at: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (at / "cell.yaml").write_text(yaml.safe_dump({"table": {"x": [1.3, 1.9]}}))
    assert main([*line.split(), "--cell", "cell.yaml"]) == 64
    assert "table.x = [1.3, 1.9]" in capsys.readouterr().err and not (at / "logs").exists()


def test_a_garment_that_every_run_would_refuse(at: Path, capsys: pytest.CaptureFixture[str]) -> None:
    garment = yaml.safe_load(own_garment(at / "tent.yaml").read_text())
    garment["keypoints"] = {name: [3.0 * c for c in place] for name, place in garment["keypoints"].items()}
    (at / "tent.yaml").write_text(yaml.safe_dump(garment, sort_keys=False))
    assert main(["trials", "--n", "1", "--garments", "small_towel,tent.yaml"]) == 64
    assert "lies nowhere wholly on the table" in capsys.readouterr().err and not (at / "logs").exists()


def test_the_variant_whose_cell_is_refused_is_named(at: Path, capsys: pytest.CaptureFixture[str]) -> None:
    variants = {"shipped": {}, "near": {"cell": {"table": {"x": [1.3, 1.9]}}}}
    (at / "two.yaml").write_text(
        yaml.safe_dump({"about": "two", "garments": ["small_towel"], "seeds": [1], "variants": variants})
    )
    assert main(["trials", "two.yaml"]) == 64
    assert "near: table.x = [1.3, 1.9]" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("runs", "line"),
    [
        (1, "hil script.yaml"), (3, "hil script.yaml script.yaml script.yaml"),
        (1, "trials --n 4 --garments small_towel"), (4, "trials --n 4 --garments small_towel --keep all"),
    ],
)  # fmt: skip
def test_space_for_all_recordings_that_are_kept(
    runs: int, line: str, at: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    least = LEAST_FREE_BYTES + (runs - 1) * KEPT_BYTES
    monkeypatch.setattr(paths, "free_bytes", lambda _: least - 1)
    assert main(line.split()) == 64
    assert f"{least / 2**20:.0f} MiB" in capsys.readouterr().err and not (at / "logs").exists()


def test_space_is_also_needed_to_continue(
    at: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    content = CampaignFile.model_validate({"garments": ["small_towel"], "seeds": [1]})
    (at / "begun").mkdir()
    CampaignFolder.create(at / "begun", campaign_of(content, load_settings(None), "sim", "xpbd"), at)
    monkeypatch.setattr(paths, "free_bytes", lambda _: LEAST_FREE_BYTES - 1)
    assert main(["trials", "--resume", "begun"]) == 64
    assert "begun has 200 MiB left; a run needs 200 MiB" in capsys.readouterr().err
