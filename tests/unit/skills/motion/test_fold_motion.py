"""Motions of whole folds planned for Baxter, checked with independent kinematics and collision margins."""

from __future__ import annotations

import socket
from dataclasses import replace

import numpy as np
import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.planning.fold_planning import reach_height
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Side, arm_slice
from foldcell.skills.motion.kinematics.posture import Posture, angles_of
from foldcell.skills.motion.moves import free_motion as free_moves
from foldcell.skills.motion.moves.arc import plan_arc
from foldcell.skills.motion.moves.fold import plan_hands_motion
from foldcell.skills.motion.moves.free_motion import plan_free_motion
from foldcell.skills.motion.moves.grasp import plan_grasp
from foldcell.skills.motion.moves.lift import plan_lift
from foldcell.skills.motion.moves.posture_search import rank_postures
from foldcell.skills.motion.moves.retreat import plan_retreat
from foldcell.skills.motion.timing.timing import LONGEST_MOTION, free_motion, peaks
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.motion.validation.trajectory_check import check_trajectory
from foldcell.skills.vocabulary import FoldLine, FoldStep, Grasp, GraspId, Outcome, Table, ToolPath, tool_rotation
from tests.tool_paths import path_deviation

MODEL = load_model()
TABLE = Table(-0.10, (0.20, 1.10), (-0.75, 0.75))
TOWELS = {"small": (0.30, 0.42), "medium": (0.40, 0.60), "large": (0.50, 0.80)}
INSET, EDGE, TOP = 0.015, 0.010, 0.012


@pytest.fixture(scope="module")
def checker():
    return CollisionChecker(MODEL, TABLE)


@pytest.fixture(autouse=True)
def no_network(monkeypatch):
    """Planning must open no socket, because one of Ruckig's features would call a web service."""

    def refuse(*_args, **_kwargs):
        raise AssertionError("motion planning opened a socket")

    for name in ("socket", "create_connection", "getaddrinfo"):
        monkeypatch.setattr(socket, name, refuse)


def arc(start, end, heading, height=0.5, speed=0.30, rate=100.0):
    """A tool path along a cubic Bezier, from rest to rest (minimum jerk in arc length)."""
    start, end = np.array(start, float), np.array(end, float)
    span = np.linalg.norm(end - start)
    up = np.array([0.0, 0.0, height * span])
    control = [start, start + up, end + up, end]
    u = np.linspace(0, 1, 2001)[:, None]
    curve = (
        (1 - u) ** 3 * control[0]
        + 3 * u * (1 - u) ** 2 * control[1]
        + 3 * u**2 * (1 - u) * control[2]
        + u**3 * control[3]
    )
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    duration = 1.875 * s[-1] / speed
    t = np.linspace(0, duration, int(duration * rate) + 1)
    x = t / duration
    travelled = (10 * x**3 - 15 * x**4 + 6 * x**5) * s[-1]
    position = np.stack([np.interp(travelled, s, curve[:, k]) for k in range(3)], axis=1)
    zero = np.zeros(len(t))
    return ToolPath(t, position, zero + heading, zero, zero)


def fold(ends, heading, **options):
    """A fold step and its paths; ends: GraspId -> (start (3,), end (3,))."""
    paths = {i: arc(a, b, heading, **options) for i, (a, b) in ends.items()}
    duration = max(p.t[-1] for p in paths.values())
    paths = {
        i: ToolPath(p.t * duration / p.t[-1], p.position, p.heading, p.pitch, p.roll) for i, p in paths.items()
    }
    grasps = {i: Grasp(p.position[0, :2], heading, 1, 0.0025) for i, p in paths.items()}
    line = FoldLine(np.zeros(2), np.array([np.cos(heading), np.sin(heading)]))
    return FoldStep("fold", 0, line, (), grasps, {i: p.position[-1] for i, p in paths.items()}), paths


def towel_fold(name, number, x=0.60, y=0.0, angle=0.0, **options):
    """Fold 1: far edge onto near edge. Fold 2, of the folded towel: left edge onto right edge."""
    lx, ly = TOWELS[name]
    c, s = np.cos(angle), np.sin(angle)

    def at(a, b, z):
        return (x + c * a - s * b, y + s * a + c * b, z)

    if number == 1:
        a, b = lx / 2 - EDGE, ly / 2 - INSET
        left, right = (at(a, b, 0.0), at(-a, b, TOP)), (at(a, -b, 0.0), at(-a, -b, TOP))
        return fold({GraspId.LEFT: left, GraspId.RIGHT: right}, np.pi / 2 + angle, **options)
    far, near, b = -INSET, -lx / 2 + INSET, ly / 2 - EDGE
    left, right = (at(far, b, 0.0), at(far, -b, TOP)), (at(near, b, 0.0), at(near, -b, TOP))
    return fold({GraspId.LEFT: left, GraspId.RIGHT: right}, angle, **options)


def planned(checker, step, paths, **options):
    return plan_hands_motion(MODEL, checker, TABLE, paths, MODEL.q_park, **options)


def tools(side, q):
    return np.array([MODEL.tool_pose(side, x) for x in q])


def test_hands_on_the_two_ends_of_a_cuff_lean_away_from_each_other(checker, monkeypatch):
    """The grasps are 117 mm apart. With the cheapest leans of each arm alone, the wrists touch."""
    left = (0.7723, 0.3929, 0.0), (0.7110, 0.0270, 0.0066)
    right = (0.6735, 0.3314, 0.0), (0.6376, 0.1174, 0.0066)
    step, paths = fold({GraspId.LEFT: left, GraspId.RIGHT: right}, -0.166, height=0.457)
    motion = planned(checker, step, paths, lift=0.03).unwrap()
    assert checker.first_collision(motion.fold.q, allow_fingertips=True) is None
    monkeypatch.setattr("foldcell.skills.motion.moves.posture_search.WIDE_CANDIDATES", 8)
    assert "not both together" in planned(checker, step, paths, lift=0.03).failure.what


def test_postures_reach_higher_than_the_descent_begins(checker, monkeypatch):
    """Otherwise the half fold of a large towel, whose corners are at the edge of the left arm's reach, gets
    postures that cannot rise after the release."""
    asked, rank = [], rank_postures
    monkeypatch.setattr(
        "foldcell.skills.motion.moves.fold.rank_postures",
        lambda *given, above, **more: asked.append(above) or rank(*given, above=above, **more),
    )
    step, paths = towel_fold("small", 1)
    motion = planned(checker, step, paths, approach_height=0.06, reach_height=0.10).unwrap()
    assert asked == [0.10] and reach_height(load_settings()) == 0.10
    for side, posture in motion.postures.items():
        tool = MODEL.tool_pose(side, motion.q_above)[:3, 3]
        assert tool[2] - TABLE.height - paths[posture.path].position[0, 2] == pytest.approx(0.06, abs=1e-3)


@pytest.mark.parametrize("angle_deg", [0, 10])
@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("name", list(TOWELS))
def test_every_towel_fold_is_planned_within_limits_and_margins_on_its_path(checker, name, number, angle_deg):
    step, paths = towel_fold(name, number, angle=np.deg2rad(angle_deg))
    motion = planned(checker, step, paths).unwrap()
    parts = (motion.approach, motion.fold, motion.retreat, motion.park)
    for part in parts:
        assert peaks(part, MODEL.planning).worst <= 1.0 + 1e-6
    assert np.array_equal(motion.approach.q[0], MODEL.q_park)
    assert motion.fold.q[0] == pytest.approx(motion.q_grasp, abs=1e-9)
    assert motion.retreat.q[0] == pytest.approx(motion.fold.q[-1], abs=1e-9)
    assert motion.park.q[0] == pytest.approx(motion.retreat.q[-1], abs=1e-9)
    assert motion.park.q[-1] == pytest.approx(MODEL.q_park, abs=1e-9)

    # Another checker with half the margins checks poses between the planner's samples.
    strict = CollisionChecker(MODEL, TABLE, body_margin=0.005, table_margin=0.01, fingertip_margin=0.01)
    for part, grasping in zip(parts, (False, True, True, False), strict=True):
        assert strict.first_collision(part.q[1::5], allow_fingertips=grasping) is None

    assert path_deviation(MODEL, TABLE, motion.fold, {s: paths[p.path] for s, p in motion.postures.items()}) < 2e-4
    for side, posture in motion.postures.items():
        intended, done = paths[posture.path], motion.tool_paths[side]
        assert done.position[0] == pytest.approx(intended.position[0], abs=1e-6)
        assert done.position[-1] == pytest.approx(intended.position[-1], abs=1e-6)
        # The held line keeps its direction, up to a turn of the hand by pi.
        line = np.stack([np.cos(done.heading), np.sin(done.heading)], axis=1)
        meant = np.array([np.cos(intended.heading[0]), np.sin(intended.heading[0])])
        if posture.roll == 0.0:
            assert np.abs(line @ meant) == pytest.approx(1.0, abs=1e-6)
        assert abs(posture.pitch) <= np.deg2rad(20.01) and abs(posture.roll) <= np.deg2rad(10.01)
        # The tool path agrees with the joints.
        T = tools(side, motion.fold.q[::25])
        R = tool_rotation(done.heading[::25], done.pitch[::25], done.roll[::25])
        assert np.abs(T[:, :3, :3] - R).max() < 1e-9


def test_descents_go_straight_down_to_the_grasp_and_beyond(checker):
    step, paths = towel_fold("medium", 1)
    motion = planned(checker, step, paths, approach_height=0.1).unwrap()
    for side, way in motion.descend.items():
        assert way.depth[0] == 0.0 and way.depth[-1] == pytest.approx(0.115)
        q = np.tile(motion.q_above, (len(way.depth), 1))
        q[:, arm_slice(side, 14)] = way.q
        assert q[0] == pytest.approx(motion.q_above, abs=1e-9)
        T = tools(side, q)
        start = paths[motion.postures[side].path].position[0]
        assert np.abs(T[:, :2, 3] - start[:2]).max() < 1e-7
        assert T[:, 2, 3] - TABLE.height == pytest.approx(start[2] + 0.1 - way.depth, abs=1e-7)
        assert np.abs(T[:, :3, :3] - T[0, :3, :3]).max() < 1e-7
        grasp = np.array(motion.q_above)
        grasp[arm_slice(side, 14)] = way.at(way.grasp_depth)
        assert MODEL.tool_pose(side, grasp)[:3, 3] - [0, 0, TABLE.height] == pytest.approx(start, abs=1e-5)


@pytest.mark.parametrize(("name", "number", "x"), [("medium", 1, 0.86), ("small", 2, 0.90)])
def test_near_the_end_of_the_reach_a_descent_neither_jumps_nor_ends_at_the_grasp(checker, name, number, x):
    """A guarded descent is streamed by its depth, 60 mm/s over samples 2 mm apart. A hand needs room to push."""
    step, paths = towel_fold(name, number, x=x)
    for way in planned(checker, step, paths, approach_height=0.1).unwrap().descend.values():
        assert np.abs(np.diff(way.q, axis=0)).max() * 0.06 / 0.002 <= MODEL.protective.velocity.max()
        assert way.depth[-1] >= way.grasp_depth + 0.005


def test_retreats_go_straight_up(checker):
    step, paths = towel_fold("small", 2)
    motion = planned(checker, step, paths).unwrap()
    for side in motion.postures:
        T = tools(side, motion.retreat.q)
        assert np.abs(T[:, :2, 3] - T[0, :2, 3]).max() < 1e-4
        assert np.diff(T[:, 2, 3]).min() > -1e-6
        assert T[-1, 2, 3] - T[0, 2, 3] == pytest.approx(0.10, abs=1e-6)
        assert (np.diff(T[:, 2, 3]) / np.diff(motion.retreat.t)).max() <= 0.26


def test_a_lift_raises_only_the_hands_that_hold(checker):
    step, paths = towel_fold("medium", 1)
    q = planned(checker, step, paths).unwrap().q_grasp
    up = plan_lift(MODEL, checker, q, (Side.LEFT,), 0.03).unwrap()
    assert check_trajectory(MODEL, checker, up, q, MODEL.planning, allow_fingertips=True).ok
    rise = MODEL.tool_pose(Side.LEFT, up.q[-1]) - MODEL.tool_pose(Side.LEFT, q)
    expected = np.zeros((4, 4))
    expected[2, 3] = 0.03
    assert rise == pytest.approx(expected, abs=1e-6)
    assert np.array_equal(
        up.q[:, arm_slice(Side.RIGHT, 14)], np.tile(q[arm_slice(Side.RIGHT, 14)], (len(up.t), 1))
    )


def test_planning_is_deterministic(checker):
    step, paths = towel_fold("medium", 2, angle=0.1)
    a = planned(checker, step, paths).unwrap()
    b = planned(CollisionChecker(MODEL, TABLE), step, paths).unwrap()
    assert a.postures == b.postures
    for name in ("approach", "fold", "retreat", "park"):
        assert np.array_equal(getattr(a, name).q, getattr(b, name).q)
        assert np.array_equal(getattr(a, name).t, getattr(b, name).t)


def test_hands_that_take_the_upper_layers_alone_are_upright_at_the_grasp(checker):
    """The cheapest motion leans from the grasp to the release; this one leans later."""
    step, paths = towel_fold("small", 1, 0.5)
    cheapest, upright = (planned(checker, step, paths, upright_grasps=u).unwrap() for u in (False, True))
    assert all(posture.pitch != 0.0 for posture in cheapest.postures.values())
    assert all(posture.pitch == posture.roll == 0.0 for posture in upright.postures.values())
    assert all(posture.pitch_change != 0.0 for posture in upright.postures.values())
    at_grasp = next(iter(upright.tool_paths.values()))
    assert at_grasp.pitch[0] == pytest.approx(0.0, abs=0.01) and abs(at_grasp.pitch[-1]) > 0.1


def test_another_posture_can_be_requested(checker):
    step, paths = towel_fold("medium", 1)
    first = planned(checker, step, paths).unwrap()
    second = planned(checker, step, paths, avoid=[first.postures]).unwrap()
    assert second.postures != first.postures


def test_the_tool_speed_is_capped_while_the_hands_hold_cloth(checker):
    step, paths = towel_fold("medium", 1, speed=0.8)
    free, capped = planned(checker, step, paths).unwrap(), planned(checker, step, paths, tool_speed=0.2).unwrap()
    assert capped.fold.duration > 1.5 * free.fold.duration
    for path in capped.tool_paths.values():
        speed = np.linalg.norm(np.diff(path.position, axis=0), axis=1) / np.diff(path.t)
        assert speed.max() < 0.202


def test_an_arc_can_be_planned_again_from_the_hands_real_positions(checker):
    """The descent ended 4 mm higher and the arms lag a little. The arc starts there and ends as planned before."""
    step, paths = towel_fold("medium", 1)
    motion = planned(checker, step, paths).unwrap()
    q = np.array(motion.q_grasp)
    for side, way in motion.descend.items():
        q[arm_slice(side, 14)] = way.at(way.grasp_depth - 0.004)
    q += np.random.default_rng(3).normal(0.0, 0.003, 14)
    again = plan_arc(MODEL, checker, TABLE, paths, motion.postures, q).unwrap()
    assert again.fold.q[0] == pytest.approx(q, abs=1e-6)
    assert peaks(again.fold, MODEL.planning).worst <= 1.0 + 1e-6
    for side, posture in motion.postures.items():
        goal = paths[posture.path]
        done = again.tool_paths[side]
        assert np.linalg.norm(done.position[0] - goal.position[0]) > 0.002
        assert done.position[-1] == pytest.approx(goal.position[-1], abs=1e-6)
        R = done.rotation[-1] @ posture.rotation(goal)[-1].T
        assert np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)) < 1e-5
        # The arc leaves upwards without a dip at the start.
        assert done.position[:, 2].min() > min(done.position[0, 2], goal.position[:, 2].min()) - 1e-3


@pytest.mark.parametrize("number", [1, 2])
def test_the_arc_after_a_lift_begins_where_the_lift_ends(checker, number):
    """The hands lift the cloth before the fold, so the arc is planned and checked from the lifted pose."""
    lift = 0.03
    step, paths = towel_fold("medium", number)
    motion = planned(checker, step, paths, lift=lift).unwrap()
    for side, posture in motion.postures.items():
        grasp, begin = tools(side, (motion.q_grasp, motion.fold.q[0]))
        assert begin[:3, 3] - grasp[:3, 3] == pytest.approx([0.0, 0.0, lift], abs=1e-4)
        assert begin[:3, :3] == pytest.approx(grasp[:3, :3], abs=1e-4)
        done, intended = motion.tool_paths[side].position, paths[posture.path].position
        assert done[0] - intended[0] == pytest.approx([0.0, 0.0, lift], abs=1e-4)
        assert done[-1] == pytest.approx(intended[-1], abs=1e-4)
    up = plan_lift(MODEL, checker, motion.q_grasp, tuple(motion.postures), lift).unwrap()
    again = plan_arc(MODEL, checker, TABLE, paths, motion.postures, up.q[-1]).unwrap()
    assert np.array_equal(again.fold.q, motion.fold.q)


def test_a_fold_whose_lift_collides_has_no_plan(checker, monkeypatch):
    step, paths = towel_fold("medium", 1)
    blocked = Outcome(failure=Failure(FailureKind.IN_COLLISION, "the way up comes too near: a - b"))
    monkeypatch.setattr("foldcell.skills.motion.moves.fold.plan_lift", lambda *_, **__: blocked)
    assert planned(checker, step, paths, lift=0.03).failure.kind is FailureKind.IN_COLLISION
    assert planned(checker, step, paths).ok


def test_one_arm_folds_while_the_other_stays_parked(checker):
    step, paths = fold({GraspId.RIGHT: ((0.6, -0.3, 0.0), (0.6, -0.05, 0.01))}, 0.0)
    motion = planned(checker, step, paths).unwrap()
    (arm,) = motion.postures
    for part in (motion.approach, motion.fold, motion.retreat, motion.park):
        assert np.abs(part.q[:, arm_slice(arm.other, 14)] - MODEL.park(arm.other)).max() < 1e-9


def test_an_unreachable_grasp_is_reported_with_the_binding_constraint(checker):
    step, paths = towel_fold("medium", 1, x=1.25)
    failure = planned(checker, step, paths).failure
    assert failure.kind is FailureKind.UNREACHABLE
    assert "table frame" in failure.what and failure.values["postures"] > 100
    assert failure.values["binding"]["constraint"] == "reach" and failure.values["other_arms"]
    assert failure.values["shift_m"] is None and "no shift" in failure.hint


def test_a_suggested_shift_makes_the_fold_reachable(checker):
    """The towel is 10 cm too far away. The test applies the suggested shift."""
    step, paths = towel_fold("medium", 1, x=0.97)
    failure = planned(checker, step, paths).failure
    assert failure.kind is FailureKind.UNREACHABLE and "nearer to the robot" in failure.hint
    dx, dy = failure.values["shift_m"]
    assert dx < 0.0 and dy == 0.0
    step, paths = towel_fold("medium", 1, x=0.97 + dx)
    assert planned(checker, step, paths).ok


def test_a_long_fold_tilts_the_hand_on_its_path(checker):
    """The hem of a large shirt moves from 0.29 m to 0.93 m in front of the robot, which no constant lean of the
    hand allows."""
    ends = {
        GraspId.LEFT: ((0.295, 0.23, 0.0), (0.93, 0.23, 0.005)),
        GraspId.RIGHT: ((0.295, -0.24, 0.0), (0.93, -0.24, 0.005)),
    }
    step, paths = fold(ends, np.pi / 2, height=0.42)
    motion = planned(checker, step, paths).unwrap()
    assert any(p.pitch_change != 0.0 for p in motion.postures.values())
    for part, fingers in ((motion.fold, True), (motion.retreat, True)):
        assert check_trajectory(MODEL, checker, part, part.q[0], MODEL.planning, allow_fingertips=fingers).ok
    assert path_deviation(MODEL, TABLE, motion.fold, {s: paths[p.path] for s, p in motion.postures.items()}) < 2e-4
    for side, posture in motion.postures.items():
        T = tools(side, motion.fold.q[[0, -1]])
        meant = posture.rotation(paths[posture.path])[[0, -1]]
        assert T[:, :3, :3] == pytest.approx(meant, abs=1e-6)
        lean = np.arccos(np.clip(-T[:, 2, 2], -1, 1))
        assert lean.max() < np.deg2rad(45.1)


@pytest.mark.parametrize("spoilt", [np.nan, np.inf])
def test_unplannable_requests_are_failures(checker, spoilt):
    step, paths = towel_fold("small", 1)
    q = np.array(MODEL.q_park)
    q[3] = spoilt
    for outcome in (
        plan_hands_motion(MODEL, checker, TABLE, paths, q),
        plan_free_motion(MODEL, checker, q, MODEL.q_park),
        plan_retreat(MODEL, checker, q),
        plan_lift(MODEL, checker, q, (Side.LEFT,), 0.03),
    ):
        assert outcome.failure.kind is FailureKind.STALE_STATE and "left_e1" in outcome.failure.what
    assert plan_free_motion(MODEL, checker, MODEL.q_park, q).failure.kind is FailureKind.LIMIT_EXCEEDED
    assert plan_lift(MODEL, checker, MODEL.q_park, (Side.LEFT,), spoilt).failure.kind is FailureKind.LIMIT_EXCEEDED
    for bad in (
        {s: ToolPath(p.t, p.position + spoilt, p.heading, p.pitch, p.roll) for s, p in paths.items()},
        {s: ToolPath(0.0 * p.t, p.position, p.heading, p.pitch, p.roll) for s, p in paths.items()},
    ):
        assert planned(checker, step, bad).failure.kind is FailureKind.UNREACHABLE


def test_limits_so_low_that_a_motion_takes_months_are_a_failure(checker):
    slow = replace(
        MODEL.planning, **{n: 1e-8 * getattr(MODEL.planning, n) for n in ("velocity", "acceleration", "jerk")}
    )
    step, paths = towel_fold("small", 1)
    q = np.array(MODEL.q_park)
    q[0] += 0.3
    for outcome in (
        plan_free_motion(MODEL, checker, MODEL.q_park, q, limits=slow),
        plan_lift(MODEL, checker, MODEL.q_park, tuple(Side), 0.05, limits=slow),
        plan_retreat(MODEL, checker, MODEL.q_park, limits=slow),
        planned(checker, step, paths, limits=slow),
    ):
        assert outcome.failure.kind is FailureKind.LIMIT_EXCEEDED
        assert "longest motion" in outcome.failure.what and outcome.failure.values["longest_s"] == LONGEST_MOTION


@pytest.mark.parametrize("height", [-0.01, 1e6, np.nan, np.inf])
def test_heights_that_no_hand_reaches_are_refused(checker, height):
    step, paths = towel_fold("small", 1)
    for outcome in (
        plan_lift(MODEL, checker, MODEL.q_park, (Side.LEFT,), height),
        plan_grasp(MODEL, checker, TABLE, paths, {}, MODEL.q_park, approach_height=height),
        plan_grasp(MODEL, checker, TABLE, paths, {}, MODEL.q_park, overtravel=height),
        planned(checker, step, paths, approach_height=height),
        planned(checker, step, paths, lift=height),
    ):
        assert outcome.failure.kind is FailureKind.LIMIT_EXCEEDED and str(height) in outcome.failure.what


@pytest.mark.parametrize("speed", [0.0, -0.1, np.nan, 1e-9])
def test_a_tool_speed_at_which_no_fold_ends_is_refused(checker, speed):
    step, paths = towel_fold("small", 1)
    failure = planned(checker, step, paths, tool_speed=speed).failure
    assert failure.kind is FailureKind.LIMIT_EXCEEDED and failure.values


def test_a_tool_path_that_takes_hours_is_refused(checker):
    step, paths = towel_fold("small", 1)
    slow = {i: ToolPath(1e9 * p.t, p.position, p.heading, p.pitch, p.roll) for i, p in paths.items()}
    failure = planned(checker, step, slow).failure
    assert failure.kind is FailureKind.UNREACHABLE and "longest motion takes 600 s" in failure.what


def test_a_goal_beyond_the_joints_ranges_is_refused(checker):
    q = np.array(MODEL.q_park)
    q[0] = MODEL.planning.upper[0] + 0.1
    failure = plan_free_motion(MODEL, checker, MODEL.q_park, q).failure
    assert failure.kind is FailureKind.LIMIT_EXCEEDED
    assert failure.values["joint"] == "left_s0" and failure.values["over_rad"] == pytest.approx(0.1)


def test_hands_that_would_collide_are_reported_by_name(checker):
    ends = {
        GraspId.LEFT: ((0.6, 0.005, 0.0), (0.5, 0.005, 0.01)),
        GraspId.RIGHT: ((0.6, -0.005, 0.0), (0.5, -0.005, 0.01)),
    }
    step, paths = fold(ends, np.pi / 2)
    failure = planned(checker, step, paths).failure
    assert failure.kind is FailureKind.IN_COLLISION
    assert "left" in failure.what and "right" in failure.what
    assert failure.values["binding"]["constraint"] == "arms" and "further apart" in failure.hint


def test_arms_above_the_table_retreat_to_the_parked_pose(checker):
    step, paths = towel_fold("large", 2)
    motion = planned(checker, step, paths).unwrap()
    q_now = motion.fold.at(0.4 * motion.fold.duration)[0]
    away = plan_retreat(MODEL, checker, q_now).unwrap()
    for part in (away.retreat, away.park):
        assert check_trajectory(MODEL, checker, part, part.q[0], MODEL.planning).ok
    assert away.park.q[-1] == pytest.approx(MODEL.q_park)


def test_arms_at_the_end_of_their_reach_rise_as_far_as_they_can(checker):
    """The hands missed a grasp and are high above the far edge. They retreat although they can rise only a few
    centimetres."""
    step, paths = towel_fold("large", 2)
    q, sides = planned(checker, step, paths).unwrap().q_above, tuple(Side)
    while plan_lift(MODEL, checker, q, sides, 0.10).ok:
        q = plan_lift(MODEL, checker, q, sides, 0.03).unwrap().q[-1]
    assert plan_lift(MODEL, checker, q, sides, 0.04).ok
    away = plan_retreat(MODEL, checker, q).unwrap()
    rise = [MODEL.tool_pose(s, away.retreat.q[k])[2, 3] for s in sides for k in (0, -1)]
    assert 0.03 < rise[1] - rise[0] < 0.08 and 0.03 < rise[3] - rise[2] < 0.08
    assert away.park.q[-1] == pytest.approx(MODEL.q_park)


def test_a_detour_is_found_if_the_straight_motion_is_blocked(checker):
    """The hands must pass each other: first the left hand is far and the right one near, then the reverse."""
    step, paths = towel_fold("small", 2)
    a = planned(checker, step, paths).unwrap().q_above
    mirror = np.array([-1.0, 1, -1, 1, -1, 1, -1])
    b = np.concatenate([a[7:] * mirror, a[:7] * mirror])
    assert not checker.in_collision(b) and not checker.edge_free(a, b)
    motion = plan_free_motion(MODEL, checker, a, b).unwrap()
    assert check_trajectory(MODEL, checker, motion, a, MODEL.planning).ok


def test_the_motion_home_from_close_hands_passes_the_execution_check(checker):
    """The hands must not pass through each other between two samples of the path. Otherwise the check before
    execution would refuse the motion each time, and the run would end as a fault."""
    # the end of a fold above the waist of pants; on a straight motion home the hands come within 3 mm of each
    # other
    close = np.array(
        [
            *(0.868, -0.0888, -1.4884, 2.0291, 1.1993, 1.3277, 2.7912),
            *(1.5307, -0.452, 0.9237, 1.1312, -0.8533, 1.2613, -1.5753),
        ]
    )
    rng = np.random.default_rng(0)
    starts = [close, *(close + rng.normal(scale=0.1, size=(60, 14)))]
    free = [q for q in starts if not checker.in_collision(q)]
    assert len(free) > 10 and free[0] is close
    for q in free:
        motion = plan_free_motion(MODEL, checker, q, MODEL.q_park).unwrap()
        assert check_trajectory(MODEL, checker, motion, q, MODEL.planning).ok


def test_arms_that_cross_at_a_cuff_pass_each_other_on_the_way_home(checker):
    """The end of three folds of a T-shirt's sleeves. On a straight motion the forearms collide at its beginning;
    the random search finds detours of 3.4 to 4.4 s."""
    ends = (
        *(-0.62, -0.443, -1.204, 1.712, 1.353, 1.014, 1.471, 0.58, -0.231, 1.307, 1.297, -1.388, 1.52, 0.863),
        *(-0.819, -0.581, -0.757, 1.36, 1.005, 1.293, -0.738, 0.518, 0.025, 1.53, 1.744, -1.852, 1.232, -1.307),
        *(-0.479, -0.194, -1.337, 1.794, -1.461, -0.989, 1.326, 0.541, -0.19, 1.3, 1.077, -1.182, 1.578, 0.546),
    )
    for q in np.reshape(ends, (3, 14)):
        assert not checker.edge_free(q, MODEL.q_park)
        for start, end in ((q, MODEL.q_park), (MODEL.q_park, q)):
            found = plan_free_motion(MODEL, checker, start, end)
            straight = free_motion(start, end, MODEL.planning).duration
            assert found.notes["way"] == "via" and found.unwrap().duration < straight + 0.8
            assert check_trajectory(MODEL, checker, found.unwrap(), start, MODEL.planning).ok


def test_rrt_connect_finds_the_same_path_for_the_same_seed(checker):
    step, paths = towel_fold("small", 2)
    a = planned(checker, step, paths).unwrap().q_above
    mirror = np.array([-1.0, 1, -1, 1, -1, 1, -1])
    b = np.concatenate([a[7:] * mirror, a[:7] * mirror])
    ways = [free_moves._connect(MODEL, checker, a, b, np.random.default_rng(1)) for _ in range(2)]
    assert ways[0] is not None and np.array_equal(*ways)
    assert np.array_equal(ways[0][0], a) and np.array_equal(ways[0][-1], b)
    for p, q in zip(ways[0], ways[0][1:], strict=False):
        assert checker.edge_free(p, q)


def test_angles_of_is_the_inverse_of_tool_rotation():
    rng = np.random.default_rng(0)
    h, p, r = rng.uniform(-3, 3, 50), rng.uniform(-1.2, 1.2, 50), rng.uniform(-1.2, 1.2, 50)
    R = tool_rotation(h, p, r)
    assert np.abs(tool_rotation(*angles_of(R)) - R).max() < 1e-12


def test_a_hand_turned_by_pi_leans_in_the_same_direction():
    """The turn by pi is about the hand's axis, so the approach direction and the held line do not change."""
    path = arc((0.5, 0.2, 0.0), (0.5, -0.2, 0.0), 0.4)
    plain, turned = (Posture(GraspId.LEFT, t, 0.3, -0.2).rotation(path) for t in (False, True))
    assert plain[:, :, 2] == pytest.approx(turned[:, :, 2])
    assert plain[:, :, 0] == pytest.approx(-turned[:, :, 0])
