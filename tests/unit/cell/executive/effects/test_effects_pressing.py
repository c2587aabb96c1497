"""When a fold is pressed, and how the pressing hand is monitored."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import cell.executive.effects.pressing as pressing
from cell.config.cell_settings import load_settings
from cell.config.garments.garment_file import load_garment
from cell.control.motions.hands import Hands
from cell.control.path_clock import PathControl
from cell.executive.effects import EFFECTS
from cell.executive.effects.inspecting import judged_as_before
from cell.states.run_context import RunContext
from cell.states.stages import Plan, PressPlan
from cell.states.transition_table import Effect, Event
from robots.baxter.model import load_model
from robots.errors import Failure, FailureKind
from robots.ports import ArmTrajectory, GripperState, Side, TactileReading
from skills.cloth.mesh import ClothMesh
from skills.grasping.hand_reading import HandReading
from skills.perception.inspection.inspect import Inspection, InspectionSettings
from skills.perception.rectification.table_view import TableView
from skills.planning.pressing import OPENING, Dab, press_paths
from skills.vocabulary import FoldLine, FoldStep, Outcome, PredictedShape
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.inspections import inspection
from tests.scenes import TABLE, camera
from tests.workcells import fake_workcell

inspect_fold, press = EFFECTS[Effect.INSPECT], EFFECTS[Effect.PRESS]
FLAT = 0.012
STEP = FoldStep("half", 0, FoldLine(np.zeros(2), np.array([1.0, 0.0])), (), {}, {})
STACK = SimpleNamespace(vertices=np.array([[0.0, 0.0, FLAT - 0.001]]))


AS_IT_IS = {name: getattr(pressing, name) for name in ("_flat", "apply_drift", "_dabs", "_planned")}


@pytest.fixture(autouse=True)
def easy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stack of 12 mm whose high places are known, and a planner that always finds a way."""
    monkeypatch.setattr(pressing, "_flat", lambda *_: STACK)
    monkeypatch.setattr(pressing, "apply_drift", lambda plan, seen: plan)
    monkeypatch.setattr(pressing, "_dabs", lambda *_: ((Dab(np.zeros(2), FLAT, 0.02),), 0.04))
    monkeypatch.setattr(pressing, "_planned", lambda *_: Outcome(({}, SimpleNamespace(tool_paths={}))))


def seen(
    height: float, diagnosis: FailureKind | None = None, pressed: tuple[float, ...] = (), **changes: Any
) -> RunContext:
    looked = SimpleNamespace(height_m=height, diagnosis=diagnosis)
    garment = SimpleNamespace(material=SimpleNamespace(thickness=0.002))
    step = SimpleNamespace(name="half", line=None)
    before = tuple(SimpleNamespace(height_m=height) for height in pressed)
    known: dict[str, Any] = {"inspection": looked, "garment": garment, "steps": (step,), "pressed": before}
    shape = PredictedShape(np.zeros((1, 3)), np.zeros((0, 3)), np.zeros((1, 2)))
    frame = FakeCell().ports().camera.capture()
    return context_with(**known, predicted=shape, frame=frame, **{"press_tries": len(pressed), **changes})


def plan_pressing(workcell: Any, context: RunContext) -> PressPlan | None:
    plan, made = context.plan, context.fold.attempt
    assert plan is not None and made is not None and made.inspection is not None
    return pressing.plan_pressing(workcell, context.fold.index, plan, made, made.inspection)


def cell_with(tmp_path: Path, **keys: float) -> Any:
    path = tmp_path / "cell.yaml"
    path.write_text("pressing:\n" + "".join(f"  {k}: {v}\n" for k, v in keys.items()))
    return fake_workcell(FakeCell(), settings=load_settings(path))


def test_a_fold_that_stands_high_is_pressed(tmp_path: Path) -> None:
    workcell = cell_with(tmp_path, max_attempts=1, min_excess_height=0.007)
    planned = plan_pressing(workcell, seen(0.030))
    assert planned is not None and planned.dabs == 1
    assert plan_pressing(workcell, seen(FLAT + 0.0069)) is None
    assert plan_pressing(workcell, seen(float("nan"))) is None, "what nobody saw does not stand high"


def test_the_settings_limit_how_often_a_fold_is_pressed(tmp_path: Path) -> None:
    assert plan_pressing(cell_with(tmp_path, max_attempts=0), seen(0.030)) is None
    assert plan_pressing(cell_with(tmp_path, max_attempts=1), seen(0.025, pressed=(0.030,))) is None
    assert plan_pressing(cell_with(tmp_path, max_attempts=2), seen(0.025, pressed=(0.030,))) is not None


def test_a_press_attempt_without_contact_counts_as_an_attempt(tmp_path: Path) -> None:
    assert plan_pressing(cell_with(tmp_path, max_attempts=1), seen(0.030, press_tries=0)) is not None
    tried = context_with(seen(0.030), press_tries=1)
    assert plan_pressing(cell_with(tmp_path, max_attempts=1), tried) is None


def test_a_fold_is_not_pressed_if_the_operator_skips_it(tmp_path: Path) -> None:
    assert plan_pressing(cell_with(tmp_path, max_attempts=1), context_with(seen(0.030), unpressed=True)) is None


def test_a_fold_that_pressing_did_not_lower_is_not_pressed_again(tmp_path: Path) -> None:
    assert plan_pressing(cell_with(tmp_path, max_attempts=3), seen(0.0295, pressed=(0.030,))) is None


def test_a_lack_of_room_for_the_fingers_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pressing, "_dabs", lambda *_: ((), 0.0))
    told: list[str] = []
    assert plan_pressing(replace(cell_with(tmp_path, max_attempts=1), tell=told.append), seen(0.030)) is None
    assert "room" in told[0]


def test_a_fold_out_of_reach_is_left_unpressed_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    no = Outcome[Any](failure=Failure(FailureKind.UNREACHABLE, "the left arm does not reach it"))
    monkeypatch.setattr(pressing, "_planned", lambda *_: no)
    told: list[str] = []
    workcell = replace(cell_with(tmp_path, max_attempts=1), tell=told.append)
    assert plan_pressing(workcell, seen(0.030)) is None
    assert "does not reach" in told[0]


@pytest.mark.parametrize(
    ("diagnosis", "event"),
    [
        (None, Event.PRESS),
        (FailureKind.PILING, Event.PRESS),
        (FailureKind.OFF_TARGET, Event.FAILED),
        (FailureKind.MISSED_LAYER, Event.FAILED),
    ],
)
def test_good_folds_and_heaps_are_pressed_and_bad_outlines_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, diagnosis: FailureKind | None, event: Event
) -> None:
    context, workcell = high(tmp_path, monkeypatch, diagnosis, outline_off=0.0)
    assert inspect_fold(workcell, context).event is event
    if event is Event.PRESS:
        assert inspect_fold(replace(workcell, approve=True), context).event is Event.APPROVAL_NEEDED


@pytest.mark.parametrize("diagnosis", [FailureKind.DROPPED_CORNER, FailureKind.SAG])
def test_an_edge_behind_is_inspected_again_after_pressing_unless_the_outline_confirms_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, diagnosis: FailureKind
) -> None:
    context, workcell = high(tmp_path, monkeypatch, diagnosis, outline_off=0.021)
    assert inspect_fold(workcell, context).event is Event.PRESS
    context, workcell = high(tmp_path, monkeypatch, diagnosis, outline_off=0.023)
    assert inspect_fold(workcell, context).event is Event.FAILED
    context, workcell = high(tmp_path, monkeypatch, diagnosis, outline_off=0.021, press_tries=1)
    assert inspect_fold(workcell, context).event is Event.FAILED, "pressed already"


def high(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    diagnosis: FailureKind | None,
    outline_off: float,
    **changes: Any,
) -> tuple[RunContext, Any]:
    """A fold that stands high when it is inspected, and a cell that may press it once."""
    import cell.executive.effects.inspecting as inspecting

    context = seen(0.030, diagnosis, **changes)
    assert context.fold.attempt is not None
    figures = {"contour": np.zeros((3, 2)), "iou_aligned": 0.95, "edge_deviation_m": outline_off}
    looked = SimpleNamespace(**vars(context.fold.attempt.inspection), **figures)
    monkeypatch.setattr(inspecting, "_compare", lambda *_: Outcome(looked))
    monkeypatch.setattr(inspecting, "figures", lambda seen: {})
    monkeypatch.setattr(inspecting, "beyond_limits", lambda *_: ["a corner"])
    return context, cell_with(tmp_path, max_attempts=1)


SQUARE = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.3], [0.0, 0.3]])


def look(contour: np.ndarray, **changes: Any) -> Inspection:
    """A good fold whose outline is nearly as far off as it may be, seen so."""
    return inspection(**{"contour": contour, "edge_deviation_m": 0.019, **changes})


def test_a_widened_crease_is_accepted_and_a_turned_corner_is_not() -> None:
    further = SQUARE - [[0.0, 0.004], [0.0, 0.004], [0.0, 0.0], [0.0, 0.0]]
    turned = further.copy()
    turned[2] -= 0.06
    before, settings = look(outline(SQUARE)), InspectionSettings()
    off = {"edge_deviation_m": 0.023, "diagnosis": FailureKind.OFF_TARGET}
    assert judged_as_before(before, look(outline(further), **off), STEP, settings).diagnosis is None
    assert judged_as_before(before, look(outline(turned), **off), STEP, settings).diagnosis is not None
    heap = look(outline(further), **off, piled_area_m2=0.01)
    assert judged_as_before(before, heap, STEP, settings).diagnosis is FailureKind.PILING, (
        "all else is judged anew"
    )
    flattened = look(outline(SQUARE), diagnosis=FailureKind.PILING)
    assert judged_as_before(flattened, look(outline(further), **off), STEP, settings).diagnosis is None
    bad = look(outline(SQUARE), diagnosis=FailureKind.OFF_TARGET, edge_deviation_m=0.0225)
    assert judged_as_before(bad, look(outline(further), **off), STEP, settings).diagnosis is FailureKind.OFF_TARGET


def outline(corners: np.ndarray) -> np.ndarray:
    """A closed polygon's boundary, every 2 mm."""
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return np.vstack([a + np.linspace(0.0, 1.0, 150, endpoint=False)[:, None] * (b - a) for a, b in sides])


# where it is pressed

VIEW = TableView(camera(), TABLE)
LAYER, BULGE = 0.004, 0.020
CREASE = FoldLine(np.array([0.6, 0.10]), np.array([1.0, 0.0]))
"""A towel from y = -0.2 m to 0.4 m, folded so that its half beyond y = 0.1 m lies on the other one."""


def folded_towel(monkeypatch: pytest.MonkeyPatch, high: tuple[float, float] | None) -> tuple[Plan, Inspection]:
    """It lies as planned; along the crease, from one x to another, it stands high for 50 mm [m]."""
    for name, function in AS_IT_IS.items():
        monkeypatch.setattr(pressing, name, function)
    rest = np.array([[x, y] for y in (-0.2, 0.1, 0.4) for x in (0.45, 0.75)])
    triangles = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4]], np.int32)
    mesh = ClothMesh(rest, np.zeros(6, np.int32), triangles, np.zeros(4, np.int32), np.zeros((0, 2), np.int32))
    pixels = np.dstack(np.mgrid[: VIEW.shape[0], : VIEW.shape[1]][::-1])

    def region(z: float, x: tuple[float, float], y: tuple[float, float]) -> np.ndarray:
        there = VIEW.to_table(pixels, z)
        return np.all((there > [x[0], y[0]]) & (there < [x[1], y[1]]), axis=2)

    height = np.where(region(2 * LAYER, (0.45, 0.75), (-0.2, 0.1)), 2 * LAYER, 0.0).astype(np.float32)
    if high is not None:
        height[region(2 * LAYER + BULGE, high, (0.05, 0.1))] = 2 * LAYER + BULGE
    step = FoldStep("half", 0, CREASE, (), {}, {})
    garment: Any = SimpleNamespace(material=SimpleNamespace(thickness=LAYER))
    flat = load_garment("medium_towel").flat_state(0.6, 0.0, 0.0)
    plan = Plan(garment, garment, flat, (step,), mesh, np.zeros((6, 3)))
    return plan, inspection(height=height, mask=height > 0.0, view=VIEW, height_m=2 * LAYER)


def test_fingers_press_along_the_flat_part_of_the_crease(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lying, looked = folded_towel(monkeypatch, (0.52, 0.68))
    dabs, highest = pressing._dabs(cell_with(tmp_path, min_excess_height=0.007), lying.steps[0], lying, looked)
    points = np.array([dab.point for dab in dabs])
    assert len(dabs) > 2 and points[:, 0].min() > 0.50 and points[:, 0].max() < 0.70
    np.testing.assert_allclose(points[:, 1], 0.10 - 0.029, atol=1e-9)
    assert [dab.bottom for dab in dabs] == pytest.approx([2 * LAYER] * len(dabs)), "two layers"
    high = np.array([dab.high for dab in dabs])
    assert (high > BULGE - 0.001).all() and (high < BULGE + LAYER).all(), "the upper layer ends at the crease"
    assert highest == pytest.approx(2 * LAYER + BULGE)


def test_pressing_uses_the_observed_position_of_the_fold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It drifted by 30 mm; the crease went along."""
    plan, looked = folded_towel(monkeypatch, None)
    folded = np.array([[x, y, 0.006] for y in (-0.2, 0.1, -0.2) for x in (0.45, 0.75)])
    shape = PredictedShape(folded, plan.mesh.triangles, plan.mesh.rest)
    asked: list[Any] = []
    monkeypatch.setattr(pressing, "_dabs", lambda cell, step, lying, seen: ((), asked.append((step, lying))))
    monkeypatch.setattr(pressing, "_flat", lambda *_: STACK)
    drifted = replace(looked, drift=np.array([0.03, 0.0]), height_m=0.03)
    context = replace(context_with(predicted=shape, inspection=drifted), plan=plan)
    assert plan_pressing(cell_with(tmp_path, max_attempts=1), context) is None
    ((step, lying),) = asked
    np.testing.assert_allclose(lying.vertices, folded + np.array([0.03, 0.0, 0.0]), atol=1e-12)
    np.testing.assert_allclose(step.line.point, CREASE.point + np.array([0.03, 0.0]), atol=1e-12)


def test_a_flat_crease_is_not_pressed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lying, looked = folded_towel(monkeypatch, None)
    assert pressing._dabs(cell_with(tmp_path, min_excess_height=0.007), lying.steps[0], lying, looked)[0] == ()


@pytest.mark.parametrize("reached", ["all", "some", "none"])
def test_one_hand_presses_as_far_as_it_reaches_if_two_cannot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reached: str
) -> None:
    monkeypatch.setattr(pressing, "_planned", AS_IT_IS["_planned"])
    dabs = tuple(Dab(np.array([0.6, y]), 0.008, 0.02) for y in (-0.3, -0.1, 0.1, 0.3))
    asked: list[Any] = []

    def plan(robot: Any, checker: Any, table: Any, paths: Any, *_: Any, **__: Any) -> Outcome[Any]:
        asked.append(paths)
        if reached == "all" or (reached == "some" and len(asked) == 2):
            return Outcome(SimpleNamespace())
        return Outcome(failure=Failure(FailureKind.UNREACHABLE, f"try {len(asked)}"))

    monkeypatch.setattr(pressing, "plan_hands_motion", plan)
    with ThreadPoolExecutor(1) as workers:
        planned = pressing._planned(fake_workcell(FakeCell(), workers), CREASE, dabs, 0.04)
    assert [len(paths) for paths in asked] == ([2] if reached == "all" else [2, 1])
    if reached == "none":
        assert planned.failure is not None and planned.failure.what == "try 1", "why not all of it"
    else:
        assert planned.unwrap()[0] is asked[-1]


def test_a_hard_push_ends_the_pressing_and_not_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The hand comes to rest and goes home; what came of it is looked at."""
    workcell = cell_with(tmp_path, max_attempts=1, force=8.0)
    context = standing_by(workcell, monkeypatch)
    for push, ended in ((7.0, False), (30.0, True)):
        feel(monkeypatch, push)
        result = press(workcell, context)
        assert result.event is Event.DONE
        assert result.record["stopped_by_force"] is ended
        assert [before.height_m for before in result.context.fold.attempt.pressed] == [0.030], (
            "how high it stood is kept"
        )
        assert result.context.fold.attempt.press_tries == 1
        assert workcell.ports.grippers[Side.LEFT].state().opening == OPENING, "one finger beside the other"
        assert result.record["strongest_n"] == pytest.approx(push)


@pytest.mark.parametrize(("stiff_m", "deepest_m"), [(0.006, 0.005), (0.010, 0.0075), (0.016, 0.010)])
def test_a_strongly_pushed_hand_stops_within_a_short_distance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stiff_m: float, deepest_m: float
) -> None:
    """Something hard lies so far above where the tips were to end: they come to rest on it, not where they were
    sent. The first joint stands for the height, as with a lever of a metre."""
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
    assert result.record["strongest_n"] == pytest.approx(deepest, abs=1.0), "it is watched to its end"


@pytest.mark.parametrize(("force", "stamp"), [(float("nan"), 0.0), (0.0, -1.0)])
def test_unreadable_fingertips_end_pressing_as_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: float, stamp: float
) -> None:
    """A stream that hangs after the zero says for ever that nothing is touched."""
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


@pytest.mark.parametrize("where", ["move", "each_hand", "plan_arc"])
def test_a_hand_that_did_not_arrive_does_not_press(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    """On its way to above the fold, while its tips are zeroed, and where no way down is free any more."""
    workcell = cell_with(tmp_path, max_attempts=1)
    context = standing_by(workcell, monkeypatch)
    why = Failure(FailureKind.TRACKING_ERROR, "the arm lags")
    failed = why if where == "move" else Outcome[Any](failure=why)
    monkeypatch.setattr(pressing, where, lambda *_, **__: failed)
    monkeypatch.setattr(pressing, "stream", lambda *_: pytest.fail("it pressed"))
    result = press(workcell, context)
    assert result.event is Event.FAILED and result.context.failure is why
    assert result.context.fold.attempt.press_tries == 1 and result.context.fold.attempt.pressed == ()


def test_a_fault_while_pressing_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workcell = cell_with(tmp_path, max_attempts=1)
    context = standing_by(workcell, monkeypatch)
    lag = Failure(FailureKind.TRACKING_ERROR, "the arm lags")
    monkeypatch.setattr(pressing, "stream", lambda *_: Outcome(failure=lag))
    result = press(workcell, context)
    assert result.event is Event.FAILED and result.context.failure is lag


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
    """The left hand's second tip is pushed so hard [N], read at `stamp` and asked for at 0 [s]."""
    tactile = TactileReading(stamp, Side.LEFT, np.zeros((2, 4, 3)), np.array([0.0, force]))
    gripper = GripperState(0.0, Side.LEFT, 0.03, 0.0, False, True)
    reading = HandReading(0.0, tactile, gripper, 0.05, np.zeros(7))
    monkeypatch.setattr(Hands, "read", lambda cell, side, state: reading)
