"""Read garment files (YAML) as Garment values, with validation. A new garment needs a file and no code."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import shapely
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from cell.config.garments.plan_check import check_lines_and_grasps
from cell.config.yaml_file import read_yaml
from robots.errors import ConfigurationError
from skills.garments.garment import Anchor, Garment, PlanGrasp, PlanStep, PlanVariant, PoseRange
from skills.vocabulary import REFERENCE_DROP, GraspId, Material, frozen

__all__ = [
    "AVERAGE",
    "DEFAULT_SURFACE",
    "FABRIC_FIELDS",
    "garment_path",
    "list_garments",
    "load_garment",
    "shipped_garment_path",
]

DEFAULT_SURFACE = "bare_table"

AVERAGE = {
    "stretch_fraction": 0.024,
    "friction_angle_deg": 22.2,
    "areal_mass": 0.30,
    "bending_length": 0.020,
    "thickness": 0.002,
    "friction_dynamic_ratio": 0.85,
    "friction_layers": 0.6,
}
"""Material of a garment without measurements: the first two values are the paper's averages, the others are
assumed."""


def list_garments() -> tuple[str, ...]:
    """Names of the shipped garments."""
    folder = resources.files("skills.garments")
    return tuple(sorted(p.name.removesuffix(".yaml") for p in folder.iterdir() if p.name.endswith(".yaml")))


def shipped_garment_path(name: str) -> Path:
    """The file of a shipped garment."""
    return Path(str(resources.files("skills.garments") / f"{name}.yaml"))


def load_garment(name_or_path: str | Path, surface: str = DEFAULT_SURFACE) -> Garment:
    """Read a garment by its shipped name or from a YAML file, with its friction on `surface`.

    Raises ConfigurationError with the file, the key, the value and the allowed values.
    """
    path = garment_path(name_or_path)
    data = read_yaml(path, "garment file").data
    try:
        file = _GarmentFile.model_validate(data)
    except ValidationError as error:
        raise _readable(path, data, error) from None
    garment = _garment(path, file, surface)
    check_lines_and_grasps(path, garment)
    return garment


def garment_path(name_or_path: str | Path) -> Path:
    """The file of a garment given by its shipped name or by a path. Raises ConfigurationError for an unknown
    name."""
    text = str(name_or_path)
    if text.endswith((".yaml", ".yml")) or "/" in text:
        return Path(text)
    if text in list_garments():
        return shipped_garment_path(text)
    close = difflib.get_close_matches(text, list_garments(), n=1)
    guess = f"did you mean {close[0]}? " if close else ""
    known = ", ".join(list_garments())
    raise ConfigurationError(
        f"there is no garment {text!r}",
        f"{guess}Shipped garments: {known}. You can also give the path of a YAML file.",
        garment=text,
    )


# ------------------------------------------------------------------ the file's schema

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]
Metres = Annotated[float, Field(ge=-1.5, le=1.5, allow_inf_nan=False)]
Range = tuple[Metres, Metres]
Degrees = Annotated[float, Field(ge=-180, le=180, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _as_weights(value: Any) -> Any:
    return {value: 1.0} if isinstance(value, str) else value


_Anchor = Annotated[dict[Name, float], BeforeValidator(_as_weights), Field(min_length=1)]


class _Grasp(_Strict):
    at: _Anchor
    inset: tuple[Annotated[float, Field(ge=0, le=0.08)], Annotated[float, Field(ge=0, le=0.08)]]
    arm: Literal["auto", "left", "right"] = "auto"
    turn_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0


class _Variant(_Strict):
    name: Name
    moves: Annotated[list[Name], Field(min_length=1)]
    grasps: Annotated[list[_Grasp], Field(min_length=1, max_length=2)]

    @model_validator(mode="after")
    def _two_arms(self) -> _Variant:
        arms = [g.arm for g in self.grasps if g.arm != "auto"]
        if len(arms) != len(set(arms)):
            raise ValueError("one arm cannot take two grasps")
        return self


class _Step(_Strict):
    name: Name
    line: tuple[_Anchor, _Anchor]
    variants: Annotated[list[_Variant], Field(min_length=1)]
    tension: tuple[Annotated[float, Field(ge=0, le=0.03)], Annotated[float, Field(ge=0, le=0.03)]] = (0.0, 0.0)


FabricField = Literal[
    "areal_mass", "stretch_fraction", "bending_length", "thickness", "friction_static", "friction_dynamic",
    "friction_layers",
]  # fmt: skip
FABRIC_FIELDS: tuple[str, ...] = get_args(FabricField)
"""Properties of a fabric. Each of them may be assumed instead of measured."""


class _MaterialFile(_Strict):
    stretch_fraction: Annotated[float, Field(ge=0.001, le=0.2)] | None = None
    hang_drop: Annotated[float, Field(ge=0.1, le=20)] = REFERENCE_DROP
    friction_angle_deg: dict[Name, Annotated[float, Field(ge=2, le=60)]] | None = None
    areal_mass: Annotated[float, Field(ge=0.03, le=2.0)] | None = None
    bending_length: Annotated[float, Field(ge=0.003, le=0.1)] | None = None
    thickness: Annotated[float, Field(ge=0.0001, le=0.01)] | None = None
    friction_dynamic_ratio: Annotated[float, Field(ge=0.3, le=1.0)] | None = None
    friction_layers: Annotated[float, Field(ge=0.05, le=2.0)] | None = None
    measured: dict[Name, str] = {}
    assumed: list[FabricField] = []


class _Poses(_Strict):
    x: Range
    y: Range
    angle_deg: tuple[Degrees, Degrees]

    @model_validator(mode="after")
    def _ordered(self) -> _Poses:
        for name in ("x", "y", "angle_deg"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: the lower end {low} has to come first, not {high}")
        return self


class _GarmentFile(_Strict):
    title: str
    category: Name
    layers: Annotated[int, Field(ge=1, le=2)]
    keypoints: Annotated[dict[Name, tuple[Metres, Metres]], Field(min_length=3)]
    material: _MaterialFile = _MaterialFile()
    plan: Annotated[list[_Step], Field(min_length=1)]
    edge_pairs: list[tuple[tuple[Name, Name], tuple[Name, Name]]] = []
    max_tool_speed: Annotated[float, Field(ge=0.02, le=1.5)] = 0.35
    size_range: tuple[Annotated[float, Field(ge=0.3, le=1)], Annotated[float, Field(ge=1, le=3)]] = (0.8, 1.2)
    poses: _Poses
    final_layers: Annotated[int, Field(ge=1, le=64)]

    @model_validator(mode="after")
    def _outline(self) -> _GarmentFile:
        points = np.array(list(self.keypoints.values()))
        polygon = shapely.Polygon(points)
        if not polygon.is_valid or polygon.area < 1e-3:
            raise ValueError("keypoints: the outline through them in this order crosses itself or has no area")
        if not polygon.exterior.is_ccw:
            raise ValueError("keypoints: list them counter-clockwise (x away from the robot, y to its left)")
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        if np.abs(middle).max() > 0.002:
            raise ValueError(f"keypoints: their middle is {middle.round(3).tolist()}, not [0, 0]")
        return self

    @model_validator(mode="after")
    def _known_points(self) -> _GarmentFile:
        for where, name in self._mentions():
            if name not in self.keypoints:
                raise ValueError(f"{where}: {name!r} is not a key point; known: {', '.join(self.keypoints)}")
        for where, anchor in self._anchors():
            if abs(sum(anchor.values()) - 1.0) > 1e-6:
                raise ValueError(
                    f"{where}: the weights of an anchor must sum to one, not {sum(anchor.values()):g}"
                )
        names = [step.name for step in self.plan]
        if len(names) != len(set(names)):
            raise ValueError("plan: two steps have the same name")
        for step in self.plan:
            if len({variant.name for variant in step.variants}) != len(step.variants):
                raise ValueError(f"plan.{step.name}: two variants have the same name")
        return self

    def _anchors(self) -> Iterator[tuple[str, dict[str, float]]]:
        for step in self.plan:
            for anchor in step.line:
                yield f"plan.{step.name}.line", anchor
            for variant in step.variants:
                for grasp in variant.grasps:
                    yield f"plan.{step.name}.{variant.name}.grasps.at", grasp.at

    def _mentions(self) -> Iterator[tuple[str, str]]:
        for where, anchor in self._anchors():
            yield from ((where, name) for name in anchor)
        for step in self.plan:
            for variant in step.variants:
                yield from ((f"plan.{step.name}.{variant.name}.moves", name) for name in variant.moves)
        for pair in self.edge_pairs:
            yield from (("edge_pairs", name) for edge in pair for name in edge)


# ------------------------------------------------------------------ file -> value


def _readable(path: Path, data: Mapping[str, Any], error: ValidationError) -> ConfigurationError:
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        message = "this key is not known"
    value = "" if first["type"] in ("missing", "value_error") else f" = {first['input']!r}"
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    hint = "Lengths are in metres; angles are in degrees if the key ends in _deg."
    if first["type"] == "extra_forbidden":
        close = difflib.get_close_matches(str(first["loc"][-1]), _known_keys(), n=1)
        hint = f"Did you mean {close[0]!r}?" if close else "Remove it; unknown keys are not ignored."
    where = f"{path}: {key}{value}: " if key else f"{path}: "
    return ConfigurationError(f"{where}{message}{more}", hint, file=str(path), key=key)


def _known_keys() -> list[str]:
    models = (_GarmentFile, _MaterialFile, _Poses, _Step, _Variant, _Grasp)
    return [name for model in models for name in model.model_fields]


def _garment(path: Path, file: _GarmentFile, surface: str) -> Garment:
    poses = file.poses
    low, high = poses.angle_deg
    return Garment(
        name=path.stem,
        title=file.title,
        category=file.category,
        layers=file.layers,
        keypoints=tuple(file.keypoints),
        template=frozen(np.array(list(file.keypoints.values()), dtype=float)),
        material=_material(path, file.material, surface),
        plan=tuple(_step(step) for step in file.plan),
        edge_pairs=tuple(file.edge_pairs),
        max_tool_speed=file.max_tool_speed,
        poses=PoseRange(poses.x, poses.y, (math.radians(low), math.radians(high))),
        size_range=file.size_range,
        final_layers=file.final_layers,
        surface=surface,
    )


def _material(path: Path, file: _MaterialFile, surface: str) -> Material:
    assumed: list[str] = list(file.assumed)

    def given(name: str, field: str | None = None) -> float:
        value = getattr(file, name)
        if value is None:
            assumed.append(field or name)
            return AVERAGE[name]
        return float(value)

    angle = AVERAGE["friction_angle_deg"]
    if file.friction_angle_deg is None:
        assumed.append("friction_static")
    elif surface in file.friction_angle_deg:
        angle = file.friction_angle_deg[surface]
    else:
        known = ", ".join(file.friction_angle_deg)
        raise ConfigurationError(
            f"{path}: material.friction_angle_deg has no surface {surface!r}",
            f"It has {known}. Measure this surface with `foldcell calibrate friction`, or choose another surface.",
            file=str(path),
            surface=surface,
        )
    mu = math.tan(math.radians(angle))
    return Material(
        areal_mass=given("areal_mass"),
        # converts the stretch of a garment hung by a clip to the stretch of a strip (calibration/shear.py)
        stretch_fraction=given("stretch_fraction") * REFERENCE_DROP / file.hang_drop,
        bending_length=given("bending_length"),
        thickness=given("thickness"),
        friction_static=mu,
        friction_dynamic=mu * given("friction_dynamic_ratio", "friction_dynamic"),
        friction_layers=given("friction_layers"),
        assumed=tuple(dict.fromkeys(assumed)),
    )


def _anchor(weights: dict[str, float]) -> Anchor:
    return Anchor(tuple(weights.items()))


def _grasp(grasp: _Grasp) -> PlanGrasp:
    grasp_id = None if grasp.arm == "auto" else GraspId(grasp.arm)
    return PlanGrasp(_anchor(grasp.at), grasp.inset, grasp_id, math.radians(grasp.turn_deg))


def _step(step: _Step) -> PlanStep:
    variants = tuple(
        PlanVariant(
            variant.name,
            tuple(variant.moves),
            tuple(map(_grasp, variant.grasps)),
        )
        for variant in step.variants
    )
    return PlanStep(step.name, (_anchor(step.line[0]), _anchor(step.line[1])), variants, step.tension)
