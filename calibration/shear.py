"""The paper's stretch test: a garment hung by one point, real and virtual.

The operator hangs the garment and measures L1 from the clip to the lowest point, lays it down with both points
spread as far as they go and measures L2; its stretch is (L1 - L2) / L2 (Li et al. 2015, IV-A). The virtual
garment is hung likewise and its stiffness is changed until it elongates as much.

A garment that hangs by a clip stretches more than a strip of its fabric that hangs by a whole edge: all of the
weight goes through the clip. The fabric is therefore named by the *hang drop*: the length of the strip that,
hung by its edge, elongates as much as this garment does by its clip (a strip: areal_mass g L / (2 Y)).

Two things decide the elongation besides the fabric. How the flanks fall: from one start or another by up to
0.15 percentage points, so that the mean of three hangs is taken, as an operator would. And the mesh, by as much
again: round the clip the stress is steep, and coarse triangles are too stiff there (MuJoCo's flex on the same mesh
says the same). The test is therefore made on the mesh that predicts, as in the paper.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from robots.errors import ConfigurationError
from robots.ports import Array, frozen
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.settings import SolverSettings
from skills.cloth.solver import ClothSimulation
from skills.vocabulary import REFERENCE_DROP, Material

__all__ = [
    "WIDEST_CLIP",
    "HungShape",
    "ShearCalibration",
    "calibrate_shear",
    "clip_and_lowest",
    "clip_width",
    "elongations",
    "hang",
    "hung_shape",
    "stretch_fraction",
]

CLIP = 0.04
"""[m] width of the clip (or of the fingers) that holds the garment."""
WIDEST_CLIP = 1.5 * CLIP
"""[m] as far apart as the ends of what the clip holds may be: more is not held by one."""
EDGE = 0.020
"""[m] edge length of the virtual garment's mesh, where none is given."""
SUBSTEPS = 40
"""Of a frame: with fewer, as the predictor takes, the elongation is up to 0.1 percentage points more or less, no
more than from start to start."""
DRAG = 4.0
"""[1/s] of the air: enough that the garment hangs still soon. It does not change how long it then is."""
SETTLE_S = 4.0
"""[s] from held up flat until it hangs still."""
RIPPLES = ((40.0, 0.0), (25.0, 1.0), (60.0, 2.0))
"""Wave number [1/m] and phase of the millimetre of ripple with which each hang starts."""
LEAST, MOST = 0.002, 0.10
TOLERANCE, ACCEPTED, TRIES = 2e-4, 5e-4, 16
"""Of the elongation: 0.02 percentage points, at which the search ends, and 0.05, with which it may have to do. Two
layers that hang against each other settle now one way, now another: a per cent of the stiffness then makes 0.1
percentage points or none."""
NEAR = 0.1
"""Tries whose elongation is this near to the wanted one, of it, tell how the garment elongates there."""
DISTINCT = 3e-3
"""Fabrics nearer to each other than this, of their stretch, are one try."""
NO_WIDER = 2e-4
"""Fabrics on either side of the wanted one that differ by less, of their stretch, have nothing between them."""
BESIDE = 1.0 + 0.012 * np.array([1.0, -1.0, 2.0, -2.0, 3.0, -3.0])
STIFFEST, LIMPEST = 2e-4, 0.4


def stretch_fraction(l1: float, l2: float) -> float:
    """(L1 - L2) / L2 of the hung length L1 [m] and the laid length L2 [m].

    Raises ConfigurationError for lengths that no garment has, or a stretch outside 0.2 to 10 %.
    """
    for name, value in (("L1", l1), ("L2", l2)):
        if not (np.isfinite(value) and 0.05 <= value <= 3.0):
            raise ConfigurationError(
                f"{name} = {value:g} m is no length of a garment", "give metres, from 0.05 to 3", **{name: value}
            )
    fraction = (l1 - l2) / l2
    if not LEAST <= fraction <= MOST:
        raise ConfigurationError(
            f"L1 = {l1:g} m and L2 = {l2:g} m are a stretch of {100 * fraction:.2f} %;"
            f" {100 * LEAST:g} to {100 * MOST:g} % can be calibrated",
            "L1 is of the hung garment and longer than L2; measure both to a millimetre",
            l1=l1, l2=l2, stretch_fraction=fraction,
        )  # fmt: skip
    return fraction


@dataclass(frozen=True, eq=False)
class HungShape:
    """A garment ready to hang: mesh; clip: (n,) vertices that the clip holds; lowest: the vertex measured to;
    rest_length: of the straight line between clip and lowest when it lies flat [m]; starts: (k, n, 3) held up."""

    mesh: ClothMesh
    clip: NDArray[np.bool_]
    lowest: int
    rest_length: float
    starts: Array

    def length(self, positions: Array) -> float:
        """From the clip's middle to the lowest point [m]: the operator's L1. positions: (n, 3)."""
        return float(np.linalg.norm(positions[self.clip].mean(axis=0) - positions[self.lowest]))

    def elongation(self, positions: Array) -> float:
        return self.length(positions) / self.rest_length - 1.0


@dataclass(frozen=True, eq=False)
class ShearCalibration:
    """stretch_fraction: measured. hang_drop: [m] of the strip that elongates as much. simulated: elongation of
    the virtual garment with it, mean of its hangs, which differ by `spread` (largest less smallest).
    l2: of the virtual garment [m]. simulations: how many hangs it took.
    shape, pictures (k, n, 3), times (k,) [s]: the last hang, to be shown."""

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
        """Elongation of a REFERENCE_DROP long strip of this fabric: `Material.stretch_fraction`."""
        return self.stretch_fraction * REFERENCE_DROP / self.hang_drop


def clip_and_lowest(template: Array, keypoints: tuple[str, ...], held: str | None = None) -> tuple[int, int]:
    """Indices into `template` (k, 2) of the point to hang by and of the lowest one.

    They are the two farthest key points whose connecting line lies in the garment: the cloth between them hangs
    straight. held: the name of the one to hang by; else the end that comes first in the file.
    Raises ConfigurationError for a name that is no key point.
    """
    if held is not None and held not in keypoints:
        raise ConfigurationError(f"{held!r} is no key point of this garment", f"it has {', '.join(keypoints)}")
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
    """The garment of outline `template` (k, 2) [m], held up by a clip over point pair[0], flat and upright."""
    local = _upright(template, pair)
    outline, height = _clipped(shapely.Polygon(local), float(local[pair[0]][1]))
    mesh = mesh_from_contour(outline, edge, layers)
    clip = np.zeros(len(mesh.rest), dtype=bool)
    clip[mesh.border] = mesh.rest[mesh.border, 1] > height - 1e-6
    lowest = int(np.argmin(np.linalg.norm(mesh.rest, axis=1)))
    middle = mesh.rest[clip].mean(axis=0)
    starts = []
    for wave, phase in RIPPLES:  # so that the flanks fall to one side at once
        ripple = 0.001 * np.sin(wave * mesh.rest[:, 0] + phase) + thickness * (mesh.layer - 0.5)
        starts.append(np.column_stack([mesh.rest[:, 0], ripple, mesh.rest[:, 1] + 0.2]))
    rest_length = float(np.linalg.norm(middle - mesh.rest[lowest]))
    return HungShape(mesh, frozen(clip), lowest, rest_length, frozen(np.array(starts)))


def _upright(template: Array, pair: tuple[int, int]) -> Array:
    """The outline (k, 2) as it hangs: pair[0] straight above pair[1], which is the origin."""
    top, low = template[pair[0]], template[pair[1]]
    up = (top - low) / np.linalg.norm(top - low)
    across = np.array([-up[1], up[0]])
    return np.column_stack([(template - low) @ across, (template - low) @ up])


def clip_width(template: Array, pair: tuple[int, int]) -> float:
    """How wide the clip comes out that holds the outline by point pair[0] [m]: CLIP where the garment has its
    narrow top there; more where the cloth beside the point is as high as it is."""
    local = _upright(template, pair)
    outline, height = _clipped(shapely.Polygon(local), float(local[pair[0]][1]))
    return float(np.ptp(outline[outline[:, 1] > height - 1e-6, 0]))


def _check_clip(template: Array, keypoints: tuple[str, ...], pair: tuple[int, int]) -> None:
    """Raises ConfigurationError for a point that no clip holds alone, with those that one does."""
    width = clip_width(template, pair)
    if width <= WIDEST_CLIP:
        return
    pairs = [clip_and_lowest(template, keypoints, name) for name in keypoints]
    fit = [keypoints[p[0]] for p in pairs if p[1] >= 0 and clip_width(template, p) <= WIDEST_CLIP]
    raise ConfigurationError(
        f"the garment cannot be hung by {keypoints[pair[0]]}: cloth beside it is as high, over {width:.2f} m",
        f"hang it by {', '.join(fit)}" if fit else "no key point of this garment can be held alone",
        held=keypoints[pair[0]], width_m=width,
    )  # fmt: skip


def _clipped(polygon: shapely.Polygon, top: float) -> tuple[Array, float]:
    """The outline below the clip, where the garment is first CLIP wide, and that height."""
    x0, _, x1, _ = polygon.bounds
    low, high = top - 0.15, top - 1e-4
    for _ in range(40):
        z = 0.5 * (low + high)
        if _width(polygon, x0, x1, z) > CLIP:
            low = z
        else:
            high = z
    below = shapely.clip_by_rect(polygon, x0 - 1.0, polygon.bounds[1] - 1.0, x1 + 1.0, low)
    parts = [p for p in shapely.get_parts(below) if isinstance(p, shapely.Polygon)]
    return np.asarray(max(parts, key=lambda p: p.area).exterior.coords)[:-1], low


def _width(polygon: shapely.Polygon, x0: float, x1: float, z: float) -> float:
    return float(shapely.intersection(polygon, shapely.LineString([(x0 - 1.0, z), (x1 + 1.0, z)])).length)


def hang(
    shape: HungShape,
    material: Material,
    seconds: float,
    start: int = 0,
    substeps: int | None = SUBSTEPS,
    pictures: int = 0,
) -> tuple[Array, Array]:
    """Let it hang for `seconds` from one of its starts: positions (n, 3) at the end, and `pictures` of the way
    (k, n, 3).

    material.stretch_fraction is of a strip of REFERENCE_DROP. substeps: of a frame; None: as the predictor would.
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
    """(k,) of the hangs from all starts, and `pictures` of the last one."""
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
    """The hang drop with which the virtual garment elongates as the real one: (L1 - L2) / L2.

    template: (k, 2) outline [m] at nominal size; it is scaled so that its laid length is l2. edge: of the mesh
    [m], best the one that predicts this garment's folds.
    Raises ConfigurationError when l2 does not fit the garment, when it cannot be hung by that point, or when the
    stretch cannot be reached.
    """
    wanted = stretch_fraction(l1, l2)
    pair = clip_and_lowest(template, keypoints, held)
    nominal = float(np.linalg.norm(template[pair[0]] - template[pair[1]]))
    scale = l2 / nominal
    if not size_range[0] <= scale <= size_range[1]:
        names = keypoints[pair[0]], keypoints[pair[1]]
        raise ConfigurationError(
            f"L2 = {l2:g} m, but {names[0]} and {names[1]} of this garment lie {nominal:.3f} m apart",
            f"{size_range[0] * nominal:.3f} to {size_range[1] * nominal:.3f} m fit; hang it by {names[0]}",
            l2=l2, nominal_m=nominal,
        )  # fmt: skip
    _check_clip(scale * template, keypoints, pair)
    shape = hung_shape(scale * template, pair, layers, material.thickness, edge)
    hung, tries = _search(shape, material, wanted, tell)
    if abs(hung.elongation - wanted) > ACCEPTED:
        reached = 100 * hung.elongation
        raise ConfigurationError(
            f"no stiffness of the virtual garment gives {100 * wanted:.2f} %; nearest {reached:.2f} %",
            _advice(hung.strip),
            wanted=wanted, reached=hung.elongation,
        )  # fmt: skip
    return ShearCalibration(
        stretch_fraction=wanted,
        hang_drop=wanted * REFERENCE_DROP / hung.strip,
        simulated=hung.elongation,
        spread=float(np.ptp(hung.hangs)),
        l2=shape.rest_length,
        simulations=tries * len(hung.hangs),
        shape=shape,
        pictures=frozen(hung.pictures),
        times=frozen(np.linspace(0.0, SETTLE_S, len(hung.pictures))),
    )


def _advice(strip: float) -> str:
    """What to do when the nearest fabric, by its strip's elongation, is not near enough."""
    if strip <= STIFFEST:
        return "the simulation resolves no stiffer cloth on this mesh: measure again, or hang it by another point"
    if strip >= LIMPEST:
        return "no cloth is so stretchy: measure again"
    return "it hangs now one way, now another: hang it by another point"


@dataclass(frozen=True, eq=False)
class _Hung:
    """A fabric, by the elongation of its strip, and how it hung."""

    strip: float
    hangs: Array
    pictures: Array

    @property
    def elongation(self) -> float:
        return float(self.hangs.mean())


def _search(shape: HungShape, material: Material, wanted: float, tell: Callable[[str], None]) -> tuple[_Hung, int]:
    """The fabric with which the garment elongates most nearly as wanted, and how many were tried."""
    strip, best = wanted / 2.0, None
    tried: list[tuple[float, float]] = []
    for _ in range(TRIES):
        hung = _Hung(strip, *elongations(shape, replace(material, stretch_fraction=strip), pictures=121))
        got = hung.elongation
        tried.append((strip, got))
        tell(f"strip stretch {100 * strip:.3f} %: the garment elongates {100 * got:.2f} % of {100 * wanted:.2f} %")
        if best is None or abs(got - wanted) < abs(best.elongation - wanted):
            best = hung
        following = _next(tried, wanted)
        if abs(got - wanted) < TOLERANCE or following is None or following == strip:  # at a bound
            break
        strip = following
    assert best is not None
    return best, len(tried)


def _within_jump(near: list[tuple[float, float]], wanted: float) -> float | None:
    """In the middle between two fabrics that hang too little and too much, the nearest of these. They differ
    least there, and what is between hangs from some of its starts in the one way and from some in the other. None
    without such a pair, or when they differ by less than NO_WIDER."""
    rising = sorted(near)
    crossing = [
        (b[0] - a[0], 0.5 * (a[0] + b[0]))
        for a, b in itertools.pairwise(rising)
        if (a[1] - wanted) * (b[1] - wanted) < 0.0
    ]
    width, middle = min(crossing, default=(0.0, 0.0))
    return middle if width > NO_WIDER * middle else None


def _next(tried: list[tuple[float, float]], wanted: float) -> float | None:
    """The next strip's elongation to try. Elongation is nearly proportional to it: as all tries near the wanted
    one say on the mean, then between those on either side of it where it jumps, then as each of them says, the
    nearest first, then beside that; before there are two by a secant on the logarithms. None when all of these
    were tried."""
    near = sorted((t for t in tried if abs(t[1] / wanted - 1.0) < NEAR), key=lambda t: abs(t[1] - wanted))
    if len(near) > 1:
        ratios = [got / strip for strip, got in near]
        mean = float(np.mean(ratios))
        said = [float(np.clip(wanted / r, STIFFEST, LIMPEST)) for r in (mean, *ratios, *(mean * BESIDE))]
        new = [s for s in said if all(abs(s / t - 1.0) > DISTINCT for t, _ in tried)]
        jump = _within_jump(near, wanted)
        if jump is not None and (not new or new[0] != said[0]):
            return jump
        return new[0] if new else None
    strip, got = tried[-1]
    slope = 1.0
    if len(tried) > 1 and tried[-2][0] != strip:
        slope = np.log(max(got, 1e-5) / max(tried[-2][1], 1e-5)) / np.log(strip / tried[-2][0])
        slope = float(np.clip(slope, 0.4, 1.5))
    step = np.clip(np.log(wanted / max(got, 1e-5)) / slope, -1.0, 1.0)
    return float(np.clip(strip * np.exp(step), STIFFEST, LIMPEST))
