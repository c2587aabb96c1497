"""Draw photographs of garments, show them to the perception, and print how well it did."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from benchmarks.photographs.judge import LIMITS, Judgement, as_record, figures, held, judge
from benchmarks.photographs.photograph import Photograph, draw
from benchmarks.photographs.sheet import sheet, tile

SHOWN = 32
"""Pictures on the sheet: the refused ones first, then the worst."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.photographs", description=__doc__)
    parser.add_argument("--count", type=int, default=100, help="number of photographs (100)")
    parser.add_argument("--first-seed", type=int, default=7001, help="seed of the first one (7001)")
    parser.add_argument("--out", type=Path, required=True, help="folder for pictures, truth and results")
    parser.add_argument("--draw-only", action="store_true", help="draw, but judge nothing")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    judgements: list[Judgement] = []
    tiles: list[np.ndarray] = []
    for seed in range(args.first_seed, args.first_seed + args.count):
        photograph = draw(seed)
        save(args.out, photograph)
        if args.draw_only:
            tiles.append(tile(photograph))
            continue
        judgements.append(judge(photograph))
        tiles.append(tile(photograph, judgements[-1]))
        records = {"figures": figures(judgements), "photographs": [as_record(j) for j in judgements]}
        (args.out / "results.json").write_text(json.dumps(records, indent=1))
    if judgements:
        tiles = [tiles[i] for i in sorted(range(len(tiles)), key=lambda i: _badness(judgements[i]))[:SHOWN]]
        report(judgements)
    cv2.imwrite(str(args.out / "sheet.png"), sheet(tiles))
    return 0 if all(held(name, figures(judgements)[name]) for name in LIMITS if judgements) else 1


def save(folder: Path, photograph: Photograph) -> None:
    """The picture, that of the empty table, and the truth."""
    cv2.imwrite(str(folder / f"{photograph.seed}.png"), photograph.picture[..., ::-1])
    if photograph.reference is not None:
        cv2.imwrite(str(folder / f"{photograph.seed}_empty.png"), photograph.reference[..., ::-1])
    (folder / f"{photograph.seed}.json").write_text(json.dumps(photograph.truth, indent=1))


def report(judgements: list[Judgement]) -> None:
    """The figures of all photographs beside their limits, and of parts of them."""
    for name, value in figures(judgements).items():
        limit = ""
        if name in LIMITS:
            relation, bound = LIMITS[name]
            limit = f"  (asked {relation} {bound}: {'held' if held(name, value) else 'MISSED'})"
        print(f"{name:26}{value:9.3f}{limit}")
    parts = {
        "camera stated, empty table": [j for j in judgements if j.reference],
        "camera stated": [j for j in judgements if j.known_camera and not j.reference],
        "camera unknown": [j for j in judgements if not j.known_camera],
        "garment stated": [j for j in judgements if j.stated],
        "garment unknown": [j for j in judgements if not j.stated],
    }
    for category in sorted({j.category for j in judgements}):
        parts[category] = [j for j in judgements if j.category == category]
    print(f"\n{'':28}pictures  accepted  right  beyond 30 mm  wrong category")
    for name, part in parts.items():
        if part:
            f = figures(part)
            print(
                f"{name:28}{len(part):8}{f['accepted_share']:10.2f}{f['right_share_of_accepted']:7.2f}"
                f"{f['beyond_30_mm']:14.0f}{f['wrong_categories']:16.0f}"
            )


def _badness(judgement: Judgement) -> tuple[int, float]:
    if not judgement.accepted:
        return 0, 0.0
    return 1, -(judgement.error_m if judgement.error_m is not None else 1.0)


if __name__ == "__main__":
    raise SystemExit(main())
