"""A synthetic run record with everything that a page can show."""

from __future__ import annotations

import cv2
import numpy as np
import synthetic_run as show

from cell.report.page import Picture, RunRecord, ScoreRow, StepRecord, TimelineItem
from cell.report.pictures.fold_pictures import KeyFrame, fold_strip
from skills.fold_figures.outline import outline


def run_record() -> RunRecord:
    towel = show.Towel.make()
    vertices = np.column_stack([towel.material, np.full(len(towel.material), 0.001)])
    before = show.picture(vertices, towel, 1, 0.0)
    records = []
    for step in show.steps():
        arcs = {i.planned_arm: show.arc(step, i) for i in step.grasps}
        frames = [
            KeyFrame(
                show.turned(vertices, step.line, np.pi * k / 5, 0.004 * (step.index + 1)),
                {side: path[round(39 * k / 5)] for side, path in arcs.items()},
                f"{0.8 * k:.1f} s",
            )
            for k in range(6)
        ]
        pictures = fold_strip(frames, towel.triangles, list(arcs.values()), show.TABLE)
        vertices = frames[-1].vertices
        target = outline(vertices, towel.triangles)
        seen = [c + np.array([0.004, -0.006]) for c in target]
        records.append(
            StepRecord(
                step.name, ("optimised", "library")[step.index], 54 * (1 - step.index), 0.0123, 0.97, 0.94, 0.0072,
                2 - step.index, ("grasp_again",) * (1 - step.index), 4.0, True,
                tuple(Picture(p, f.caption) for p, f in zip(pictures, frames, strict=True)),
                "drawn from the recorded garment (simulation)",
                tuple(target), tuple(c + 0.002 for c in target), tuple(seen), 0.0188, (0.0273,) * (1 - step.index),
            )
        )  # fmt: skip
    after = show.picture(vertices, towel, 2, 30.0)
    return RunRecord(
        run_id="20260101-120000-medium_towel-7",
        garment="medium_towel",
        result="folded",
        title="Medium towel",
        seed=7,
        world="xpbd",
        started="1 January 2026, 12:00:00",
        robot_time_s=81.4,
        wall_time_s=33.2,
        steps=tuple(records),
        stage_times_s={"looking": 2.1, "recognising": 4.0, "optimising": 12.5, "folding": 9.3, "retreating": 6.0},
        stage_wall_times_s={"looking": 0.6, "recognising": 0.8, "optimising": 14.1, "folding": 5.2},
        timeline=(
            TimelineItem(31.22, "failure", "missed_grasp", "right: 0.1 N between the pads, 2.1 N expected"),
            TimelineItem(31.25, "recovery", "grasp_again", "5 mm lower"),
        ),
        score=(
            ScoreRow("iou", 0.941, 0.90, at_least=True),
            ScoreRow("correspondence_m", 0.0093, 0.018, unit="m"),
            ScoreRow("edges_m", 0.0412, 0.030, unit="m"),
            ScoreRow("height_m", 0.0101, 0.018, unit="m", ideal=0.0143),
            ScoreRow("drift_m", 0.0072, 0.050, unit="m"),
            ScoreRow("drift_rad", 0.031, 0.1745, unit="rad"),
        ),
        pictures=(
            Picture(before.rgb, "Before"),
            Picture(cv2.GaussianBlur(before.rgb, (5, 5), 0), "Recognised: towel, confidence 0.97"),
            Picture(after.rgb, "After"),
        ),
        versions={"foldcell": "0.1.0", "python": "3.11.9", "numpy": np.__version__},
        settings={"garment": "medium_towel", "cell": {"table": {"height_m": -0.1, "x_m": [0.2, 1.0]}}},
        recording="run.rrd",
        recording_note="complete",
    )
