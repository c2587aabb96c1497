"""Plans motions of both arms through free space, from rest to rest: straight in joint space if possible, else
through fixed way-points, else by RRT-Connect.

RRT-Connect (Kuffner and LaValle, ICRA 2000) plans over all joints of both arms with the caller's random generator
and a bounded number of iterations. Random shortcuts then shorten the path.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import ArmTrajectory, Array, Side
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.timing.timing import free_motion, join, time_path
from foldcell.skills.motion.validation.collision import CollisionChecker, Contact
from foldcell.skills.motion.validation.failures import validate_goal, validate_state
from foldcell.skills.motion.validation.trajectory_check import contact_along
from foldcell.skills.plane import resampled
from foldcell.skills.vocabulary import Outcome, refuse, skill

STEP = 0.35
"""Maximum length of a new branch of a tree [rad, joint with the largest motion]."""
MAX_ITERATIONS = 1500
SHORTCUTS = 60
COARSE, FINE = 0.05, 0.01
"""Spacing of the collision checks along a path [rad, joint with the largest motion]. At the coarse spacing, a
collision of hands that pass each other can be missed."""
LEAD_SHARES = ((0.2, 0.0), (0.4, 0.0), (0.6, 0.0), (0.65, 0.35), (0.8, 0.2), (1.0, 0.0))
"""For paths on which one arm moves ahead of the other: how far (0..1) the leading and the trailing arm have moved
towards the goal at the way-point."""
STOP_S = 0.3
"""Time that a stop at a way-point adds, about [s]."""
NEAR, APART = 0.30, ((0.0, 0.04), (0.04, 0.04), (0.0, 0.08), (0.04, 0.08))
"""Hands that are nearer to each other than NEAR may first move apart: each away from the other along the forward
axis, and towards its own side, by these lengths [m]."""
CORNERS = (0.48, 0.3, 0.15)
"""The blend at a way-point replaces this share of each adjoining segment. The values are tried in turn."""


@skill
def plan_free_motion(
    model: RobotModel,
    checker: CollisionChecker,
    q0: Array,
    q1: Array,
    *,
    limits: JointLimits | None = None,
    rng: np.random.Generator | None = None,
) -> Outcome[ArmTrajectory]:
    """Plan a collision-free motion from rest at q0 (joints,) to rest at q1 (joints,).

    The motion is straight in joint space if that is free. Otherwise it passes through way-points, with blended
    corners if these are free too. The result has passed the same collision check that is made again before it is
    sent. limits: the model's planning limits when None. rng: for RRT-Connect. Failures: STALE_STATE (q0 is not a
    valid state), LIMIT_EXCEEDED (q1 is not a valid goal, or the limits are so low that the motion would take too
    long), IN_COLLISION (q0 or q1 is in collision, or no path was found).
    """
    limits = limits or model.planning
    refuse(validate_state(model, q0) or validate_goal(model, q1, q0) or _check_endpoints(checker, q0, q1))
    contact = None
    for method, points in _candidate_paths(model, checker, q0, q1, rng):
        for motion in _time_parameterized(points, limits):
            contact = contact_along(checker, motion)
            if contact is None:
                return Outcome(motion, notes={"way": method})
    return Outcome(failure=_no_path_found(contact))


def _time_parameterized(points: Array, limits: JointLimits) -> Iterator[ArmTrajectory]:
    """Yield trajectories through points (n, joints): first those with blended corners that are faster than
    stopping, then the one that stops at each point."""
    stopping = join([free_motion(a, b, limits) for a, b in pairwise(points)])
    for share in CORNERS if len(points) > 2 else ():
        blended = time_path(blend_corners(points, share), limits)
        if blended.duration < stopping.duration:
            yield blended
    yield stopping


def _candidate_paths(
    model: RobotModel, checker: CollisionChecker, q0: Array, q1: Array, rng: np.random.Generator | None = None
) -> Iterator[tuple[str, Array]]:
    """Yield paths from q0 (joints,) to q1 (joints,), the best first, each as (method, way-points (n, joints)).

    A path is straight in joint space between its way-points. method: "straight", "via" (through fixed way-points)
    or "rrt". The second RRT path, which is the last one, is checked for collision at the fine spacing, all other
    paths at the coarse spacing.
    """
    for via in sorted(_fixed_waypoints(model, q0, q1), key=lambda via: _seconds(model, [q0, *via, q1])):
        points = np.array([q0, *via, q1])
        if all(checker.edge_free(a, b, resolution=COARSE) for a, b in pairwise(points)):
            yield "via" if via else "straight", points
    rng = rng or np.random.default_rng(0)
    for resolution in (COARSE, FINE):
        found = _connect(model, checker, q0, q1, rng, resolution)
        if found is None:
            return
        yield "rrt", found


def _check_endpoints(checker: CollisionChecker, q0: Array, q1: Array) -> Failure | None:
    """Return IN_COLLISION if q0 (joints,) or q1 (joints,) is itself in collision, so that no path can be free,
    else None."""
    for name, q in (("start", q0), ("goal", q1)):
        contact = checker.contact(q)
        if contact is not None:
            return Failure(
                FailureKind.IN_COLLISION,
                f"the {name} of a free motion is in collision: {contact}",
                "raise the hands straight up first",
                {"pair": str(contact), "end": name},
            )
    return None


def _no_path_found(contact: Contact | None) -> Failure:
    """Create the failure IN_COLLISION for the case that no candidate path is free. contact: of the last candidate;
    None if there was no candidate."""
    message = f"no collision-free path was found in {MAX_ITERATIONS} tries"
    if contact is not None:
        message = f"no collision-free path was found; the last candidate is in collision: {contact}"
    return Failure(
        FailureKind.IN_COLLISION,
        message,
        "clear the table's surroundings, or jog the arms apart",
        {"tries": MAX_ITERATIONS},
    )


def blend_corners(points: Array, share: float) -> Array:
    """Replace the corners of the path through points (n, joints) by parabolas, and sample it evenly: (120,
    joints).

    share: part (0..0.5) of each adjoining segment that a parabola replaces.
    """
    u = np.linspace(0.0, 1.0, 12)[:, None]
    path = [points[:1]]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        a, b = corner + share * (before - corner), corner + share * (after - corner)
        path.append((1 - u) ** 2 * a + 2 * u * (1 - u) * corner + u**2 * b)
    path.append(points[-1:])
    return resampled(np.vstack(path), 120)


def _fixed_waypoints(model: RobotModel, q0: Array, q1: Array) -> list[list[Array]]:
    """Return lists of intermediate way-points; usually one list gives a free path.

    (1) No way-point. (2) A way-point at which one arm is ahead of the other. (3) Both arms pass through the parked
    pose. (4) One arm parks while the other moves to its goal. (5) Hands that start or end near each other move
    apart first, or together last.
    """
    left, right = model.arm(Side.LEFT), model.arm(Side.RIGHT)

    def at_progress(left_share: float, right_share: float) -> Array:
        q = q0.copy()
        q[left] += left_share * (q1[left] - q0[left])
        q[right] += right_share * (q1[right] - q0[right])
        return q

    waypoints: list[list[Array]] = [[]]
    for leading, trailing in LEAD_SHARES:
        waypoints += [[at_progress(leading, trailing)], [at_progress(trailing, leading)]]
    waypoints.append([model.q_park])
    for cut in (left, right):
        aside, at_goal = q0.copy(), q1.copy()
        aside[cut] = at_goal[cut] = model.q_park[cut]
        waypoints.append([aside, at_goal])
    for by in APART:
        first, last = ([q for q in [_apart(model, end, *by)] if q is not None] for end in (q0, q1))
        waypoints += [way for way in ([*first], [*last], [*first, *last]) if way]
    return waypoints


def _apart(model: RobotModel, q: Array, forward: float, aside: float) -> Array | None:
    """Return q (joints,) with each hand moved away from the other along the forward axis, and towards the side
    where it is parked, by these lengths [m]. Arms that cross then pass each other. None if the hands are not near
    each other, or cannot move so."""
    poses, parked = (
        {side: ik.tool_pose(model.chains[side], joints[model.arm(side)]) for side in Side}
        for joints in (q, model.q_park)
    )
    gap = poses[Side.LEFT][:2, 3] - poses[Side.RIGHT][:2, 3]
    sideways = parked[Side.LEFT][:2, 3] - parked[Side.RIGHT][:2, 3]
    sideways /= np.linalg.norm(sideways)
    ahead = np.array([sideways[1], -sideways[0]])
    if not np.linalg.norm(gap) < NEAR:
        return None
    shift, out = forward * np.sign(gap @ ahead) * ahead + aside * sideways, q.copy()
    for side, sign in ((Side.LEFT, 1.0), (Side.RIGHT, -1.0)):
        poses[side][:2, 3] += sign * shift
        solved = ik.solve_pose(model, side, poses[side], q[model.arm(side)], gain=0.0)
        if solved is None:
            return None
        out[model.arm(side)] = solved
    return out


def _seconds(model: RobotModel, points: list[Array]) -> float:
    """Return about the time of a path with stops at its points [s]."""
    way = np.abs(np.diff(points, axis=0)) / model.planning.velocity
    return float((way.max(axis=1) + STOP_S).sum())


class _Tree:
    def __init__(self, root: Array) -> None:
        self.nodes = [root]
        self.parents = [-1]

    def nearest(self, q: Array) -> int:
        return int(np.abs(np.array(self.nodes) - q).max(axis=1).argmin())

    def add(self, q: Array, parent: int) -> int:
        self.nodes.append(q)
        self.parents.append(parent)
        return len(self.nodes) - 1

    def path_to_root(self, i: int) -> list[Array]:
        path = []
        while i >= 0:
            path.append(self.nodes[i])
            i = self.parents[i]
        return path


def _extend(checker: CollisionChecker, tree: _Tree, goal: Array, resolution: float) -> tuple[int, bool]:
    """Grow one branch of the tree towards the goal. Return the new node (-1 if blocked), and whether it reached
    the goal."""
    nearest_node = tree.nearest(goal)
    gap = goal - tree.nodes[nearest_node]
    length = float(np.abs(gap).max())
    q = goal if length <= STEP else tree.nodes[nearest_node] + gap * (STEP / length)
    if not checker.edge_free(tree.nodes[nearest_node], q, resolution=resolution):
        return -1, False
    return tree.add(q, nearest_node), length <= STEP


def _connect(
    model: RobotModel,
    checker: CollisionChecker,
    q0: Array,
    q1: Array,
    rng: np.random.Generator,
    resolution: float = COARSE,
) -> Array | None:
    lower, upper = np.minimum(q0, q1) - 0.8, np.maximum(q0, q1) + 0.8
    lower, upper = np.maximum(lower, model.planning.lower), np.minimum(upper, model.planning.upper)
    a, b = _Tree(q0), _Tree(q1)
    for k in range(MAX_ITERATIONS):
        new, _ = _extend(checker, a, rng.uniform(lower, upper), resolution)
        if new >= 0:
            meeting_node, reached = _extend(checker, b, a.nodes[new], resolution)
            while meeting_node >= 0 and not reached:
                meeting_node, reached = _extend(checker, b, a.nodes[new], resolution)
            if reached:
                path = [*a.path_to_root(new)[::-1], *b.path_to_root(meeting_node)[1:]]
                return _shortcut(checker, np.array(path if k % 2 == 0 else path[::-1]), rng, resolution)
        a, b = b, a
    return None


def _shortcut(checker: CollisionChecker, points: Array, rng: np.random.Generator, resolution: float) -> Array:
    """Shorten the path by straight lines between random points on it."""
    for _ in range(SHORTCUTS):
        if len(points) < 3:
            break
        i, j = sorted(rng.choice(len(points) - 1, 2, replace=False))
        u, v = rng.uniform(size=2)
        a = points[i] + u * (points[i + 1] - points[i])
        b = points[j] + v * (points[j + 1] - points[j])
        if checker.edge_free(a, b, resolution=resolution):
            points = np.vstack([points[: i + 1], a, b, points[j + 1 :]])
    keep = [0]
    for k in range(1, len(points)):
        if np.abs(points[k] - points[keep[-1]]).max() > 1e-9:
            keep.append(k)
    return points[keep]
