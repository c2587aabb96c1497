"""Choosing how the hands hold: tilt, turn, and which arm takes which grasp.

Candidates are tried in the order of their lean, each followed by inverse kinematics over the whole fold
(down, arc, up). The cheapest pair of which both arms stay free of each other wins. The order and the
start configurations are fixed, so that the same question has the same answer.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product

import numpy as np

from robots.errors import Failure, FailureKind
from robots.model import RobotModel
from robots.ports import Array, Side, arm_slice
from skills.motion.kinematics import ik
from skills.motion.kinematics.posture import Posture, in_base, with_ends
from skills.motion.validation.collision import CollisionChecker, Contact
from skills.vocabulary import GraspId, Outcome, Table, ToolPath

__all__ = ["Choice", "rank_postures"]

PITCH = np.deg2rad([0.0, 10.0, -10.0, 20.0, -20.0, 30.0, -30.0, 40.0, -40.0])
ROLL = np.deg2rad([0.0, 10.0, -10.0, 20.0, -20.0, 30.0, -30.0])
PITCH_CHANGE = np.deg2rad([20.0, -20.0, 40.0, -40.0, 60.0, -60.0, 80.0, -80.0])
"""Tried only where no lean that stays the same through the fold will do."""
PITCH_UNIT = np.deg2rad(30.0)
ROLL_UNIT = np.deg2rad(11.5)
"""Leans that cost 1: a lean along the held line lifts one end of the line and is dearer."""
TRAVEL_WEIGHT = 0.3
"""Cost of one second of joint motion at full speed, of the fold and of the way to it."""
MARGIN_WEIGHT = 0.01
"""Cost of the distance to the nearest joint limit: weight over distance in rad."""
SWAP_COST = 0.5
"""Arms are swapped only for a gain in lean that is worth it."""
GOOD = 4.0
"""Cost of a pair at which the other assignment of arms is not looked at."""
DETOUR_COST = 0.5
"""Of a way to the fold or from it to the parked pose that is not free straight on."""
KEEP = 8
"""Candidates kept an arm."""
ENOUGH = 3
"""Candidates after which leans that cost much more are not tried."""
RANKED = 5
"""Combinations kept."""
TOUCH_COST = 2.0
"""Of a joint that rides on its limit on the way: where it leaves the limit, the path has a kink."""
SEARCH_MARGIN = 0.03
"""Joint limits are kept by this much more in the search than later [rad]: a grasp ends a little elsewhere."""
SAMPLES = 18


@dataclass(frozen=True, eq=False)
class Choice:
    """postures and q: by arm; q (n, 7) along down, arc and up, coarsely."""

    postures: Mapping[Side, Posture]
    q: Mapping[Side, Array]
    cost: float


@dataclass(eq=False)
class _Tally:
    """Why candidates fell out with one assignment of arms, for the failure's text.

    begun, whole, free: per arm, how many ways could begin, reached every pose, and were clear of body and table.
    """

    swapped: bool
    tried: int = 0
    begun: Counter[Side] = field(default_factory=Counter)
    whole: Counter[Side] = field(default_factory=Counter)
    free: Counter[Side] = field(default_factory=Counter)
    reached: dict[Side, float] = field(default_factory=dict)
    where: dict[Side, Array] = field(default_factory=dict)
    limit: dict[Side, Counter[str]] = field(default_factory=lambda: {side: Counter() for side in Side})
    alone: dict[Side, Counter[str]] = field(default_factory=lambda: {side: Counter() for side in Side})
    together: Counter[str] = field(default_factory=Counter)

    def binding(self, arms: Sequence[Side]) -> _Binding:
        """The first thing that no candidate gets past: an arm's reach, its surroundings, or the other arm."""
        for arm in arms:
            if not self.whole[arm]:
                joint = self.limit[arm].most_common(1)[0][0] if self.limit[arm] else "the arm's length"
                where = [round(float(x), 3) for x in self.where[arm]] if arm in self.where else []
                return _Binding(0, "reach", arm, joint, tuple(where), self.reached.get(arm, 0.0))
        for arm in arms:
            if not self.free[arm]:
                return _Binding(1, "surroundings", arm, self.alone[arm].most_common(1)[0][0])
        pair = self.together.most_common(1)[0][0] if self.together else "choices that were tried before"
        return _Binding(2, "arms", None, pair)


@dataclass(frozen=True)
class _Binding:
    """stage: how far the search came (0 reach, 1 alone, 2 together); what: a joint or a pair of objects."""

    stage: int
    constraint: str
    arm: Side | None
    what: str
    where: tuple[float, ...] = ()
    share_reached: float = 1.0

    def __str__(self) -> str:
        if self.constraint == "reach":
            return f"the {self.arm} arm does not reach {list(self.where)} (table frame, m), bound by {self.what}"
        if self.constraint == "surroundings":
            return f"the {self.arm} arm reaches everything but comes too near: {self.what}"
        return f"each arm has a way, but not both together; most often in the way: {self.what}"

    def values(self) -> dict[str, object]:
        return {
            "constraint": self.constraint, "arm": None if self.arm is None else str(self.arm), "what": self.what,
            "where_m": list(self.where), "share_reached": self.share_reached,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Candidate:
    posture: Posture
    q: Array
    cost: float


@lru_cache(maxsize=2)
def _leans(changing: bool) -> tuple[tuple[float, float, float, float, bool], ...]:
    """(cost, pitch, roll, pitch_change, turned), the cheapest first; `changing`: those whose pitch changes."""
    if changing:
        steepest = float(PITCH.max()) + 1e-9
        leans = [(p, 0.0, c) for p in PITCH.tolist() for c in PITCH_CHANGE.tolist() if abs(p + c) <= steepest]
    else:
        leans = [(p, r, 0.0) for p in PITCH.tolist() for r in ROLL.tolist()]
    grid = [
        (float(((p / PITCH_UNIT) ** 2 + ((p + c) / PITCH_UNIT) ** 2) / 2 + (r / ROLL_UNIT) ** 2), p, r, c, turned)
        for p, r, c in leans
        for turned in (False, True)
    ]
    return tuple(sorted(grid, key=lambda lean: lean[0]))


def rank_postures(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[GraspId, ToolPath],
    q_now: Array,
    *,
    above: float,
    below: float,
    avoid: Sequence[Mapping[Side, Posture]] = (),
) -> Outcome[tuple[Choice, ...]]:
    """A few choices, the cheapest first, for tool paths keyed as the fold step's grasps; arms may be swapped.

    above, below: straight ways down to the grasp and up from the release [m]. avoid: choices that were tried
    and are not wanted again. Failures: UNREACHABLE (no
    posture reaches every pose), IN_COLLISION (some do, but none without touching).
    """
    tallies: list[_Tally] = []
    coarse = {i: with_ends(path, above, below, SAMPLES) for i, path in paths.items()}
    found: list[Choice] = []
    for swapped in (False, True):
        if found and found[0].cost < GOOD:
            break
        arms = {_taker(i, swapped): i for i in paths}
        tally = _Tally(swapped)
        tallies.append(tally)
        candidates: dict[Side, list[_Candidate]] = {arm: [] for arm in arms}
        for changing in (False, True):
            if changing and (found or not all(tally.begun[arm] for arm in arms)):
                break  # a lean that changes on the way begins as one that does not
            for arm, i in arms.items():
                candidates[arm] += _candidates(
                    model, checker, table, arm, i, coarse[i], q_now, tuple(arms), _leans(changing), tally
                )
            found += _together(checker, candidates, q_now, SWAP_COST if swapped else 0.0, avoid, tally)
        found.sort(key=lambda choice: choice.cost)
    if not found:
        return Outcome(failure=_failure(tallies, tuple(paths)))
    tried = sum(tally.tried for tally in tallies)
    return Outcome(tuple(found), notes={"postures_tried": tried, "posture_cost": round(found[0].cost, 3)})


def _taker(grasp_id: GraspId, swapped: bool) -> Side:
    return grasp_id.planned_arm.other if swapped else grasp_id.planned_arm


def _candidates(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    arm: Side,
    grasp_id: GraspId,
    path: ToolPath,
    q_now: Array,
    used: Sequence[Side],
    leans: Sequence[tuple[float, float, float, float, bool]],
    tally: _Tally,
) -> list[_Candidate]:
    """Postures of one arm that reach the whole path without touching body or table, cheapest leans first."""
    position = in_base(table, path.position)
    seeds = ik.arm_seeds(model, arm, q_now)
    kept: list[_Candidate] = []
    for lean, pitch, roll, change, turned in leans:
        if len(kept) >= ENOUGH and lean > min(c.cost for c in kept) + 1.0:
            break
        posture = Posture(grasp_id, turned, pitch, roll, change)
        rotation = posture.rotation(path)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation[0], position[0]
        tally.tried += 1
        ways = _ways(model, arm, rotation, position, ik.solve_seeds(model, arm, T, seeds), path, tally)
        scored = sorted(((lean + _motion_cost(model, arm, q, q_now), q) for q in ways), key=lambda w: w[0])
        for cost, q in scored:
            contact = _alone(model, checker, arm, q, q_now, used)
            if contact is None:
                tally.free[arm] += 1
                kept.append(_Candidate(posture, q, cost))
                break
            tally.alone[arm][str(contact)] += 1
        if len(kept) >= KEEP:
            break
    return kept


def _ways(
    model: RobotModel, arm: Side, rotation: Array, position: Array, starts: Array, path: ToolPath, tally: _Tally
) -> list[Array]:
    """Joint paths (n, 7) over the whole tool path, one for each start that gets through."""
    ways = []
    tally.begun[arm] += len(starts)
    if len(starts) == 0 and arm not in tally.where:
        tally.where[arm] = path.position[0]
    for start in starts:
        solution = ik.follow_path(model, arm, rotation, position, start, max_step=0.6, margin=SEARCH_MARGIN)
        if solution.complete:
            tally.whole[arm] += 1
            ways.append(solution.q)
        elif len(solution.q) / len(position) > tally.reached.get(arm, -1.0):
            tally.reached[arm] = len(solution.q) / len(position)
            tally.where[arm] = path.position[len(solution.q)]
            if len(solution.q):
                tally.limit[arm][_nearest_limit(model, arm, solution.q[-1])] += 1
    return ways


def _nearest_limit(model: RobotModel, arm: Side, q: Array) -> str:
    cut = arm_slice(arm)
    room = np.minimum(q - model.planning.lower[cut], model.planning.upper[cut] - q)
    return model.joint_names[cut][int(room.argmin())]


def _motion_cost(model: RobotModel, arm: Side, q: Array, q_now: Array) -> float:
    cut = arm_slice(arm)
    limits = model.planning
    travel = np.abs(np.diff(q, axis=0)).sum(axis=0) / limits.velocity[cut]
    way = np.abs(q[0] - q_now[cut]) / limits.velocity[cut]
    room = min((q - limits.lower[cut]).min(), (limits.upper[cut] - q).min())
    touch = TOUCH_COST if room < SEARCH_MARGIN + 1e-3 else 0.0
    return float(TRAVEL_WEIGHT * (travel.max() + way.max()) + MARGIN_WEIGHT / max(room, 1e-3) + touch)


def _alone(
    model: RobotModel, checker: CollisionChecker, arm: Side, q: Array, q_now: Array, used: Sequence[Side]
) -> Contact | None:
    """The first contact of one arm on its way; the other arm stays where it is, or, if it works too, is parked."""
    both = np.tile(model.q_park if arm.other in used else q_now, (len(q), 1))
    both[:, arm_slice(arm)] = q
    return checker.first_collision(both, allow_fingertips=True)


def _together(
    checker: CollisionChecker,
    candidates: Mapping[Side, list[_Candidate]],
    q_now: Array,
    extra: float,
    avoid: Sequence[Mapping[Side, Posture]],
    tally: _Tally,
) -> list[Choice]:
    """The cheapest few combinations that stay free of each other, the arms moving in step."""
    arms = list(candidates)
    found: list[Choice] = []
    for picked in sorted(product(*(candidates[arm] for arm in arms)), key=lambda p: sum(c.cost for c in p)):
        postures = {arm: c.posture for arm, c in zip(arms, picked, strict=True)}
        if postures in avoid:
            continue
        both = np.tile(q_now, (len(picked[0].q), 1))
        for arm, candidate in zip(arms, picked, strict=True):
            both[:, arm_slice(arm)] = candidate.q
        contact = checker.first_collision(both, allow_fingertips=True)
        if contact is not None:
            tally.together[str(contact)] += 1
            continue
        cost = sum(c.cost for c in picked) + extra + DETOUR_COST * _detours(checker, q_now, both)
        found.append(Choice(postures, {arm: c.q for arm, c in zip(arms, picked, strict=True)}, float(cost)))
        if len(found) == RANKED:
            break
    return found


def _detours(checker: CollisionChecker, q_now: Array, both: Array) -> int:
    """Of the ways to the first and from the last configuration, how many are not free straight on."""
    ways = ((q_now, both[0]), (both[-1], checker.model.q_park))
    return sum(not checker.edge_free(a, b, resolution=0.1) for a, b in ways)


def _failure(tallies: Sequence[_Tally], grasp_ids: Sequence[GraspId]) -> Failure:
    """What binds with the assignment of arms that came furthest; the other one's is told beside it."""
    bindings = [(tally, tally.binding([_taker(i, tally.swapped) for i in grasp_ids])) for tally in tallies]
    tally, first = max(bindings, key=lambda pair: (pair[1].stage, not pair[0].swapped))
    others = [str(b) for t, b in bindings if t is not tally]
    kind = FailureKind.UNREACHABLE if first.stage == 0 else FailureKind.IN_COLLISION
    values = {
        "postures": sum(t.tried for t in tallies),
        "arms_swapped": tally.swapped,
        "binding": first.values(),
        "other_arms": others,
    }
    swapped = ", with the arms swapped" if tally.swapped else ""
    return Failure(
        kind,
        f"no tilt of the hands makes this fold possible{swapped}: {first}",
        "lay the garment nearer to the middle of the table"
        + (", or take hold further apart" if first.stage == 2 else ""),
        values,
    )
