"""Draw photographs of garments, show them to the perception, and print how well it did."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from benchmarks.photographs import judge as judging
from benchmarks.photographs.phone.photograph import draw as draw_phone
from benchmarks.photographs.photograph import Photograph
from benchmarks.photographs.real.photograph import draw as draw_real
from benchmarks.photographs.sheet import sheet, tile

SETS = {"phone": draw_phone, "real": draw_real}
SHOWN = 32
"""Pictures on one sheet."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.photographs", description=__doc__)
    parser.add_argument("--set", choices=sorted(SETS), default="phone", help="which pictures (phone)")
    parser.add_argument("--count", type=int, default=100, help="number of photographs (100)")
    parser.add_argument("--first-seed", type=int, default=1, help="seed of the first one (1)")
    parser.add_argument("--out", type=Path, required=True, help="folder for pictures, truth, results and sheets")
    parser.add_argument("--draw-only", action="store_true", help="draw, but judge nothing")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    draw = SETS[args.set]
    judgements: list[judging.Judgement] = []
    tiles: list[np.ndarray] = []
    for seed in range(args.first_seed, args.first_seed + args.count):
        photograph = draw(seed)
        save(args.out, photograph)
        if args.draw_only:
            tiles.append(tile(photograph, {}, "" if photograph.stated else "auto"))
            continue
        judgement = judging.judge(photograph)
        judgements.append(judgement)
        stated = "" if photograph.stated else "auto: "
        tiles.append(tile(photograph, judgement.found_px, stated + judging.caption(judgement)))
        print(f"{len(judgements)} of {args.count}, seed {seed}: {stated}{judging.caption(judgement)}", flush=True)
        records = {
            "figures": judging.figures(judgements),
            "photographs": [judging.as_record(j) for j in judgements],
        }
        (args.out / "results.json").write_text(json.dumps(records, indent=1))
    if judgements:
        tiles = [tiles[i] for i in sorted(range(len(tiles)), key=lambda i: judging.badness(judgements[i]))]
        judging.report(judgements)
    for page in range(0, len(tiles), SHOWN):
        cv2.imwrite(str(args.out / f"sheet_{page // SHOWN + 1}.jpg"), sheet(tiles[page : page + SHOWN]))
    measured = judging.figures(judgements) if judgements else {}
    return 0 if all(judging.held(name, measured[name]) for name in judging.LIMITS if judgements) else 1


def save(folder: Path, photograph: Photograph) -> None:
    """The picture and the truth."""
    cv2.imwrite(str(folder / f"{photograph.seed}.png"), photograph.picture[..., ::-1])
    (folder / f"{photograph.seed}.json").write_text(json.dumps(photograph.truth, indent=1))


if __name__ == "__main__":
    raise SystemExit(main())
