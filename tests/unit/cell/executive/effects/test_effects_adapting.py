"""Learning friction from a fold: only a fold that dragged cloth is simulated."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.calibration.identify import BOUND, silhouette
from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.executive.effects.adapting import FACTORS, adapt
from foldcell.cell.planning.fold_planning import simulated_paths
from foldcell.cell.states.stages import Plan
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.trajectory.arcs.paths import LIFT_HEIGHT, fold_paths
from foldcell.skills.vocabulary import Material, PredictedShape
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

TOWEL = load_garment("medium_towel")
STATE = TOWEL.flat_state(*TOWEL.poses.middle)
STEPS = plan_folds(STATE, TOWEL).unwrap()
MESH = mesh_from_contour(STATE.contour, 0.03, TOWEL.layers)
FLAT = MESH.lay_flat(TOWEL.material.thickness)
MU = TOWEL.material.friction_static


class View:
    """A view from straight above."""

    def shadow_on_table(self, xyz: Array) -> Array:
        return np.asarray(xyz)[:, :2]


def settings(adapting: bool) -> CellSettings:
    shipped = load_settings()
    return shipped.model_copy(
        update={"optimiser": shipped.optimiser.model_copy(update={"learn_friction": adapting})}
    )


def motion() -> Any:
    """A fold from the lifted grasps that is so high that it drags the part at rest."""
    controls, half = {}, STEPS[0]
    for i, grasp in half.grasps.items():
        start, end = np.append(grasp.point, LIFT_HEIGHT), half.targets[i]
        up = np.array([0.0, 0.0, 0.75])
        controls[i] = np.array([start, start + up, end + up, end])
    paths = fold_paths(controls, {i: g.heading for i, g in half.grasps.items()}, 3.0)
    driven = {i.planned_arm: path for i, path in paths.items()}
    return SimpleNamespace(tool_paths=driven, postures={i.planned_arm: SimpleNamespace(path=i) for i in paths})


def folded(cell: Any, mesh: ClothMesh, material: Material) -> Array:
    paths = simulated_paths(cell.settings, motion())
    return predict_fold(mesh, mesh.lay_flat(material.thickness), material, paths).vertices


def outline(vertices: Array, mesh: ClothMesh) -> Array:
    shape = silhouette(vertices, mesh.triangles)
    largest = max(getattr(shape, "geoms", [shape]), key=lambda part: part.area)
    return np.asarray(largest.exterior.coords)[:-1]


class Told:
    """A recorder that notes what it is told about friction."""

    def __init__(self) -> None:
        self.heard: list[tuple[float, float, float]] = []

    def adapted(self, *figures: float) -> None:
        self.heard.append(figures)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def workers() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as pool:
        yield pool


@pytest.fixture(scope="module")
def predicted(workers: ThreadPoolExecutor) -> Array:
    return folded(fake_workcell(FakeCell(), workers), MESH, TOWEL.material)


def after(
    workers: ThreadPoolExecutor, predicted: Array, contour: Array, *, on: bool = True, index: int = 0
) -> Any:
    """The friction after a fold that left this outline, the journal record, the time spent, and the calls of the
    recorder."""
    clock, told = FakeCell(), Told()
    cell = fake_workcell(clock, workers, expected=TOWEL, recorder=told, settings=settings(on))
    seen: Any = SimpleNamespace(contour=contour, view=View())
    shape = PredictedShape(predicted, MESH.triangles, MESH.rest)
    made = context_with(motion=motion(), predicted=shape).fold.attempt
    assert made is not None
    garment, record = adapt(cell, index, Plan(TOWEL, TOWEL, STATE, STEPS, MESH, FLAT), made, seen)
    return SimpleNamespace(
        friction=garment.material.friction_static, record=record, spent=clock.now, told=told.heard,
        each=cell.settings.computing.simulation_s,
    )  # fmt: skip


def test_a_fold_as_predicted_needs_no_adaptation(workers: ThreadPoolExecutor, predicted: Array) -> None:
    same = after(workers, predicted, outline(predicted, MESH))
    assert same.friction == MU and same.spent == 0.0 and same.told == []
    assert same.record["outline_residual_m"] < 1e-3


@pytest.mark.parametrize("factor", [0.55, 1.6])
def test_the_friction_estimate_follows_the_observed_drag(
    workers: ThreadPoolExecutor, predicted: Array, factor: float
) -> None:
    """The outline comes from a world with another mesh. The update is bounded, charged, recorded and shown."""
    world = mesh_from_contour(STATE.contour, 0.026, TOWEL.layers, 0.4)
    cell = fake_workcell(FakeCell(), workers)
    contour = outline(folded(cell, world, TOWEL.material.with_friction(factor * MU)), world)
    learned = after(workers, predicted, contour)
    assert (learned.friction - MU) * (factor - 1.0) > 0.0
    assert (1.0 - BOUND) * MU <= learned.friction <= (1.0 + BOUND) * MU
    assert learned.spent == pytest.approx(len(FACTORS) * learned.each)
    assert learned.record["friction_before"] == MU and learned.record["friction"] == learned.friction
    ((_, shown, share),) = learned.told
    assert shown == learned.friction and share == learned.record["friction_learned"]

    for nothing in (after(workers, predicted, contour, on=False), after(workers, predicted, contour, index=1)):
        assert nothing.friction == MU and nothing.record == {} and nothing.spent == 0.0
