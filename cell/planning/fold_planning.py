"""Plan and predict a fold with the settings of the cell: its trajectory, the arms' motion, and the simulation of
this motion. A run, `foldcell optimise` and `foldcell garment check` use these functions, so that they agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import Array, Side
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.pinch import Patch
from foldcell.skills.cloth.predict import FoldPrediction, predict_fold
from foldcell.skills.garments.garment import Garment
from foldcell.skills.motion.kinematics.posture import Posture
from foldcell.skills.motion.moves.fold import FoldMotion, plan_hands_motion
from foldcell.skills.motion.moves.retreat import RETREAT_HEIGHT
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.trajectory.arcs.paths import after_lift
from foldcell.skills.trajectory.search.optimise import ClothPredictor, Progress, Watch, optimise_fold
from foldcell.skills.trajectory.search.problem import Predictor
from foldcell.skills.trajectory.trajectory_library import Library, lookup, trajectory_from
from foldcell.skills.vocabulary import FoldStep, GraspId, GraspTrajectory, Outcome, ToolPath

PREDICTED_FRAMES = 6
"""Number of shapes of a prediction that the pages show in a row. `recorder.key_frames` in cell.yaml is the number
of pictures by the camera."""


def tool_speed(settings: CellSettings, garment: Garment) -> float:
    """Return the largest speed of the tools with this garment in hand [m/s]."""
    return min(garment.max_tool_speed, settings.motion.tool_speed)


def reach_height(settings: CellSettings) -> float:
    """Return the height above a grasp that a posture has to reach [m]: as high as the hands rise after a fold, so
    that postures at the edge of their reach are not chosen."""
    return max(settings.motion.approach_height, RETREAT_HEIGHT)


def motion_rng() -> np.random.Generator:
    """Return a random generator for the motion planner, with the same seed in every run."""
    return np.random.default_rng(1)


def search_rng(rng: np.random.Generator, search: int) -> np.random.Generator:
    """Return the generator of a search for the arms' motion. search: number of the search, from 0. The first
    search gets `rng` itself; each further search gets a different generator."""
    return rng.spawn(search)[-1] if search else rng


def stored_trajectory(
    settings: CellSettings, library: Library, garment: Garment, step: FoldStep
) -> GraspTrajectory | None:
    """Return the library's arcs for a step of this garment, or for one like it; None if there are none."""
    arms = len(step.grasps)
    entry = lookup(library, garment.category, step.name, garment.material, garment.size_m, arms=arms)
    if entry is None:
        return None
    return trajectory_from(entry, step, garment.material.thickness, tool_speed(settings, garment))


def search_trajectory(
    settings: CellSettings,
    garment: Garment,
    step: FoldStep,
    mesh: ClothMesh,
    vertices: Array,
    method: str,
    budget: int | None,
    found: GraspTrajectory | None = None,
    trusted: bool = False,
    predict: Predictor | None = None,
    progress: Progress | None = None,
    watch: Watch | None = None,
) -> Outcome[GraspTrajectory]:
    """Optimise a step with the garment at `vertices` (n, 3) [m], starting from the arcs `found` in the library.

    method, budget, predict, progress, watch: as for `optimise_fold`. trusted: return these arcs unchanged if they
    reach their stored dissimilarity in this simulation. The failures are those of `optimise_fold`.
    """
    return optimise_fold(
        step, mesh, vertices, garment.material, method, budget,
        threads=settings.optimiser.threads, progress=progress, max_tool_speed=tool_speed(settings, garment),
        predict=predict or ClothPredictor(pads=settings.gripper.pads),
        start=None if found is None else dict(found.control_points),
        promised=found.dissimilarity if found is not None and trusted else None,
        promised_initial=None if found is None else found.dissimilarity_initial, watch=watch,
        lift_height=settings.grasp.lift_height, bending_factors=garment.bending_factors,
    )  # fmt: skip


def plan_arms(
    settings: CellSettings,
    model: RobotModel,
    checker: CollisionChecker,
    limits: JointLimits | None,
    garment: Garment,
    step: FoldStep,
    paths: Mapping[GraspId, ToolPath],
    q_now: Array,
    rng: np.random.Generator,
    avoid: Sequence[Mapping[Side, Posture]] = (),
    upright: bool = False,
    layer: float | None = None,
) -> Outcome[FoldMotion]:
    """Plan the motion of both arms for a step along tool paths, from q_now (joints,) at rest. upright: first try
    hands that are upright at the grasp, as if layers were to stay. layer: thickness with which the step was
    planned [m]; None: the stated one. The failures are those of `plan_hands_motion`."""
    thickness = garment.material.thickness if layer is None else layer
    layers_stay = upright or not all(g.whole_stack(thickness) for g in step.grasps.values())
    return plan_hands_motion(
        model, checker, settings.table, paths, q_now, limits=limits,
        tool_speed=tool_speed(settings, garment), approach_height=settings.motion.approach_height,
        reach_height=reach_height(settings), lift=settings.grasp.lift_height, rng=rng, avoid=avoid,
        upright_grasps=layers_stay,
    )  # fmt: skip


def predict_motion(
    settings: CellSettings,
    garment: Garment,
    mesh: ClothMesh,
    vertices: Array,
    paths: Mapping[GraspId, ToolPath],
    keyframes: int = 0,
    patches: Mapping[GraspId, Patch] | None = None,
) -> FoldPrediction:
    """Simulate a step with the tool paths that the arms will execute (`simulated_paths`), including orientation
    and timing. vertices: (n, 3) before it [m]; patches: as for `predict_fold`, whose errors it raises."""
    return predict_fold(
        mesh, vertices, garment.material, paths, pads=settings.gripper.pads, keyframes=keyframes,
        grip_force=settings.grasp.grip_force, patches=patches,
    )  # fmt: skip


def simulated_paths(settings: CellSettings, motion: FoldMotion) -> dict[GraspId, ToolPath]:
    """Return the tool paths of a motion by grasp, as input of a simulation: the lift, then the arc."""
    height = settings.grasp.lift_height
    return {posture.path: after_lift(motion.tool_paths[arm], height) for arm, posture in motion.postures.items()}
