"""Whether the fold plan of a garment file can be made on its own outline: every way of every step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path

import numpy as np

from robots.errors import ConfigurationError
from skills.garments.garment import Garment
from skills.planning.folding import layers_at
from skills.planning.plan import LEAST_FLAP, plan_folds
from skills.vocabulary import FoldStep

__all__ = ["check_lines_and_grasps"]


def check_lines_and_grasps(path: Path, garment: Garment) -> None:
    """Each fold line divides what the folds before it leave, and hands take hold of what it moves.

    Raises ConfigurationError, which names the step and its variant.
    """
    state = garment.flat_state(0.0, 0.0)
    for chosen in _choices(garment):
        planned = plan_folds(state, garment, chosen)
        if planned.failure is not None:
            f, name = planned.failure, str(planned.failure.values["step"])
            key = f"plan.{name}.line"
            hint = f"{f.hint}; its two points lie apart, and the key points in `moves` on one side of it"
            raise ConfigurationError(
                f"{path}: {key}{_way(name, garment, chosen)}: {f.what}", hint, file=str(path), key=key
            )
        for step in planned.unwrap():
            if any(chosen[s.name] != s.variants[0].name for s in garment.plan[: step.index]):
                break  # grasps are stated for what the preferred ways have left
            what = _out_of_hand(step, garment)
            if what is not None:
                key = f"plan.{step.name}.grasps"
                hint = "take hold at a key point that moves, or between two; `inset` leads inwards from there"
                where = f"{path}: {key}{_way(step.name, garment, chosen)}"
                raise ConfigurationError(f"{where}: {what}", hint, file=str(path), key=key)


def _choices(garment: Garment) -> Iterator[Mapping[str, str]]:
    """Every way through the plan, the preferred one first: the scorer asks for all of them."""
    ways = [[(step.name, variant.name) for variant in step.variants] for step in garment.plan]
    yield from map(dict, product(*ways))


def _way(step: str, garment: Garment, chosen: Mapping[str, str]) -> str:
    """The variant in brackets, where the step has more than one."""
    several = any(s.name == step and len(s.variants) > 1 for s in garment.plan)
    return f" ({chosen[step]})" if several else ""


def _out_of_hand(step: FoldStep, garment: Garment) -> str | None:
    """What is wrong with the place of a grasp, None where hands find moving cloth."""
    outline = np.asarray(garment.flat_state(0.0, 0.0).contour)
    for grasp_id, grasp in step.grasps.items():
        if layers_at(step.earlier, outline, grasp.point, garment.layers) == 0:
            return f"the {grasp_id} hand's grasp lies beside the garment"
        beyond = float(step.line.signed_distance(grasp.point))
        if beyond < LEAST_FLAP:
            least = f"not {1e3 * LEAST_FLAP:.0f} mm or more"
            return f"the {grasp_id} hand's grasp lies {1e3 * beyond:.0f} mm inside what moves, {least}"
    return None
