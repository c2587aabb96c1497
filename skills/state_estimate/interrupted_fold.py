"""Simulates folds that end early: a hand loses its cloth, hands open on the way, or they hold one layer less."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.pinch import PadGeometry
from foldcell.skills.cloth.predict import HANDS, sample_paths
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.state_estimate.hand_course import HandCourse
from foldcell.skills.state_estimate.hypothesis import Interruption
from foldcell.skills.vocabulary import Array, GraspId, Material, ToolPath, frozen

SETTLE_S = 1.2
"""Time that the cloth gets to come to rest [s]."""
RAISED = 1.0
"""Height by which hands that miss a layer are raised, in thicknesses of a layer."""


def simulate_interruptions(
    mesh: ClothMesh,
    positions: Array,
    material: Material,
    paths: Mapping[GraspId, ToolPath],
    interruptions: Sequence[Interruption],
    grip_force: float = 20.0,
    proceed: Callable[[], None] = lambda: None,
    pads: PadGeometry | None = None,
    course: HandCourse | None = None,
) -> list[Array]:
    """Simulate a fold from `positions` (n, 3) along the tools' paths, once for each interruption. Returns the
    positions (n, 3) in which the cloth comes to rest, in the order of the interruptions.

    The fold up to the first difference from the plan is simulated only once. proceed: called before each
    interruption is simulated; it may raise an exception to end the computation. pads: of the hands; None: the
    default pads. course: measured course of the hands, which a measured interruption needs.
    """
    fold = _Fold(mesh, positions, material, paths, grip_force, pads)
    results: dict[int, Array] = {}
    for missed in (False, True):
        chosen = [i for i, k in enumerate(interruptions) if k.missed_layer == missed and not k.measured]
        if chosen:
            fold.begin(RAISED * material.thickness if missed else 0.0)
        for i in sorted(chosen, key=lambda i: interruptions[i].begins):
            proceed()
            fold.go_to(fold.frame_at(interruptions[i].begins))
            results[i] = fold.end_by(interruptions[i])
    for i, how in enumerate(interruptions):
        if how.measured and course is not None:
            proceed()
            results[i] = fold.along(course)
    return [results[i] for i in range(len(interruptions))]


class _Fold:
    """One simulated fold, which is carried forwards and branches at the interruptions."""

    def __init__(
        self,
        mesh: ClothMesh,
        positions: Array,
        material: Material,
        paths: Mapping[GraspId, ToolPath],
        grip_force: float,
        pads: PadGeometry | None,
    ) -> None:
        self._simulation = ClothSimulation(mesh, material, positions, pads=pads, at_rest=True)
        self._start = self._simulation.checkpoint()
        self._paths, self._grip_force = paths, grip_force
        self._frame_s = self._simulation.settings.frame
        duration = max(float(path.t[-1]) for path in paths.values())
        self._last = max(1, round(duration / self._frame_s))
        self._position, self._rotation = sample_paths(paths, self._last, self._frame_s)
        hands = [h for h, grasp_id in enumerate(HANDS) if grasp_id in paths]
        steps = np.linalg.norm(np.diff(self._position[:, hands], axis=0), axis=2).sum(axis=1)
        self._share = np.r_[0.0, np.cumsum(steps)] / max(float(steps.sum()), 1e-9)
        self._now = 0

    def frame_at(self, share: float) -> int:
        """Return the frame at a share of the hands' way."""
        return int(np.searchsorted(self._share, share - 1e-9)) if share < 1.0 else self._last

    def begin(self, raised: float) -> None:
        """Close the hands at the start, `raised` [m] above the planned grasps."""
        self._simulation.restore(self._start)
        self._now = 0
        for hand, grasp_id in enumerate(HANDS):
            if grasp_id in self._paths:
                at = self._position[0, hand] + np.array([0.0, 0.0, raised])
                self._simulation.grip(hand, at, self._rotation[0, hand], self._grip_force)

    def go_to(self, frame: int) -> None:
        """Follow the paths to a frame, forwards or backwards."""
        step = 1 if frame >= self._now else -1
        course = np.arange(self._now, frame + step, step)
        if len(course) > 1:
            self._simulation.advance_along(self._position[course], self._rotation[course])
        self._now = frame

    def along(self, course: HandCourse) -> Array:
        """Simulate the fold as the hands were measured to move, and return the positions (n, 3) at rest."""
        heights = {grasp_id: float(path.position[0, 2]) for grasp_id, path in self._paths.items()}
        self._position, self._rotation = course.sampled(self._frame_s, heights)
        self._last = len(self._position) - 1
        self.begin(0.0)
        for grasp_id, until in sorted(course.until.items(), key=lambda item: item[1]):
            self.go_to(min(round(until / self._frame_s), self._last))
            self._simulation.release(HANDS.index(grasp_id))
        self._simulation.advance(round(SETTLE_S / self._frame_s))
        return frozen(self._simulation.positions)

    def end_by(self, how: Interruption) -> Array:
        """Simulate the rest of the fold with an interruption, then restore the state of the present moment."""
        saved, now = self._simulation.checkpoint(), self._now
        losses = sorted((self.frame_at(share), grasp_id) for grasp_id, share in how.lost.items())
        for frame, grasp_id in losses:
            self.go_to(frame)
            self._simulation.release(HANDS.index(grasp_id))
        self.go_to(self.frame_at(how.end))
        if how.laid_back:
            self.go_to(0)
        for hand in range(len(HANDS)):
            self._simulation.release(hand)
        self._simulation.advance(round(SETTLE_S / self._frame_s))
        result = frozen(self._simulation.positions)
        self._simulation.restore(saved)
        self._now = now
        return result
