"""The paper's stretch test: a real and a virtual garment hang by one point.

The operator hangs the garment and measures L1 from the clip to the lowest point. Then the operator lays it down,
spreads the same two points as far apart as they go and measures L2. The stretch is (L1 - L2) / L2 (Li et al. 2015,
IV-A). The virtual garment hangs in the same way, and its stiffness is changed until its elongation matches.

A garment that hangs by a clip stretches more than a strip of its fabric that hangs by a whole edge, because all of
the weight passes through the clip. The fabric is therefore described by the *hang drop*: the length of a strip
that elongates as much when it hangs by its edge as this garment does when it hangs by the clip. (A strip of length
L and membrane modulus Y [N/m] elongates by areal_mass g L / (2 Y).)

Two other things also affect the elongation. First, the cloth beside the hanging line can fall in different shapes,
which changes the elongation by up to 0.15 percentage points between starts. The mean of three hangs is therefore
taken, as an operator would do. Second, the mesh changes it by the same amount: the stress near the clip is steep,
and coarse triangles are too stiff there (MuJoCo's flex on the same mesh agrees). The test therefore uses the mesh
of the prediction, as in the paper.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array, frozen
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.vocabulary import REFERENCE_DROP, Material

CLIP = 0.04
"""Width of the clip (or of the fingers) that holds the garment [m]."""
WIDEST_CLIP = 1.5 * CLIP
"""Largest width that one clip can hold [m]."""
EDGE = 0.020
"""Default edge length of the virtual garment's mesh [m]."""
SUBSTEPS = 40
"""Substeps per frame. With the smaller number that the predictor uses, the elongation changes by up to 0.1
percentage points, which is less than the difference between starts."""
DRAG = 4.0
"""Air drag [1/s]. It quickly brings the garment to rest and does not change its final length."""
SETTLE_S = 4.0
"""Time from the flat start until the garment is at rest [s]."""
RIPPLES = ((40.0, 0.0), (25.0, 1.0), (60.0, 2.0))
"""For each hang: wave number [1/m] and phase [rad] of the ripple of its initial shape. The amplitude is 1 mm."""
MIN_STRETCH, MAX_STRETCH = 0.002, 0.10
TOLERANCE, ACCEPTED, MAX_FABRICS = 2e-4, 5e-4, 16
"""TOLERANCE: the search ends when the error of the elongation is smaller than this (0.02 percentage points).
ACCEPTED: largest error of an accepted result (0.05 percentage points). MAX_FABRICS: largest number of fabrics to
try. ACCEPTED is larger than TOLERANCE, because two layers that hang against each other can settle in several
shapes: a change of the stiffness by one per cent then changes the elongation by 0.1 percentage points or not at
all."""
NEAR = 0.1
"""A tried fabric is used to estimate the local slope if its relative error of the elongation is below this."""
DISTINCT = 3e-3
"""A new fabric is tried only if its strip elongation differs from that of every tried fabric by more than this
fraction."""
NO_WIDER = 2e-4
"""A bracket of two fabrics around the wanted elongation is halved only while its relative width exceeds this."""
BESIDE = 1.0 + 0.012 * np.array([1.0, -1.0, 2.0, -2.0, 3.0, -3.0])
"""A strip elongation times one of these factors gives a neighbouring fabric. The search tries neighbours last."""
STIFFEST, LIMPEST = 2e-4, 0.4
"""Smallest and largest strip elongation in the search."""


def stretch_fraction(l1: float, l2: float) -> float:
    """Return (L1 - L2) / L2 for the hung length L1 [m] and the laid length L2 [m].

    Raises ConfigurationError for a length outside 0.05 to 3 m or a stretch outside 0.2 to 10 %.
    """
    for name, value in (("L1", l1), ("L2", l2)):
        if not (np.isfinite(value) and 0.05 <= value <= 3.0):
            raise ConfigurationError(
                f"no garment has {name} = {value:g} m", "give metres, from 0.05 to 3", **{name: value}
            )
    fraction = (l1 - l2) / l2
    if not MIN_STRETCH <= fraction <= MAX_STRETCH:
        raise ConfigurationError(
            f"L1 = {l1:g} m and L2 = {l2:g} m are a stretch of {100 * fraction:.2f} %;"
            f" {100 * MIN_STRETCH:g} to {100 * MAX_STRETCH:g} % can be calibrated",
            "L1 is the length of the hanging garment and exceeds L2; measure both to a millimetre",
            l1=l1, l2=l2, stretch_fraction=fraction,
        )  # fmt: skip
    return fraction


@dataclass(frozen=True, eq=False)
class HungShape:
    """A virtual garment before it hangs. clip: (n,) whether the clip holds a vertex; lowest: index of the vertex
    that hangs lowest; rest_length: distance between clip and lowest vertex in the flat garment [m]; starts: (k, n,
    3) initial positions of the k hangs [m]."""

    mesh: ClothMesh
    clip: NDArray[np.bool_]
    lowest: int
    rest_length: float
    starts: Array

    def length(self, positions: Array) -> float:
        """Return the length that the operator measures as L1: distance from the middle of the clip to the lowest
        point [m]. positions: (n, 3)."""
        return float(np.linalg.norm(positions[self.clip].mean(axis=0) - positions[self.lowest]))

    def elongation(self, positions: Array) -> float:
        return self.length(positions) / self.rest_length - 1.0


@dataclass(frozen=True, eq=False)
class ShearCalibration:
    """Result of the stretch test. stretch_fraction: the measured stretch. hang_drop: length of the strip that
    elongates as much [m]. simulated: mean elongation in the hangs of the virtual garment; spread: largest minus
    smallest of these elongations. l2: laid length of the virtual garment [m]. simulations: number of simulated
    hangs. shape, pictures (k, n, 3), times (k,) [s]: the last hang, for the report."""

    stretch_fraction: float
    hang_drop: float
    simulated: float
    spread: float
    l2: float
    simulations: int
    shape: HungShape
    pictures: Array
    times: Array

    @property
    def strip_stretch(self) -> float:
        """Elongation of a strip of this fabric with length REFERENCE_DROP. It is stored as
        `Material.stretch_fraction`."""
        return self.stretch_fraction * REFERENCE_DROP / self.hang_drop


def clip_and_lowest(template: Array, keypoints: tuple[str, ...], held: str | None = None) -> tuple[int, int]:
    """Return the indices into `template` (k, 2) of the point that the clip holds and of the lowest point.

    They are the two key points with the longest straight line between them that lies inside the garment, because
    the cloth along this line hangs straight. held: name of the key point in the clip; default: the point that
    comes first in the file. Raises ConfigurationError for an unknown key point.
    """
    if held is not None and held not in keypoints:
        raise ConfigurationError(
            f"{held!r} is not a key point of this garment", f"its key points are {', '.join(keypoints)}"
        )
    polygon = shapely.Polygon(template).buffer(1e-6)
    best, pair = 0.0, (-1, -1)
    for i in range(len(template)) if held is None else (keypoints.index(held),):
        for j in range(len(template)):
            line = shapely.LineString([template[i], template[j]])
            if line.length > best + 1e-9 and polygon.covers(line):
                best, pair = line.length, (i, j)
    return pair


def hung_shape(
    template: Array, pair: tuple[int, int], layers: int, thickness: float, edge: float = EDGE
) -> HungShape:
    """Return the garment of outline `template` (k, 2) [m], flat and upright, held by a clip at point pair[0].
    pair: indices as returned by `clip_and_lowest`."""
    outline, height = _clipped(template, pair)
    mesh = mesh_from_contour(outline, edge, layers)
    clip = np.zeros(len(mesh.rest), dtype=bool)
    clip[mesh.border] = mesh.rest[mesh.border, 1] > height - 1e-6
    lowest = int(np.argmin(np.linalg.norm(mesh.rest, axis=1)))
    middle = mesh.rest[clip].mean(axis=0)
    starts = []
    for wave, phase in RIPPLES:  # a ripple decides early to which side the flanks fall
        ripple = 0.001 * np.sin(wave * mesh.rest[:, 0] + phase) + thickness * (mesh.layer - 0.5)
        starts.append(np.column_stack([mesh.rest[:, 0], ripple, mesh.rest[:, 1] + 0.2]))
    rest_length = float(np.linalg.norm(middle - mesh.rest[lowest]))
    return HungShape(mesh, frozen(clip), lowest, rest_length, frozen(np.array(starts)))


def clip_width(template: Array, pair: tuple[int, int]) -> float:
    """Return the width of the cloth in a clip at point pair[0] [m]. It is CLIP if the garment is narrow at this
    point, and more if the cloth beside the point is as high as the point."""
    outline, height = _clipped(template, pair)
    return float(np.ptp(outline[outline[:, 1] > height - 1e-6, 0]))


def _check_clip(template: Array, keypoints: tuple[str, ...], pair: tuple[int, int]) -> None:
    """Check that one clip can hold the point pair[0]. Raises ConfigurationError if it cannot; the hint lists the
    points that a clip can hold."""
    width = clip_width(template, pair)
    if width <= WIDEST_CLIP:
        return
    pairs = [clip_and_lowest(template, keypoints, name) for name in keypoints]
    fit = [keypoints[p[0]] for p in pairs if p[1] >= 0 and clip_width(template, p) <= WIDEST_CLIP]
    raise ConfigurationError(
        f"the garment cannot hang by {keypoints[pair[0]]}: {width:.2f} m of cloth beside it are as high",
        f"hang it by {', '.join(fit)}" if fit else "one clip cannot hold any key point of this garment alone",
        held=keypoints[pair[0]], width_m=width,
    )  # fmt: skip


def _clipped(template: Array, pair: tuple[int, int]) -> tuple[Array, float]:
    """Return the outline below the clip, and the height of the clip, with pair[0] straight above pair[1], which is
    the origin. The clip is at the highest place where the garment is CLIP wide."""
    along = template[pair[0]] - template[pair[1]]
    top = float(np.linalg.norm(along))
    up = along / top
    across = np.array([-up[1], up[0]])
    polygon = shapely.Polygon((template - template[pair[1]]) @ np.column_stack([across, up]))
    x0, _, x1, _ = polygon.bounds
    low, high = top - 0.15, top - 1e-4
    for _ in range(40):
        z = 0.5 * (low + high)
        cut = shapely.LineString([(x0 - 1.0, z), (x1 + 1.0, z)])
        if shapely.intersection(polygon, cut).length > CLIP:
            low = z
        else:
            high = z
    below = shapely.clip_by_rect(polygon, x0 - 1.0, polygon.bounds[1] - 1.0, x1 + 1.0, low)
    parts = [p for p in shapely.get_parts(below) if isinstance(p, shapely.Polygon)]
    return np.asarray(max(parts, key=lambda p: p.area).exterior.coords)[:-1], low


def hang(
    shape: HungShape,
    material: Material,
    seconds: float,
    start: int = 0,
    substeps: int | None = SUBSTEPS,
    pictures: int = 0,
) -> tuple[Array, Array]:
    """Simulate `seconds` of hanging from one of the initial shapes. Returns the final positions (n, 3) and
    `pictures` shapes during the motion (k, n, 3).

    material.stretch_fraction: stretch of a strip of length REFERENCE_DROP. start: index into shape.starts.
    substeps: number per frame; None: the predictor's number.
    """
    settings = SolverSettings(substeps=substeps, drag=DRAG, sleep_frames=0)
    simulation = ClothSimulation(
        shape.mesh, material, shape.starts[start], settings, table=False, fixed=shape.clip
    )
    frames = max(1, round(seconds * settings.frame_rate))
    bounds = np.unique(np.linspace(0, frames, max(pictures, 2), dtype=int))
    taken = [simulation.positions]
    for step in np.diff(bounds):
        simulation.advance(int(step))
        taken.append(simulation.positions)
    return taken[-1], np.array(taken if pictures else taken[:0])


def elongations(
    shape: HungShape, material: Material, substeps: int | None = SUBSTEPS, pictures: int = 0
) -> tuple[Array, Array]:
    """Return the elongations (k,) of the hangs from all starts, and `pictures` shapes of the last hang."""
    found, shots = [], np.zeros((0, 0, 3))
    for start in range(len(shape.starts)):
        last = start == len(shape.starts) - 1
        end, shots = hang(shape, material, SETTLE_S, start, substeps, pictures if last else 0)
        found.append(shape.elongation(end))
    return np.array(found), shots


def calibrate_shear(
    template: Array,
    keypoints: tuple[str, ...],
    layers: int,
    material: Material,
    l1: float,
    l2: float,
    held: str | None = None,
    size_range: tuple[float, float] = (0.8, 1.2),
    tell: Callable[[str], None] = lambda line: None,
    edge: float = EDGE,
) -> ShearCalibration:
    """Find the hang drop with which the virtual garment elongates like the real one, which is by (L1 - L2) / L2.

    template: (k, 2) outline [m] at nominal size; it is scaled to the laid length l2. edge: mesh edge [m],
    preferably the edge with which this garment's folds are predicted. Raises ConfigurationError if l2 does
    not fit the garment, if the garment cannot hang by that point, or if the stretch cannot be reached.
    """
    wanted = stretch_fraction(l1, l2)
    pair = clip_and_lowest(template, keypoints, held)
    nominal = float(np.linalg.norm(template[pair[0]] - template[pair[1]]))
    scale = l2 / nominal
    if not size_range[0] <= scale <= size_range[1]:
        names = keypoints[pair[0]], keypoints[pair[1]]
        raise ConfigurationError(
            f"L2 = {l2:g} m, but {names[0]} and {names[1]} of this garment are {nominal:.3f} m apart",
            f"give {size_range[0] * nominal:.3f} to {size_range[1] * nominal:.3f} m; hang it by {names[0]}",
            l2=l2, nominal_m=nominal,
        )  # fmt: skip
    _check_clip(scale * template, keypoints, pair)
    shape = hung_shape(scale * template, pair, layers, material.thickness, edge)
    hung, fabrics = _search(shape, material, wanted, tell)
    if abs(hung.elongation - wanted) > ACCEPTED:
        reached = 100 * hung.elongation
        raise ConfigurationError(
            f"no stiffness of the virtual garment gives {100 * wanted:.2f} %; the nearest is {reached:.2f} %",
            _advice(hung.strip),
            wanted=wanted, reached=hung.elongation,
        )  # fmt: skip
    return ShearCalibration(
        stretch_fraction=wanted,
        hang_drop=wanted * REFERENCE_DROP / hung.strip,
        simulated=hung.elongation,
        spread=float(np.ptp(hung.hangs)),
        l2=shape.rest_length,
        simulations=fabrics * len(hung.hangs),
        shape=shape,
        pictures=frozen(hung.pictures),
        times=frozen(np.linspace(0.0, SETTLE_S, len(hung.pictures))),
    )


def _advice(strip: float) -> str:
    """Return the hint for a search that failed. strip: strip elongation of the nearest fabric."""
    if strip <= STIFFEST:
        return "the simulation resolves no stiffer cloth on this mesh: measure again, or hang it by another point"
    if strip >= LIMPEST:
        return "no cloth is so stretchy: measure again"
    return "the garment settles in different ways: hang it by another point"


@dataclass(frozen=True, eq=False)
class _Hung:
    """A tried fabric. strip: elongation of a strip of it; hangs: (k,) elongations of the garment; pictures: shapes
    during the last hang."""

    strip: float
    hangs: Array
    pictures: Array

    @property
    def elongation(self) -> float:
        return float(self.hangs.mean())


def _search(shape: HungShape, material: Material, wanted: float, tell: Callable[[str], None]) -> tuple[_Hung, int]:
    """Find the fabric with which the garment's elongation is closest to `wanted`. Returns this fabric and the
    number of fabrics tried."""
    strip, best = wanted / 2.0, None
    tried: list[tuple[float, float]] = []
    for _ in range(MAX_FABRICS):
        hung = _Hung(strip, *elongations(shape, replace(material, stretch_fraction=strip), pictures=121))
        got = hung.elongation
        tried.append((strip, got))
        tell(f"strip stretch {100 * strip:.3f} %: the garment elongates {100 * got:.2f} % of {100 * wanted:.2f} %")
        if best is None or abs(got - wanted) < abs(best.elongation - wanted):
            best = hung
        following = _next(tried, wanted)
        if abs(got - wanted) < TOLERANCE or following is None or following == strip:  # at a limit
            break
        strip = following
    assert best is not None
    return best, len(tried)


def _within_jump(near: list[tuple[float, float]], wanted: float) -> float | None:
    """Return the middle of the narrowest bracket; None if there is no bracket or if it is narrower than NO_WIDER.

    A bracket is a pair of neighbouring tried fabrics, one with too little and one with too much elongation. If the
    elongation jumps between them, a fabric in the middle settles in one shape from some starts and in another
    shape from the other starts. Its mean elongation is then also in the middle.
    """
    rising = sorted(near)
    crossing = [
        (b[0] - a[0], 0.5 * (a[0] + b[0]))
        for a, b in itertools.pairwise(rising)
        if (a[1] - wanted) * (b[1] - wanted) < 0.0
    ]
    width, middle = min(crossing, default=(0.0, 0.0))
    return middle if width > NO_WIDER * middle else None


def _next(tried: list[tuple[float, float]], wanted: float) -> float | None:
    """Return the next strip elongation to try; None if all candidates were tried.

    tried: pairs (strip elongation, garment elongation). The second is nearly proportional to the first.

    If two or more tried fabrics are near the wanted elongation, each of them gives a ratio of the two elongations,
    and a ratio gives a candidate. The candidates are, in this order: (1) from the mean ratio; (2) the middle of a
    bracket at a jump (`_within_jump`); (3) from each single ratio, nearest fabric first; (4) the neighbours of
    (1). If fewer fabrics are near, the only candidate is a secant step on the logarithms.
    """
    near = sorted((t for t in tried if abs(t[1] / wanted - 1.0) < NEAR), key=lambda t: abs(t[1] - wanted))
    if len(near) > 1:
        ratios = [got / strip for strip, got in near]
        mean = float(np.mean(ratios))
        candidates = [float(np.clip(wanted / r, STIFFEST, LIMPEST)) for r in (mean, *ratios, *(mean * BESIDE))]
        new = [s for s in candidates if all(abs(s / t - 1.0) > DISTINCT for t, _ in tried)]
        jump = _within_jump(near, wanted)
        if jump is not None and (not new or new[0] != candidates[0]):
            return jump
        return new[0] if new else None
    strip, got = tried[-1]
    slope = 1.0
    if len(tried) > 1 and tried[-2][0] != strip:
        slope = np.log(max(got, 1e-5) / max(tried[-2][1], 1e-5)) / np.log(strip / tried[-2][0])
        slope = float(np.clip(slope, 0.4, 1.5))
    step = np.clip(np.log(wanted / max(got, 1e-5)) / slope, -1.0, 1.0)
    return float(np.clip(strip * np.exp(step), STIFFEST, LIMPEST))
