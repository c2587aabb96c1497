"""A category as a family of shapes, and the member of it that fits an outline.

A shape is described by joints, in half of the garment, because the other half mirrors it. A joint states where a
key point lies, seen from another one: its distance and its direction. The direction of a limb is free on each
side: a sleeve is stretched out or lies beside the body, and a leg swings. The direction of a cuff is measured from
its sleeve. Bends between key points round a shoulder, a side or a knee. Each figure has the range of the shipped
garments and of six real ones (`benchmarks.real_outlines`), with a margin.

A member is fitted to an outline by Gauss-Newton steps on distances in both directions, with Tukey's weights
(Fitzgibbon, Robust registration of 2D and 3D point sets, 2003), from several directions of the limbs in each
plausible orientation. Figures outside their range are drawn back to it. Where the outline shows no corner, the
usual figure decides. The registration then starts from the member instead of from the template.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from foldcell.robots.ports import Array
from foldcell.skills.garments.outline_check import crosses_itself
from foldcell.skills.perception.classify import polygon_iou
from foldcell.skills.perception.outline import GarmentOutline, MemberOutline, counter_clockwise, polygon_area
from foldcell.skills.perception.registration.energy import Boundary, closest_segments
from foldcell.skills.perception.registration.register import best_starts
from foldcell.skills.plane import rotation

Span = tuple[float, float]


@dataclass(frozen=True)
class Joint:
    """Where a key point lies in half of a garment.

    point, origin: names without the side; origin '': the middle between the first point and its mirror image.
    length: range of the distance between them, relative to the garment's length. angle: range of the direction,
    from the garment's axis outwards [degrees]; the same twice: fixed. after: name of the point whose direction the
    angle is measured from. limb: whether the direction differs between the sides. before: for a bend that is no
    key point, the key point that follows; the bend lies between its origin and that one.
    """

    point: str
    origin: str
    length: Span
    angle: Span
    after: str = ""
    limb: bool = False
    before: str = ""

    @property
    def fixed(self) -> bool:
        """Whether its direction is fixed. A bend then lies on the axis, in the middle of an edge."""
        return self.angle[0] == self.angle[1]


@dataclass(frozen=True)
class Corner:
    """Three points in a row. turn: range of the turn of the outline at the second one [degrees]. Without it, the
    end of a cuff or an armpit could lie anywhere on a straight edge."""

    points: tuple[str, str, str]
    turn: Span


@dataclass(frozen=True)
class Family:
    """The shapes of a category. joints: each after its origin. end: name of the point at the other end of the
    axis. The garment's length is its distance from the first point, along the axis. u: (2,) axis in the laid pose,
    from the first point to the end; v: (2,) from the axis to the first half. sides: of the first half and of the
    other one, in the names of key points. limb_angles, limb_lengths: directions [degrees] and lengths, relative to
    the garment's, of the limbs from which a fit starts. depth: another depth of the armpits, relative to the
    garment's length, from which it starts, too. shear: standard
    deviation of the shear, because cloth is laid askew and cameras tilt. either_way: whether its ends are so alike
    that a fit starts from both."""

    joints: tuple[Joint, ...]
    end: str
    u: tuple[float, float]
    v: tuple[float, float]
    sides: tuple[str, str]
    limb_angles: tuple[float, ...] = ()
    limb_lengths: tuple[float, ...] = ()
    corners: tuple[Corner, ...] = ()
    depth: float = 0.0
    shear: float = 0.05
    either_way: bool = False


def _shirt(*sleeve: Joint, angles: tuple[float, ...] = (), lengths: tuple[float, ...] = ()) -> Family:
    joints = (
        Joint("hem", "", (0.22, 0.55), (90.0, 90.0)),
        Joint("armpit", "hem", (0.42, 0.80), (-20.0, 16.0)),
        Joint("side", "hem", (0.15, 0.50), (-26.0, 20.0), before="armpit"),
        Joint("shoulder", "armpit", (0.18, 0.48), (-24.0, 30.0)),
        Joint("collar", "shoulder", (0.09, 0.34), (-90.0, -42.0)),
        *sleeve,
    )
    corners = (
        Corner(("cuff_upper", "cuff_lower", "armpit"), (35.0, 125.0)),
        Corner(("cuff_lower", "armpit", "side"), (40.0, 176.0)),
    )
    return Family(joints, "collar", (1.0, 0.0), (0.0, -1.0), ("right", "left"), angles, lengths, corners, 0.54)


def _trousers(outer: Span) -> Family:
    joints = (
        Joint("waist", "", (0.12, outer[1]), (90.0, 90.0)),
        Joint("ankle_outer", "waist", (0.94, 1.15), (-18.0, 32.0), limb=True),
        Joint("ankle_inner", "ankle_outer", outer, (-118.0, -64.0), after="ankle_outer"),
        Joint("crotch", "", (0.20, 0.85), (0.0, 0.0)),
        Joint("hip", "waist", (0.08, 0.35), (-18.0, 45.0), before="ankle_outer"),
        Joint("knee_outer", "waist", (0.40, 0.75), (-16.0, 16.0), after="ankle_outer", before="ankle_outer"),
        Joint("knee_inner", "ankle_inner", (0.15, 0.60), (150.0, 210.0), after="ankle_outer", before="crotch"),
    )
    return Family(
        joints,
        "ankle_outer",
        (0.0, -1.0),
        (-1.0, 0.0),
        ("near", "far"),
        (-6.0, 2.0, 12.0, 22.0),
        (1.0,),
        shear=0.005,
    )


_CURVES = (
    Joint("collar_base", "shoulder", (0.05, 0.30), (-88.0, -40.0), before="collar"),
    Joint("neckline", "", (0.80, 1.05), (0.0, 0.0), before="collar"),
    Joint("hemline", "neckline", (0.75, 1.15), (180.0, 180.0), before="hem"),
)
"""The lower edge of a collar that stands up, and the middle of the neckline. A member of such a shirt has its key
point at the upper edge, until `upper_edge` moves it to the lower one."""

_VEST = Family(
    (
        Joint("hem", "", (0.22, 0.55), (90.0, 90.0)),
        Joint("armpit", "hem", (0.42, 0.80), (-16.0, 14.0)),
        Joint("side", "hem", (0.15, 0.50), (-26.0, 20.0), before="armpit"),
        Joint("shoulder", "armpit", (0.18, 0.52), (-40.0, 6.0)),
        Joint("collar", "shoulder", (0.04, 0.22), (-90.0, -45.0)),
        Joint("neck", "", (0.55, 0.96), (0.0, 0.0)),
        Joint("armhole", "armpit", (0.06, 0.35), (-80.0, 0.0), before="shoulder"),
        Joint("neckline", "collar", (0.04, 0.40), (-200.0, -110.0), before="neck"),
        Joint("hemline", "neck", (0.50, 1.05), (180.0, 180.0), before="hem"),
    ),
    "collar",
    (1.0, 0.0),
    (0.0, -1.0),
    ("right", "left"),
    corners=(
        Corner(("armhole", "shoulder", "collar"), (35.0, 125.0)),
        Corner(("shoulder", "collar", "neckline"), (50.0, 140.0)),
    ),
)

_SKIRT = Family(
    (
        Joint("hem", "", (0.20, 0.90), (90.0, 90.0)),
        Joint("waist", "hem", (0.97, 1.12), (-32.0, 14.0)),
        Joint("side", "hem", (0.30, 0.75), (-32.0, 14.0), before="waist"),
        Joint("waistline", "", (0.93, 1.06), (0.0, 0.0), before="waist"),
        Joint("hemline", "waistline", (0.90, 1.15), (180.0, 180.0), before="hem"),
    ),
    "waist",
    (1.0, 0.0),
    (0.0, -1.0),
    ("right", "left"),
    either_way=True,
)

FAMILIES: Mapping[str, Family] = {
    "t_shirt": _shirt(
        Joint("cuff_upper", "shoulder", (0.18, 0.48), (75.0, 184.0), limb=True),
        Joint("cuff_lower", "cuff_upper", (0.12, 0.36), (60.0, 125.0), after="cuff_upper"),
        Joint("sleeve_top", "shoulder", (0.04, 0.30), (85.0, 178.0), before="cuff_upper"),
        *_CURVES,
        angles=(100.0, 125.0, 150.0, 170.0),
        lengths=(0.25, 0.38),
    ),
    "long_sleeve_shirt": _shirt(
        Joint("cuff_upper", "shoulder", (0.50, 1.15), (75.0, 192.0), limb=True),
        Joint("cuff_lower", "cuff_upper", (0.08, 0.28), (60.0, 120.0), after="cuff_upper"),
        Joint("sleeve_top", "shoulder", (0.04, 0.45), (85.0, 184.0), before="cuff_upper"),
        Joint("elbow", "cuff_lower", (0.10, 0.60), (150.0, 210.0), after="cuff_upper", before="armpit"),
        *_CURVES,
        angles=(95.0, 115.0, 135.0, 155.0, 170.0),
        lengths=(0.58, 0.80, 1.00),
    ),
    "vest": _VEST,
    "skirt": _SKIRT,
    "pants": _trousers((0.10, 0.32)),
    "shorts": _trousers((0.24, 1.15)),
}  # fmt: skip
"""The families of categories. For a towel, the stretch of the template is enough."""

_STEPS = 30
"""Gauss-Newton steps of a fit."""
_FIRST_STEPS = 8
"""Steps after which only the best starts go on."""
_TRIED = 10
"""Number of starts that are fitted, those that are nearest to the outline."""
_KEPT = 2
"""Number of starts that go on."""
_SHARPNESS = 4.0
"""Sharpness with which the directions of two edges are compared; 4 is a standard deviation of 7 degrees."""
_SCALE, _LAST_SCALE = 0.15, 0.03
"""First and last scale of Tukey's weights, relative to the square root of the garment's area."""
_DATA_SIGMA = 0.012
"""Standard deviation of the edge of an outline, relative to the square root of its area."""
_RANGE_SIGMA, _USUAL_SHARE = 0.05, 0.2
"""Standard deviation of a figure beyond its range (logarithm of a length, angle [rad]), and within the range,
relative to its width. The latter decides where the outline does not: a rounded shoulder has no corner."""
_SIDE_SIGMA, _FIXED_SIGMA = 0.35, 5e-4
"""Standard deviations of the difference between the directions of two limbs, and of a fixed direction [rad]."""
_POSE = 4
"""Number of parameters of the pose."""
_BEND_SIGMA = 0.05
"""Standard deviation of a bend from a straight edge, relative to the garment's length."""
_MOST_COUNTED = 9.0
"""A squared deviation counts at most as this in how unusual a member is: a single figure may be very unusual."""
_CROSSED = 1.5
"""Factor of the cost of an outline that crosses itself, as that of a sleeve which lies beside the body can."""
_PRIOR_COST = 1e-4
"""Weight of the squared deviations in the cost, which chooses between fits."""
_LEAST_OUT = 0.01
"""Least distance of a key point from the axis, relative to the garment's length. The halves do not cross."""
_SAMPLES = 6
"""Places on each edge of a member at which its distance from the outline is measured."""
_NEEDLESS = 0.95
"""A template that overlaps by more than this as it is, is kept."""


def best_members(contour: Array, garments: Sequence[GarmentOutline]) -> list[GarmentOutline]:
    """Return each garment with the shape of its family that fits an observed boundary (n, 2) [m] best. A template
    that fits as it is, and a category without limbs, stay."""
    contour = counter_clockwise(contour)
    searches = [_search(contour, garment) for garment in garments]
    return [
        garment if found is None else found.member() or garment
        for garment, found in zip(garments, searches, strict=True)
    ]


def likely_members(contour: Array, garments: Sequence[GarmentOutline], cost: float) -> list[MemberOutline]:
    """Return the members of the garments whose starts are nearest to an observed boundary (n, 2) [m]. cost: of the
    starts, at most, relative to that of the nearest."""
    contour = counter_clockwise(contour)
    searches = [found for garment in garments if (found := _search(contour, garment)) is not None]
    most = cost * min((found.costs[0] for found in searches), default=0.0)
    members = [found.member() for found in searches if found.costs[0] <= most]
    return [member for member in members if member is not None]


def _search(contour: Array, garment: GarmentOutline) -> _Search | None:
    """Return the starts from which the member of a garment is sought; None if the garment stays as it is."""
    family = FAMILIES.get(garment.category)
    template = np.asarray(garment.template, dtype=float)
    if family is None or not _has_joints(garment, family):
        return None
    scale = float(np.sqrt(polygon_area(contour) / abs(polygon_area(template))))
    outline = contour / scale
    boundary = Boundary(outline, step=0.003, sample_step=0.015)
    overlap = max(polygon_iou(start.polygon, outline) for start in best_starts(template, boundary, 2))
    if overlap > _NEEDLESS:
        return None
    size = float(np.sqrt(polygon_area(outline)))
    model = _Model(family, garment.keypoints, _vertices(garment.keypoints, family))
    starts = _starts(model, template, boundary)
    costs = [_cost(model, p, boundary, size) for p in starts]
    order = np.argsort(costs, kind="stable")[:_TRIED]
    nearest, least = [starts[k] for k in order], [costs[k] for k in order]
    return _Search(garment, model, boundary, outline, scale, size, overlap, nearest, least)


@dataclass(frozen=True, eq=False)
class _Search:
    """What the search for a garment's member starts from. outline: (n, 2) the observed boundary, in the template's
    size, which is smaller by `scale`. size: square root of its area. overlap: of the template as it is. starts:
    parameters, nearest first, with their costs."""

    garment: GarmentOutline
    model: _Model
    boundary: Boundary
    outline: Array
    scale: float
    size: float
    overlap: float
    starts: list[Array]
    costs: list[float]

    def member(self) -> MemberOutline | None:
        """Return the member that fits best; None if the template fits better."""
        model, boundary, size = self.model, self.boundary, self.size

        def cost(p: Array) -> float:
            crossed = crosses_itself(model.polygon(p))
            return _cost(model, p, boundary, size) * (_CROSSED if crossed else 1.0)

        fits = [_fitted(model, p, boundary, size, range(_FIRST_STEPS)) for p in self.starts]
        fits = sorted(fits, key=cost)
        if model.family.either_way:  # the best of each way
            fits = [fits[0], *(p for p in fits if np.cos(p[2] - fits[0][2]) < -0.5)]
        fits = [_fitted(model, p, boundary, size, range(_FIRST_STEPS, _STEPS)) for p in fits[:_KEPT]]
        chosen, *others = sorted(fits, key=cost)
        # A squared deviation costs `_PRIOR_COST`, and half of it is a negative log likelihood.
        ahead = [cost(p) - cost(chosen) for p in others if np.cos(p[2] - chosen[2]) < -0.5]
        turned = float(expit(-0.5 * min(ahead) / _PRIOR_COST)) if ahead else 0.0
        polygon, names = model.polygon(chosen), self.garment.keypoints
        if polygon_iou(polygon, self.outline) <= self.overlap:
            return None
        return MemberOutline(
            self.garment.name,
            self.garment.category,
            names,
            model.template(chosen),
            self.scale * polygon,
            np.array([names.index(name) if name in names else -1 for name in model.vertices]),
            _unusual(model.prior(chosen)),
            _unusual(model.deviations(chosen)[0]),
            turned,
        )


def _unusual(deviations: Array) -> float:
    """Return the mean square of deviations (r,) [standard deviations], none of which counts for too much."""
    return float(np.minimum(deviations**2, _MOST_COUNTED).mean())


def _has_joints(garment: GarmentOutline, family: Family) -> bool:
    names = {_without_side(name, family) for name in garment.keypoints}
    return names == {joint.point for joint in family.joints if not joint.before}


def _vertices(keypoints: tuple[str, ...], family: Family) -> tuple[str, ...]:
    """Return the key points with the bends between them."""
    found: list[str] = []
    for name, after in zip(keypoints, (*keypoints[1:], keypoints[0]), strict=True):
        a, b = (_without_side(n, family) for n in (name, after))
        side = "".join(f"_{s}" for s in family.sides if name.endswith(f"_{s}") or after.endswith(f"_{s}"))
        found.append(name)
        for one, other, step in ((a, b, 1), (b, a, -1)):
            bends = [j.point for j in family.joints if j.before == other and j.origin == one]
            found += [f"{bend}{side}" for bend in bends[::step]]
        found += [j.point for j in family.joints if a == b == j.before and j.fixed]
    return tuple(found)


def _without_side(name: str, family: Family) -> str:
    stem, _, side = name.rpartition("_")
    return stem if side in family.sides else name


@dataclass(frozen=True, eq=False)
class _Model:
    """A family for one order of key points. vertices: those of the outline, which are the key points and the
    bends. Its parameters are the pose (x, y, turn, shear across the axis), and for each joint the logarithm of its
    length and its angle [rad], twice for a limb.
    """

    family: Family
    keypoints: tuple[str, ...]
    vertices: tuple[str, ...]

    @property
    def basis(self) -> Array:
        """(2, 2): axis and direction to the first half, as rows."""
        return np.array([self.family.u, self.family.v])

    def polygon(self, p: Array) -> Array:
        """Return the outline (..., k, 2) of the members with the parameters (..., n), placed."""
        c, s = np.cos(p[..., 2, None]), np.sin(p[..., 2, None])
        laid = self.laid(p)
        u, v = self.basis
        x, y = np.moveaxis(laid + (p[..., 3, None] * (laid @ u))[..., None] * v, -1, 0)
        return np.stack([c * x - s * y + p[..., 0, None], s * x + c * y + p[..., 1, None]], axis=-1)

    def laid(self, p: Array) -> Array:
        """Return the outline (..., k, 2) in the laid pose, with the origin in the middle of the first points."""
        halves = [self._half(p, side) for side in (0, 1)]
        found = []
        for name in self.vertices:
            side = int(name.rpartition("_")[2] == self.family.sides[1])
            found.append(halves[side][_without_side(name, self.family)] * (1, 1 - 2 * side))
        return np.stack(found, axis=-2) @ self.basis

    def _half(self, p: Array, side: int) -> dict[str, Array]:
        """Return the places (..., 2), along the axis and outwards, of the points of one half."""
        at, places, turns = _POSE, {"": np.zeros(2)}, dict[str, Array]()
        for joint in self.family.joints:
            angle = p[..., at + 1 + (side if joint.limb else 0)] + turns.get(joint.after, 0.0)
            turns[joint.point] = angle
            arm = np.exp(p[..., at, None]) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            places[joint.point] = places[joint.origin] + arm
            at += 3 if joint.limb else 2
        return places

    def measured(self, laid: Array) -> Array:
        """Return the parameters of an outline (k, 2) in the laid pose. Unequal halves are averaged, except for the
        directions of limbs."""
        index = {name: k for k, name in enumerate(self.keypoints)}
        first = self.family.joints[0].point
        middle = 0.5 * sum(laid[index[f"{first}_{side}"]] for side in self.family.sides)
        halves: list[dict[str, Array]] = []
        for sign, side in zip((1.0, -1.0), self.family.sides, strict=True):
            half = {"": np.zeros(2)}
            for joint in self.family.joints:
                n = joint.point
                if not joint.before:
                    place = laid[index[f"{n}_{side}" if f"{n}_{side}" in index else n]] - middle
                    half[n] = (place @ self.basis.T) * (1.0, sign)
            half |= {joint.point: self._on_edge(joint, half) for joint in self.family.joints if joint.before}
            halves.append(half)
        p = [*middle, 0.0, 0.0]
        turns: dict[str, tuple[float, float]] = {"": (0.0, 0.0)}
        for joint in self.family.joints:
            apart = [half[joint.point] - half[joint.origin] for half in halves]
            turns[joint.point] = (_direction(apart[0]), _direction(apart[1]))
            angles = [a - b for a, b in zip(turns[joint.point], turns[joint.after], strict=True)]
            angles = [_near(a, np.deg2rad(np.mean(joint.angle))) for a in angles]
            p.append(float(np.log(max(np.mean([np.linalg.norm(d) for d in apart]), 1e-3))))
            p += angles if joint.limb else [float(np.mean(angles))]
        return np.array(p)

    def deeper(self, p: Array) -> Array:
        """Return the parameters with armpits at the depth of the family, and shoulders where they are."""
        deep = p.copy()
        armpit, shoulder = _POSE + 2, _POSE + 6
        deep[armpit] = np.log(self.family.depth * self.length(p))
        deep[shoulder] = np.log(np.exp(p[shoulder]) + np.exp(p[armpit]) - np.exp(deep[armpit]))
        return deep

    def length(self, p: Array) -> float:
        """Return the garment's length."""
        return float(self._half(p, 0)[self.family.end][0])

    def _on_edge(self, bend: Joint, half: Mapping[str, Array]) -> Array:
        """Return the place (..., 2) of a bend on a straight edge, on which the bends are spaced evenly."""
        if bend.fixed:
            return half[bend.before] * (1.0, 0.0)
        row = [b.point for b in self.family.joints if (b.origin, b.before) == (bend.origin, bend.before)]
        share = (row.index(bend.point) + 1) / (len(row) + 1)
        return (1.0 - share) * half[bend.origin] + share * half[bend.before]

    def template(self, p: Array) -> Array:
        """Return the key points (k, 2) in the laid pose, centred on 0."""
        points = self.laid(p)[[name in self.keypoints for name in self.vertices]]
        return np.asarray(points - 0.5 * (points.min(axis=0) + points.max(axis=0)))

    def prior(self, p: Array) -> Array:
        """Return the residuals (..., r) of the parameters (..., n)."""
        return np.concatenate(self.deviations(p), axis=-1)

    def deviations(self, p: Array) -> tuple[Array, Array]:
        """Return two groups of residuals (..., r). The first is that of the proportions: of the figures from the
        middles of their ranges and from the ranges, of the sides from each other, and of points across the axis.
        The second is that of how the cloth lies: the shear, and the bends from a straight edge."""
        half, other, at = self._half(p, 0), self._half(p, 1), _POSE
        size = np.maximum(half[self.family.end][..., :1], 1e-3)
        found: list[Array] = []
        lie = [p[..., 3, None] / self.family.shear]
        for joint in self.family.joints:
            figures = [(p[..., at, None] - np.log(size), np.log(joint.length))]
            if not joint.fixed:
                figures.append((p[..., at + 1 : at + (3 if joint.limb else 2)], np.deg2rad(joint.angle)))
            for values, span in figures:
                found.append((values - np.clip(values, *span)) / _RANGE_SIGMA)
                if not (joint.limb or joint.before):
                    found.append((values - np.mean(span)) / (_USUAL_SHARE * (span[1] - span[0])))
            if joint.fixed:
                found.append((p[..., at + 1, None] - np.deg2rad(joint.angle[0])) / _FIXED_SIGMA)
            else:
                out = np.concatenate([h[joint.point][..., 1:] for h in (half, other)], axis=-1) / size
                found.append((out - np.maximum(out, _LEAST_OUT)) / (_RANGE_SIGMA * _LEAST_OUT))
            if joint.limb:
                found.append((p[..., at + 1, None] - p[..., at + 2, None]) / _SIDE_SIGMA)
            if joint.before:
                lie.append((half[joint.point] - self._on_edge(joint, half)) / (_BEND_SIGMA * size))
            at += 3 if joint.limb else 2
        for corner in self.family.corners:
            a, b, c = (half[name] for name in corner.points)
            lengths = np.linalg.norm(b - a, axis=-1) * np.linalg.norm(c - b, axis=-1)
            cosine = ((b - a) * (c - b)).sum(axis=-1) / np.maximum(lengths, 1e-9)
            turn = np.arccos(np.clip(cosine, -0.999, 0.999))[..., None]
            found.append((turn - np.clip(turn, *np.deg2rad(corner.turn))) / _RANGE_SIGMA)
        return np.concatenate(found, axis=-1), np.concatenate(lie, axis=-1)


def _direction(v: Array) -> float:
    return float(np.arctan2(v[1], v[0]))


def _near(angle: float, other: float) -> float:
    """Return the angle plus the turns that bring it nearest to the other one [rad]."""
    return float(other + (angle - other + np.pi) % (2.0 * np.pi) - np.pi)


def _starts(model: _Model, template: Array, boundary: Boundary) -> list[Array]:
    """Return the parameters from which the fit starts: the template, and the same with its limbs in other
    directions and of other lengths, each placed in its most plausible orientations."""
    own = model.measured(template)
    shapes, at = [own], _POSE
    for joint in model.family.joints:
        if joint.limb:
            for angle in model.family.limb_angles:
                for length in model.family.limb_lengths:
                    shape = own.copy()
                    shape[at] = np.log(length * model.length(own))
                    shape[at + 1 : at + 3] = np.deg2rad(angle)
                    shapes.append(shape)
        at += 3 if joint.limb else 2
    starts, turns = [], _edge_turns(boundary.points)
    middle = 0.5 * (boundary.points.min(axis=0) + boundary.points.max(axis=0))
    for shape in shapes:
        outline = model.template(shape)
        if polygon_area(outline) <= 0.0:
            continue
        for start in best_starts(outline, boundary, 2, turns):
            upright = model.measured(start.polygon @ rotation(start.angle))
            upright[:2] = rotation(start.angle) @ upright[:2]
            upright[2] = start.angle
            starts += [upright, model.deeper(upright)] if model.family.depth > 0.0 else [upright]
            if model.family.either_way:
                starts.append(np.array([*(2.0 * middle - upright[:2]), upright[2] + np.pi, *upright[3:]]))
    return starts


def _edge_turns(points: Array) -> list[float]:
    """Return the four directions [rad] along and across which most of a boundary (n, 2) runs, as hem and sides do.
    A garment that is about as wide as long has no clear long axis."""
    along = np.roll(points, -1, axis=0) - points
    tried = np.deg2rad(np.arange(0.0, 90.0, 3.0))
    off = np.arctan2(along[:, 1], along[:, 0]) - tried[:, None]
    runs = (np.linalg.norm(along, axis=1) * np.exp((np.cos(4.0 * off) - 1.0) * _SHARPNESS)).sum(axis=1)
    return [float(tried[np.argmax(runs)]) + 0.5 * np.pi * k for k in range(4)]


def _fitted(model: _Model, p: Array, boundary: Boundary, size: float, steps: Sequence[int]) -> Array:
    """Return the parameters after some Gauss-Newton steps."""
    change = 1e-5 * np.vstack([np.zeros(len(p)), np.eye(len(p))])
    for step in steps:
        shapes, priors = model.polygon(p + change), model.prior(p + change)
        X, prior = shapes[0], priors[0]
        if polygon_area(X) <= 0.0:
            return p
        dX, P = (shapes[1:] - X) / 1e-5, ((priors[1:] - prior) / 1e-5).T
        r, normal, segment, t = _residuals(X, boundary)
        after = (segment + 1) % len(X)
        moves = (1.0 - t)[:, None] * dX[:, segment] + t[:, None] * dX[:, after]
        J = (moves * normal).sum(axis=2).T
        scale = size * max(_SCALE * 0.85**step, _LAST_SCALE)
        w = np.clip(1.0 - (r / scale) ** 2, 0.0, None) ** 2 / (size * _DATA_SIGMA) ** 2
        A = (J * w[:, None]).T @ J + P.T @ P
        g = (J * w[:, None]).T @ r + P.T @ prior
        A[np.diag_indices_from(A)] *= 1.02
        p = p - np.clip(np.linalg.solve(A + 1e-6 * np.eye(len(p)), g), -0.25, 0.25)
    return p


def _residuals(X: Array, boundary: Boundary) -> tuple[Array, Array, Array, Array]:
    """Return distances (m,), their directions (m, 2), and the places on the outline X (k, 2): edge (m,) and place
    on it (m,). First those of the places on X from the boundary, then those of the boundary's samples from X."""
    edge = np.repeat(np.arange(len(X)), _SAMPLES)
    t = np.tile((np.arange(_SAMPLES) + 0.5) / _SAMPLES, len(X))
    along = np.roll(X, -1, axis=0) - X
    q = X[edge] + t[:, None] * along[edge]
    outwards = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    _, _, on_boundary = closest_segments(boundary.samples, q, outwards[edge])
    segment, place, on_model = closest_segments(X, boundary.samples, boundary.sample_normals)
    away = np.concatenate([q - on_boundary, on_model - boundary.samples])
    far = np.linalg.norm(away, axis=1)
    normals = np.where(
        far[:, None] > 1e-4,
        away / np.maximum(far, 1e-9)[:, None],
        np.concatenate([outwards[edge], boundary.sample_normals]),
    )
    return far, normals, np.concatenate([edge, segment]), np.concatenate([t, place])


def _cost(model: _Model, p: Array, boundary: Boundary, size: float) -> float:
    """Mean of the truncated distances in both directions, relative to the size of the garment, and the prior."""
    X = model.polygon(p)
    if polygon_area(X) <= 0.0:
        return np.inf
    r = np.minimum(np.abs(_residuals(X, boundary)[0]), 0.2 * size)
    k = len(X) * _SAMPLES
    return float(r[:k].mean() + r[k:].mean()) / size + _PRIOR_COST * float((model.prior(p) ** 2).sum())
