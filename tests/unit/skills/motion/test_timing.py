"""Time laws: they keep every limit, stay on the path, and take nearly the shortest time."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from foldcell.robots.baxter.robot import load_model
from foldcell.robots.errors import InternalError
from foldcell.robots.ports import ArmTrajectory
from foldcell.skills.motion.moves.free_motion import blend_corners
from foldcell.skills.motion.timing.timing import (
    LONGEST_MOTION,
    STOP_TIME,
    TICK,
    ClockWarp,
    TimingError,
    free_motion,
    hold,
    join,
    peaks,
    time_law,
    time_path,
    warp_clock,
    warped,
)
from tests.builders.stops import stop_profile

MODEL = load_model()
LIMITS = MODEL.planning
TOLERANCE = 1.0 + 1e-6


def random_configuration(rng):
    return rng.uniform(LIMITS.lower, LIMITS.upper)


def wavy(rng, knots=6, size=1.0, samples=60):
    """A smooth joint path (samples, 14)."""
    return CubicSpline(np.linspace(0, 1, knots), rng.uniform(-size, size, (knots, 14)))(np.linspace(0, 1, samples))


def measured(trajectory):
    """Shares of the velocity, acceleration and jerk limits, from `ArmTrajectory.at` alone, as a streaming driver
    sees them."""
    t = np.linspace(0, trajectory.duration, 4 * len(trajectory.t))
    v = np.array([trajectory.at(x)[1] for x in t])
    a = np.diff(v, axis=0) / np.diff(t)[:, None]
    return np.abs(v / LIMITS.velocity).max(), np.abs(a / LIMITS.acceleration).max()


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
def test_free_motions_are_straight_lines_within_the_limits(seed):
    rng = np.random.default_rng(seed)
    q0, q1 = random_configuration(rng), random_configuration(rng)
    motion = free_motion(q0, q1, LIMITS)
    assert np.array_equal(motion.q[0], q0) and np.array_equal(motion.q[-1], q1)
    assert not motion.qd[[0, -1]].any()
    assert np.diff(motion.t).max() <= TICK + 1e-9 and np.diff(motion.t).min() > 0.5 * TICK
    assert peaks(motion, LIMITS).worst <= TOLERANCE
    v, a = measured(motion)
    assert v <= TOLERANCE and a <= TOLERANCE
    u = (motion.q - q0) @ (q1 - q0) / ((q1 - q0) @ (q1 - q0))
    assert np.abs(q0 + u[:, None] * (q1 - q0) - motion.q).max() < 1e-6
    assert motion.duration >= (np.abs(q1 - q0) / LIMITS.velocity).max()


def test_one_free_joint_takes_the_closed_form_time():
    """A long motion at the velocity limit takes D / v + v / a + a / j (trapezoidal acceleration)."""
    q1 = np.zeros(14)
    q1[0] = 1.5
    motion = free_motion(np.zeros(14), q1, LIMITS)
    v, a, j = (0.98 * x[0] for x in (LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk))
    assert motion.duration == pytest.approx(1.5 / v + v / a + a / j, rel=1e-6)


def test_a_motion_to_the_present_position_is_valid():
    q = random_configuration(np.random.default_rng(0))
    motion = free_motion(q, q, LIMITS)
    assert motion.duration > 0 and np.array_equal(motion.q[-1], q) and peaks(motion, LIMITS).worst == 0.0


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.floats(0.1, 1.5))
def test_timed_paths_stay_on_the_path_within_the_limits(seed, size):
    path = wavy(np.random.default_rng(seed), size=size)
    motion = time_path(path, LIMITS)
    assert peaks(motion, LIMITS).worst <= TOLERANCE
    v, a = measured(motion)
    assert v <= TOLERANCE and a <= TOLERANCE
    assert motion.q[0] == pytest.approx(path[0], abs=1e-9) and motion.q[-1] == pytest.approx(path[-1], abs=1e-9)
    assert not motion.qd[[0, -1]].any()
    # The trajectory passes all given samples and stays on the densely sampled path.
    dense = CubicSpline(np.linspace(0, 1, 60), path)(np.linspace(0, 1, 6000))
    gap = np.array([np.abs(dense - q).max(axis=1).min() for q in motion.q[:: max(1, len(motion.q) // 40)]])
    assert gap.max() < 5e-3 * size
    passed = np.array([np.abs(motion.q - q).max(axis=1).min() for q in path[::10]])
    assert passed.max() < 0.02


def test_tiny_curved_paths_keep_the_limits():
    rng, worst = np.random.default_rng(3), 0.0
    for _ in range(100):
        q = random_configuration(rng)
        corners = q + 10 ** rng.uniform(-5.0, -2.5) * rng.normal(size=(3, 14))
        worst = max(worst, peaks(time_path(blend_corners(corners, 0.3), LIMITS), LIMITS).worst)
    assert worst <= TOLERANCE


def test_a_straight_path_is_timed_nearly_as_fast_as_ruckig_can():
    rng = np.random.default_rng(4)
    ratios = []
    for _ in range(10):
        q0, q1 = random_configuration(rng), random_configuration(rng)
        line = q0 + np.linspace(0, 1, 50)[:, None] * (q1 - q0)
        ratios.append(time_path(line, LIMITS).duration / free_motion(q0, q1, LIMITS).duration)
    assert np.median(ratios) < 1.15 and min(ratios) > 0.97


def line(rng, samples=60):
    """A line in joint space between two random configurations, evenly sampled."""
    q0, q1 = random_configuration(rng), random_configuration(rng)
    return q0 + np.linspace(0, 1, samples)[:, None] * (q1 - q0)


@pytest.mark.parametrize("where", [0, 29, 59])
@pytest.mark.parametrize("repeats", [1, 2, 5])
@pytest.mark.parametrize("distance", [0.0, 1e-9, 1e-7, 1e-6])
def test_samples_that_repeat_do_not_slow_a_path(where, repeats, distance):
    """Against the same path without them: a spline through both would have a bend of any size between them."""
    path = line(np.random.default_rng(20))
    along = path[-1] - path[0]
    again = path[where] + distance * np.arange(1, repeats + 1)[:, None] * along
    given = np.insert(path, where + 1, again, axis=0)
    motion = time_path(given, LIMITS)
    assert motion.duration == pytest.approx(time_path(path, LIMITS).duration, rel=0.01)
    assert peaks(motion, LIMITS).worst <= TOLERANCE
    assert motion.q[0] == pytest.approx(given[0], abs=1e-9) and motion.q[-1] == pytest.approx(given[-1], abs=1e-9)


def test_repeated_samples_keep_the_cap_on_the_tools_speed():
    path = np.repeat(line(np.random.default_rng(22)), 3, axis=0)
    length = np.repeat(np.linspace(0.0, 1.0, 60), 3)[:, None]
    assert 5.0 < time_path(path, LIMITS, lengths=length, speed=0.2).duration < 5.5


@pytest.mark.parametrize("passes", [2, 3, 5])
@pytest.mark.parametrize("repeated_at_the_turn", [False, True])
def test_a_path_that_turns_back_takes_as_long_as_its_parts(passes, repeated_at_the_turn):
    """Closed form of one joint to and fro, at rest at each turn: D / v + v / a + a / j for each pass."""
    forth = np.zeros((60, 14))
    forth[:, 0] = np.linspace(0.0, 1.5, 60)
    skip = 0 if repeated_at_the_turn else 1
    path = np.vstack([forth, *((forth[::-1] if k % 2 else forth)[skip:] for k in range(1, passes))])
    v, a, j = (0.98 * x[0] for x in (LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk))
    motion = time_path(path, LIMITS)
    assert peaks(motion, LIMITS).worst <= TOLERANCE
    assert passes * (1.5 / v + v / a) < motion.duration < 1.1 * passes * (1.5 / v + v / a + a / j)
    assert motion.q[:, 0].min() >= -1e-6 and motion.q[:, 0].max() <= 1.5 + 1e-6
    turns = np.flatnonzero(np.diff(np.sign(motion.qd[np.abs(motion.qd[:, 0]) > 1e-6, 0])))
    assert len(turns) == passes - 1, "and every pass is made"


def test_a_path_that_swings_smoothly_turns_back_without_slowing_the_rest():
    """Sampled as a sine: the steps near a turn are small. Against a line of each swing."""
    rng = np.random.default_rng(23)
    q0, q1 = random_configuration(rng), random_configuration(rng)
    path = (q0 + q1) / 2 + 0.5 * np.sin(np.linspace(-0.5 * np.pi, 4.5 * np.pi, 301))[:, None] * (q1 - q0)
    motion = time_path(path, LIMITS)
    assert peaks(motion, LIMITS).worst <= TOLERANCE
    assert motion.duration < 1.15 * 5 * free_motion(q0, q1, LIMITS).duration


def test_a_path_with_sharp_corners_is_hardly_slower_than_one_with_stops():
    """Between its corners a path is a line, which `free_motion` times in closed form."""
    rng = np.random.default_rng(24)
    corners = [random_configuration(rng) for _ in range(5)]
    x = np.linspace(0.0, 1.0, 40)[1:, None]
    path = np.vstack([corners[:1], *(a + x * (b - a) for a, b in pairwise(corners))])
    motion = time_path(path, LIMITS)
    assert peaks(motion, LIMITS).worst <= TOLERANCE
    assert motion.duration < 1.1 * sum(free_motion(a, b, LIMITS).duration for a, b in pairwise(corners))


GOOD = np.zeros((4, 14)) + 0.1 * np.arange(4)[:, None]
TIMES = np.linspace(0.0, 2.0, 4)


@pytest.mark.parametrize("name", ["velocity", "acceleration", "jerk"])
@pytest.mark.parametrize("joint", [0, 9])
def test_a_motion_that_would_take_months_is_refused_before_it_is_sampled(name, joint):
    """2.8e-8 rad/s would be ten million seconds, a billion samples."""
    limit = np.array(getattr(LIMITS, name))
    limit[joint] = {"velocity": 2.8e-8, "acceleration": 2.8e-10, "jerk": 2.8e-12}[name]
    slow = replace(LIMITS, **{name: limit})
    for ask in (
        lambda: free_motion(GOOD[0], GOOD[-1], slow),
        lambda: time_path(GOOD, slow),
        lambda: time_law(GOOD, TIMES, slow),
    ):
        with pytest.raises(TimingError) as error:
            ask()
        assert error.value.values["longest_s"] == LONGEST_MOTION and "limits" in error.value.hint
        assert error.value.values["duration_s"] > LONGEST_MOTION


@pytest.mark.parametrize(
    "ask",
    [
        lambda: time_path(GOOD, LIMITS, lengths=np.arange(4.0)[:, None], speed=1e-8),
        lambda: time_law(GOOD, 1e9 * TIMES, LIMITS),
        lambda: warped(hold(GOOD[0]), ClockWarp(0.0, 1e9, 0.0)),
    ],
)
def test_no_other_motion_is_sampled_for_months(ask):
    with pytest.raises(TimingError, match="longest motion"):
        ask()


def test_the_slowest_settings_are_not_refused():
    """5 % of the joints' speed, from one end of every joint's range to the other."""
    slowest = MODEL.limits("commissioning", 0.05)
    assert 10.0 < free_motion(LIMITS.lower, LIMITS.upper, slowest).duration < 0.5 * LONGEST_MOTION


def test_limits_that_no_motion_keeps_are_refused():
    with pytest.raises(TimingError, match="too large or too small") as error:
        free_motion(GOOD[0], GOOD[-1], replace(LIMITS, velocity=np.full(14, 1e-300)))
    assert error.value.values["velocity"] < 1e-298


def test_the_tool_speed_cap_is_kept():
    path = wavy(np.random.default_rng(5), size=0.3)
    length = np.stack([np.linspace(0, 1.0, 60), np.linspace(0, 0.4, 60) ** 2], axis=1)
    motion = time_path(path, LIMITS, lengths=length, speed=0.2)
    free = time_path(path, LIMITS)
    assert motion.duration > 5.0 > free.duration
    # The travelled arc length is recovered from the nearest sample of the path.
    fine = CubicSpline(np.linspace(0, 1, 60), np.hstack([path, length]))(np.linspace(0, 1, 8000))
    travelled = np.array([fine[np.abs(fine[:, :14] - q).max(axis=1).argmin(), 14] for q in motion.q])
    speed = np.diff(travelled[::10]) / np.diff(motion.t[::10])
    assert speed.max() < 0.21


def test_a_requested_time_law_is_kept_when_the_limits_allow_it():
    t = np.linspace(0, 6.0, 120)
    u = t / 6.0
    s = 10 * u**3 - 15 * u**4 + 6 * u**5
    a, b = np.zeros(14), np.full(14, 0.8)
    motion = time_law(a + s[:, None] * (b - a), t, LIMITS)
    assert motion.duration == pytest.approx(6.0)
    for ti in np.linspace(0.5, 5.5, 20):
        wish = np.interp(ti, t, s) * 0.8
        assert motion.at(ti)[0][3] == pytest.approx(wish, abs=1e-4)


def test_a_requested_time_law_that_starts_with_a_jerk_is_softened():
    t = np.linspace(0, 6.0, 120)
    motion = time_law(np.linspace(0, 1, 120)[:, None] * np.full(14, 0.8), t, LIMITS)
    assert 6.0 < motion.duration < 6.5
    assert peaks(motion, LIMITS).worst <= TOLERANCE
    assert np.abs(motion.qdd[[0, -1]] / LIMITS.jerk).max() < TICK


def test_a_requested_time_law_beyond_the_limits_is_slowed_only_where_the_limits_bind():
    rng = np.random.default_rng(6)
    path = wavy(rng, size=0.8, samples=200)
    t = np.linspace(0, 1.0, 200)
    motion = time_law(path, t, LIMITS)
    assert motion.duration > 1.5
    assert peaks(motion, LIMITS).worst <= TOLERANCE
    assert motion.duration < 1.6 * time_path(path, LIMITS).duration


def smooth_wish(peak_share, gap=0.8):
    """A minimum-jerk time law. Its duration is such that the fastest joint peaks, at 15/8 of its mean speed, at
    this share of its velocity limit."""
    duration = float((1.875 * gap / LIMITS.velocity).max() / peak_share)
    t = np.linspace(0.0, duration, 200)
    u = t / duration
    return t, np.outer(10 * u**3 - 15 * u**4 + 6 * u**5, np.full(14, gap))


@pytest.mark.parametrize("share", [0.95, 1.05, 1.3, 1.5])
def test_a_requested_time_law_is_kept_up_to_the_limit_and_slowed_beyond_it(share):
    t, path = smooth_wish(share, gap=1.5)
    motion = time_law(path, t, LIMITS)
    assert peaks(motion, LIMITS).worst <= TOLERANCE
    assert (motion.duration == pytest.approx(t[-1])) == (share < 1.0)


def test_a_requested_start_at_full_acceleration_is_softened():
    """A cosine law begins and ends at rest, but its acceleration begins and ends with a step."""
    t = np.linspace(0.0, 2.5, 200)
    path = np.outer(0.5 - 0.5 * np.cos(np.pi * t / 2.5), np.full(14, 0.8))
    assert (0.8 * np.pi**2 / 12.5 > LIMITS.jerk * TICK).any()
    motion = time_law(path, t, LIMITS)
    assert (np.abs(motion.qdd[[0, -1]]) <= LIMITS.jerk * TICK).all()
    assert peaks(motion, LIMITS).worst <= TOLERANCE and 2.5 < motion.duration < 3.2


def test_a_requested_time_law_too_fast_in_one_place_is_slowed_there():
    """The law is slow, with a burst at three times the velocity limit. Stretched uniformly, it would take 24 s
    instead of 8 s."""
    t = np.linspace(0.0, 8.0, 400)
    burst = 0.5 * (1.0 + np.tanh((t - 4.0) / 0.1))
    s = 0.2 * (t - np.sin(2 * np.pi * t / 8.0) * 8.0 / (2 * np.pi)) / 8.0 + burst * 0.6
    path = np.outer(s - s[0], LIMITS.velocity)
    motion = time_law(path, t, LIMITS)
    assert np.gradient(s, t).max() > 2.9
    assert peaks(motion, LIMITS).worst <= TOLERANCE
    assert motion.duration < 1.6 * 8.0
    slow = (motion.q[:, 0] < path[t < 3.0, 0].max()) | (motion.q[:, 0] > path[t > 5.0, 0].min())
    wished = np.interp(motion.q[slow, 0], path[:, 0], np.gradient(path[:, 0], t))
    assert (motion.qd[slow, 0] < 1.02 * wished + 0.01).all(), "the motion is nowhere faster than requested"


@pytest.mark.parametrize("kind", ["free", "path", "wish", "softened", "stop"])
def test_accelerations_and_velocities_are_the_derivatives_of_velocities_and_positions(kind):
    """Both are sent to the arms. With samples 10 ms apart, the jerk limit bounds the error of a finite
    difference."""
    rng = np.random.default_rng(11)
    path = wavy(rng, size=0.5)
    if kind == "free":
        motion = free_motion(path[0], path[-1], LIMITS)
    elif kind == "path":
        motion = time_path(path, LIMITS)
    elif kind == "stop":
        whole = time_path(path, LIMITS)
        motion = stop_profile(whole, 0.4 * whole.duration, MODEL.protective)
    else:
        t, wish = smooth_wish(0.6 if kind == "wish" else 1.4)
        motion = time_law(wish, t, LIMITS)
    jerk = (MODEL.protective if kind == "stop" else LIMITS).jerk
    h = float(np.diff(motion.t).max())
    mean_speed = (motion.qd[1:] + motion.qd[:-1]) / 2
    assert (np.abs(np.diff(motion.q, axis=0) / np.diff(motion.t)[:, None] - mean_speed) <= jerk * h**2 / 6).all()
    mean_change = (motion.qdd[1:] + motion.qdd[:-1]) / 2
    assert (np.abs(np.diff(motion.qd, axis=0) / np.diff(motion.t)[:, None] - mean_change) <= jerk * h).all()
    assert np.abs(motion.qdd).max() > 0.1


def test_paths_without_a_speed_cap_are_not_slowed():
    path = wavy(np.random.default_rng(5), size=0.3)
    free = time_path(path, LIMITS)
    for some in ({"lengths": np.linspace(0, 5.0, 60)[:, None]}, {"speed": 0.01}):
        assert time_path(path, LIMITS, **some).duration == free.duration


def test_joined_motions_must_meet():
    rng = np.random.default_rng(7)
    a, b, c = (random_configuration(rng) for _ in range(3))
    first, second = free_motion(a, b, LIMITS), free_motion(b, c, LIMITS)
    whole = join([first, second])
    assert whole.duration == pytest.approx(first.duration + second.duration)
    assert peaks(whole, LIMITS).worst <= TOLERANCE
    with pytest.raises(InternalError):
        join([first, hold(c)])


def test_a_start_after_a_pause_keeps_the_limits_from_any_point_of_the_path():
    """Where a joint is at its acceleration limit, a restart has no reserve and takes longer."""
    motion = time_path(wavy(np.random.default_rng(9), size=0.8), LIMITS)
    for t in np.linspace(0.0, motion.duration, 25)[:-1]:
        warp = warp_clock(motion, ClockWarp(float(t), 0.6, 1.0, rate=0.0), LIMITS)
        assert peaks(warped(motion, warp), LIMITS).worst <= TOLERANCE


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.8, 0.97])
def test_a_stop_stays_on_the_path_and_ends_at_rest(share):
    motion = time_path(wavy(np.random.default_rng(9), size=0.8), LIMITS)
    t = share * motion.duration
    stop = stop_profile(motion, t, MODEL.protective)
    assert stop.q[0] == pytest.approx(motion.at(t)[0], abs=1e-9)
    assert stop.qd[0] == pytest.approx(motion.at(t)[1], abs=1e-9)
    assert not stop.qd[-1].any()
    assert stop.duration <= 1.0
    assert peaks(stop, MODEL.protective).worst <= TOLERANCE
    fine = np.array([motion.at(x)[0] for x in np.linspace(t, motion.duration, 3000)])
    assert max(np.abs(fine - q).max(axis=1).min() for q in stop.q[::5]) < 2e-3


@pytest.mark.parametrize("t", [-1.0, 1e3])
def test_a_stop_before_the_beginning_or_after_the_end_stays_on_the_path(t):
    motion = time_path(wavy(np.random.default_rng(9), size=0.8), LIMITS)
    stop = stop_profile(motion, t, MODEL.protective)
    if t > 0:
        assert np.array_equal(stop.q, np.tile(motion.q[-1], (len(stop.q), 1))) and not stop.qd.any()
    else:
        assert np.array_equal(stop.q[0], motion.q[0]) and not stop.qd[-1].any()


@pytest.mark.parametrize("rate", [0.4, 1.0])
def test_a_constant_clock_rate_only_stretches_time(rate):
    """For a cubic in time, defined by two samples and their velocities, q, q' and q'' have closed forms."""
    a, b, c = (np.random.default_rng(k).normal(size=14) for k in range(3))
    t = np.array([0.0, 0.3, 0.5, 1.0])[:, None]
    cubic = ArmTrajectory(t[:, 0], a * t**3 + b * t**2 + c * t, 3 * a * t**2 + 2 * b * t + c, 6 * a * t + 2 * b)
    motion = warped(cubic, ClockWarp(0.1, 0.6, rate, rate=rate))
    tau = 0.1 + rate * motion.t[:, None]
    np.testing.assert_allclose(motion.q, a * tau**3 + b * tau**2 + c * tau, atol=1e-12)
    np.testing.assert_allclose(motion.qd, rate * (3 * a * tau**2 + 2 * b * tau + c), atol=1e-12)
    np.testing.assert_allclose(motion.qdd, rate**2 * (6 * a * tau + 2 * b), atol=1e-10)


def test_infeasible_limits_stretch_a_stop_at_most_4_times_and_a_start_16_times():
    """A stop must end soon, but a start can take longer. Limits of a hundredth cannot be kept by either."""
    motion = time_path(wavy(np.random.default_rng(9), size=0.8), LIMITS)
    tight = replace(LIMITS, velocity=0.01 * LIMITS.velocity, acceleration=0.01 * LIMITS.acceleration)
    middle = 0.5 * motion.duration
    for share in (1.0, 0.5):
        stop = stop_profile(motion, middle, tight, share * STOP_TIME)
        assert stop.duration == pytest.approx(4.0 * share * STOP_TIME) and not stop.qd[-1].any()
    for goal, factor in ((0.0, 4.0), (1.0, 16.0), (0.5, 16.0)):
        warp = warp_clock(motion, ClockWarp(middle, STOP_TIME, goal, rate=0.9), tight)
        assert warp.duration == pytest.approx(factor * STOP_TIME)


def test_a_stop_takes_its_given_time_if_the_limits_allow_it():
    motion = time_path(wavy(np.random.default_rng(9), size=0.8), LIMITS)
    slow = ArmTrajectory(10.0 * motion.t, motion.q, 0.1 * motion.qd, 0.01 * motion.qdd)
    for duration in (0.3, STOP_TIME):
        assert stop_profile(slow, 0.5 * slow.duration, MODEL.protective, duration).duration == duration


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("backwards", [False, True])
def test_jerk_in_either_direction_counts(sign, backwards):
    """For q = j t^3 / 6 on one joint, from rest, the shares of all limits have closed forms."""
    j, t = 3.0, np.linspace(0.0, 0.5, 51)
    q, qd, qdd = (np.zeros((51, 14)) for _ in range(3))
    q[:, 2], qd[:, 2], qdd[:, 2] = sign * j * t**3 / 6, sign * j * t**2 / 2, sign * j * t
    if backwards:
        q, qd, qdd = q[::-1], -qd[::-1], qdd[::-1]
    share = peaks(ArmTrajectory(t, q, qd, qdd), LIMITS)
    assert share.velocity == pytest.approx(j * 0.125 / LIMITS.velocity[2])
    assert share.acceleration == pytest.approx(j * 0.5 / LIMITS.acceleration[2])
    assert share.jerk == pytest.approx(j / LIMITS.jerk[2])
    assert share.worst == max(share.velocity, share.acceleration, share.jerk)
    slower = ArmTrajectory(share.stretch * t, q, qd / share.stretch, qdd / share.stretch**2)
    assert peaks(slower, LIMITS).worst == pytest.approx(1.0), "the motion is just within the limit"


def test_the_largest_velocity_between_two_samples_is_found():
    """From rest to rest by d in one interval T: the speed in the middle is 3/2 of the mean, the acceleration at
    the ends is 6 d / T^2, and the jerk is 12 d / T^3."""
    d, T = 0.3, 2.0
    q = np.zeros((2, 14))
    q[1, 5] = -d
    share = peaks(ArmTrajectory(np.array([0.0, T]), q, np.zeros((2, 14)), np.zeros((2, 14))), LIMITS)
    assert share.velocity == pytest.approx(1.5 * d / T / LIMITS.velocity[5])
    assert share.acceleration == pytest.approx(6 * d / T**2 / LIMITS.acceleration[5])
    assert share.jerk == pytest.approx(12 * d / T**3 / LIMITS.jerk[5])


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.floats(0.1, 1.0), st.floats(-2.0, 2.0), st.sampled_from([0.0, 1.0]), st.floats(0.2, 1.5))
def test_a_clock_warp_changes_its_rate_smoothly(rate, slope, goal, duration):
    """By definition, the clock is the integral of its rate, and the slope is the derivative of the rate. Both ends
    have the given rates."""
    warp = ClockWarp(2.0, duration, goal, rate, slope)
    tau = np.linspace(0.0, duration, 4001)
    clock, r, s = warp.at(tau)
    assert (clock[0], r[0], s[0]) == pytest.approx((2.0, rate, slope))
    assert (r[-1], s[-1]) == pytest.approx((goal, 0.0), abs=1e-9)
    assert np.abs(np.gradient(clock, tau)[1:-1] - r[1:-1]).max() < 1e-3
    assert np.abs(np.gradient(r, tau)[1:-1] - s[1:-1]).max() < 2e-2
    still = warp.at(duration + 1.0)
    assert float(still[1]) == pytest.approx(goal)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_start_from_rest_on_the_path_meets_the_running_motion(share):
    motion = time_path(wavy(np.random.default_rng(9), size=0.8), LIMITS)
    begin = ClockWarp(share * motion.duration, 0.6, 1.0, rate=0.0)
    warp = warp_clock(motion, begin, LIMITS)
    start = warped(motion, warp)
    assert not start.qd[0].any() and peaks(start, LIMITS).worst <= TOLERANCE
    clock = float(warp.at(warp.duration)[0])
    if clock < motion.duration:
        assert start.q[-1] == pytest.approx(motion.at(clock)[0], abs=1e-9)
        assert start.qd[-1] == pytest.approx(motion.at(clock)[1], abs=1e-6)
