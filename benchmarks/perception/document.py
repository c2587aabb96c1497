"""docs/perception.md and its pictures from the figures of one run.

foldcell bench perception --json > figures.json
python -m benchmarks.perception.document figures.json
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures_file import command, read_figures
from benchmarks.perception.scenes import TABLE, draw_scene
from cell.config.garments.garment_file import list_garments, load_garment
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError
from skills.perception.fitting_picture import draw_fitting
from skills.perception.perceive import perceive

__all__ = ["draw_curve", "draw_example", "draw_reliability", "main", "write"]

DOCS = Path(__file__).parents[2] / "docs"
FEW = 10
"""A rate over fewer scenes is in the table only."""
EXAMPLE = ("long_sleeve_shirt_large", 2)
INK, FAINT, OURS, IDEAL = (52, 44, 40), (225, 225, 225), (170, 90, 40), (150, 150, 150)
FONT = cv2.FONT_HERSHEY_SIMPLEX
BARS = {
    "accepted_rate": ">= 0.97", "keypoints_within_10mm_rate": ">= 0.95", "accepted_beyond_30mm": "0",
    "category_rate": ">= 0.99", "time_ms_median": "<= 100", "time_ms_p99": "<= 200",
    "inspection_detection_rate": ">= 0.95", "inspection_false_alarm_rate": "<= 0.02",
}  # fmt: skip


def write(figures: Mapping[str, Any], docs: Path = DOCS) -> None:
    """The page and its pictures, each whole or not at all. Raises KeyError for a figure that is missing."""
    page = _page(figures)
    pictures = docs / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    bins = [b for key in ("reliability", "held_out_reliability") for b in figures.get(key, [])]
    reliability = [
        (b["mean_confidence"], b["within_10mm_rate"], b["scenes"]) for b in sorted(bins, key=_confidence)
    ]
    _save(pictures / "perception_reliability.png", draw_reliability(reliability))
    curves = {
        kind: [(c["severity_mm"], c["diagnosed_rightly_rate"]) for c in figures["inspection_curves"]
               if c["defect"] == kind and c["severity_mm"] is not None]
        for kind in ("drift", "piling", "sag", "dropped_corner")
    }  # fmt: skip
    _save(pictures / "inspection_curves.png", draw_curve(curves))
    _save(pictures / "perception_fitting.png", draw_example()[:, :, ::-1])
    write_whole(docs / "perception.md", page.encode())


def draw_example() -> NDArray[np.uint8]:
    """(H, W, 3) RGB: how a shirt of the bench is registered."""
    garments = [load_garment(name) for name in list_garments()]
    scene = draw_scene(*EXAMPLE)
    seen = perceive(scene.frame, scene.calibration, TABLE, scene.reference, garments)
    return draw_fitting(seen.unwrap())


def _confidence(of_bin: Mapping[str, float]) -> float:
    return of_bin["mean_confidence"]


def _page(f: Mapping[str, Any]) -> str:
    measured = [
        (key.replace("_", " "), bar, _shown(f[key]), _shown(f.get(f"held_out_{key}"))) for key, bar in BARS.items()
    ]
    garments = [
        (g["garment"], g["scenes"], _shown(g["accepted_rate"]), _shown(g["keypoints_within_10mm_rate"]),
         _shown(g["worst_keypoint_mm_median"]), _shown(g["worst_keypoint_mm_p95"]),
         _shown(g["paper_method_within_10mm_rate"]))
        for g in f["garments"]
    ]  # fmt: skip
    bins = [
        (name, f"{b['confidence_from']:.2f}", b["scenes"], _shown(b["mean_confidence"]),
         _shown(b["within_10mm_rate"]))
        for name, key in (("bench", "reliability"), ("held out", "held_out_reliability"))
        for b in f.get(key, [])
    ]  # fmt: skip
    curves = [
        (c["defect"], "-" if c["severity_mm"] is None else f"{c['severity_mm']:.0f}", c["pictures"],
         _shown(c["diagnosed_rightly_rate"]), _shown(c["noticed_rate"]))
        for c in f["inspection_curves"]
    ]  # fmt: skip
    photographs = [
        (p["ground"], p["photographs"], _shown(p["accepted_rate"]), _shown(p["within_5_percent_rate"]))
        for p in f["photographs_of"]
    ]
    return "\n".join([
        "# What perception sees, measured", "",
        *_prose("""Written by `python -m benchmarks.perception.document` from `foldcell bench perception --json`;
            all pictures are simulated. "Held out" are seeds that nobody looked at while the skill was
            written."""),
        "![The template, its fitting, the result](pictures/perception_fitting.png)", "",
        f"## Key points: {f['scenes']} scenes, {f['held_out_scenes']} held out", "",
        *_table(("figure", "bar", "bench", "held out"), measured),
        *_prose(f"""The paper's own method, in the same scenes: {_shown(f['paper_method_within_10mm_rate'])} within
            10 mm; its time there [ms]: {f['paper_time_ms']}. Things that are no shipped garment:
            {f['unknown_scenes']} pictures, of which a share of {_shown(f['unknown_accepted_rate'])} was
            taken for one. The camera's own error,
            median: {f['camera_error_mm_median']:.1f} mm."""),
        *_table(("garment", "scenes", "accepted", "within 10 mm", "worst point, median mm", "p95 mm",
                 "paper's method"), garments),
        "## Does the confidence hold?", "",
        *_prose("""Of the accepted scenes whose stated confidence lies in a range: how often were all key points
            within 10 mm? What fits badly is refused, so that nearly all that is accepted has the highest
            confidence: it is right on the whole, and tells little between one accepted scene and another."""),
        *_table(("scenes from", "confidence from", "scenes", "mean confidence", "within 10 mm"), bins),
        "![Stated confidence against what was found](pictures/perception_reliability.png)", "",
        f"## After a fold: {f['inspection_folds_seen']} folds, {f['inspection_pictures']} pictures", "",
        *_prose("""Towels, trousers and shirts; severities as displaced or raised by the defect. One layer of
            cloth is no more than a pixel's depth noise: it shows only as the mean over a strip along the moved
            edge. Small sags and lost corners cannot be told from a good fold, low piles not from creases; drift
            below the threshold is no defect, the next fold is planned from where the garment lies."""),
        *_table(("defect", "severity mm", "pictures", "diagnosed rightly", "noticed"), curves),
        "![Rate of right diagnoses over severity](pictures/inspection_curves.png)", "",
        "## Photographs by an unknown camera", "",
        *_prose(f"""{f['photographs']} drawn photographs (no reference, no depth, any resolution, tilt, uneven
            light, JPEG): accepted {_shown(f['photographs_accepted_rate'])}, category right in
            {_shown(f['photographs_category_rate'])} of these, all key points within 2 % of the garment's
            diagonal in {_shown(f['photographs_within_2_percent_rate'])}, within 5 % in
            {_shown(f['photographs_within_5_percent_rate'])}. Thrown down or hung up:
            {f['photographs_not_flat']}, of which {f['photographs_not_flat_accepted']} were taken for a garment
            laid flat. The shapes are not those of the templates: a template of one's own garment does better."""),
        *_table(("ground", "photographs", "accepted", "within 5 %"), photographs),
    ])  # fmt: skip


def _prose(text: str) -> list[str]:
    return [*textwrap.wrap(" ".join(text.split()), 110), ""]


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> list[str]:
    return [
        "| " + " | ".join(head) + " |",
        "|" + " --- |" * len(head),
        *("| " + " | ".join(str(cell) for cell in row) + " |" for row in rows),
        "",
    ]


def draw_reliability(points: Sequence[tuple[float, float, int]]) -> NDArray[np.uint8]:
    """(H, W, 3) BGR: stated confidence across, share within 10 mm up; a dot's size tells the number of scenes."""
    picture, place = _axes("stated confidence", "all key points within 10 mm", (0.5, 1.0), (0.5, 1.0), 0.1, 0.1)
    cv2.line(picture, place(0.5, 0.5), place(1.0, 1.0), IDEAL, 1, cv2.LINE_AA)
    for confidence, rate, scenes in points:
        if scenes < FEW:
            continue
        at = place(confidence, max(rate, 0.5))
        cv2.circle(picture, at, 4 + round(np.sqrt(scenes) / 2), OURS, -1, cv2.LINE_AA)
        cv2.putText(picture, str(scenes), (at[0] - 34, at[1] - 10), FONT, 0.42, INK, 1, cv2.LINE_AA)
    cv2.putText(picture, "numbers: scenes", place(0.52, 0.96), FONT, 0.42, INK, 1, cv2.LINE_AA)
    return picture


def draw_curve(curves: Mapping[str, Sequence[tuple[float, float]]]) -> NDArray[np.uint8]:
    """(H, W, 3) BGR: rate of right diagnoses over severity [mm], a line a kind."""
    picture, place = _axes("severity [mm]", "diagnosed rightly", (0, 120), (0, 1), 20, 0.2)
    colours = ((170, 90, 40), (60, 140, 60), (60, 60, 200), (160, 60, 150))
    for i, (kind, points) in enumerate(curves.items()):
        line = np.array([place(x, y) for x, y in points], np.int32)
        cv2.polylines(picture, [line], False, colours[i], 2, cv2.LINE_AA)
        for at in line.tolist():
            cv2.circle(picture, tuple(at), 4, colours[i], -1, cv2.LINE_AA)
        x, y = place(78, 0.42 - 0.08 * i)
        cv2.line(picture, (x, y - 4), (x + 24, y - 4), colours[i], 2, cv2.LINE_AA)
        cv2.putText(picture, kind.replace("_", " "), (x + 32, y), FONT, 0.45, INK, 1, cv2.LINE_AA)
    return picture


def _axes(
    across: str, up: str, x: tuple[float, float], y: tuple[float, float], dx: float, dy: float
) -> tuple[NDArray[np.uint8], Any]:
    """An empty diagram and the map from values to its pixels."""
    width, height, left, bottom, top, right = 640, 440, 70, 60, 40, 30
    picture = np.full((height, width, 3), 255, np.uint8)

    def place(a: float, b: float) -> tuple[int, int]:
        u = left + (a - x[0]) / (x[1] - x[0]) * (width - left - right)
        v = height - bottom - (b - y[0]) / (y[1] - y[0]) * (height - bottom - top)
        return round(u), round(v)

    for a in np.arange(x[0], x[1] + dx / 2, dx):
        cv2.line(picture, place(a, y[0]), place(a, y[1]), FAINT, 1)
        u, v = place(a, y[0])
        text = f"{a:g}" if dx >= 1 else f"{a:.1f}"
        cv2.putText(picture, text, (u - 12, v + 20), FONT, 0.42, INK, 1, cv2.LINE_AA)
    for b in np.arange(y[0], y[1] + dy / 2, dy):
        cv2.line(picture, place(x[0], b), place(x[1], b), FAINT, 1)
        u, v = place(x[0], b)
        cv2.putText(picture, f"{b:.1f}", (u - 36, v + 5), FONT, 0.42, INK, 1, cv2.LINE_AA)
    cv2.rectangle(picture, place(x[0], y[1]), place(x[1], y[0]), INK, 1)
    cv2.putText(picture, across, (width // 2 - 60, height - 14), FONT, 0.5, INK, 1, cv2.LINE_AA)
    cv2.putText(picture, up, (left, 24), FONT, 0.5, INK, 1, cv2.LINE_AA)
    return picture, place


def _save(path: Path, picture: NDArray[np.uint8]) -> None:
    done, png = cv2.imencode(".png", picture)
    if not done:
        raise AssertionError(f"{path} could not be encoded")
    write_whole(path, png.tobytes())


def main(arguments: Sequence[str]) -> int:
    if len(arguments) != 1:
        raise ConfigurationError(
            "one file of figures is expected", "python -m benchmarks.perception.document figures.json"
        )
    figures = read_figures(Path(arguments[0]), "perception")
    try:
        write(figures)
    except KeyError as e:
        raise ConfigurationError(
            f"{arguments[0]} holds no figures of perception: {e} is not among them",
            "give the output of: foldcell bench perception --json",
        ) from e
    return 0


if __name__ == "__main__":
    sys.exit(command(main))
