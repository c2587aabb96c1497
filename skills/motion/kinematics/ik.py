"""Inverse kinematics of one arm by damped least squares, for single poses and for paths of tool poses (compiled).

The solver is a Levenberg-Marquardt iteration on the pose error with the damping of Sugihara (IEEE T-RO 27(5),
2011): proportional to the squared error, plus a bias. Joints that push against their limit are excluded from the
step. An arm of seven joints can move without moving the tool (in its null space). For a single pose, this freedom
keeps the joints near `q_reference`; along a path, it keeps them away from their limits. An arm of six joints has
no such freedom. Forward kinematics agrees with Pinocchio to 1e-12 (tested).
"""

from __future__ import annotations

import numpy as np

from foldcell.robots.model import ArmChain, RobotModel
from foldcell.robots.ports import Array, Side
from foldcell.skills.compiled import cached

MAX_ITERATIONS = 60
STEP_LIMIT = 0.4
"""Largest joint step of one iteration [rad]."""
TOLERANCE = 1e-9
"""Maximum error of position [m] and of orientation [rad] of a solution."""
LIMIT_ZONE = 0.35
"""If a joint on a path is nearer to a limit than this, self-motion moves it away from the limit [rad]."""
LIMIT_GAIN = 4.0
"""Maximum self-motion away from a limit per metre of tool travel [rad/m]."""
SEEDS = 12
"""Number of fixed random configurations that serve as seeds, besides the arm's present and its parked one."""


@cached()
def _forward(rotation, translation, q, axes, origins, R, p):  # type: ignore[no-untyped-def]
    """Fills in, in the base frame: axes and origins (arm, 3) of the joints, and the tool's R (3, 3), p
    (3,)."""
    W = np.empty((3, 3))
    M = np.empty((3, 3))
    for i in range(3):
        p[i] = translation[0, i]
        for j in range(3):
            W[i, j] = rotation[0, i, j]
    for k in range(q.shape[0]):
        c, s = np.cos(q[k]), np.sin(q[k])
        for i in range(3):
            origins[k, i] = p[i]
            axes[k, i] = W[i, 2]
            a, b = W[i, 0], W[i, 1]
            W[i, 0] = c * a + s * b
            W[i, 1] = c * b - s * a
        for i in range(3):
            p[i] += (
                W[i, 0] * translation[k + 1, 0] + W[i, 1] * translation[k + 1, 1] + W[i, 2] * translation[k + 1, 2]
            )
            for j in range(3):
                M[i, j] = (
                    W[i, 0] * rotation[k + 1, 0, j]
                    + W[i, 1] * rotation[k + 1, 1, j]
                    + W[i, 2] * rotation[k + 1, 2, j]
                )
        W, M = M, W
    for i in range(3):
        for j in range(3):
            R[i, j] = W[i, j]


@cached()
def _pose_error(R, p, R_target, p_target, e):  # type: ignore[no-untyped-def]
    """Fills e (6,) with the position difference and the rotation vector of R_target R^T; returns their norms."""
    D = np.empty((3, 3))
    for i in range(3):
        e[i] = p_target[i] - p[i]
        for j in range(3):
            D[i, j] = R_target[i, 0] * R[j, 0] + R_target[i, 1] * R[j, 1] + R_target[i, 2] * R[j, 2]
    w0, w1, w2 = D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]
    sine = 0.5 * np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    cosine = 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    # Near a half turn the axis is ill-conditioned; any axis lets the iteration leave this point.
    factor = 0.5 if sine < 1e-9 else 0.5 * angle / sine
    e[3], e[4], e[5] = factor * w0, factor * w1, factor * w2
    if sine < 1e-9 and cosine < 0.0:
        e[3] = np.pi
    return np.sqrt(e[0] ** 2 + e[1] ** 2 + e[2] ** 2), np.sqrt(e[3] ** 2 + e[4] ** 2 + e[5] ** 2)


@cached()
def _fill_jacobian(axes, origins, p, J):  # type: ignore[no-untyped-def]
    for k in range(axes.shape[0]):
        d0, d1, d2 = p[0] - origins[k, 0], p[1] - origins[k, 1], p[2] - origins[k, 2]
        a0, a1, a2 = axes[k, 0], axes[k, 1], axes[k, 2]
        J[0, k] = a1 * d2 - a2 * d1
        J[1, k] = a2 * d0 - a0 * d2
        J[2, k] = a0 * d1 - a1 * d0
        J[3, k], J[4, k], J[5, k] = a0, a1, a2


@cached()
def _cholesky_solve(A, b):  # type: ignore[no-untyped-def]
    """Solves A x = b in place for a symmetric positive definite A (n, n); b (n,) becomes x."""
    n = b.shape[0]
    for j in range(n):
        for i in range(j, n):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = np.sqrt(total) if i == j else total / A[j, j]
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= A[i, k] * b[k]
        b[i] = total / A[i, i]
    for i in range(n - 1, -1, -1):
        total = b[i]
        for k in range(i + 1, n):
            total -= A[k, i] * b[k]
        b[i] = total / A[i, i]


@cached()
def _damped_step(J, e, rest, damping, active, dq):  # type: ignore[no-untyped-def]
    """Fills dq (arm,) = J+ e + (I - J+ J) rest over the active joints, where J+ is the damped pseudo-inverse and
    rest (arm,) the desired step in the null space."""
    n = dq.shape[0]
    A = np.zeros((6, 6))
    b = np.empty(6)
    for i in range(6):
        b[i] = e[i]
        for k in range(n):
            if active[k]:
                b[i] -= J[i, k] * rest[k]
                for j in range(6):
                    A[i, j] += J[i, k] * J[j, k]
        A[i, i] += damping
    _cholesky_solve(A, b)
    for k in range(n):
        dq[k] = 0.0
        if active[k]:
            dq[k] = rest[k]
            for i in range(6):
                dq[k] += J[i, k] * b[i]


@cached()
def _solve(rotation, translation, R_target, p_target, q, lower, upper, q_reference, gain, iterations):  # type: ignore[no-untyped-def]
    """Iterates q (arm,) in place; returns whether the tool reaches the pose within TOLERANCE."""
    n = q.shape[0]
    axes, origins, J = np.empty((n, 3)), np.empty((n, 3)), np.empty((6, n))
    R, p, e = np.empty((3, 3)), np.empty(3), np.empty(6)
    dq, rest, active = np.empty(n), np.empty(n), np.empty(n, dtype=np.bool_)
    for step in range(iterations + 1):
        _forward(rotation, translation, q, axes, origins, R, p)
        distance, angle = _pose_error(R, p, R_target, p_target, e)
        if distance < TOLERANCE and angle < TOLERANCE:
            return True
        if step == iterations:
            return False
        _fill_jacobian(axes, origins, p, J)
        error = distance * distance + angle * angle
        # The null-space term fades out with the pose error, so that the iteration converges.
        pull = gain * min(1.0, np.sqrt(error) * 10.0)
        for k in range(n):
            active[k] = True
            rest[k] = pull * (q_reference[k] - q[k])
        for _ in range(4):
            _damped_step(J, e, rest, 1e-3 * error + 1e-11, active, dq)
            blocked = False
            for k in range(n):
                pushes = (q[k] <= lower[k] and dq[k] < 0.0) or (q[k] >= upper[k] and dq[k] > 0.0)
                if active[k] and pushes:
                    active[k] = False
                    blocked = True
            if not blocked:
                break
        largest = 0.0
        for k in range(n):
            largest = max(largest, abs(dq[k]))
        scale = min(1.0, STEP_LIMIT / largest) if largest > 0.0 else 1.0
        for k in range(n):
            q[k] = min(max(q[k] + scale * dq[k], lower[k]), upper[k])
    return False


@cached()
def _solve_many(rotation, translation, R_target, p_target, seeds, lower, upper, gain, iterations, out):  # type: ignore[no-untyped-def]
    """Solves from every seed (m, arm) in turn; returns the number of distinct solutions in out (m, arm)."""
    found, n = 0, seeds.shape[1]
    q = np.empty(n)
    for s in range(seeds.shape[0]):
        q[:] = seeds[s]
        if not _solve(rotation, translation, R_target, p_target, q, lower, upper, seeds[s], gain, iterations):
            continue
        new = True
        for f in range(found):
            gap = 0.0
            for k in range(n):
                gap = max(gap, abs(out[f, k] - q[k]))
            if gap < 0.15:
                new = False
                break
        if new:
            out[found] = q
            found += 1
    return found


@cached()
def _away_from_limits(J, q, lower, upper, distance, out):  # type: ignore[no-untyped-def]
    """Fills out (arm,) with a step of self-motion that moves joints away from limits that they are near, while the
    tool travels `distance` [m]."""
    n = q.shape[0]
    push, active = np.empty(n), np.ones(n, dtype=np.bool_)
    none = True
    for k in range(n):
        push[k] = 0.0
        low, high = q[k] - lower[k], upper[k] - q[k]
        if low < LIMIT_ZONE:
            push[k] += LIMIT_GAIN * distance * (1.0 - low / LIMIT_ZONE) ** 2
            none = False
        if high < LIMIT_ZONE:
            push[k] -= LIMIT_GAIN * distance * (1.0 - high / LIMIT_ZONE) ** 2
            none = False
    if none:
        out[:] = 0.0
    else:
        _damped_step(J, np.zeros(6), push, 1e-6, active, out)


@cached()
def _follow(rotation, translation, R_path, p_path, q0, lower, upper, max_step, out):  # type: ignore[no-untyped-def]
    """Fills out (n, arm) with the joints along a path of n poses; returns the number of poses that are reached
    without a joint step above max_step."""
    n = q0.shape[0]
    axes, origins, J = np.empty((n, 3)), np.empty((n, 3)), np.empty((6, n))
    R, p, drift, q = np.empty((3, 3)), np.empty(3), np.empty(n), q0.copy()
    for i in range(p_path.shape[0]):
        if i > 0:
            _forward(rotation, translation, q, axes, origins, R, p)
            _fill_jacobian(axes, origins, p, J)
            distance = np.sqrt(np.sum((p_path[i] - p_path[i - 1]) ** 2))
            _away_from_limits(J, q, lower, upper, distance, drift)
            for k in range(n):
                q[k] = min(max(q[k] + drift[k], lower[k]), upper[k])
        if not _solve(rotation, translation, R_path[i], p_path[i], q, lower, upper, q, 0.0, 20):
            return i
        if i > 0:
            for k in range(n):
                if abs(q[k] - out[i - 1, k]) > max_step:
                    return i
        out[i] = q
    return p_path.shape[0]


def tool_pose(chain: ArmChain, q: Array) -> Array:
    """Compute T_base_tool (4, 4) of one arm at q (arm,)."""
    T, n = np.eye(4), len(q)
    R, p = np.empty((3, 3)), np.empty(3)
    _forward(
        chain.rotation, chain.translation, np.asarray(q, float), np.empty((n, 3)), np.empty((n, 3)), R, p
    )  # fmt: skip
    T[:3, :3], T[:3, 3] = R, p
    return T


def solve_pose(model: RobotModel, side: Side, T_base_tool: Array, q0: Array, *, gain: float = 0.1) -> Array | None:
    """Find joints (arm,) near q0 (arm,) that bring one tool to T_base_tool (4, 4); None when the iteration fails.

    The solution stays within the planning position limits. gain: share (0..1) of the distance to q0 that the null
    space may remove in each iteration.
    """
    chain, joints = model.chains[side], model.arm(side)
    q = np.array(q0, dtype=float)
    ok = _solve(
        chain.rotation, chain.translation, np.ascontiguousarray(T_base_tool[:3, :3]),
        np.ascontiguousarray(T_base_tool[:3, 3]), q, model.planning.lower[joints], model.planning.upper[joints],
        np.array(q0, dtype=float), gain, MAX_ITERATIONS,
    )  # fmt: skip
    return q if ok else None


def arm_seeds(model: RobotModel, side: Side, q_now: Array) -> Array:
    """Return seeds (k, arm) of one arm for `solve_seeds`: its joints in q_now (joints,), its parked pose, and
    fixed random configurations."""
    joints = model.arm(side)
    lower, upper = model.planning.lower[joints], model.planning.upper[joints]
    spread = np.random.default_rng(7).uniform(lower, upper, (SEEDS, len(lower)))
    return np.vstack([np.clip(q_now[joints], lower, upper), model.q_park[joints], spread])


def solve_seeds(model: RobotModel, side: Side, T_base_tool: Array, seeds: Array) -> Array:
    """Find all distinct solutions (m, arm) for T_base_tool (4, 4) that are reached from seeds (k, arm), in their
    order."""
    chain, joints = model.chains[side], model.arm(side)
    out = np.empty_like(seeds)
    m = _solve_many(
        chain.rotation, chain.translation, np.ascontiguousarray(T_base_tool[:3, :3]),
        np.ascontiguousarray(T_base_tool[:3, 3]), seeds, model.planning.lower[joints],
        model.planning.upper[joints], 0.02, MAX_ITERATIONS, out,
    )  # fmt: skip
    return out[:m]


def follow_path(
    model: RobotModel,
    side: Side,
    rotation: Array,
    position: Array,
    q0: Array,
    *,
    max_step: float = 0.35,
    margin: float = 0.01,
) -> Array:
    """Find joints along tool poses: rotation (n, 3, 3), position (n, 3) in the base frame, starting near q0
    (arm,). Returns the joints (m, arm) at the first m poses: at all of them if m = n.

    Stops at the first pose that is out of reach, or that needs a joint step above max_step [rad] (a jump to
    another solution). Joints stay `margin` [rad] inside the planning position limits, because the spline through
    the samples overshoots. If a joint starts beyond the margin, its start is its limit.
    """
    chain, joints = model.chains[side], model.arm(side)
    out = np.empty((position.shape[0], len(q0)))
    start = np.array(q0, dtype=float)
    lower = np.minimum(model.planning.lower[joints] + margin, start)
    upper = np.maximum(model.planning.upper[joints] - margin, start)
    m = _follow(
        chain.rotation, chain.translation, np.ascontiguousarray(rotation), np.ascontiguousarray(position),
        start, lower, upper, max_step, out,
    )  # fmt: skip
    return out[:m]
