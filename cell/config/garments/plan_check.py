"""Check that the fold plan of a garment file is feasible on its outline, for every combination of variants."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np

from foldcell.cell.config.yaml_file import Document, Key
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.fold_plan.folding import layers_at
from foldcell.skills.fold_plan.plan import LEAST_FLAP, plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.vocabulary import FoldStep


def check_lines_and_grasps(document: Document, garment: Garment) -> None:
    """Check that each fold line divides the garment as the earlier folds leave it, and that the grasps lie on the
    part that moves.

    document: the garment's file. Raises ConfigurationError with the line, the step and its variant.
    """
    state = garment.flat_state(0.0, 0.0)
    for chosen in _choices(garment):
        planned = plan_folds(state, garment, chosen)
        if planned.failure is not None:
            f, name = planned.failure, str(planned.failure.values["step"])
            key = f"plan.{name}.line"
            hint = (
                f"{f.hint}; its two points must differ, and the key points in `moves` must lie on one side of it"
            )
            where = f"{document.where(_line_key(name, garment))}: {key}{_variant(name, garment, chosen)}"
            raise ConfigurationError(f"{where}: {f.what}", hint, file=str(document.path), key=key)
        for step in planned.unwrap():
            if any(chosen[s.name] != s.variants[0].name for s in garment.plan[: step.index]):
                break  # the grasps in the file are meant for the preferred variants of the earlier steps
            what = _grasp_error(step, garment)
            if what is not None:
                key = f"plan.{step.name}.grasps"
                hint = "grasp at a moving key point, or between two of them; `inset` leads inwards from there"
                line = document.where(_grasps_key(step.name, garment, chosen))
                where = f"{line}: {key}{_variant(step.name, garment, chosen)}"
                raise ConfigurationError(f"{where}: {what}", hint, file=str(document.path), key=key)


def _choices(garment: Garment) -> Iterator[Mapping[str, str]]:
    """Yield every combination of variants (step -> variant), beginning with the preferred variants. All
    combinations are checked, because a run may use any of them and the scorer compares with each."""
    variants = [[(step.name, variant.name) for variant in step.variants] for step in garment.plan]
    yield from map(dict, product(*variants))


def _variant(step: str, garment: Garment, chosen: Mapping[str, str]) -> str:
    """Return the chosen variant in brackets if the step has more than one variant, else an empty text."""
    several = any(s.name == step and len(s.variants) > 1 for s in garment.plan)
    return f" ({chosen[step]})" if several else ""


def _line_key(step: str, garment: Garment) -> Key:
    """Return the key of a step's fold line in the file."""
    return ("plan", [s.name for s in garment.plan].index(step), "line")


def _grasps_key(step: str, garment: Garment, chosen: Mapping[str, str]) -> Key:
    """Return the key of the grasps of a step's chosen variant in the file."""
    index = [s.name for s in garment.plan].index(step)
    variants = [v.name for v in garment.plan[index].variants]
    return ("plan", index, "variants", variants.index(chosen[step]), "grasps")


def _grasp_error(step: FoldStep, garment: Garment) -> str | None:
    """Return an error message for a grasp that is not on moving cloth, or None."""
    outline = np.asarray(garment.flat_state(0.0, 0.0).contour)
    for grasp_id, grasp in step.grasps.items():
        if layers_at(step.earlier, outline, grasp.point, garment.layers) == 0:
            return f"the {grasp_id} hand's grasp lies beside the garment"
        beyond = float(step.line.signed_distance(grasp.point))
        if beyond < LEAST_FLAP:
            minimum = f"at least {1e3 * LEAST_FLAP:.0f} mm are needed"
            return f"the {grasp_id} hand's grasp lies {1e3 * beyond:.0f} mm inside the moved part; {minimum}"
    return None
