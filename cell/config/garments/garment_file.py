"""Read garment files (YAML) as Garment values, with validation. A new garment needs a file and no code."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    field_validator,
    model_validator,
)

from foldcell.cell.config.garments.fabric_file import load_fabrics
from foldcell.cell.config.garments.plan_check import check_lines_and_grasps
from foldcell.cell.config.yaml_file import (
    Document,
    Key,
    did_you_mean,
    parse_yaml,
    read_text,
    rule_broken,
    validated,
)
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.garments.garment import Anchor, Garment, PlanGrasp, PlanStep, PlanVariant, PoseRange
from foldcell.skills.garments.outline_check import (
    LARGEST,
    SMALLEST,
    crosses_itself,
    impossible_size,
    runs_clockwise,
    same_places,
)
from foldcell.skills.vocabulary import CREASE_SET, REFERENCE_DROP, GraspId, Material, frozen

DEFAULT_SURFACE = "bare_table"
WHAT = "garment file"
"""Name of these files in error messages."""

AVERAGE = {
    "stretch_fraction": 0.024,
    "friction_angle_deg": 22.2,
    "areal_mass": 0.30,
    "bending_length": 0.020,
    "thickness": 0.002,
    "friction_dynamic_ratio": 0.85,
    "friction_layers": 0.6,
    "crease_set": CREASE_SET,
}
"""Material of a garment without measurements: the first two values are the paper's averages, the others are
assumed."""


def list_garments() -> tuple[str, ...]:
    """Return the names of the shipped garments."""
    folder = resources.files("foldcell.skills.garments")
    return tuple(sorted(p.name.removesuffix(".yaml") for p in folder.iterdir() if p.name.endswith(".yaml")))


def shipped_garment_path(name: str) -> Path:
    """Return the path of a shipped garment's file."""
    return Path(str(resources.files("foldcell.skills.garments") / f"{name}.yaml"))


def load_garment(name_or_path: str | Path, surface: str = DEFAULT_SURFACE) -> Garment:
    """Read a garment by its shipped name or from a YAML file, with its friction on `surface`.

    Raises ConfigurationError with the file, the line, the key, the value and the allowed values.
    """
    path = garment_path(name_or_path)
    return parse_garment(path, read_text(path, WHAT), surface)


@lru_cache(maxsize=64)
def parse_garment(path: Path, text: str, surface: str) -> Garment:
    """Return the garment of a file with this text, as `load_garment` does. path: name of the file, for messages.

    A run asks for each garment several times, and checking all ways to fold it takes long.
    """
    document = parse_yaml(text, path, WHAT)
    file = validated(document, _GarmentFile)
    garment = _garment(document, file, surface)
    check_lines_and_grasps(document, garment)
    return garment


def garment_path(name_or_path: str | Path) -> Path:
    """Return the path of the file of a garment that is given by its shipped name or by a path. Raises
    ConfigurationError for an unknown name."""
    text = str(name_or_path)
    if text.endswith((".yaml", ".yml")) or "/" in text:
        return Path(text)
    if text in list_garments():
        return shipped_garment_path(text)
    known = f"{did_you_mean(text, list_garments())}Shipped garments: {', '.join(list_garments())}"
    raise ConfigurationError(
        f"there is no garment {text!r}",
        f"{known}. You can also give the path of a YAML file.",
        garment=text,
    )


# ------------------------------------------------------------------ the file's schema

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]
Metres = Annotated[float, Field(ge=-1.5, le=1.5, strict=True)]
Range = tuple[Metres, Metres]
Degrees = Annotated[float, Field(ge=-180, le=180, strict=True)]
Inset = Annotated[float, Field(ge=0, le=0.08, strict=True)]
Tension = Annotated[float, Field(ge=0, le=0.03, strict=True)]
FrictionDegrees = Annotated[float, Field(ge=2, le=60, strict=True)]
Shrunk = Annotated[float, Field(ge=0.3, le=1, strict=True)]
Grown = Annotated[float, Field(ge=1, le=3, strict=True)]
Weight = Annotated[float, Field(strict=True)]

MOST_WAYS = 256
"""Maximum number of ways to fold a garment, which is the product of the numbers of variants of its steps. It is
limited because all ways are checked."""


def _about(about: str, default: Any = ...) -> Any:
    return Field(default, description=about)


def _number(low: float, high: float, about: str, default: Any = ...) -> Any:
    return Field(default, ge=low, le=high, strict=True, description=about)


def _count(low: int, high: int, about: str) -> Any:
    return Field(ge=low, le=high, strict=True, description=about)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _as_weights(value: Any) -> Any:
    return {value: 1.0} if isinstance(value, str) else value


_Anchor = Annotated[dict[Name, Weight], BeforeValidator(_as_weights), Field(min_length=1)]


class _Grasp(_Strict):
    at: _Anchor = _about("place of the grasp: a key point, or key points with weights")
    inset: tuple[Inset, Inset] = _about("how far inside the edge, along both directions of the corner [m]")
    arm: Literal["auto", "left", "right"] = _about("the arm that takes this grasp", "auto")
    turn_deg: float = _number(-90, 90, "turn of the hand about the vertical [degrees]", 0.0)


class _Variant(_Strict):
    name: Name = _about("name in the journal and in reports")
    moves: list[Name] = Field(min_length=1, description="key points that the fold moves")
    grasps: list[_Grasp] = Field(min_length=1, max_length=2, description="one or two grasps")

    @model_validator(mode="after")
    def _two_arms(self) -> _Variant:
        arms = [g.arm for g in self.grasps if g.arm != "auto"]
        if len(arms) != len(set(arms)):
            raise rule_broken("one arm cannot take two grasps")
        return self


class _Step(_Strict):
    name: Name = _about("name in the journal and in reports")
    line: tuple[_Anchor, _Anchor] = _about(
        "both ends of the fold line: key points, or key points with weights that sum to one"
    )
    variants: list[_Variant] = Field(
        min_length=1,
        description="ways to make this fold; the next one is tried if the arms cannot make the first",
    )
    tension: tuple[Tension, Tension] = _about(
        "how much further from the line, and further outwards, the targets of the grasps lie [m]", (0.0, 0.0)
    )


FabricField = Literal[
    "areal_mass", "stretch_fraction", "bending_length", "thickness", "friction_static", "friction_dynamic",
    "friction_layers", "crease_set",
]  # fmt: skip
FABRIC_FIELDS: tuple[str, ...] = get_args(FabricField)
"""Names of the properties of a fabric. Each property may be assumed instead of measured."""


class _MaterialFile(_Strict):
    fabric: Name | None = _about(
        "class of fabrics; gives what is not stated, and the range that the simulated cell draws from", None
    )
    stretch_fraction: float | None = _number(
        0.001, 0.2, "how much the hung garment is longer than when it lies, as a share", None
    )
    hang_drop: float = _number(0.1, 20, "length that hung when this was measured [m]", REFERENCE_DROP)
    friction_angle_deg: dict[Name, FrictionDegrees] | None = _about(
        "surface: angle at which the garment slides [degrees]", None
    )
    areal_mass: float | None = _number(0.03, 2.0, "mass of one layer [kg/m2]", None)
    bending_length: float | None = _number(0.003, 0.1, "bending length of one layer [m]", None)
    thickness: float | None = _number(0.0001, 0.01, "thickness of one layer [m]", None)
    friction_dynamic_ratio: float | None = _number(
        0.3, 1.0, "friction while it slides, as a share of the friction at rest", None
    )
    friction_layers: float | None = _number(0.05, 2.0, "friction coefficient of one layer on another", None)
    crease_set: float | None = _number(
        0.0, 0.8, "share of a bend beyond the elastic part that a standard press sets", None
    )
    measured: dict[Name, str] = _about("property: who measured it and when", {})
    assumed: list[FabricField] = _about("properties that nobody measured", [])

    @field_validator("fabric")
    @classmethod
    def _known_fabric(cls, name: str | None) -> str | None:
        if name is not None and name not in load_fabrics():
            raise rule_broken(f"this class of fabrics is not known; known: {', '.join(load_fabrics())}")
        return name


class _Poses(_Strict):
    x: Range = _about("range of the place [m], table frame")
    y: Range = _about("range of the place [m], table frame")
    angle_deg: tuple[Degrees, Degrees] = _about("range of the angle [degrees]")

    @model_validator(mode="after")
    def _ordered(self) -> _Poses:
        for name in ("x", "y", "angle_deg"):
            low, high = getattr(self, name)
            if low > high:
                raise rule_broken(f"{name}: the lower end {low} has to come first, not {high}")
        return self


class _GarmentFile(_Strict):
    title: str = _about("name for people")
    category: Name = _about("kind of garment; photographs and pictures are recognised by it")
    layers: int = _count(1, 2, "layers of cloth of the garment as it lies")
    keypoints: dict[Name, tuple[Metres, Metres]] = Field(
        min_length=3,
        max_length=100,
        description="name: [x, y] [m], counter-clockwise around the outline as it lies; their middle is [0, 0]",
    )
    material: _MaterialFile = _about("the fabric", _MaterialFile())
    plan: list[_Step] = Field(min_length=1, description="the folds, one after the other")
    edge_pairs: list[tuple[tuple[Name, Name], tuple[Name, Name]]] = _about(
        "pairs of edges, each by two key points, that lie on one another when the garment is folded",
        [],
    )
    max_tool_speed: float = _number(
        0.02, 1.5, "largest speed of the hands while they carry the garment [m/s]", 0.35
    )
    size_range: tuple[Shrunk, Grown] = _about(
        "smallest and largest size that is recognised, as a share of this one", (0.8, 1.2)
    )
    poses: _Poses = _about("where the garment may lie")
    final_layers: int = _count(1, 64, "layers of the folded garment")

    @model_validator(mode="after")
    def _outline(self) -> _GarmentFile:
        points = np.array(list(self.keypoints.values()))
        same = same_places(points, list(self.keypoints))
        if same:
            raise rule_broken(
                f"{same[0][0]} and {same[0][1]} lie at the same place; move one", "keypoints", same[0][1]
            )
        if crosses_itself(points):
            raise rule_broken("the outline through them in this order crosses itself", "keypoints")
        if runs_clockwise(points):
            raise rule_broken("list them counter-clockwise (x away from the robot, y to its left)", "keypoints")
        if impossible_size(points):
            size = np.ptp(points, axis=0)
            what = f"they span {size[0]:.3f} x {size[1]:.3f} m; {SMALLEST:g} to {LARGEST:g} m is possible"
            raise rule_broken(what, "keypoints")
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        if np.abs(middle).max() > 0.002:
            raise rule_broken(f"their middle is {middle.round(3).tolist()}, not [0, 0]", "keypoints")
        return self

    @model_validator(mode="after")
    def _known_points(self) -> _GarmentFile:
        for key, name in self._mentions():
            if name not in self.keypoints:
                raise rule_broken(f"{name!r} is not a key point; known: {', '.join(self.keypoints)}", *key)
        for key, anchor in self._anchors():
            if abs(sum(anchor.values()) - 1.0) > 1e-6:
                raise rule_broken(f"the weights of an anchor must sum to one, not {sum(anchor.values()):g}", *key)
        return self

    @model_validator(mode="after")
    def _plan_names(self) -> _GarmentFile:
        names: list[str] = []
        for i, step in enumerate(self.plan):
            if step.name in names:
                raise rule_broken(f"two steps have the same name {step.name!r}", "plan", i, "name")
            names.append(step.name)
            variants: list[str] = []
            for k, variant in enumerate(step.variants):
                if variant.name in variants:
                    what = f"two variants of the step {step.name!r} have the same name {variant.name!r}"
                    raise rule_broken(what, "plan", i, "variants", k, "name")
                variants.append(variant.name)
        ways = math.prod(len(step.variants) for step in self.plan)
        if ways > MOST_WAYS:
            raise rule_broken(f"its variants make {ways} ways to fold; at most {MOST_WAYS} are allowed", "plan")
        return self

    def _anchors(self) -> Iterator[tuple[Key, dict[str, float]]]:
        """Yield every anchor of the plan (key points with weights), with its key in the file."""
        for i, step in enumerate(self.plan):
            for end, anchor in enumerate(step.line):
                yield ("plan", i, "line", end), anchor
            for k, variant in enumerate(step.variants):
                for n, grasp in enumerate(variant.grasps):
                    yield ("plan", i, "variants", k, "grasps", n, "at"), grasp.at

    def _mentions(self) -> Iterator[tuple[Key, str]]:
        """Yield every mention of a key point in the file, with its key in the file."""
        for key, anchor in self._anchors():
            yield from (((*key, name), name) for name in anchor)
        for i, step in enumerate(self.plan):
            for k, variant in enumerate(step.variants):
                for n, name in enumerate(variant.moves):
                    yield ("plan", i, "variants", k, "moves", n), name
        for i, pair in enumerate(self.edge_pairs):
            for e, edge in enumerate(pair):
                yield from ((("edge_pairs", i, e, n), name) for n, name in enumerate(edge))


# ------------------------------------------------------------------ file -> value


def _garment(document: Document, file: _GarmentFile, surface: str) -> Garment:
    poses = file.poses
    low, high = poses.angle_deg
    return Garment(
        name=document.path.stem,
        title=file.title,
        category=file.category,
        layers=file.layers,
        keypoints=tuple(file.keypoints),
        template=frozen(np.array(list(file.keypoints.values()), dtype=float)),
        material=_material(document, file.material, surface),
        plan=tuple(_step(step) for step in file.plan),
        edge_pairs=tuple(file.edge_pairs),
        max_tool_speed=file.max_tool_speed,
        poses=PoseRange(poses.x, poses.y, (math.radians(low), math.radians(high))),
        size_range=file.size_range,
        final_layers=file.final_layers,
        surface=surface,
        fabric=None if file.material.fabric is None else load_fabrics()[file.material.fabric],
    )


def _material(document: Document, file: _MaterialFile, surface: str) -> Material:
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
            f"{document.where(('material', 'friction_angle_deg'))}: material.friction_angle_deg has no surface"
            f" {surface!r}",
            f"It has {known}. Measure this surface with `foldcell calibrate friction`, or choose another surface.",
            file=str(document.path),
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
        crease_set=given("crease_set"),
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
