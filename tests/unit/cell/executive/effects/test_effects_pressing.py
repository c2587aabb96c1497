"""When a fold is pressed, and how the pressing hand is monitored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.control.motions.hands import Hands
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.executive.effects import EFFECTS, inspecting, pressing
from foldcell.cell.executive.effects.inspecting import judged_as_before
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import Plan, PressPlan
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import ArmTrajectory, GripperState, Side, TactileReading
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.fold_plan.pressing import OPENING, Dab, press_paths
from foldcell.skills.grasping.hand_reading import HandReading
from foldcell.skills.perception.inspection.claim import Claim
from foldcell.skills.perception.inspection.moved_edge import MovedEdge
from foldcell.skills.perception.inspection.result import Inspection
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import FoldLine, FoldStep, Outcome, PredictedShape
from tests.builders.contexts import context_with
from tests.builders.shipped_settings import INSPECTION
from tests.fakes import FakeCell
from tests.inspections import a_claim, inspection
from tests.scenes import TABLE, camera
from tests.workcells import fake_workcell

inspect_fold, press = EFFECTS[Effect.INSPECT], EFFECTS[Effect.PRESS]
VIEW = TableView(camera(), TABLE)
LAYER, BULGE = 0.004, 0.020
FLAT = 2 * LAYER
"""Height of the folded towel where it lies flat: two layers [m]."""
CREASE = FoldLine(np.array([0.6, 0.10]), np.array([1.0, 0.0]))
STEP = FoldStep("half", 0, CREASE, (), {}, {})
"""The fold of a towel that covers y = -0.2 to 0.4 m: the half beyond y = 0.1 m lands on the other half."""
MIDDLE = (0.52, 0.68)
"""The part of the crease that stands high in most tests: from x to x [m]."""


def folded_towel(high: tuple[float, float] | None = MIDDLE, drift_y: float = 0.0) -> tuple[Plan, Inspection]:
    """The plan of the fold, and an inspection that saw it.

    high: the crease stands high for 50 mm between these two x [m]; None: it lies flat. drift_y: the garment lies
    this far off along y [m].
    """
    rest = np.array([[x, y] for y in (-0.2, 0.1, 0.4) for x in (0.45, 0.75)])
    triangles = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4]], np.int32)
    mesh = ClothMesh(rest, np.zeros(6, np.int32), triangles, np.zeros(4, np.int32), np.zeros((0, 2), np.int32))
    pixels = np.dstack(np.mgrid[: VIEW.shape[0], : VIEW.shape[1]][::-1])

    def region(z: float, x: tuple[float, float], y: tuple[float, float]) -> np.ndarray:
        there = VIEW.to_table(pixels, z) - [0.0, drift_y]
        return np.all((there > [x[0], y[0]]) & (there < [x[1], y[1]]), axis=2)

    height = np.where(region(FLAT, (0.45, 0.75), (-0.2, 0.1)), FLAT, 0.0).astype(np.float32)
    if high is not None:
        height[region(FLAT + BULGE, high, (0.05, 0.1))] = FLAT + BULGE
    garment: Any = SimpleNamespace(material=SimpleNamespace(thickness=LAYER))
    flat = load_garment("medium_towel").flat_state(0.6, 0.0, 0.0)
    plan = Plan(garment, garment, flat, (STEP,), mesh, np.zeros((6, 3)))
    drift = np.array([0.0, drift_y])
    return plan, inspection(height=height, mask=height > 0.0, view=VIEW, height_m=FLAT, drift=drift)


@pytest.fixture(autouse=True)
def reach(monkeypatch: pytest.MonkeyPatch) -> None:
    """A motion planner that finds a motion for any paths."""
    motion = SimpleNamespace(tool_paths={})
    monkeypatch.setattr(pressing, "plan_hands_motion", lambda *_, **__: Outcome(motion))


def seen(
    height: float,
    diagnosis: FailureKind | None = None,
    pressed: tuple[float, ...] = (),
    high: tuple[float, float] | None = MIDDLE,
    drift_y: float = 0.0,
    **changes: Any,
) -> RunContext:
    """The towel has just been folded and inspected.

    height: of the fold, as inspected [m]; pressed: the heights before each pressing [m].
    """
    plan, looked = folded_towel(high, drift_y)
    folded = np.array([[x, y, 0.75 * FLAT] for y in (-0.2, 0.1, -0.2) for x in (0.45, 0.75)])
    known: dict[str, Any] = {
        "inspection": replace(looked, height_m=height, diagnosis=diagnosis),
        "predicted": PredictedShape(folded, plan.mesh.triangles, plan.mesh.rest),
        "pressed": tuple(inspection(height_m=before) for before in pressed),
        "press_tries": len(pressed),
        "claim": too_high(),
        "frame": FakeCell().ports().camera.capture(),
    }
    return replace(context_with(**{**known, **changes}), plan=plan)


def too_high(*after: float, **changes: Any) -> Claim:
    """A claim about a fold that is too high. after: probabilities that it is good after one more pressing, two."""
    known: dict[str, Any] = {"flat": False, "reliability": 0.9, "probable_pressed": after or (0.9, 0.95, 0.99)}
    return a_claim(**{**known, **changes})


def plan_pressing(workcell: Any, context: RunContext) -> PressPlan | None:
    """The effect's plan for the fold that was inspected last."""
    plan, made = context.plan, context.fold.attempt
    assert plan is not None and made is not None and made.inspection is not None
    return pressing.plan_pressing(workcell, context.fold.index, plan, made, made.inspection)


def cell_with(tmp_path: Path, **keys: float) -> Any:
    path = tmp_path / "cell.yaml"
    path.write_text("pressing:" + ("\n" if keys else " {}\n") + "".join(f"  {k}: {v}\n" for k, v in keys.items()))
    return fake_workcell(FakeCell(), settings=load_settings(path))


HEAP = {"diagnosis": FailureKind.PILING, "claim": None}


@pytest.mark.parametrize(
    ("attempts", "height", "known", "pressed"),
    [
        (1, 0.030, {}, True),
        (1, FLAT + 0.0071, HEAP, True),
        (1, FLAT + 0.0069, HEAP, False),
        # an unknown height; flat enough for the claim; an earlier fold, as high as its fabric makes it
        (1, float("nan"), {}, False),
        (1, 0.030, {"claim": a_claim(flat=True)}, False),
        (1, 0.030, {"claim": None}, False),
        # so near to its limit that the claim is not sure: pressing is worth its time if it makes it much surer
        (1, 0.030, {"claim": a_claim(reliability=0.80, probable_pressed=(0.94,))}, True),
        (1, 0.030, {"claim": a_claim(reliability=0.88, probable_pressed=(0.98,))}, False),
        (1, 0.030, {"claim": a_claim(reliability=0.80, probable_pressed=(0.90,))}, False),
        (2, 0.030, {"claim": a_claim(reliability=0.80, probable_pressed=(0.90, 0.94))}, False),
        # a high crease makes the overlap doubtful; pressing mends no other shape; a fold that stays too high is
        # not worth it
        (1, 0.030, {"claim": too_high(shape=False)}, True),
        (1, 0.030, {"claim": too_high(shape=False, probable_pressed=())}, False),
        (1, 0.030, {"claim": too_high(0.60)}, True),
        (1, 0.030, {"claim": too_high(0.40, 0.80)}, False),
        (2, 0.030, {"claim": too_high(0.40, 0.80)}, True),
        (2, 0.030, {"claim": too_high(0.20, 0.40)}, False),
        # the settings limit the number of attempts, also of those without contact
        (0, 0.030, {}, False),
        (1, 0.025, {"pressed": (0.030,)}, False),
        (2, 0.025, {"pressed": (0.030,)}, True),
        (1, 0.030, {"press_tries": 1}, False),
        # the operator skipped it; the pressing before did not lower it
        (1, 0.030, {"unpressed": True}, False),
        (3, 0.0295, {"pressed": (0.030,)}, False),
    ],
)
def test_a_fold_is_pressed_if_it_stands_high_and_pressing_may_help(
    tmp_path: Path, attempts: int, height: float, known: dict[str, Any], pressed: bool
) -> None:
    workcell = cell_with(tmp_path, max_attempts=attempts, min_excess_height=0.007)
    planned = plan_pressing(workcell, seen(height, **known))
    assert (planned is not None and planned.dabs > 2) is pressed


@pytest.mark.parametrize(("figures", "pressed"), [({}, False), ({"iou_aligned": 0.8}, True)])
def test_a_heap_is_pressed_before_the_next_fold_only_if_the_finished_garment_would_hide_a_defect(
    tmp_path: Path, figures: dict[str, float], pressed: bool
) -> None:
    """The height itself is judged at the end."""
    context = seen(0.030, **HEAP)
    plan, made = context.plan, context.fold.attempt
    assert plan is not None and made is not None and made.inspection is not None
    plan, heap = replace(plan, steps=(STEP, STEP)), replace(made.inspection, **figures)
    assert bool(pressing.plan_pressing(cell_with(tmp_path), 0, plan, made, heap)) is pressed


@pytest.mark.parametrize("high", [(0.45, 0.46), None])
def test_a_high_fold_without_room_for_the_fingers_is_reported(
    tmp_path: Path, high: tuple[float, float] | None
) -> None:
    """Only a place at the edge stands high, or no place of the crease does."""
    told: list[str] = []
    workcell = replace(cell_with(tmp_path, max_attempts=1), tell=told.append)
    assert plan_pressing(workcell, seen(0.030, high=high)) is None
    assert "room" in told[0]


def test_a_fold_out_of_reach_is_left_unpressed_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    no = Outcome[Any](failure=Failure(FailureKind.UNREACHABLE, "the left arm does not reach it"))
    monkeypatch.setattr(pressing, "plan_hands_motion", lambda *_, **__: no)
    told: list[str] = []
    workcell = replace(cell_with(tmp_path, max_attempts=1), tell=told.append)
    assert plan_pressing(workcell, seen(0.030)) is None
    assert "does not reach" in told[0]


@pytest.mark.parametrize(
    ("diagnosis", "event"),
    [
        (None, Event.ALL_FOLDED),
        (FailureKind.PILING, Event.PRESS),
        (FailureKind.OFF_TARGET, Event.FAILED),
        (FailureKind.MISSED_LAYER, Event.FAILED),
    ],
)
def test_heaps_are_pressed_and_bad_outlines_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, diagnosis: FailureKind | None, event: Event
) -> None:
    context, workcell = high(tmp_path, monkeypatch, diagnosis, outline_off=0.0)
    assert inspect_fold(workcell, context).event is event
    if event is Event.PRESS:
        assert inspect_fold(replace(workcell, approve=True), context).event is Event.APPROVAL_NEEDED


@pytest.mark.parametrize("diagnosis", [FailureKind.DROPPED_CORNER, FailureKind.SAG])
def test_a_lagging_edge_is_pressed_only_if_the_outline_matches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, diagnosis: FailureKind
) -> None:
    context, workcell = high(tmp_path, monkeypatch, diagnosis, outline_off=0.021)
    assert inspect_fold(workcell, context).event is Event.PRESS
    context, workcell = high(tmp_path, monkeypatch, diagnosis, outline_off=0.023)
    assert inspect_fold(workcell, context).event is Event.FAILED
    context, workcell = high(tmp_path, monkeypatch, diagnosis, outline_off=0.021, press_tries=1)
    assert inspect_fold(workcell, context).event is Event.FAILED, "the fold was already pressed"


def high(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    diagnosis: FailureKind | None,
    outline_off: float,
    **changes: Any,
) -> tuple[RunContext, Any]:
    """A fold that stands high when it is inspected, and a cell that may press it once.

    outline_off: the largest deviation of the observed outline [m].
    """
    context = seen(0.030, **changes)
    assert context.fold.attempt is not None and context.fold.attempt.inspection is not None
    looked = replace(
        context.fold.attempt.inspection, diagnosis=diagnosis, iou_aligned=0.95, edge_deviation_m=outline_off
    )
    monkeypatch.setattr(inspecting, "inspect", lambda *_, **__: Outcome(looked))
    nothing = Outcome[Any](failure=Failure(FailureKind.NO_GARMENT, "nothing is estimated here"))
    monkeypatch.setattr(inspecting, "note_estimate", lambda *_: nothing)
    return context, cell_with(tmp_path, max_attempts=1)


SQUARE = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.3], [0.0, 0.3]])


def look(contour: np.ndarray, **changes: Any) -> Inspection:
    """An inspection of a good fold whose outline deviates nearly as much as allowed."""
    return inspection(**{"contour": contour, "edge_deviation_m": 0.019, **changes})


def test_after_pressing_a_widened_crease_is_accepted_and_a_turned_corner_is_not() -> None:
    further = SQUARE - [[0.0, 0.004], [0.0, 0.004], [0.0, 0.0], [0.0, 0.0]]
    turned = further.copy()
    turned[2] -= 0.06
    before, settings = look(outline(SQUARE)), INSPECTION
    off = {"edge_deviation_m": 0.023, "diagnosis": FailureKind.OFF_TARGET}
    assert judged_as_before(before, look(outline(further), **off), STEP, settings).diagnosis is None
    assert judged_as_before(before, look(outline(turned), **off), STEP, settings).diagnosis is not None
    heap = look(outline(further), **off, piled_area_m2=0.01)
    assert judged_as_before(before, heap, STEP, settings).diagnosis is FailureKind.PILING, (
        "all other figures are judged again"
    )
    flattened = look(outline(SQUARE), diagnosis=FailureKind.PILING)
    assert judged_as_before(flattened, look(outline(further), **off), STEP, settings).diagnosis is None
    lags = MovedEdge(np.r_[np.full(3, 0.05), np.zeros(9)], 0.003)
    ahead = replace(lags, lag=np.zeros(12))
    lagging = look(outline(further), edge=lags, diagnosis=FailureKind.DROPPED_CORNER)
    for edge, kind in ((ahead, None), (lags, FailureKind.DROPPED_CORNER), (None, FailureKind.DROPPED_CORNER)):
        found = judged_as_before(look(outline(SQUARE), edge=edge), lagging, STEP, settings)
        assert found.diagnosis is kind, "an edge that lay in its place before still does so"
    bad = look(outline(SQUARE), diagnosis=FailureKind.OFF_TARGET, edge_deviation_m=0.0225)
    assert judged_as_before(bad, look(outline(further), **off), STEP, settings).diagnosis is FailureKind.OFF_TARGET


@pytest.mark.parametrize(("after", "overlap"), [(0.94, 0.96), (0.97, 0.97)])
def test_pressing_takes_nothing_from_the_overlap_of_a_fold_that_it_does_not_displace(
    after: float, overlap: float
) -> None:
    """The prediction is not pressed. In 25 small towels that were pressed, the overlap estimated by the claim was
    0.004 too small on average. Now it is 0.002."""
    before, moved = look(outline(SQUARE), iou_aligned=0.96), SQUARE.copy()
    moved[2] -= 0.06
    pressed, displaced = (look(outline(corners), iou_aligned=after) for corners in (SQUARE, moved))
    assert judged_as_before(before, pressed, STEP, INSPECTION).iou_aligned == overlap
    assert judged_as_before(before, displaced, STEP, INSPECTION).iou_aligned == after


def outline(corners: np.ndarray) -> np.ndarray:
    """A closed polygon's boundary, every 2 mm."""
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return np.vstack([a + np.linspace(0.0, 1.0, 150, endpoint=False)[:, None] * (b - a) for a, b in sides])


def test_fingers_press_along_the_high_part_of_the_crease(tmp_path: Path) -> None:
    lying, looked = folded_towel()
    dabs, highest = pressing._dabs(cell_with(tmp_path, min_excess_height=0.007), STEP, lying, looked)
    points = np.array([dab.point for dab in dabs])
    assert len(dabs) > 2 and points[:, 0].min() > 0.50 and points[:, 0].max() < 0.70
    np.testing.assert_allclose(points[:, 1], 0.10 - 0.029, atol=1e-9)
    assert [dab.bottom for dab in dabs] == pytest.approx([FLAT] * len(dabs)), "two layers"
    high = np.array([dab.high for dab in dabs])
    assert (high > BULGE - 0.001).all() and (high < BULGE + LAYER).all(), "the upper layer ends at the crease"
    assert highest == pytest.approx(FLAT + BULGE)


@pytest.mark.parametrize("drift_y", [0.0, 0.03])
def test_a_drifted_fold_is_pressed_where_it_was_observed(tmp_path: Path, drift_y: float) -> None:
    planned = plan_pressing(cell_with(tmp_path, max_attempts=1), seen(0.030, drift_y=drift_y))
    assert planned is not None
    tips = np.vstack([path.position for path in planned.paths.values()])
    low = tips[tips[:, 2] < tips[:, 2].min() + 0.001]
    np.testing.assert_allclose(low[:, 1], 0.10 + drift_y - 0.029, atol=1e-6)
    assert low[:, 0].min() > 0.50 and low[:, 0].max() < 0.70


@pytest.mark.parametrize("reached", ["all", "some", "none"])
def test_one_hand_presses_as_far_as_it_reaches_if_two_cannot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reached: str
) -> None:
    dabs = tuple(Dab(np.array([0.6, y]), 0.008, 0.02) for y in (-0.3, -0.1, 0.1, 0.3))
    asked: list[Any] = []

    def plan(robot: Any, checker: Any, table: Any, paths: Any, *_: Any, **__: Any) -> Outcome[Any]:
        asked.append(paths)
        if reached == "all" or (reached == "some" and len(asked) == 2):
            return Outcome(SimpleNamespace())
        return Outcome(failure=Failure(FailureKind.UNREACHABLE, f"try {len(asked)}"))

    monkeypatch.setattr(pressing, "plan_hands_motion", plan)
    planned = pressing._planned(fake_workcell(FakeCell()), CREASE, dabs, 0.04)
    assert [len(paths) for paths in asked] == ([2] if reached == "all" else [2, 1])
    if reached == "none":
        assert planned.failure is not None and planned.failure.what == "try 1", (
            "the failure of the plan for all dabs is reported"
        )
    else:
        assert planned.unwrap()[0] is asked[-1]


def test_a_hard_push_ends_the_pressing_and_not_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The hand comes to rest and retreats, and the fold is inspected again."""
    workcell = cell_with(tmp_path, max_attempts=1, force=8.0)
    context = standing_by(workcell, monkeypatch)
    for push, ended in ((7.0, False), (30.0, True)):
        feel(monkeypatch, push)
        result = press(workcell, context)
        assert result.event is Event.DONE
        assert result.record["stopped_by_force"] is ended
        assert [before.height_m for before in result.context.fold.attempt.pressed] == [0.030], (
            "the height before pressing is kept"
        )
        assert result.context.fold.attempt.press_tries == 1
        assert workcell.ports.grippers[Side.LEFT].state().opening == OPENING, "the fingers are side by side"
        assert result.record["strongest_n"] == pytest.approx(push)


@pytest.mark.parametrize(("stiff_m", "deepest_m"), [(0.006, 0.005), (0.010, 0.0075), (0.016, 0.010)])
def test_a_strongly_pushed_hand_stops_within_a_short_distance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stiff_m: float, deepest_m: float
) -> None:
    """A hard object lies `stiff_m` above the planned end of the tips [m], so the tips come to rest on it. The
    first joint stands for the height, like a lever of one metre."""
    through = pressing.stream
    workcell = cell_with(tmp_path, max_attempts=1, force=8.0)
    context = standing_by(workcell, monkeypatch)
    (path,) = press_paths(STEP.line, [Dab(np.zeros(2), FLAT, 0.02)], 0.035).values()
    q, qd = np.zeros((len(path.t), 14)), np.zeros((len(path.t), 14))
    q[:, 0] = path.position[:, 2]
    qd[:, 0] = np.gradient(q[:, 0], path.t)
    dab = SimpleNamespace(fold=ArmTrajectory(path.t, q, qd, np.gradient(qd, path.t, axis=0)))
    monkeypatch.setattr(pressing, "plan_arc", lambda *_, **__: Outcome(dab))
    monkeypatch.setattr(pressing, "stream", through)
    baxter = load_model()
    control = PathControl(None, baxter.protective, baxter.commissioning)
    monkeypatch.setattr(pressing, "pausable", lambda cell: control)
    heights: list[float] = []

    def read(cell: Any, side: Side, state: Any) -> HandReading:
        heights.append(float(state.q[0]))
        into = max(0.0, FLAT + stiff_m - heights[-1])
        tactile = TactileReading(state.stamp, side, np.zeros((2, 4, 3)), np.array([0.0, 1e4 * into]))
        gripper = GripperState(state.stamp, side, 0.03, 0.0, False, True)
        return HandReading(state.stamp, tactile, gripper, 0.05, np.zeros(7))

    monkeypatch.setattr(Hands, "read", read)
    workcell.ports.arms.command(q[0], np.zeros(14))
    result = press(workcell, context)
    assert result.event is Event.DONE and result.record["stopped_by_force"]
    assert min(heights) >= FLAT + stiff_m - deepest_m
    deepest = 1e4 * (FLAT + stiff_m - min(heights))
    assert result.record["strongest_n"] == pytest.approx(deepest, abs=1.0), (
        "the force is monitored until the motion ends"
    )


def test_pauses_before_and_while_the_hands_press_are_no_robot_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workcell = cell_with(tmp_path, max_attempts=1)
    context = replace(standing_by(workcell, monkeypatch), waited_s=1.0)

    def move(cell: Any, trajectory: Any, control: PathControl | None = None) -> None:
        (control or PathControl(None, cell.robot.protective, cell.limits)).waited_s += 2.0

    def stream(loop: Any, trajectory: Any, watch: Any, control: PathControl) -> Outcome[Any]:
        control.waited_s += 4.0
        return Outcome(())

    monkeypatch.setattr(pressing, "move", move)
    monkeypatch.setattr(pressing, "stream", stream)
    assert press(workcell, context).context.waited_s == 7.0


@pytest.mark.parametrize(("force", "stamp"), [(float("nan"), 0.0), (0.0, -1.0)])
def test_unreadable_fingertips_end_pressing_as_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: float, stamp: float
) -> None:
    """A tactile stream that freezes after the tare would always report no contact."""
    workcell = cell_with(tmp_path, max_attempts=1)
    context = standing_by(workcell, monkeypatch)
    feel(monkeypatch, force, stamp)
    assert press(workcell, context).event is Event.FAILED


def test_a_failure_while_a_pushed_hand_brakes_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workcell = cell_with(tmp_path, max_attempts=1, force=8.0)
    context = standing_by(workcell, monkeypatch)
    feel(monkeypatch, 30.0)
    lag = Failure(FailureKind.TRACKING_ERROR, "the arm lags")

    def stream(loop: Any, trajectory: Any, watch: Any, control: Any) -> Outcome[Any]:
        assert watch(SimpleNamespace(t=0.0, state=loop.ports.arms.state()))
        return Outcome(failure=lag)

    monkeypatch.setattr(pressing, "stream", stream)
    result = press(workcell, context)
    assert result.event is Event.FAILED and result.context.failure is lag


@pytest.mark.parametrize("where", ["move", "each_hand", "plan_arc", "stream"])
def test_a_fault_ends_the_pressing_as_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    """On the way above the fold, during the tare, because no free path down is found, and while the hand presses:
    only then it has pressed."""
    workcell = cell_with(tmp_path, max_attempts=1)
    context = standing_by(workcell, monkeypatch)
    why = Failure(FailureKind.TRACKING_ERROR, "the arm lags")
    failed = why if where == "move" else Outcome[Any](failure=why)
    monkeypatch.setattr(pressing, "stream", lambda *_: pytest.fail("the hand does not press"))
    monkeypatch.setattr(pressing, where, lambda *_, **__: failed)
    result = press(workcell, context)
    assert result.event is Event.FAILED and result.context.failure is why
    assert result.context.fold.attempt.press_tries == 1
    assert len(result.context.fold.attempt.pressed) == (where == "stream")


def standing_by(workcell: Any, monkeypatch: pytest.MonkeyPatch) -> RunContext:
    """A planned pressing, and arms that follow commands while the force monitor watches."""
    still = ArmTrajectory(np.array([0.0, 1.0]), np.zeros((2, 14)), np.zeros((2, 14)), np.zeros((2, 14)))
    motion = SimpleNamespace(postures={Side.LEFT: None}, approach=still, tool_paths={})
    monkeypatch.setattr(pressing, "move", lambda *_, **__: None)
    monkeypatch.setattr(pressing, "plan_arc", lambda *_, **__: Outcome(SimpleNamespace(fold=still)))

    def stream(loop: Any, trajectory: Any, watch: Any, control: Any) -> Outcome[Any]:
        tick = SimpleNamespace(t=0.0, state=loop.ports.arms.state())
        failure = watch(tick)
        return Outcome(failure=failure) if failure else Outcome(tick.state)

    monkeypatch.setattr(pressing, "stream", stream)
    monkeypatch.setattr(Hands, "recording", lambda hands, watch: watch)
    monkeypatch.setattr(pressing, "each_hand", lambda *_: Outcome({Side.LEFT: SimpleNamespace(tip=np.zeros(2))}))
    context: Any = seen(0.030)
    return context_with(context, press_plan=PressPlan(context.fold.attempt.inspection, {}, motion, 1))  # type: ignore[arg-type]


def feel(monkeypatch: pytest.MonkeyPatch, force: float, stamp: float = 0.0) -> None:
    """All readings show this force [N] on the left hand's second tip, with this stamp [s]."""
    tactile = TactileReading(stamp, Side.LEFT, np.zeros((2, 4, 3)), np.array([0.0, force]))
    gripper = GripperState(0.0, Side.LEFT, 0.03, 0.0, False, True)
    reading = HandReading(0.0, tactile, gripper, 0.05, np.zeros(7))
    monkeypatch.setattr(Hands, "read", lambda cell, side, state: reading)
