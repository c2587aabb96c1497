"""Ways through free joint space: straight if possible, by a few obvious way-points, else RRT-Connect.

RRT-Connect is Kuffner and LaValle's (ICRA 2000), over all 14 joints, with the caller's generator and a
bounded number of tries; the result is shortened by random shortcuts.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from robots.errors import Failure, FailureKind
from robots.model import RobotModel
from robots.ports import Array, Side, arm_slice
from skills.motion.validation.collision import CollisionChecker, Contact

__all__ = ["blocked_end", "no_way", "rounded", "ways"]

STEP = 0.35
"""Longest new branch [rad, largest joint]."""
TRIES = 1500
SHORTCUTS = 60
COARSE, FINE = 0.05, 0.01
"""[rad, largest joint] between two looks at a way: hands that pass each other can slip through the coarse ones."""
LEADS = ((0.65, 0.35), (0.8, 0.2), (1.0, 0.0))
"""Shares of their ways that the arms have made half-way, when one goes ahead."""


def ways(
    model: RobotModel, checker: CollisionChecker, q0: Array, q1: Array, rng: np.random.Generator | None = None
) -> Iterator[tuple[str, Array]]:
    """Way-points (n, 14) from q0 to q1, straight in joint space between them, and how they were found; the best
    first. They are free of collision as far as a coarse look tells, only the last one by a fine look."""
    for via in _obvious(model, q0, q1):
        points = np.array([q0, *via, q1])
        if _free(checker, points):
            yield "via" if via else "straight", points
    rng = rng or np.random.default_rng(0)
    for resolution in (COARSE, FINE):
        found = _connect(model, checker, q0, q1, rng, resolution)
        if found is None:
            return
        yield "rrt", found


def blocked_end(checker: CollisionChecker, q0: Array, q1: Array) -> Failure | None:
    """IN_COLLISION when no way from q0 (14,) to q1 (14,) can be free, since one of them is not."""
    for name, q in (("start", q0), ("goal", q1)):
        contact = checker.contact(q)
        if contact is not None:
            return Failure(
                FailureKind.IN_COLLISION,
                f"the {name} of a free motion is too near: {contact}",
                "raise the hands straight up first",
                {"pair": str(contact), "end": name},
            )
    return None


def no_way(contact: Contact | None) -> Failure:
    """IN_COLLISION: the tries are used up; contact: what was in the last one's way, if it was looked at finely."""
    what = f"no free way was found in {TRIES} tries"
    if contact is not None:
        what = f"no free way was found: the last one comes too near: {contact}"
    return Failure(
        FailureKind.IN_COLLISION, what, "clear the table's surroundings, or jog the arms apart", {"tries": TRIES}
    )


def rounded(points: Array, share: float, samples: int = 120) -> Array:
    """The way through points (n, 14) with its corners rounded, sampled evenly (samples, 14).

    Each corner is a parabola that takes `share` of the legs beside it.
    """
    u = np.linspace(0.0, 1.0, 12)[:, None]
    way = [points[:1]]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        a, b = corner + share * (before - corner), corner + share * (after - corner)
        way.append((1 - u) ** 2 * a + 2 * u * (1 - u) * corner + u**2 * b)
    way.append(points[-1:])
    line = np.vstack(way)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    even = np.linspace(0.0, s[-1], samples)
    return np.stack([np.interp(even, s, line[:, k]) for k in range(line.shape[1])], axis=1)


def _obvious(model: RobotModel, q0: Array, q1: Array) -> list[list[Array]]:
    """Way-points that mostly work: none; one arm ahead of the other; over the parked pose."""
    left, right = arm_slice(Side.LEFT), arm_slice(Side.RIGHT)

    def part(of_left: float, of_right: float) -> Array:
        q = q0.copy()
        q[left] += of_left * (q1[left] - q0[left])
        q[right] += of_right * (q1[right] - q0[right])
        return q

    ways: list[list[Array]] = [[]]
    for ahead, behind in LEADS:
        ways += [[part(ahead, behind)], [part(behind, ahead)]]
    ways.append([model.q_park])
    for cut in (left, right):
        halfway, arrived = q0.copy(), q1.copy()
        halfway[cut] = arrived[cut] = model.q_park[cut]
        ways.append([halfway, arrived])
    return ways


def _free(checker: CollisionChecker, points: Array) -> bool:
    return all(checker.edge_free(a, b, resolution=COARSE) for a, b in pairwise(points))


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

    def back(self, i: int) -> list[Array]:
        way = []
        while i >= 0:
            way.append(self.nodes[i])
            i = self.parents[i]
        return way


def _extend(checker: CollisionChecker, tree: _Tree, goal: Array, resolution: float) -> tuple[int, bool]:
    """One branch towards goal: (new node or -1, whether it got there)."""
    near = tree.nearest(goal)
    gap = goal - tree.nodes[near]
    length = float(np.abs(gap).max())
    q = goal if length <= STEP else tree.nodes[near] + gap * (STEP / length)
    if not checker.edge_free(tree.nodes[near], q, resolution=resolution):
        return -1, False
    return tree.add(q, near), length <= STEP


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
    for k in range(TRIES):
        new, _ = _extend(checker, a, rng.uniform(lower, upper), resolution)
        if new >= 0:
            met, there = _extend(checker, b, a.nodes[new], resolution)
            while met >= 0 and not there:
                met, there = _extend(checker, b, a.nodes[new], resolution)
            if there:
                way = [*a.back(new)[::-1], *b.back(met)[1:]]
                return _shortcut(checker, np.array(way if k % 2 == 0 else way[::-1]), rng, resolution)
        a, b = b, a
    return None


def _shortcut(checker: CollisionChecker, points: Array, rng: np.random.Generator, resolution: float) -> Array:
    """Cut corners between random points on the way while it is longer than a straight line."""
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
