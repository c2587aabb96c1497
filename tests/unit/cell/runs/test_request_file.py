"""The request of a run is saved in its folder and read back unchanged."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import pytest

from foldcell.cell.config.calibration_file import table_text
from foldcell.cell.config.garments.garment_file import load_garment, shipped_garment_path
from foldcell.cell.runs.request_file import keep_request, load_request
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.robots.errors import ConfigurationError
from tests.runs import fold_request


def kept(tmp_path: Path, request: FoldRequest) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    keep_request(folder, request)
    return folder


def test_a_request_is_read_back_with_the_exact_settings(tmp_path: Path) -> None:
    request = fold_request(tmp_path, seed=7, realtime=True)
    request = replace(request, page=True, page_port=8080, page_origin="http://localhost:9000")
    back = load_request(kept(tmp_path, request), request.logs, quiet=True)
    assert back.settings.fingerprint() == request.settings.fingerprint()
    same = {f.name for f in fields(FoldRequest)} - {"settings"}
    assert {n: getattr(back, n) for n in same} == {n: getattr(request, n) for n in same}


def test_a_request_without_the_origin_of_its_page_is_read(tmp_path: Path) -> None:
    """Earlier versions of the program did not keep it."""
    request = fold_request(tmp_path)
    path = kept(tmp_path, request) / "request.json"
    told = json.loads(path.read_text("utf-8"))
    del told["page_origin"]
    path.write_text(json.dumps(told), encoding="utf-8")
    assert load_request(path.parent, request.logs).page_origin == ""


def test_a_user_garment_file_is_kept_with_the_run(tmp_path: Path) -> None:
    """The garment file may have the name of the settings file, and the original may change or be deleted."""
    source = tmp_path / "mine" / "cell.yaml"
    source.parent.mkdir()
    source.write_bytes(shipped_garment_path("small_towel").read_bytes())
    request = fold_request(tmp_path, garment=str(source))
    folder = kept(tmp_path, request)
    source.unlink()
    back = load_request(folder, request.logs)
    assert load_garment(back.garment).name == "cell"
    assert back.settings.fingerprint() == request.settings.fingerprint()


@pytest.mark.parametrize("damage", [None, "", "[]", '{"schema": 99}', '{"schema": 1, "garment": "x"}'])
def test_a_run_folder_without_a_request_is_refused(tmp_path: Path, damage: str | None) -> None:
    request = fold_request(tmp_path)
    folder = kept(tmp_path, request)
    path = folder / "request.json"
    path.unlink() if damage is None else path.write_text(damage, encoding="utf-8")
    with pytest.raises(ConfigurationError, match="the request of the run"):
        load_request(folder, request.logs)


def test_a_calibration_that_has_changed_since_is_refused(tmp_path: Path) -> None:
    """What the run saw and planned with the old calibration is void."""
    table = tmp_path / "table.yaml"
    table.write_text(table_text(-0.11), encoding="utf-8")
    request = fold_request(tmp_path, {"table": {"calibration": str(table)}})
    folder = kept(tmp_path, request)
    assert load_request(folder, request.logs).settings.table.height == request.settings.table.height
    table.write_text(table_text(-0.10), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"the calibration has changed since .*table\.yaml"):
        load_request(folder, request.logs)


def test_a_saved_request_is_readable_json(tmp_path: Path) -> None:
    told = json.loads((kept(tmp_path, fold_request(tmp_path, seed=3)) / "request.json").read_text("utf-8"))
    assert (told["garment"], told["seed"], told["driver"], told["world"]) == ("small_towel", 3, "sim", "xpbd")
