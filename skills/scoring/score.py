"""The score of a simulated run: a comparison of the final garment with the target of its plan.

The scorer reads the world's truth (final vertices, flat rest shape), which neither the executive nor any skill can
see. Its result affects no decision of a run.

The target is the plan applied to the world's true rest shape. The mesh is cut along the fold lines, so that every
triangle lies on one side of each line, and is folded as a perfect isometry. The final shape is aligned with the
target (alignment.py), and all figures of the shape are computed after this alignment. The verdicts are in
verdict.py.

Lengths in metres, angles in radians, table frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from foldcell.skills.fold_figures.fold_figures import measure_cut_fold
from foldcell.skills.fold_figures.folded_mesh import fold_mesh
from foldcell.skills.fold_plan.folding import fold_xy
from foldcell.skills.fold_plan.plan import ways_to_fold
from foldcell.skills.garments.garment import Garment
from foldcell.skills.scoring.alignment import AlignedGarment, FinalGarment
from foldcell.skills.scoring.verdict import DEFAULT_LIMITS, Figure, Score, ScoreLimits
from foldcell.skills.vocabulary import Array


def score(garment: FinalGarment, limits: ScoreLimits = DEFAULT_LIMITS) -> Score:
    """Score a folded garment. Raises InternalError if its vertices are not finite or too far apart."""
    folded = fold_mesh(garment.material, garment.triangles, garment.lines, garment.vertices)
    aligned, final = AlignedGarment(garment, folded), folded.attributes
    seen = measure_cut_fold(folded, np.column_stack([aligned.moved(final[:, :2]), final[:, 2]]))
    offsets = (float(np.linalg.norm(off)) for off in aligned.keypoint_offsets().values())
    figures = {
        "iou": Figure(seen.iou, limits.iou, at_least=True),
        "correspondence_m": Figure(
            float(np.average(aligned.error, weights=folded.area)),
            limits.correspondence * diagonal(garment.material),
        ),
        "edges_m": Figure(aligned.largest_edge_distance(), limits.edges),
        "keypoints_m": Figure(max(offsets, default=0.0), limits.keypoints),
        "height_m": Figure(seen.height, math.inf),  # the limits of the heights depend on the ideal fold
        "crease_height_m": Figure(seen.crease_height, math.inf),
        "drift_m": Figure(float(np.linalg.norm(aligned.drift)), limits.drift),
        "drift_rad": Figure(abs(aligned.turn), limits.drift_angle),
    }
    found = Score(figures, round(seen.layers), seen.layers * garment.thickness, tuple(garment.lines))
    return found if garment.ideal is None else found.with_ideal(garment.ideal, limits)


def keypoint_offsets(garment: FinalGarment) -> dict[str, Array]:
    """Return, for each key point, the vector (2,) from its place in the target to where it is now [m], with the
    garment aligned as for its score. Raises InternalError like `score`."""
    folded = fold_mesh(garment.material, garment.triangles, garment.lines, garment.vertices)
    return AlignedGarment(garment, folded).keypoint_offsets()


def score_plan(
    vertices: Array,
    triangles: NDArray[np.int32],
    material: Array,
    keypoints: Mapping[str, Array],
    garment: Garment,
    thickness: float,
) -> Score:
    """Score a folded garment against its plan. keypoints: the true key points, name -> (2,) material coordinates.
    The heights are not judged yet (`Score.with_ideal`).

    A step of a plan may have several variants (for example, either half folded onto the other). The garment is
    scored against the combination of variants whose target is nearest to its final shape. Targets whose shape it
    does not have, even after alignment, come last, because somebody may have moved it since it was laid. Raises
    InternalError like `score`.
    """
    pairs = named_edge_pairs(garment.edge_pairs, keypoints)
    finals = [
        FinalGarment(vertices, triangles, material, lines, thickness, pairs, keypoints)
        for lines in ways_to_fold(garment, keypoints)
    ]
    scores = [score(final) for final in finals]
    fits = [found.figures["correspondence_m"] for found in scores]
    nearest = min(fit.value for fit in fits)
    alike = [k for k, fit in enumerate(fits) if fit.passed or fit.value == nearest]
    return scores[min(alike, key=lambda k: _mean_distance(finals[k]))]


def _mean_distance(garment: FinalGarment) -> float:
    target = fold_xy(garment.lines, garment.material)
    return float(np.linalg.norm(garment.vertices[:, :2] - target, axis=1).mean())


def named_edge_pairs(
    pairs: Sequence[tuple[Sequence[str], Sequence[str]]], keypoints: Mapping[str, Array]
) -> tuple[tuple[Array, Array], ...]:
    """Return the edge pairs of a garment file as polylines between the garment's true key points."""
    return tuple(
        (np.array([keypoints[n] for n in a], dtype=float), np.array([keypoints[n] for n in b], dtype=float))
        for a, b in pairs
    )


def diagonal(material: Array) -> float:
    """Return the largest distance between two points of the rest shape (n, 2) [m]. For a rectangle it is the
    diagonal."""
    return float(pdist(material[ConvexHull(material).vertices]).max())
