"""The record of a synthetic run, and pictures of everything that a report can show."""

from __future__ import annotations

import cv2
import numpy as np
import synthetic_run as show

from foldcell.cell.record.run_record import FoldRecord, GraspRecord, RunEvent, RunRecord
from foldcell.cell.report.page import FoldPictures, ReportPictures
from foldcell.cell.report.pictures.film import CaptionedPicture
from foldcell.cell.report.pictures.fold_pictures import KeyFrame, Scenery, fold_strip, motion_view
from foldcell.robots.errors import FailureKind
from foldcell.skills.fold_figures.drawn_mesh import outline
from tests.builders.records import run_record, score_record

LIMITS = {
    "iou": 0.90, "correspondence_m": 0.018, "edges_m": 0.030, "height_m": 0.018, "drift_m": 0.050,
    "drift_rad": 0.1745,
}  # fmt: skip
GOOD_SCORE = score_record(
    LIMITS, iou=0.941, correspondence_m=0.0093, edges_m=0.0212, height_m=0.0101, drift_m=0.0072, drift_rad=0.031,
    ideal_height_m=0.0143,
)  # fmt: skip


GRASPS = (
    GraspRecord(31.2, "right", 0.0043, "tip", 0.21, 0.0011, 0, FailureKind.MISSED_GRASP),
    GraspRecord(44.8, "right", 0.0041, "tip", 1.834, 0.0036, 2),
)


def report_record() -> RunRecord:
    """Two folds, of which the first was grasped twice and pressed."""
    folds = tuple(
        FoldRecord(
            step.name, done=True, accepted=True, source=("optimised", "library")[step.index],
            simulations=54 * (1 - step.index), dissimilarity_m=0.0123, aligned_iou=0.97, observed_iou=0.94,
            drift_m=0.0072, observed_height_m=0.0188, pressed_from_m=(0.0273,) * (1 - step.index), duration_s=4.0,
            attempts=2 - step.index, recoveries=("missed_grasp -> grasp_again",) * (1 - step.index),
            grasps=GRASPS[step.index :],
            repairs=("undo: the hands carry the moved cloth back where it lay before the fold",) * step.index,
        )
        for step in show.steps()
    )  # fmt: skip
    return run_record(
        steps=folds,
        score=score_record(**{**vars(GOOD_SCORE), "passed": False, "shape": False, "edges_m": 0.0412}),
        stage_times_s={"looking": 2.1, "recognising": 4.0, "optimising": 12.5, "folding": 9.3},
        events=(
            RunEvent(31.22, "failure", "missed grasp", "right: 0.1 N between the pads, 2.1 N expected"),
            RunEvent(31.25, "recovery", "grasp again", "planned the motion again"),
        ),
    )


def report_pictures() -> ReportPictures:
    towel = show.Towel.make()
    vertices = np.column_stack([towel.material, np.full(len(towel.material), 0.001)])
    before = show.picture(vertices, towel, 1, 0.0).rgb
    folds = {}
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
        paths = list(arcs.values())
        pictures = fold_strip(frames, towel.triangles, motion_view(frames, paths), Scenery(show.TABLE, paths))
        vertices = frames[-1].vertices
        predicted = outline(vertices, towel.triangles)
        folds[step.name] = FoldPictures(
            tuple(CaptionedPicture(p, f.caption) for p, f in zip(pictures, frames, strict=True)),
            "drawn from the recorded garment (simulation)",
            {"predicted": predicted, "observed": [c + np.array([0.004, -0.006]) for c in predicted]},
        )
    after = show.picture(vertices, towel, 2, 30.0).rgb
    recognised = CaptionedPicture(cv2.GaussianBlur(before, (5, 5), 0), "Recognised: towel, confidence 0.97")
    return ReportPictures(
        folds, (CaptionedPicture(before, "Before"), recognised, CaptionedPicture(after, "After"))
    )
