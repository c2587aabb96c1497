"""The choice of a trajectory: from the library if its promise holds, otherwise optimised."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.trajectory_library.library_file import entry_of
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.planning.fold_planning import search_rng
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.errors import FailureKind, StorageError
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.trajectory.arcs.bezier import arc_controls
from foldcell.skills.trajectory.arcs.frame import frames_of
from foldcell.skills.trajectory.search.acceptance import POOR_SHARE, PROMISE_SLACK
from foldcell.skills.trajectory.trajectory_library import Library
from foldcell.skills.vocabulary import GarmentState, GraspId, GraspTrajectory
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

TOWEL = load_garment("medium_towel")
STATE = TOWEL.flat_state(*TOWEL.poses.middle)
HALF = plan_folds(STATE, TOWEL).unwrap()[0]
MESH = mesh_from_contour(STATE.contour, 0.05, TOWEL.layers)
PROMISED = 0.004
LIBRARY_HEIGHT = 0.64
LIFT = 0.005
"""Lift before the arc [m]. It is small, so that an arc is identified by its top."""
NEAR = 0.013
DIAGONAL = float(np.linalg.norm(np.ptp(MESH.rest, axis=0)))


def library(height: float = LIBRARY_HEIGHT) -> Library:
    frames = frames_of(HALF, TOWEL.material.thickness)
    controls = {s: arc_controls(f.start, f.end, height, 0.0) for s, f in frames.items()}
    found = GraspTrajectory(controls, 2.0, "optimised", 5.0, PROMISED, 25)
    return Library((replace(entry_of(TOWEL, HALF, found, "default", 0.01), max_tool_speed=0.35),))


class Perceived:
    """A stand-in for a perception."""

    def __init__(self, state: GarmentState) -> None:
        self.state, self.garment = state, "medium_towel"


class Cloth:
    """A stand-in simulation. D is `looked_up` for the library's arc and `others` for every other arc. It notes the
    tops of all arcs."""

    def __init__(self, looked_up: float, others: float) -> None:
        self.looked_up, self.others = looked_up, others
        self.tops: list[float] = []

    def __call__(self, mesh: Any, positions: Array, material: Any, paths: Mapping[GraspId, Any], /) -> Array:
        path = paths[GraspId.LEFT].position
        top = (path[:, 2].max() - path[0, 2]) / np.linalg.norm(path[-1] - path[0])
        self.tops.append(top)
        own = abs(top - 0.75 * LIBRARY_HEIGHT) < NEAR
        target = target_vertices(mesh, HALF.lines, TOWEL.material)
        return target + np.array([0.0, 0.0, self.looked_up if own else self.others])


class Watcher:
    """A recorder that notes all candidates."""

    def __init__(self) -> None:
        self.seen: list[tuple[float, int, Mapping[GraspId, Array], tuple[float, float], tuple[float, float]]] = []

    def plan(self, *_: Any) -> None: ...

    def candidate(self, *seen: Any) -> None:
        self.seen.append(seen)


@pytest.fixture
def workers() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as pool:
        yield pool


class Choice:
    """One choice of a trajectory, in a workcell with this cloth."""

    def __init__(
        self, cloth: Cloth, workers: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch, *changes: Adjustment,
        shelf: Library | None = None, full: bool = False,
    ) -> None:  # fmt: skip
        monkeypatch.setattr("foldcell.cell.executive.effects.planning.ClothPredictor", lambda pads: cloth)
        self.cell, self.kept, self.watcher, self.cloth = FakeCell(), [], Watcher(), cloth
        shelf = library() if shelf is None else shelf
        settings = load_settings()
        self.full, self.told = full, list[str]()
        low = settings.grasp.model_copy(update={"lift_height": LIFT})
        self.settings = settings.model_copy(update={"grasp": low})
        cell = fake_workcell(
            self.cell, workers, expected=TOWEL, library=lambda: shelf, recorder=self.watcher,
            keep=self._keep, settings=self.settings, tell=self.told.append,
        )  # fmt: skip
        context = context_with(
            garment=TOWEL, steps=(HALF,), mesh=MESH, vertices=MESH.lay_flat(TOWEL.material.thickness),
            adjustments=changes,
        )  # fmt: skip
        self.result: Result = EFFECTS[Effect.CHOOSE_TRAJECTORY](cell, context)

    def _keep(self, *it: Any) -> None:
        if self.full:
            raise StorageError("library.json cannot be written: No space left on device")
        self.kept.append(it)

    @property
    def trajectory(self) -> GraspTrajectory:
        assert self.result.context.fold.trajectory is not None
        return self.result.context.fold.trajectory


@pytest.mark.parametrize(("behind", "others", "simulations"), [(0.1, 0.001, 1), (0.9, 0.016, 2)])
def test_a_looked_up_arc_with_the_promised_cost_is_used(
    workers: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch, behind: float, others: float, simulations: int
) -> None:
    """An arc well behind its promise is compared with the initial arc, which is worse by the same amount here."""
    comes_to = PROMISED + behind * PROMISE_SLACK
    choice = Choice(Cloth(comes_to, others), workers, monkeypatch)
    assert choice.result.event is Event.DONE and choice.trajectory.source == "library"
    assert len(choice.cloth.tops) == simulations == choice.trajectory.simulations, "no optimisation runs"
    assert choice.trajectory.dissimilarity == pytest.approx(comes_to), "D is the one simulated now"
    assert choice.kept == [], "an arc from the library is not added again"
    costs = choice.settings.computing
    assert choice.cell.now == pytest.approx(costs.library_s + simulations * costs.simulation_s)


def test_a_looked_up_arc_worse_than_promised_is_optimised(
    workers: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    choice = Choice(Cloth(PROMISED + 0.9 * PROMISE_SLACK, 0.010), workers, monkeypatch)
    assert choice.trajectory.source == "optimised"


def test_a_looked_up_arc_with_a_high_predicted_cost_is_optimised(
    workers: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    choice = Choice(Cloth(PROMISED + 1.1 * PROMISE_SLACK, 0.003), workers, monkeypatch)
    assert choice.result.event is Event.DONE and choice.trajectory.source == "optimised"
    assert choice.trajectory.dissimilarity == pytest.approx(0.003)
    assert choice.cloth.tops[0] == pytest.approx(0.75 * LIBRARY_HEIGHT, abs=NEAR), (
        "the looked-up arc is simulated first"
    )
    assert choice.trajectory.simulations == len(choice.cloth.tops) <= choice.settings.optimiser.simulations + 1
    ((kept, _, _, notes),) = choice.kept
    assert kept is choice.trajectory and notes["method"] == "default" and notes["dissimilarity_initial_m"]
    costs = choice.settings.computing
    spent = costs.library_s + len(choice.cloth.tops) * costs.simulation_s
    assert choice.cell.now == pytest.approx(spent), "all simulations are charged"


def test_a_trajectory_that_cannot_be_saved_is_still_used(
    workers: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    choice = Choice(Cloth(PROMISED + 1.1 * PROMISE_SLACK, 0.003), workers, monkeypatch, full=True)
    assert choice.result.event is Event.DONE and choice.trajectory.source == "optimised"
    assert "No space left" in str(choice.result.record["not_kept"]) and "No space left" in choice.told[-1]


def test_the_looked_up_arc_is_kept_if_nothing_better_is_found(
    workers: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The arc is worse than promised but good enough, and it counts as a candidate of the search."""
    choice = Choice(Cloth(0.012, 0.030), workers, monkeypatch)
    assert choice.trajectory.source == "optimised" and choice.trajectory.dissimilarity == pytest.approx(0.012)


def test_arcs_for_another_number_of_hands_are_ignored(
    workers: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other entry is from a user's towel that is folded with one hand."""
    (both,) = library().entries
    one_hand = replace(both, garment="mine", inner={GraspId.LEFT: both.inner[GraspId.LEFT]})
    choice = Choice(Cloth(PROMISED, 0.008), workers, monkeypatch, shelf=Library((one_hand, both)))
    assert choice.trajectory.source == "library" and set(choice.trajectory.control_points) == set(GraspId)


def test_optimised_and_looked_up_arcs_pass_the_same_acceptance_test(
    workers: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    poor = 1.01 * POOR_SHARE * DIAGONAL
    choice = Choice(Cloth(poor, poor), workers, monkeypatch)
    failure = choice.result.context.failure
    assert choice.result.event is Event.FAILED and failure is not None
    assert failure.kind is FailureKind.PREDICTION_POOR
    assert failure.values["limit_m"] == pytest.approx(POOR_SHARE * DIAGONAL)
    assert failure.values["dissimilarity_m"] == pytest.approx(poor)


def test_the_first_recovery_optimises_the_looked_up_arc_and_the_second_ignores_it(
    workers: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    again = Choice(Cloth(PROMISED, 0.008), workers, monkeypatch, Adjustment.OPTIMISE)
    assert len(again.cloth.tops) > 2 and again.trajectory.source == "optimised"
    assert again.trajectory.dissimilarity == pytest.approx(PROMISED), "the result is the warm start"
    plain = Choice(Cloth(PROMISED, 0.008), workers, monkeypatch, Adjustment.OPTIMISE, Adjustment.PLAIN_ARC)
    assert len(plain.cloth.tops) == 1 and plain.trajectory.dissimilarity == pytest.approx(0.008)
    assert plain.kept == [], "the initial arc is not saved as the result of a search"
    empty = Choice(Cloth(PROMISED, 0.008), workers, monkeypatch, shelf=Library())
    assert len(empty.cloth.tops) > 2 and empty.trajectory.source == "optimised" and len(empty.kept) == 1


def test_the_recorder_gets_every_candidate_of_the_search(
    workers: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    choice = Choice(Cloth(0.012, 0.006), workers, monkeypatch)
    seen = choice.watcher.seen
    times, counts = [s[0] for s in seen], [s[1] for s in seen]
    assert counts[0] == 1 and counts == sorted(set(counts)) and times == sorted(times)
    best = float("inf")
    for _, _, arcs, (d, cost), (best_d, best_cost) in seen:
        best = min(best, cost)
        assert best_cost == best and d in (pytest.approx(0.012), pytest.approx(0.006)) and best_d <= 0.0121
        for i, arc in arcs.items():
            assert arc.shape[1] == 3
            assert np.allclose(arc[0, :2], HALF.grasps[i].point) and np.allclose(arc[-1], HALF.targets[i])


def test_each_search_has_its_own_reproducible_random_numbers() -> None:
    workcell = fake_workcell(FakeCell())
    first, second, third = (search_rng(workcell.rng(), k).random(4) for k in range(3))
    assert len({tuple(x) for x in (first, second, third)}) == 3
    np.testing.assert_array_equal(search_rng(workcell.rng(), 2).random(4), third)
    np.testing.assert_array_equal(first, workcell.rng().random(4), "the first search uses the run's generator")


# other variants


def perceived() -> Any:
    return Perceived(STATE)


def planned(context: RunContext) -> RunContext:
    """The context after planning with its adjustments."""
    result = EFFECTS[Effect.PLAN_FOLDS](fake_workcell(FakeCell(), expected=TOWEL), context)
    assert result.event is Event.DONE
    assert result.record.get("ways", [s.variant for s in result.context.steps]) == [
        s.variant for s in result.context.steps
    ]
    return result.context


def test_the_other_variant_of_a_fold_moves_the_other_part() -> None:
    first = planned(context_with(perception=perceived()))
    other = planned(context_with(first, adjustments=(Adjustment.OTHER_VARIANT,)))
    assert [s.variant for s in first.steps] == ["left_onto_right", "far_onto_near"]
    assert [s.variant for s in other.steps] == ["right_onto_left", "far_onto_near"]
    for i in GraspId:  # the grasps are on the other side of the line, at the same distance
        before, now = (s.line.signed_distance(s.grasps[i].point) for s in (first.steps[0], other.steps[0]))
        assert before > 0.1 and now == pytest.approx(before)
        away = first.steps[0].line.signed_distance(other.steps[0].grasps[i].point)
        assert away == pytest.approx(-before)
    assert other.plan is not None and first.plan is not None
    assert len(other.plan.vertices) == len(first.plan.vertices)
    again = planned(context_with(first, adjustments=(Adjustment.OTHER_VARIANT,) * 2))
    assert [s.variant for s in again.steps] == ["left_onto_right", "far_onto_near"], (
        "the plan has only two variants"
    )


def test_changing_the_variant_keeps_the_folds_already_made() -> None:
    first = planned(context_with(perception=perceived(), adjustments=(Adjustment.OTHER_VARIANT,)))
    assert first.plan is not None
    moved = context_with(first, index=1, adjustments=(), vertices=first.plan.vertices + 0.001)
    same = planned(moved)
    assert same.steps is moved.steps, "the plan does not change"
    other = planned(context_with(moved, adjustments=(Adjustment.OTHER_VARIANT,)))
    assert [s.variant for s in other.steps] == ["right_onto_left", "near_onto_far"]
    assert (
        other.steps[0] is first.steps[0]
        and other.plan.vertices is moved.plan.vertices
        and other.plan.mesh is first.plan.mesh
    )
    np.testing.assert_array_equal(other.steps[1].earlier[0].point, first.steps[0].line.point)
    np.testing.assert_array_equal(other.steps[1].earlier[0].direction, first.steps[0].line.direction)
    for i in GraspId:
        away = first.steps[1].line.signed_distance(other.steps[1].grasps[i].point)
        assert away < -0.05 < 0.05 < first.steps[1].line.signed_distance(first.steps[1].grasps[i].point)


def test_a_saved_trajectory_belongs_to_the_executed_variant() -> None:
    turned = plan_folds(STATE, TOWEL, {"half": "right_onto_left"}).unwrap()[0]
    controls = {s: arc_controls(f.start, f.end, 0.6, 0.0) for s, f in frames_of(turned, 0.002).items()}
    entry = entry_of(TOWEL, turned, GraspTrajectory(controls, 2.0, "optimised", 5.0, 0.004, 25), "default", 0.01)
    assert entry.variant == "right_onto_left"
