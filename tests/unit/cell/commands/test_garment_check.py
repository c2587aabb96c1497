"""The prediction of `foldcell garment check`, by a real simulation of the fabric whose mesh is coarsest."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest
import yaml

from foldcell.cell.commands.main import main
from foldcell.cell.config.garments.garment_file import shipped_garment_path


def test_garment_check_tells_which_fold_will_not_go_and_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A towel as stiff as cardboard: its first fold opens into a tube, of which a hand takes the upper layer."""
    data = yaml.safe_load(shipped_garment_path("small_towel").read_text(encoding="utf-8"))
    data["material"] = {k: v for k, v in data["material"].items() if k not in ("fabric", "hang_drop")}
    data["material"]["bending_length"] = 0.06
    stiff = tmp_path / "stiff.yaml"
    stiff.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    line = ["garment", "check", str(stiff), "--draw", str(tmp_path), "--logs", str(tmp_path), "--json"]
    assert main(line) == 2
    (found,) = json.loads(capsys.readouterr().out.splitlines()[-1])["checked"]
    half, quarter = found["prediction"]["folds"]
    assert not found["good"] and half["good"] and not quarter["good"]
    assert all(reason["hint"] for reason in quarter["reasons"])
    assert any("short of its place (limit 30 mm)" in reason["what"] for reason in quarter["reasons"])
    assert quarter["dissimilarity_m"] > quarter["dissimilarity_limit_m"] > half["dissimilarity_m"]
    assert quarter["iou"] < quarter["limits"]["iou"] and "height_m" in quarter["limits"]
    picture = cv2.imread(found["prediction"]["drawing"])
    assert picture is not None
    assert {(80, 160, 40), (240, 226, 214)} <= {tuple(c) for c in picture.reshape(-1, 3)}  # plan and cloth (BGR)
