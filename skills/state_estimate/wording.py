"""Describes an estimated state in words for the operator."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from foldcell.skills.state_estimate.comparison import Fit
from foldcell.skills.state_estimate.estimate import StateEstimate
from foldcell.skills.state_estimate.hypothesis import FoldState, Interruption
from foldcell.skills.vocabulary import GraspId

MOVED, TURNED = 0.02, 0.07
"""Smaller displacements [m] and turns [rad] are not mentioned."""
HIGHEST = 0.99
"""Highest confidence that is stated: the figures do not support more."""


def describe(estimate: StateEstimate, hands: Mapping[GraspId, str] | None = None) -> str:
    """Describe the state in one clause, with its confidence. hands: the name of the hand of each grasp, by default
    that of the planned arm."""
    names = {grasp_id: grasp_id.value for grasp_id in GraspId} | dict(hands or {})
    return f"{_state(estimate, names)} (confidence {min(estimate.confidence, HIGHEST):.2f})"


def _state(estimate: StateEstimate, names: Mapping[GraspId, str]) -> str:
    best = estimate.best
    if best is None or estimate.state is FoldState.HEAP:
        return "the garment lies in a heap: it looks like no stage of this fold"
    if estimate.state is FoldState.BEFORE:
        return f"the garment lies as before the fold{_moved(best)}"
    if estimate.state is FoldState.AFTER:
        return f"the fold is made{_moved(best)}"
    how = best.hypothesis.interruption
    if how is not None and how.turned is not None:
        return f"the upper layers lie turned back at the {names[how.turned]} grasp{_moved(best)}"
    return "the fold is half made" + (f": {_cause(how, names)}" if how else "") + _moved(best)


def _moved(found: Fit) -> str:
    parts = []
    if found.drift_m > MOVED:
        parts.append(f"{100 * found.drift_m:.0f} cm away")
    if abs(found.drift_rad) > TURNED:
        parts.append(f"turned by {abs(np.rad2deg(found.drift_rad)):.0f} degrees")
    return f", {' and '.join(parts)}" if parts else ""


def _cause(how: Interruption, names: Mapping[GraspId, str]) -> str:
    if how.missed_layer:
        return "a layer was left behind"
    if how.measured:
        return "it lies where the hands lost it, as their sensors show"
    back = ", and the rest was laid back" if how.laid_back else ""
    if not how.lost:
        return f"the hands let go {_share(how.end)} along the way"
    corners = " and the ".join(names[grasp_id] for grasp_id in how.lost)
    return f"the {corners} corner slipped out {_share(min(how.lost.values()))} along the way{back}"


def _share(share: float) -> str:
    return f"{round(100 * share / 5) * 5} %"
