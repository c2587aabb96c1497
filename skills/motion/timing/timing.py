"""Time parameterization of both arms' paths within velocity, acceleration and jerk limits.

Free motions are straight lines in joint space, timed by Ruckig along the line. On a path that must be followed
exactly, only the parameter is timed, q(s(t)), so the arms never leave the path:

1. TOPP-RA (Pham and Pham, IEEE T-RO 34(3), 2018) gives the fastest ds/dt within the limits of velocity,
   acceleration and the tools' speed. Or the caller gives the time law s(t), as for a fold.
2. ds/dt is smoothed over time, which bounds the jerk. The jerk limits set the width of the kernel.
3. Velocity, acceleration and jerk of q(s(t)) are measured on the samples, and time is stretched evenly until
   all of them are within their limits.

Repeated samples count as one sample, because a spline through both could have an arbitrarily large bend between
them. At a sharp turn of the path, the spline has a bend that would slow down the whole motion. The path is
therefore also timed with a stop at the turn, and the shorter motion is taken.

A motion that is too long to be sampled raises a TimingError, which a planner (`foldcell.skills.motion.moves`) ends
with.

Ruckig's way-points (`intermediate_positions`) are never used, because they call a network service.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import ruckig
from scipy.interpolate import CubicSpline, make_interp_spline

from foldcell.robots.errors import Failure, FailureKind, InternalError
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import ArmTrajectory, Array, frozen
from foldcell.skills.motion.timing.without_plots import without_plots
from foldcell.skills.vocabulary import Failed

with without_plots():
    import toppra
    import toppra.algorithm
    import toppra.constraint

LONGEST_MOTION = 600.0
"""Maximum duration of one motion [s]; it has 60 000 samples. Even at the slowest settings of a cell (5 % of the
joints' speed, tools at 0.02 m/s) no motion takes more than about three minutes."""
TICK = 0.01
"""Longest time between samples [s]."""
STOP_TIME = 0.6
"""Time in which the clock of a trajectory slows down to a stop, or starts again [s]."""
WARP_FACTORS = (1.0, 1.25, 1.6, 2.0, 2.8, 4.0)
"""Factors on STOP_TIME that are tried in turn, because the joints' limits can require a longer time."""
HEADROOM = 0.98
"""Share of the limits that is used in planning. The rest is for the Hermite interpolant, which can exceed the
values at the samples."""
GRID = 100
LAW_STEP = 0.002
REPEATED = 1e-5
"""Two samples of a path that are nearer to each other than this count as one. The distance is expressed as the
time that it takes at full joint speed [s]."""
SHARP_TURNS = (0.0, 0.5)
"""Cosines of 90 and 60 degrees, which are tried in turn. A sample at which successive steps of the path turn by
more than the tried angle may become a stop. A smooth path is sampled so finely that it turns by less."""
MAX_STRETCHES = 40
"""Maximum number of times that a trajectory is stretched. One or two suffice, except for bends of a milliradian,
whose sampled jerk is irregular."""


class TimingError(Failed):
    """Raised when a motion cannot be timed: no motion keeps its limits, or it would take longer than
    LONGEST_MOTION."""

    def __init__(self, what: str, hint: str, **values: Any) -> None:
        super().__init__(Failure(FailureKind.LIMIT_EXCEEDED, what, hint, values))


@dataclass(frozen=True)
class Peaks:
    """Largest share of each limit that a trajectory uses (1 = at the limit), over all joints and times."""

    velocity: float
    acceleration: float
    jerk: float

    @property
    def worst(self) -> float:
        return max(self.velocity, self.acceleration, self.jerk)

    @property
    def stretch(self) -> float:
        """Factor on the trajectory's times that brings velocity, acceleration and jerk within their limits."""
        return max(self.velocity, self.acceleration**0.5, self.jerk ** (1.0 / 3.0))


def peaks(trajectory: ArmTrajectory, limits: JointLimits) -> Peaks:
    """Compute the peaks of the cubic Hermite interpolant. In each interval, the acceleration is largest at one
    end, the jerk is constant, and the velocity can be largest in between."""
    h = np.diff(trajectory.t)[:, None]
    q0, q1, v0, v1 = trajectory.q[:-1], trajectory.q[1:], trajectory.qd[:-1], trajectory.qd[1:]
    a0 = 6 * (q1 - q0) / h**2 - (4 * v0 + 2 * v1) / h
    a1 = -6 * (q1 - q0) / h**2 + (2 * v0 + 4 * v1) / h
    # The velocity of a Hermite piece is a parabola, whose extremum can lie inside the interval.
    s = np.clip(a0 / np.where(a0 == a1, np.inf, a0 - a1), 0.0, 1.0)
    inside = v0 + h * (a0 * s + 0.5 * (a1 - a0) * s**2)
    velocity = np.maximum(np.maximum(np.abs(v0), np.abs(v1)), np.abs(inside))
    acceleration = np.maximum(np.abs(a0), np.abs(a1))
    jerk = np.abs(a1 - a0) / h
    return Peaks(
        float((velocity / limits.velocity).max()),
        float((acceleration / limits.acceleration).max()),
        float((jerk / limits.jerk).max()),
    )


def hold(q: Array) -> ArmTrajectory:
    """Create a trajectory that rests at q (joints,) for two ticks."""
    t, zero = _sample_times(2 * TICK), np.zeros((3, len(q)))
    return ArmTrajectory(frozen(t), frozen(zero + q), frozen(zero), frozen(zero))


def join(parts: Sequence[ArmTrajectory]) -> ArmTrajectory:
    """Concatenate trajectories. Each must start at the position and velocity at which the one before ends.

    Raises InternalError when they do not meet.
    """
    t, q, qd, qdd = [parts[0].t], [parts[0].q], [parts[0].qd], [parts[0].qdd]
    for before, after in pairwise(parts):
        gap = max(np.abs(before.q[-1] - after.q[0]).max(), np.abs(before.qd[-1] - after.qd[0]).max())
        if gap > 1e-6:
            raise InternalError("joined trajectories do not meet", gap=float(gap))
        t.append(t[-1][-1] + after.t[1:])
        q.append(after.q[1:])
        qd.append(after.qd[1:])
        qdd.append(after.qdd[1:])
    return ArmTrajectory(*(frozen(np.concatenate(x)) for x in (t, q, qd, qdd)))


def free_motion(q0: Array, q1: Array, limits: JointLimits) -> ArmTrajectory:
    """Compute the time-optimal motion within the limits from rest at q0 (joints,) to rest at q1 (joints,),
    straight in joint space.

    Raises TimingError for limits that no motion keeps, and for a motion that would take too long.
    """
    gap = q1 - q0
    if np.abs(gap).max() < 1e-9:
        return hold(q0)
    # All joints share one parameter from 0 to 1. Ruckig's own phase synchronisation of many joints is not used: it
    # silently falls back to curved, time-synchronised motions if limits of different order bind two joints.
    distance = np.maximum(np.abs(gap), 1e-12)
    generator = ruckig.Ruckig(1)
    request = ruckig.InputParameter(1)
    request.current_position, request.target_position = [0.0], [1.0]
    request.max_velocity = [HEADROOM * float((limits.velocity / distance).min())]
    request.max_acceleration = [HEADROOM * float((limits.acceleration / distance).min())]
    request.max_jerk = [HEADROOM * float((limits.jerk / distance).min())]
    result = ruckig.Trajectory(1)
    try:
        result_code = generator.calculate(request, result)
    except ruckig.RuckigError as e:
        raise _no_free_motion(request, "its limits are too large or too small") from e
    if result_code not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise _no_free_motion(request, str(result_code))
    _validate_duration(result.duration, "the free motion")
    t = _sample_times(result.duration)
    u, rate, acceleration = (np.array(x) for x in zip(*(result.at_time(float(ti))[:3] for ti in t), strict=True))
    u[0], u[-1], rate[0], rate[-1] = 0.0, 1.0, 0.0, 0.0
    q = q0 + u * gap
    q[-1] = q1
    return ArmTrajectory(frozen(t), frozen(q), frozen(rate * gap), frozen(acceleration * gap))


def _no_free_motion(request: ruckig.InputParameter, why: str) -> TimingError:
    limits = {name: getattr(request, f"max_{name}")[0] for name in ("velocity", "acceleration", "jerk")}
    return TimingError(
        f"Ruckig found no motion between two states at rest: {why}",
        "correct the limits on the joints' velocity, acceleration and jerk",
        **limits,
    )


def time_path(
    path: Array, limits: JointLimits, *, lengths: Array | None = None, speed: float | None = None
) -> ArmTrajectory:
    """Time a smooth joint path (n, joints) from rest to rest, as fast as the limits allow.

    lengths: (n, k) distance travelled by each of k tools at each sample [m]; speed: maximum speed of the
    tools [m/s]. The path is the cubic spline through the samples. If it turns sharply, it can be several splines,
    with a stop between them. Raises TimingError for a motion that would take too long.
    """
    kept = _without_repeats(path / limits.velocity)
    path, lengths = path[kept], None if lengths is None else lengths[kept]
    best: ArmTrajectory | None = None
    refusal: TimingError | None = None
    for stops in _stops_tried(path / limits.velocity):
        ends = [0, *stops, len(path) - 1]
        parts = [slice(a, b + 1) for a, b in pairwise(ends)]
        try:
            motion = join(
                [_time_part(path[k], limits, None if lengths is None else lengths[k], speed) for k in parts]
            )
        except TimingError as e:
            refusal = refusal or e
            continue
        if best is None or motion.duration < best.duration:
            best = motion
    if best is None:
        assert refusal is not None
        raise refusal
    return best


def _time_part(path: Array, limits: JointLimits, lengths: Array | None, speed: float | None) -> ArmTrajectory:
    """Time the spline through path (n, joints), from rest to rest."""
    s = _path_parameter(path, limits)
    curve = CubicSpline(s, path)
    speed_cap = None if lengths is None or speed is None else (CubicSpline(s, lengths), speed)
    return _smooth_and_stretch(curve, *_time_optimal_law(curve, s, limits, speed_cap), limits)


def _without_repeats(path: Array) -> list[int]:
    """Return the indices of the samples of path (n, k) that remain without repeats: each differs from the
    remaining one before it. The two ends always remain."""
    kept = [0]
    for i in range(1, len(path)):
        if np.linalg.norm(path[i] - path[kept[-1]]) > REPEATED:
            kept.append(i)
    last = len(path) - 1
    if kept[-1] != last:
        kept = [*(kept[:-1] or kept), last]
    return kept


def _stops_tried(path: Array) -> Iterator[list[int]]:
    """Yield lists of samples (indices) of path (n, k), without repeats, at which to stop: first no stop, then the
    sharp turns, for each bound of SHARP_TURNS."""
    yield []
    step = np.diff(path, axis=0)
    along = step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12)
    cosine = (along[1:] * along[:-1]).sum(axis=1)
    tried: list[int] = []
    for bound in SHARP_TURNS:
        stops = [int(i) + 1 for i in np.flatnonzero(cosine < bound)]
        if stops != tried:
            yield stops
        tried = stops


def time_law(path: Array, t: Array, limits: JointLimits) -> ArmTrajectory:
    """Time a joint path (n, joints) at the requested times t (n,) [s], or more slowly where the limits require it.

    Times that keep the limits, with soft start and stop, are used unchanged. If only the start or stop is too
    abrupt, it is softened. Otherwise the result is the fastest time law that is nowhere ahead of the requested
    times. Raises TimingError for a motion that would take too long.
    """
    tau = t - t[0]
    _validate_duration(float(tau[-1]), "the requested motion")
    exact = _as_requested(path, tau, limits)
    if exact is not None:
        return exact
    curve = CubicSpline(tau, path)
    softened = _smooth_and_stretch(curve, np.array([0.0, tau[-1]]), np.array([0.0, tau[-1]]), limits)
    slack = softened.duration / (tau[-1] + 2 * _kernel_width(limits))
    if slack < 1.02:
        return softened
    clock = CubicSpline(tau, tau[:, None])
    return min(
        (softened, _smooth_and_stretch(curve, *_time_optimal_law(curve, tau, limits, (clock, 1.0)), limits)),
        key=lambda a: a.duration,
    )


def _as_requested(path: Array, tau: Array, limits: JointLimits) -> ArmTrajectory | None:
    """Return the spline through path (n, joints) at times tau (n,) [s]; None if it exceeds a limit, or if its
    start or stop is not soft."""
    curve = CubicSpline(tau, path, bc_type="clamped")
    t = _sample_times(float(tau[-1]))
    q, qd, qdd = curve(t), curve(t, 1), curve(t, 2)
    qd[0] = qd[-1] = 0.0
    trajectory = ArmTrajectory(frozen(t), frozen(q), frozen(qd), frozen(qdd))
    # The arms rest before the start and after the end, so the acceleration jumps there. The largest allowed jump
    # is the change of acceleration that the largest jerk makes in one tick.
    soft_ends = np.all(np.abs(qdd[[0, -1]]) <= limits.jerk * TICK)
    return trajectory if soft_ends and peaks(trajectory, limits).worst <= 1.0 else None


@dataclass(frozen=True)
class ClockWarp:
    """A change of the rate at which a trajectory's clock runs: a cubic from `rate` with `slope` [1/s] to `goal`
    with slope 0.

    start: the clock's present reading [s]. duration: of the change [s], after which the rate stays at `goal`.
    """

    start: float
    duration: float
    goal: float
    rate: float = 1.0
    slope: float = 0.0

    def at(self, tau: Array | float) -> tuple[Array, Array, Array]:
        """Return the clock's reading [s], its rate [1] and the rate's slope [1/s], (n,) each, tau (n,) [s] from
        now."""
        d = self.duration
        u = np.clip(np.asarray(tau, dtype=float) / d, 0.0, 1.0)
        rate_drop, slope_share = self.rate - self.goal, self.slope * d
        rate = self.goal + rate_drop * (1.0 - u**2 * (3.0 - 2.0 * u)) + slope_share * u * (1.0 - u) ** 2
        slope = (-6.0 * rate_drop * u * (1.0 - u) + slope_share * (1.0 - u) * (1.0 - 3.0 * u)) / d
        drop_integral, slope_integral = u - u**3 + 0.5 * u**4, 0.5 * u**2 - 2.0 * u**3 / 3.0 + 0.25 * u**4
        return (
            self.start + d * (self.goal * u + rate_drop * drop_integral + slope_share * slope_integral),
            rate,
            slope,
        )


def warp_clock(trajectory: ArmTrajectory, warp: ClockWarp, limits: JointLimits) -> ClockWarp:
    """Lengthen the duration of a warp until the trajectory's joints keep `limits`.

    A stop is lengthened up to four times. A start is less urgent and is lengthened up to sixteen times.
    """
    for factor in WARP_FACTORS if warp.goal == 0.0 else (*WARP_FACTORS, 5.6, 8.0, 16.0):
        lengthened = replace(warp, duration=factor * warp.duration)
        if peaks(warped(trajectory, lengthened), limits).worst <= 1.0:
            break
    return lengthened


def warped(trajectory: ArmTrajectory, warp: ClockWarp) -> ArmTrajectory:
    """Compute the motion along the trajectory while its clock changes its rate. The path is the same; the motion
    ends at rest if the goal is 0."""
    tau = _sample_times(warp.duration)
    clock, rate, slope = warp.at(tau)
    inside = clock < trajectory.duration
    q, v, a = trajectory.sampled(np.minimum(clock, trajectory.duration))
    rate, slope = np.where(inside, rate, 0.0)[:, None], np.where(inside, slope, 0.0)[:, None]
    qd, qdd = v * rate, a * rate**2 + v * slope
    if warp.goal == 0.0:
        qd[-1] = 0.0
    return ArmTrajectory(frozen(tau), frozen(q), frozen(qd), frozen(qdd))


def _validate_duration(seconds: float, what: str = "the motion") -> None:
    """Raises TimingError if `seconds` is not finite, or above LONGEST_MOTION. Call it before sampling."""
    if not seconds <= LONGEST_MOTION:  # also true for NaN
        raise TimingError(
            f"{what} would take {seconds:.4g} s; the longest motion takes {LONGEST_MOTION:.0f} s",
            "raise the limits on the joints' velocity, acceleration and jerk and on the tools' speed",
            duration_s=float(seconds) if np.isfinite(seconds) else None,
            longest_s=LONGEST_MOTION,
        )


def _sample_times(duration: float) -> Array:
    """Evenly spaced times from 0 to duration, at most TICK apart. Raises TimingError for too long a duration."""
    _validate_duration(duration)
    n = max(2, int(np.ceil(duration / TICK - 1e-9)))
    return np.linspace(0.0, duration, n + 1)


def _path_parameter(path: Array, limits: JointLimits) -> Array:
    """Path parameter (n,): the time at which each sample is reached at full joint speed [s]."""
    step = np.linalg.norm(np.diff(path, axis=0) / limits.velocity, axis=1)
    return np.concatenate([[0.0], np.cumsum(np.maximum(step, 1e-6))])


def _kernel_width(limits: JointLimits) -> float:
    """Width of the window over which ds/dt is averaged [s]: a / j, the ratio of the limits of acceleration and
    jerk. A reversal of the acceleration takes 2 a / j; half of this suffices for most paths."""
    return float((limits.acceleration / limits.jerk).max())


def _time_optimal_law(
    curve: CubicSpline, s: Array, limits: JointLimits, speed_cap: tuple[CubicSpline, float] | None
) -> tuple[Array, Array]:
    """Compute TOPP-RA's time law from rest to rest, finely sampled: t (m,) [s] and s (m,)."""
    path = _WithLengths(curve, speed_cap[0]) if speed_cap else _WithLengths(curve, None)
    extra = path.dof - curve(0.0).shape[0]
    v = HEADROOM * np.concatenate([limits.velocity, np.full(extra, speed_cap[1] if speed_cap else 1.0)])
    a = HEADROOM * np.concatenate([limits.acceleration, np.full(extra, 1e3)])
    constraints = [
        toppra.constraint.JointVelocityConstraint(np.stack([-v, v], axis=1)),
        toppra.constraint.JointAccelerationConstraint(np.stack([-a, a], axis=1)),
    ]
    grid = np.linspace(s[0], s[-1], GRID + 1)
    solver = toppra.algorithm.TOPPRA(constraints, path, gridpoints=grid, solver_wrapper="seidel")
    data = solver.compute_parameterization(0.0, 0.0, return_data=True)
    rate = None if data is None else data[1]
    if rate is None or not np.all(np.isfinite(rate)):
        return np.array([0.0, 4.0 * s[-1]]), np.array([s[0], s[-1]])
    # d2s/dt2 is constant between grid points, so the times are exact.
    ds = np.diff(grid)
    t = np.concatenate([[0.0], np.cumsum(2.0 * ds / np.maximum(rate[:-1] + rate[1:], 1e-6))])
    _validate_duration(float(t[-1]))
    fine_t = np.linspace(0.0, t[-1], max(2, int(t[-1] / LAW_STEP)))
    i = np.clip(np.searchsorted(t, fine_t, side="right") - 1, 0, GRID - 1)
    dt = fine_t - t[i]
    acceleration = (rate[i + 1] - rate[i]) / (t[i + 1] - t[i])
    return fine_t, np.clip(grid[i] + rate[i] * dt + 0.5 * acceleration * dt**2, s[0], s[-1])


class _WithLengths(toppra.interpolator.AbstractGeometricPath):
    """A joint path for TOPP-RA, in which the distances that the tools have travelled are additional
    coordinates."""

    def __init__(self, curve: CubicSpline, lengths: CubicSpline | None) -> None:
        self._curves = (curve,) if lengths is None else (curve, lengths)
        self._dof = sum(c(0.0).shape[0] for c in self._curves)

    def __call__(self, s: Array, order: int = 0) -> Array:
        return np.concatenate([c(s, order) for c in self._curves], axis=-1)

    @property
    def dof(self) -> int:
        return self._dof

    @property
    def path_interval(self) -> Array:
        """Range of the path parameter; TOPP-RA compares its grid with it."""
        return np.array([self._curves[0].x[0], self._curves[0].x[-1]])


def _smooth_and_stretch(curve: CubicSpline, t: Array, s: Array, limits: JointLimits) -> ArmTrajectory:
    """Perform steps 2 and 3 of the module's description: smooth the time law (t, s), then stretch time until every
    limit is kept."""
    law, duration = _smooth(t, s, _kernel_width(limits))
    stretch = 1.0
    for _ in range(MAX_STRETCHES):
        trajectory = _tabulate(curve, law, duration, stretch)
        excess = peaks(trajectory, limits)
        if excess.worst <= 1.0:
            return trajectory
        stretch *= excess.stretch * 1.002
    return trajectory


def _smooth(t: Array, s: Array, width: float) -> tuple[make_interp_spline, float]:
    """Average s(t) twice over windows of `width` [s]. Return it as a C4 spline, and its duration [s]."""
    _validate_duration(float(t[-1]) + 2.0 * width)
    k = max(1, round(width / LAW_STEP))
    n = int(np.ceil(t[-1] / LAW_STEP))
    padded = np.interp(np.arange(-2 * k, n + 2 * k + 1) * LAW_STEP, t, s)
    box = np.ones(k) / k
    smooth = np.convolve(np.convolve(padded, box, mode="valid"), box, mode="valid")
    moving = np.flatnonzero((smooth > s[0] + 1e-12) & (smooth < s[-1] - 1e-12))
    first, last = max(moving[0] - 1, 0), min(moving[-1] + 1, len(smooth) - 1)
    smooth = smooth[first : last + 1]
    smooth[0], smooth[-1] = s[0], s[-1]
    time = np.arange(len(smooth)) * LAW_STEP
    # Every fifth sample suffices: the kernel is wider than the grid.
    knots = np.unique(np.concatenate([np.arange(0, len(time), 5), [len(time) - 1]]))
    at_rest = [(1, 0.0), (2, 0.0)]
    return make_interp_spline(time[knots], smooth[knots], k=5, bc_type=(at_rest, at_rest)), float(time[-1])


def _tabulate(curve: CubicSpline, law: make_interp_spline, duration: float, stretch: float) -> ArmTrajectory:
    t = _sample_times(duration * stretch)
    u = t / stretch
    u[-1] = duration
    s, rate, acceleration = law(u), law(u, 1)[:, None] / stretch, law(u, 2)[:, None] / stretch**2
    q, slope, curvature = curve(s), curve(s, 1), curve(s, 2)
    qd, qdd = slope * rate, curvature * rate**2 + slope * acceleration
    qd[0] = qd[-1] = 0.0
    return ArmTrajectory(frozen(t), frozen(q), frozen(qd), frozen(qdd))
