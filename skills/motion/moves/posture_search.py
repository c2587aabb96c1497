"""Search for the postures of the hands: lean, half turn, and which arm takes which grasp.

The postures of each arm are tried in order of increasing lean. Inverse kinematics follows each posture over the
whole fold (descent, arc, retreat). The best choice is the combination of lowest cost in which the arms do not
touch. The order and the seed configurations are fixed, so the same input always gives the same result.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from functools import lru_cache
from itertools import product

import numpy as np

from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, Side, arm_slice
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.kinematics.posture import Posture, in_base, with_ends
from foldcell.skills.motion.validation.collision import CollisionChecker, Contact
from foldcell.skills.vocabulary import GraspId, Outcome, Table, ToolPath

PITCH = np.deg2rad([0.0, 10.0, -10.0, 20.0, -20.0, 30.0, -30.0, 40.0, -40.0])
ROLL = np.deg2rad([0.0, 10.0, -10.0, 20.0, -20.0, 30.0, -30.0])
PITCH_CHANGE = np.deg2rad([20.0, -20.0, 40.0, -40.0, 60.0, -60.0, 80.0, -80.0])
"""Changes of pitch during the fold, tried only if no constant lean is feasible."""
PITCH_UNIT = np.deg2rad(30.0)
ROLL_UNIT = np.deg2rad(11.5)
"""A constant pitch of PITCH_UNIT costs 1, and so does a roll of ROLL_UNIT; the cost grows with the square of the
angle. Roll costs more than pitch, because it lifts one end of the strip of cloth between the pads."""
TRAVEL_WEIGHT = 0.3
"""Cost per second that the joint motion of fold and approach would take at full speed."""
MARGIN_WEIGHT = 0.01
"""Weight of the nearness to a joint limit. The cost is this weight divided by the smallest distance to a
limit [rad]."""
SWAP_COST = 0.5
"""Cost of swapping the arms."""
GOOD_COST = 4.0
"""If a choice costs less than this, the swapped assignment of arms is not searched."""
DETOUR_COST = 0.5
"""Cost of a collision on the straight line in joint space from the present pose to the fold. A collision on the
line from the fold to the parked pose costs the same."""
MAX_CANDIDATES = 8
"""Maximum number of feasible postures that are collected per arm."""
ENOUGH_CANDIDATES = 3
"""Once an arm has this number of feasible postures, leans that cost over 1 more than the cheapest posture are not
tried."""
WIDE_CANDIDATES = 24
"""Number of feasible postures that are collected per arm if each arm has feasible postures, but no two of them fit
together. Hands close to one another, such as on the two ends of a cuff, need leans away from each other."""
MAX_CHOICES = 5
"""Maximum number of choices from one assignment of the arms."""
AT_LIMIT_COST = 2.0
"""Cost if a joint moves along its limit, because its path then has a kink where it leaves the limit."""
SEARCH_MARGIN = 0.03
"""Extra distance to the joint limits in the search [rad], because the actual grasp differs a little."""
SAMPLES = 18


@dataclass(frozen=True, eq=False)
class PostureChoice:
    """A posture for each arm in use. postures, q: by arm. q: (n, arm) joints along the descent, the arc and the
    retreat, coarsely sampled. cost: sum over the arms, see the constants of this module."""

    postures: Mapping[Side, Posture]
    q: Mapping[Side, Array]
    cost: float


@dataclass(eq=False)
class _Tally:
    """Counts why the postures failed for one assignment of the arms. The text of the failure is made from these
    counts.

    For each arm, numbers of joint paths. started: those with a start configuration. complete: those that reach
    every pose. free: those that also touch neither body nor table.
    """

    swapped: bool
    tried: int = 0
    started: Counter[Side] = field(default_factory=Counter)
    complete: Counter[Side] = field(default_factory=Counter)
    free: Counter[Side] = field(default_factory=Counter)
    reached: dict[Side, float] = field(default_factory=dict)
    where: dict[Side, Array] = field(default_factory=dict)
    limit: dict[Side, Counter[str]] = field(default_factory=lambda: {side: Counter() for side in Side})
    arm_contacts: dict[Side, Counter[str]] = field(default_factory=lambda: {side: Counter() for side in Side})
    pair_contacts: Counter[str] = field(default_factory=Counter)

    def binding(self, arms: Sequence[Side]) -> _Binding:
        """Return the first constraint that no posture satisfies: an arm's reach, its surroundings, or both
        arms."""
        for arm in arms:
            if not self.complete[arm]:
                joint = self.limit[arm].most_common(1)[0][0] if self.limit[arm] else "the arm's length"
                where = [round(float(x), 3) for x in self.where[arm]] if arm in self.where else []
                return _Binding(0, "reach", arm, joint, tuple(where), self.reached.get(arm, 0.0))
        for arm in arms:
            if not self.free[arm]:
                return _Binding(1, "surroundings", arm, self.arm_contacts[arm].most_common(1)[0][0])
        tried = "none, all choices were tried before"
        pair = self.pair_contacts.most_common(1)[0][0] if self.pair_contacts else tried
        return _Binding(2, "arms", None, pair)


@dataclass(frozen=True)
class _Binding:
    """The constraint that makes a fold infeasible. stage: stage of the search at which it failed (0 reach, 1
    surroundings, 2 both arms together). what: name of a joint, or of two objects in contact."""

    stage: int
    constraint: str
    arm: Side | None
    what: str
    where: tuple[float, ...] = ()
    share_reached: float = 1.0

    def __str__(self) -> str:
        if self.constraint == "reach":
            return f"the {self.arm} arm does not reach {list(self.where)} (table frame, m), limited by {self.what}"
        if self.constraint == "surroundings":
            return f"the {self.arm} arm reaches every pose but is in collision: {self.what}"
        return f"each arm has a path, but not both together; most frequent collision: {self.what}"

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


class _Lean(Enum):
    """Which leans a search tries."""

    UPRIGHT_GRASP = auto()  # upright at the grasp, and with any pitch at the release
    CONSTANT = auto()
    CHANGING = auto()  # with a pitch that changes during the fold


@lru_cache(maxsize=len(_Lean))
def _leans(kind: _Lean) -> tuple[tuple[float, float, float, float, bool], ...]:
    """Return all leans of a kind as (cost, pitch, roll, pitch_change, turned), the cheapest first."""
    if kind is _Lean.UPRIGHT_GRASP:
        leans = [(0.0, 0.0, c) for c in PITCH.tolist()]
    elif kind is _Lean.CHANGING:
        max_pitch = float(PITCH.max()) + 1e-9
        leans = [(p, 0.0, c) for p in PITCH.tolist() for c in PITCH_CHANGE.tolist() if abs(p + c) <= max_pitch]
    else:
        leans = [(p, r, 0.0) for p in PITCH.tolist() for r in ROLL.tolist()]
    grid = [
        (float(((p / PITCH_UNIT) ** 2 + ((p + c) / PITCH_UNIT) ** 2) / 2 + (r / ROLL_UNIT) ** 2), p, r, c, turned)
        for p, r, c in leans
        for turned in (False, True)
    ]
    return tuple(sorted(grid, key=lambda lean: lean[0]))


_SEARCHES = (
    (_Lean.UPRIGHT_GRASP, False), (_Lean.CONSTANT, False), (_Lean.CONSTANT, True), (_Lean.CHANGING, False),
)  # fmt: skip
"""The searches, in order: the kind of leans, and whether to collect WIDE_CANDIDATES. The first search that finds a
choice ends the sequence."""


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
    upright_grasps: bool = False,
) -> Outcome[tuple[PostureChoice, ...]]:
    """Find choices of postures for the tool paths of a fold step, and sort them by cost, the cheapest first.

    At most five choices come from each assignment of the arms (as planned, or swapped). above: height of the
    straight descent to the grasp [m]; below: height of the straight retreat from the release [m]. avoid: choices
    that are not returned again. upright_grasps: first try postures whose hands are upright at the grasp. A
    fingertip of a leaning hand reaches lower than the other one, into layers that are to stay. Failures:
    UNREACHABLE (no posture reaches every pose), IN_COLLISION (postures reach every pose, but none without a
    collision).
    """
    tallies: list[_Tally] = []
    coarse = {i: with_ends(path, above, below, SAMPLES) for i, path in paths.items()}
    found: list[PostureChoice] = []
    for swapped in (False, True):
        if found and found[0].cost < GOOD_COST:
            break
        arms = {_arm_for(i, swapped): i for i in paths}
        tally = _Tally(swapped)
        tallies.append(tally)
        candidates: dict[Side, list[_Candidate]] = {arm: [] for arm in arms}
        for kind, wide in _SEARCHES if upright_grasps else _SEARCHES[1:]:
            if found:
                break
            if wide and (len(arms) < 2 or not all(candidates.values())):
                continue
            if kind is _Lean.CHANGING and not all(tally.started[arm] for arm in arms):
                break  # A changing lean starts like a constant one, so it does not reach the start either.
            for arm, i in arms.items():
                new = _candidates(
                    model, checker, table, arm, i, coarse[i], q_now, tuple(arms), _leans(kind), tally, wide
                )
                candidates[arm] = new if wide else candidates[arm] + new
            found += _collision_free_combinations(
                checker, candidates, q_now, SWAP_COST if swapped else 0.0, avoid, tally
            )
        found.sort(key=lambda choice: choice.cost)
    if not found:
        return Outcome(failure=_failure(tallies, tuple(paths)))
    tried = sum(tally.tried for tally in tallies)
    return Outcome(tuple(found), notes={"postures_tried": tried, "posture_cost": round(found[0].cost, 3)})


def _arm_for(grasp_id: GraspId, swapped: bool) -> Side:
    return grasp_id.planned_arm.other if swapped else grasp_id.planned_arm


def _candidates(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    arm: Side,
    grasp_id: GraspId,
    path: ToolPath,
    q_now: Array,
    arms_used: Sequence[Side],
    leans: Sequence[tuple[float, float, float, float, bool]],
    tally: _Tally,
    wide: bool,
) -> list[_Candidate]:
    """Find postures of one arm that reach every pose without touching body or table, the cheapest lean first.
    wide: WIDE_CANDIDATES of them, also with leans that cost much."""
    position = in_base(table, path.position)
    seeds = ik.arm_seeds(model, arm, q_now)
    kept: list[_Candidate] = []
    for lean, pitch, roll, change, turned in leans:
        if not wide and len(kept) >= ENOUGH_CANDIDATES and lean > min(c.cost for c in kept) + 1.0:
            break
        posture = Posture(grasp_id, turned, pitch, roll, change)
        rotation = posture.rotation(path)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation[0], position[0]
        tally.tried += 1
        joint_paths = _joint_paths(
            model, arm, rotation, position, ik.solve_seeds(model, arm, T, seeds), path, tally
        )
        by_cost = sorted(((lean + _motion_cost(model, arm, q, q_now), q) for q in joint_paths), key=lambda w: w[0])
        for cost, q in by_cost:
            contact = _first_contact(model, checker, arm, q, q_now, arms_used)
            if contact is None:
                tally.free[arm] += 1
                kept.append(_Candidate(posture, q, cost))
                break
            tally.arm_contacts[arm][str(contact)] += 1
        if len(kept) >= (WIDE_CANDIDATES if wide else MAX_CANDIDATES):
            break
    return kept


def _joint_paths(
    model: RobotModel, arm: Side, rotation: Array, position: Array, starts: Array, path: ToolPath, tally: _Tally
) -> list[Array]:
    """Find joint paths (n, arm) along the whole tool path: one for each start configuration from which its end is
    reached."""
    joint_paths = []
    tally.started[arm] += len(starts)
    if len(starts) == 0 and arm not in tally.where:
        tally.where[arm] = path.position[0]
    for start in starts:
        q = ik.follow_path(model, arm, rotation, position, start, max_step=0.6, margin=SEARCH_MARGIN)
        if len(q) == len(position):
            tally.complete[arm] += 1
            joint_paths.append(q)
        elif len(q) / len(position) > tally.reached.get(arm, -1.0):
            tally.reached[arm] = len(q) / len(position)
            tally.where[arm] = path.position[len(q)]
            if len(q):
                tally.limit[arm][_nearest_limit(model, arm, q[-1])] += 1
    return joint_paths


def _nearest_limit(model: RobotModel, arm: Side, q: Array) -> str:
    joints = model.arm(arm)
    margin = np.minimum(q - model.planning.lower[joints], model.planning.upper[joints] - q)
    return model.joint_names[joints][int(margin.argmin())]


def _motion_cost(model: RobotModel, arm: Side, q: Array, q_now: Array) -> float:
    joints = model.arm(arm)
    limits = model.planning
    travel = np.abs(np.diff(q, axis=0)).sum(axis=0) / limits.velocity[joints]
    approach = np.abs(q[0] - q_now[joints]) / limits.velocity[joints]
    margin = min((q - limits.lower[joints]).min(), (limits.upper[joints] - q).min())
    at_limit = AT_LIMIT_COST if margin < SEARCH_MARGIN + 1e-3 else 0.0
    return float(TRAVEL_WEIGHT * (travel.max() + approach.max()) + MARGIN_WEIGHT / max(margin, 1e-3) + at_limit)


def _first_contact(
    model: RobotModel, checker: CollisionChecker, arm: Side, q: Array, q_now: Array, arms_used: Sequence[Side]
) -> Contact | None:
    """Find the first contact of one arm on its joint path q (n, arm). The other arm is assumed to be parked if it
    is used too, else to stay at its present position."""
    q_both = np.tile(model.q_park if arm.other in arms_used else q_now, (len(q), 1))
    q_both[:, model.arm(arm)] = q
    return checker.first_collision(q_both, allow_fingertips=True)


def _collision_free_combinations(
    checker: CollisionChecker,
    candidates: Mapping[Side, list[_Candidate]],
    q_now: Array,
    swap_cost: float,
    avoid: Sequence[Mapping[Side, Posture]],
    tally: _Tally,
) -> list[PostureChoice]:
    """Find the cheapest combinations (at most MAX_CHOICES) in which the arms do not touch while they move
    simultaneously."""
    arms = list(candidates)
    found: list[PostureChoice] = []
    for combination in sorted(product(*(candidates[arm] for arm in arms)), key=lambda p: sum(c.cost for c in p)):
        postures = {arm: c.posture for arm, c in zip(arms, combination, strict=True)}
        if postures in avoid:
            continue
        q_both = np.tile(q_now, (len(combination[0].q), 1))
        for arm, candidate in zip(arms, combination, strict=True):
            q_both[:, arm_slice(arm, len(q_now))] = candidate.q
        contact = checker.first_collision(q_both, allow_fingertips=True)
        if contact is not None:
            tally.pair_contacts[str(contact)] += 1
            continue
        cost = sum(c.cost for c in combination) + swap_cost + DETOUR_COST * _detours(checker, q_now, q_both)
        found.append(
            PostureChoice(postures, {arm: c.q for arm, c in zip(arms, combination, strict=True)}, float(cost))
        )
        if len(found) == MAX_CHOICES:
            break
    return found


def _detours(checker: CollisionChecker, q_now: Array, q_both: Array) -> int:
    """Number of motions (approach, return) that are in collision on the straight line in joint space: 0, 1 or
    2."""
    edges = ((q_now, q_both[0]), (q_both[-1], checker.model.q_park))
    return sum(not checker.edge_free(a, b, resolution=0.1) for a, b in edges)


def _failure(tallies: Sequence[_Tally], grasp_ids: Sequence[GraspId]) -> Failure:
    """Create the failure. It states the binding constraint of the assignment of arms that passed the most stages
    of the search. Its values also contain the constraint of the other assignment."""
    bindings = [(tally, tally.binding([_arm_for(i, tally.swapped) for i in grasp_ids])) for tally in tallies]
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
        f"no lean of the hands makes this fold possible{swapped}: {first}",
        "lay the garment nearer to the middle of the table"
        + (", or take hold further apart" if first.stage == 2 else ""),
        values,
    )
