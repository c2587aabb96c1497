"""The results page on perception is made from saved figures."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.perception import document

REQUIRED = {
    "scenes": 400, "held_out_scenes": 133, "paper_method_within_10mm_rate": 0.25, "paper_time_ms": "3000-5000",
    "unknown_scenes": 70, "unknown_accepted_rate": 0.0, "camera_error_mm_median": 3.0,
    "garments": [{"garment": "jeans", "scenes": 37, "accepted_rate": 1.0, "keypoints_within_10mm_rate": 0.97,
                  "worst_keypoint_mm_median": 3.7, "worst_keypoint_mm_p95": None,
                  "paper_method_within_10mm_rate": 0.3}],
    "reliability": [{"confidence_from": 0.9, "scenes": 30, "mean_confidence": 0.93, "within_10mm_rate": 0.9}],
    "inspection_folds_seen": 60, "inspection_pictures": 1300,
    "inspection_curves": [{"defect": "sag", "severity_mm": 40.0, "pictures": 48, "diagnosed_rightly_rate": 1.0,
                           "noticed_rate": 1.0}],
    **{key: 0.991 for key in document.BARS},
}  # fmt: skip


def test_the_page_holds_the_figures_and_its_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(document, "draw_example", lambda: np.zeros((8, 8, 3), np.uint8))
    (tmp_path / "results").mkdir()
    document.write(REQUIRED, tmp_path)
    page = (tmp_path / "results" / "perception.md").read_text()
    assert "| keypoints within 10mm rate | >= 0.95 | 0.991 | - |" in page
    assert "| sag | 40 | 48 | 1 | 1 |" in page
    assert "pictures/perception_fitting.png" in page
    assert cv2.imread(str(tmp_path / "pictures" / "perception_fitting.png")) is not None
