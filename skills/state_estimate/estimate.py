"""Estimates the state of a garment after a failed fold, by comparing the picture with simulated hypotheses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.state_estimate.comparison import Fit, fit
from foldcell.skills.state_estimate.hypothesis import FoldState, Hypothesis, Interruption
from foldcell.skills.state_estimate.observation import Observation
from foldcell.skills.vocabulary import GraspId, PredictedShape

Simulate = Callable[[Sequence[Interruption]], Sequence[Array]]
"""Simulates interrupted folds: returns the vertices (n, 3) after each of them."""

ONE_HAND = 2  # the loss of the cloth by one hand is simulated at every second moment
NEARLY_ALL = 0.98  # share of the vertices that decides whether two shapes are the same
MEASURED = Interruption(measured=True)
REACTION = 0.12  # share of the way between the slip of one hand and the opening of the other, at first


# Priors of the states
PRIORS: Mapping[FoldState, float] = {
    FoldState.BEFORE: 0.30,
    FoldState.AFTER: 0.25,
    FoldState.HALF_WAY: 0.35,
    FoldState.HEAP: 0.10,
}
# Priors of the states if the hands came to the targets and no loss of cloth was noticed (assumed)
COMPLETED: Mapping[FoldState, float] = {
    FoldState.BEFORE: 0.02,
    FoldState.AFTER: 0.70,
    FoldState.HALF_WAY: 0.25,
    FoldState.HEAP: 0.03,
}
# Misfit that changes the odds of a hypothesis by a factor of e. It makes the confidence agree with the share of
# correct estimates (docs/results/state_estimate.md).
TEMPERATURE = 12.0
HEAP = 0.8  # misfit of a heap for each cell with cloth
# Misfit for each cell below which the measured course of the hands explains the picture. It is larger than that of
# shapes before and after the fold, because a shape half way is less certain.
AS_MEASURED = 0.4
# If the shape before or after the fold has a smaller misfit for each cell and a smaller unexplained area [m2], no
# interrupted fold is simulated
EXPLAINED, EXPLAINED_M2 = 0.15, 0.0030
MOMENTS = (0.2, 0.35, 0.5, 0.65, 0.8)  # shares of the hands' way at which interruptions are simulated at first
REFINEMENTS = 3  # number of times that the distance between moments is halved around the best one
# If NEARLY_ALL vertices of an interrupted fold lie nearer than this to the shape before or after the fold, it
# counts as that state [m]
SAME = 0.030
DRIFT, TURN = 0.060, 0.25  # standard deviations of the garment's displacement [m] and turn [rad]
# The shape before or after the fold is first aligned with the picture from angle 0. If the result does not explain
# the picture, the alignment begins again from each of these angles [rad].
TURNS = (-0.5, 0.5)


@dataclass(frozen=True, eq=False)
class StateEstimate:
    """The most probable state, and its probability. best: the best fit of this state; None for a heap.
    probabilities: of all states; they sum to 1. fits: of the hypotheses, the best fit first. simulations: number
    of interrupted folds that were simulated. contour: (n, 2) observed boundary [m]."""

    state: FoldState
    confidence: float
    best: Fit | None
    probabilities: Mapping[FoldState, float]
    fits: tuple[Fit, ...]
    simulations: int
    contour: Array
    as_folded: Fit | None = None
    """The fit of the fold as it was predicted, without any interruption."""

    @property
    def likeliest_shape(self) -> Fit | None:
        """The best fit of the most probable state; if this is a heap, the best fit of all."""
        return self.best or next(iter(self.fits), None)

    def of_state(self, state: FoldState) -> Fit | None:
        """Return the best fit of a state, None if it has no hypothesis."""
        return next((f for f in self.fits if f.hypothesis.state is state), None)

    def condensed(self) -> StateEstimate:
        """Return the same estimate with only the best fit of each state."""
        best = [f for f in map(self.of_state, FoldState) if f is not None]
        return replace(self, fits=tuple(sorted(best, key=self.fits.index)))


def estimate_state(
    seen: Observation,
    before: PredictedShape,
    after: PredictedShape,
    grasps: Sequence[GraspId],
    simulate: Simulate,
    lift: float = 0.0,
    several_layers: bool = False,
    priors: Mapping[FoldState, float] = PRIORS,
    measured: bool = False,
) -> StateEstimate:
    """Estimate the state of a garment.

    before, after: shapes before the fold and after it, as believed and predicted. grasps: the grasps of the fold.
    simulate: simulates interrupted folds; it is called only if neither shape explains the picture. lift: height by
    which the camera sees the flat garment above its mesh [m]. several_layers: whether the hands grasp more than
    one layer, so that a layer can be missed. measured: whether the course of the hands is known. If so, it is
    simulated first. The other interruptions are simulated only if it does not explain the picture.
    """

    def fitted(hypothesis: Hypothesis) -> Fit:
        turned = hypothesis.state is not FoldState.HALF_WAY
        found = fit(seen, hypothesis, lift)
        if not turned or _explained(found):
            return found
        return min(found, fit(seen, hypothesis, lift, TURNS), key=_cost)

    def simulated_fits(ways: Sequence[Interruption]) -> list[Fit]:
        shapes = [replace(before, vertices=vertices) for vertices in simulate(ways)]
        return [
            fitted(Hypothesis(_state_of(shape, before, after), shape, how))
            for shape, how in zip(shapes, ways, strict=True)
        ]

    ends = [Hypothesis(FoldState.BEFORE, before), Hypothesis(FoldState.AFTER, after)]
    fits = [fitted(h) for h in ends]
    if any(map(_explained, fits)):
        return _judge(seen, fits, 0, priors)
    simulated = 0
    if measured:
        fits += simulated_fits((MEASURED,))
        simulated = 1
        if fits[-1].misfit < AS_MEASURED * fits[-1].cells:
            return _judge(seen, fits, simulated, priors)
    chosen: Sequence[Interruption] = _interruptions(grasps, several_layers)
    for halvings in range(REFINEMENTS + 1):
        fits += simulated_fits(chosen)
        simulated += len(chosen)
        best = min(fits, key=_cost).hypothesis.interruption
        if best is None or best.missed_layer or best.measured:
            break
        chosen = _between(best, 0.5 ** (halvings + 1) * _spacing(best))
    return _judge(seen, fits, simulated, priors)


def _interruptions(grasps: Sequence[GraspId], several_layers: bool) -> tuple[Interruption, ...]:
    """Return the ways in which a fold with these grasps can end early, at MOMENTS of the hands' way."""
    ways = [Interruption(end=share) for share in MOMENTS]
    if several_layers:
        ways.append(Interruption(missed_layer=True))
    if len(grasps) < 2:
        return tuple(ways)
    middle = MOMENTS[len(MOMENTS) // 2]
    for grasp_id in grasps:
        for share in MOMENTS[::ONE_HAND]:
            ways += [Interruption({grasp_id: share}), Interruption({grasp_id: share}, share + REACTION)]
        ways.append(Interruption({grasp_id: middle}, end=middle, laid_back=True))
    return tuple(ways)


def _spacing(how: Interruption) -> float:
    """Return the distance between the first moments at which interruptions of this kind are simulated."""
    return float(np.diff(MOMENTS).mean()) * (ONE_HAND if how.lost else 1)


def _between(best: Interruption, distance: float) -> tuple[Interruption, ...]:
    """Return interruptions of the same kind as the best one: a little earlier and later, and, if the other hand
    opens soon after a slip, with half and twice that delay."""
    delay = best.end - best.begins
    shares = [s for s in (best.begins - distance, best.begins + distance) if 0.0 < s < 1.0]
    variants = [(share, best.end if best.end == 1.0 else min(share + delay, 0.99)) for share in shares]
    if best.lost and best.end < 1.0 and not best.laid_back:
        variants += [(best.begins, min(best.begins + factor * delay, 0.99)) for factor in (0.5, 2.0)]
    return tuple(replace(best, lost=dict.fromkeys(best.lost, share), end=end) for share, end in variants)


def _state_of(shape: PredictedShape, before: PredictedShape, after: PredictedShape) -> FoldState:
    """Return the state to which a simulated shape belongs. For example, the fold is completed although a hand
    opens shortly before the target, or the cloth falls back because it is released early."""
    for state, end in ((FoldState.AFTER, after), (FoldState.BEFORE, before)):
        distance = np.linalg.norm(shape.vertices - end.vertices, axis=1)
        if np.quantile(distance, NEARLY_ALL) < SAME:
            return state
    return FoldState.HALF_WAY


def _explained(found: Fit) -> bool:
    """Whether a shape explains the picture as well as correct shapes do."""
    return found.misfit < EXPLAINED * found.cells and found.unexplained_m2 < EXPLAINED_M2


def _cost(found: Fit) -> float:
    """Negative log-likelihood of a fit, with the prior of its displacement."""
    moved = (found.drift_m / DRIFT) ** 2 + (found.drift_rad / TURN) ** 2
    return found.misfit / TEMPERATURE + 0.5 * moved


def _share(found: Fit, fits: Sequence[Fit]) -> float:
    """Return the share of a hypothesis in the prior of its state."""
    alike = [f for f in fits if f.hypothesis.state is found.hypothesis.state]
    group = [f for f in alike if _measured(f) == _measured(found)]
    return 1.0 / len(group) if len(group) == len(alike) else 0.5 / len(group)


def _measured(found: Fit) -> bool:
    how = found.hypothesis.interruption
    return how is not None and how.measured


def _judge(
    seen: Observation, fits: Sequence[Fit], simulations: int, priors: Mapping[FoldState, float]
) -> StateEstimate:
    """Compute the probabilities of the states. The prior of a state is shared equally by its hypotheses, with one
    exception: the measured course of the hands has half of it, because it contains no guess."""
    ordered = tuple(sorted(fits, key=_cost))
    cells = min(f.cells for f in fits)
    score = {FoldState.HEAP: [np.log(priors[FoldState.HEAP]) - HEAP * cells / TEMPERATURE]}
    for f in fits:
        state = f.hypothesis.state
        prior = float(np.log(priors[state] * _share(f, fits)))
        score.setdefault(state, []).append(prior - _cost(f))
    total = {state: float(np.logaddexp.reduce(values)) for state, values in score.items()}
    norm = float(np.logaddexp.reduce(list(total.values())))
    probabilities = {state: float(np.exp(total.get(state, -np.inf) - norm)) for state in FoldState}
    state = max(probabilities, key=lambda s: probabilities[s])
    best = next((f for f in ordered if f.hypothesis.state is state), None)
    folded = (f for f in fits if f.hypothesis.state is FoldState.AFTER and f.hypothesis.interruption is None)
    return StateEstimate(
        state, probabilities[state], best, probabilities, ordered, simulations, seen.contour, next(folded, None)
    )
