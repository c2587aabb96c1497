"""The values that packages exchange. All are frozen, with read-only arrays, in metres, radians and seconds.

All coordinates are in the table frame (see robots.ports): x forward, y left, z = 0 on the table. A point of the
garment is given either by its present position (table frame) or by its material coordinates, its position in the
flat garment before the first fold. Before the first fold, the two are equal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import wraps
from typing import Generic, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.errors import CellError, Failure, FailureKind
from foldcell.robots.ports import Array, CameraFrame, Intrinsics, Side, frozen

__all__ = [
    "REFERENCE_DROP",
    "Array",
    "CameraCalibration",
    "CameraFrame",
    "Corner",
    "Failed",
    "Failure",
    "FailureKind",
    "FoldLine",
    "FoldStep",
    "GarmentState",
    "Grasp",
    "GraspId",
    "GraspTrajectory",
    "Intrinsics",
    "Material",
    "Outcome",
    "PredictedShape",
    "Table",
    "ToolPath",
    "frozen",
    "refuse",
    "skill",
    "tool_rotation",
]

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


class Failed(CellError):
    """Ends a skill with a failure, wherever in it `Outcome.unwrap` or `refuse` meets the failure (`skill`)."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.what, failure.hint)
        self.failure, self.values = failure, dict(failure.values)


def refuse(failure: Failure | None) -> None:
    """End the skill with this failure, if there is one."""
    if failure is not None:
        raise Failed(failure)


def skill(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function that returns an Outcome end with the failure that `unwrap` or `refuse` meets within it."""

    @wraps(function)
    def ended(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except Failed as end:
            return Outcome(failure=end.failure)  # type: ignore[return-value]

    return ended


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """The result of a skill: a value or a failure, never both. `notes`: figures for the record."""

    value: T | None = None
    failure: Failure | None = None
    notes: Mapping[str, float | int | str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (self.value is None) == (self.failure is None):
            raise ValueError("an Outcome has either a value or a failure")

    @property
    def ok(self) -> bool:
        return self.failure is None

    def unwrap(self) -> T:
        """Return the value. Raises Failed for a failure, with which a `skill` then ends."""
        refuse(self.failure)
        return cast(T, self.value)


@dataclass(frozen=True)
class Table:
    """The table's top: its height in the base frame and its extent in the table frame [m]."""

    height: float
    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def T_base_table(self) -> Array:
        T = np.eye(4)
        T[2, 3] = self.height
        return T


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """The calibration of the camera. T_table_camera: (4, 4), camera to table.

    head_pan: the pan angle of the head at which the camera was calibrated [rad]; pictures from another angle are
    refused.
    """

    intrinsics: Intrinsics
    T_table_camera: Array
    head_pan: float = 0.0


REFERENCE_DROP = 0.6
"""[m] length of the hanging strip for which a fabric's stretch is stated."""

CREASE_SET = 0.55
"""crease_set of a fabric without a crease test. With it the simulated test of unfinished cotton keeps the measured
103 degrees (crease recovery of warp and weft together: 155 of 360; Fashion and Textiles 2017, s40691-017-0104-2,
Table 13). Assumed for other fabrics; range 0.2 (finished against creases) to 0.7."""


@dataclass(frozen=True)
class Material:
    """Measurable properties of a fabric; the friction is that of garment and surface together.

    areal_mass [kg/m2]; stretch_fraction: elongation of a strip, REFERENCE_DROP long, that hangs by its end (the
    paper's shear_frac is of the garment hung by a point: calibration/shear.py); bending_length: Peirce's
    cantilever bending length [m]; thickness of one layer [m]; friction coefficients with the table and between
    layers (Coulomb); crease_set: share of a crease that a standard load sets (calibration/crease.py).
    """

    areal_mass: float
    stretch_fraction: float
    bending_length: float
    thickness: float
    friction_static: float
    friction_dynamic: float
    friction_layers: float
    assumed: tuple[str, ...] = ()
    """Names of the fields that were not measured for this garment."""
    crease_set: float = CREASE_SET

    def with_friction(self, mu: float) -> Material:
        """The same fabric on a table with the static coefficient `mu`. The dynamic coefficient changes in the same
        proportion."""
        ratio = self.friction_dynamic / self.friction_static
        return replace(self, friction_static=mu, friction_dynamic=mu * ratio)


@dataclass(frozen=True, eq=False)
class GarmentState:
    """The garment on the table as perceived.

    contour: (n, 2) counter-clockwise, not closed. keypoints: name -> (2,) position. confidence: probability that
    all key points are accurate to 10 mm (1 for a state that was not perceived). ambiguous: names of symmetries
    that the picture cannot resolve.
    """

    category: str
    contour: Array
    keypoints: Mapping[str, Array]
    confidence: float
    ambiguous: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FoldLine:
    """A directed line: the part to the LEFT of point -> point + direction moves, the rest stays.

    It refers to the garment as it lies before this fold. point: (2,), direction: (2,) unit.
    """

    point: Array
    direction: Array

    @property
    def normal(self) -> Array:
        """(2,) unit, towards the moving side."""
        return np.array([-self.direction[1], self.direction[0]])

    def signed_distance(self, xy: Array) -> Array:
        """(..., 2) -> (...,): positive on the moving side."""
        return (np.asarray(xy) - self.point) @ self.normal

    def reflect(self, xy: Array) -> Array:
        """(..., 2) -> (..., 2): mirror image in the line."""
        d = self.signed_distance(xy)
        return np.asarray(xy) - 2.0 * np.multiply.outer(d, self.normal)


@dataclass(frozen=True, eq=False)
class Corner:
    """A convex corner of an outline. point: (2,) its tip [m]; inward: (2,) unit, its bisector."""

    point: Array
    inward: Array


class GraspId(StrEnum):
    """Identifier of a grasp of a fold step, the key of its target, arc and tool path. It is named after the
    planned arm. The motion planner chooses the arm that executes it (`Posture.path`), which is a
    `foldcell.robots.ports.Side`. The two enumerations compare equal, so only their types tell them apart."""

    LEFT = "left"
    RIGHT = "right"

    @property
    def other(self) -> GraspId:
        return GraspId.RIGHT if self is GraspId.LEFT else GraspId.LEFT

    @property
    def planned_arm(self) -> Side:
        """The arm that takes the grasp unless the arms are swapped."""
        return Side(self.value)


@dataclass(frozen=True, eq=False)
class Grasp:
    """Position and orientation of one hand's grasp.

    point: (2,) middle of the held line, table frame. heading: direction of the held line (the tool's x) in the
    table plane [rad]. layers: number of layers to pinch. height: of the top of the stack under the tool before the
    grasp [m].
    """

    point: Array
    heading: float
    layers: int
    height: float

    def whole_stack(self, thickness: float) -> bool:
        """Whether the grasp holds all layers down to the table. thickness: of a layer, as in the plan of the
        grasp [m]."""
        return self.height < (self.layers + 0.5) * thickness


@dataclass(frozen=True, eq=False)
class FoldStep:
    """One fold: grasps, release targets and the target shape.

    index counts from 0. line: the fold line. earlier: the lines of the steps before, in order; the target shape is
    the flat outline folded by `earlier` and then by `line`. grasps and targets: one for each hand used; a target
    is (3,), the tool centre point at release, z above the stack. variant: name of the variant of the plan.
    """

    name: str
    index: int
    line: FoldLine
    earlier: tuple[FoldLine, ...]
    grasps: Mapping[GraspId, Grasp]
    targets: Mapping[GraspId, Array]
    variant: str = ""

    @property
    def lines(self) -> tuple[FoldLine, ...]:
        return (*self.earlier, self.line)


@dataclass(frozen=True, eq=False)
class GraspTrajectory:
    """The path of the held line's middle for each grasp: Bezier control points (n + 1, 3) in the table frame.

    source: 'library' or 'optimised'. cost: C(x) of the paper; dissimilarity: its D [m]; dissimilarity_initial: D
    of the paper's first guess where these arcs were optimised [m]. duration: of the motion from grasp to release
    [s].
    """

    control_points: Mapping[GraspId, Array]
    duration: float
    source: str
    cost: float
    dissimilarity: float
    simulations: int = 0
    dissimilarity_initial: float | None = None


def tool_rotation(heading: Array, pitch: Array, roll: Array) -> Array:
    """R_table_tool = Rz(heading) @ diag(1, -1, -1) @ Rx(pitch) @ Ry(roll); (n,) each [rad] -> (n, 3, 3)."""
    h, p, r = np.broadcast_arrays(heading, pitch, roll)
    ch, sh, cp, sp, cr, sr = np.cos(h), np.sin(h), np.cos(p), np.sin(p), np.cos(r), np.sin(r)
    zero, one = np.zeros_like(ch), np.ones_like(ch)

    def stack(*rows: Array) -> Array:
        return np.stack(rows, axis=-1).reshape(*ch.shape, 3, 3)

    Rz_down = stack(ch, sh, zero, sh, -ch, zero, zero, zero, -one)
    Rx = stack(one, zero, zero, zero, cp, -sp, zero, sp, cp)
    Ry = stack(cr, zero, sr, zero, one, zero, -sr, zero, cr)
    return Rz_down @ Rx @ Ry


@dataclass(frozen=True, eq=False)
class ToolPath:
    """The sampled path of one tool, for the arms and for the cloth simulation.

    t: (n,) [s] from 0; position: (n, 3) of the tool centre point, table frame; heading, pitch, roll: (n,).
    Orientation R_table_tool = Rz(heading) @ diag(1, -1, -1) @ Rx(pitch) @ Ry(roll); with all three zero the hand
    points straight down with its held line along table x.
    """

    t: Array
    position: Array
    heading: Array
    pitch: Array
    roll: Array

    def at(self, t: Array) -> ToolPath:
        """Return the path at other times t (m,), linearly between its samples."""
        position = np.column_stack([np.interp(t, self.t, x) for x in self.position.T])
        angles = (np.unwrap(self.heading), self.pitch, self.roll)
        return ToolPath(t, position, *(np.interp(t, self.t, x) for x in angles))

    @property
    def rotation(self) -> Array:
        """(n, 3, 3) R_table_tool."""
        return tool_rotation(self.heading, self.pitch, self.roll)


@dataclass(frozen=True, eq=False)
class PredictedShape:
    """A garment's shape as a triangle mesh: vertices (n, 3) table frame, triangles (m, 3), and the material
    coordinates (n, 2) of its vertices."""

    vertices: Array
    triangles: NDArray[np.int32]
    material: Array
