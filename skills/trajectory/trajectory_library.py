"""Library of optimised arcs. They are stored in normalised form, with their provenance. An arc that was looked up
is scaled to the present fold."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from foldcell.skills.trajectory.arcs.bezier import arc_lengths
from foldcell.skills.trajectory.arcs.frame import frames_of
from foldcell.skills.trajectory.arcs.paths import fold_duration
from foldcell.skills.trajectory.search.objective import cost
from foldcell.skills.vocabulary import Array, FoldStep, GraspId, GraspTrajectory, Material, frozen

SCHEMA = "foldcell.library/1"

SIZE_RATIO = 1.30
"""Look-up limit of the size: largest ratio (longer to shorter) between a side of the garment and the same side of
the entry's garment."""

MATERIAL_RATIOS = {
    "friction_static": 1.35,
    "stretch_fraction": 2.5,
    "bending_length": 1.6,
    "areal_mass": 1.6,
    "friction_layers": 1.5,
}
"""Look-up limits of the fabric: largest ratio (larger to smaller) between the garment's value and the entry's
value. The limits are slightly narrower than the range that optimised arcs tolerated in simulations."""

SANE = 3.0
"""Largest plausible distance of the inner control points from the grasp along each axis, in units of the fold's
distance; an entry with farther points is refused."""


@dataclass(frozen=True, eq=False)
class LibraryEntry:
    """One optimised fold. inner: (n - 1, 3) inner control points of each grasp's arc, in the fold's frame.

    size_m: extent of the flat garment along x and y as laid [m]; dissimilarity and dissimilarity_initial: D of
    this arc and of the paper's first guess [m], on a mesh with edges of edge_length [m]; simulations: number of
    simulations of the optimisation; max_tool_speed [m/s]; version: version of the program that made the entry.
    """

    category: str
    step: str
    variant: str
    garment: str
    material: Material
    size_m: tuple[float, float]
    inner: Mapping[GraspId, Array]
    edge_length: float
    method: str
    dissimilarity: float
    dissimilarity_initial: float
    simulations: int
    max_tool_speed: float
    version: str


@dataclass(frozen=True)
class Library:
    """Entries in order of preference: if several entries are equally near to a garment (`lookup`), the first of
    them is used."""

    entries: tuple[LibraryEntry, ...] = ()

    def with_entry(self, entry: LibraryEntry) -> Library:
        """Return this library with `entry` placed first. It replaces the entry for the same fold, garment,
        material and size."""
        return Library((entry, *(e for e in self.entries if _identity(e) != _identity(entry))))

    def merged(self, other: Library) -> Library:
        """Return both libraries as one; this one's entries come first."""
        return Library((*self.entries, *other.entries))


@dataclass(frozen=True)
class Refusal:
    """An entry that was refused, and the reason. index: position of the entry in the file, -1 if the whole file
    was refused."""

    index: int
    reason: str


def lookup(
    library: Library,
    category: str,
    step: str,
    material: Material,
    size_m: tuple[float, float],
    arms: int | None = None,
) -> LibraryEntry | None:
    """Return the entry for this category and step that is nearest in size and fabric, or None if none is within
    the limits.

    arms: number of arms of the step; entries with another number are skipped.
    """
    nearest: tuple[float, LibraryEntry] | None = None
    for entry in library.entries:
        if (entry.category, entry.step) != (category, step):
            continue
        if arms not in (None, len(entry.inner)):
            continue
        away = _distance(entry, material, size_m)
        if away is not None and (nearest is None or away < nearest[0]):
            nearest = (away, entry)
    return None if nearest is None else nearest[1]


def trajectory_from(
    entry: LibraryEntry, step: FoldStep, thickness: float, max_tool_speed: float | None = None
) -> GraspTrajectory | None:
    """Transfer the entry's arcs to the grasps and targets of the present step, scaled by the distance of the fold.

    thickness: of one layer [m]. In the result, D of the arcs and D of the first guess are copied from the entry; D
    of the present fold has to be simulated. If the entry and the step have one grasp each, one with the left hand
    and the other with the right hand, the arc is mirrored. Returns None if the entry and the step differ in their
    number of grasps.
    """
    frames = frames_of(step, thickness)
    inner = dict(entry.inner)
    if set(inner) != set(frames):
        if len(inner) != len(frames):
            return None
        ((grasp_id, points),) = inner.items()
        inner = {grasp_id.other: points * (1.0, -1.0, 1.0)}
    controls = {grasp_id: frozen(frames[grasp_id].denormalise(points)) for grasp_id, points in inner.items()}
    duration = fold_duration(controls, max_tool_speed or entry.max_tool_speed)
    lengths = np.array([arc_lengths(c)[1][-1] for c in controls.values()])
    c = cost(lengths, entry.dissimilarity)
    return GraspTrajectory(
        controls, duration, "library", c, entry.dissimilarity, dissimilarity_initial=entry.dissimilarity_initial
    )


def to_json(library: Library) -> str:
    """Return the library as JSON; each entry has the hash of its content."""
    rows = [{"sha256": _digest(body), **body} for body in map(_body, library.entries)]
    return json.dumps({"schema": SCHEMA, "entries": rows}, indent=1) + "\n"


def from_json(text: str) -> tuple[Library, tuple[Refusal, ...]]:
    """Return the valid entries and the refusals. A corrupt or foreign entry is never used."""
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:  # RecursionError: nested too deep
        return Library(), (Refusal(-1, f"not JSON: {error}"),)
    if not isinstance(data, dict) or not isinstance(data.get("entries"), list):
        return Library(), (Refusal(-1, "not a trajectory library"),)
    if data.get("schema") != SCHEMA:
        return Library(), (Refusal(-1, f"schema {data.get('schema')!r}, this program reads {SCHEMA!r}"),)
    entries, refused = [], []
    for index, row in enumerate(data["entries"]):
        try:
            entries.append(_entry(row))
        except _Refused as error:
            refused.append(Refusal(index, str(error)))
    return Library(tuple(entries)), tuple(refused)


class _Refused(Exception):
    pass


def _identity(entry: LibraryEntry) -> tuple[object, ...]:
    return entry.category, entry.step, entry.variant, entry.garment, entry.material, entry.size_m


def _distance(entry: LibraryEntry, material: Material, size_m: tuple[float, float]) -> float | None:
    """Return the distance of an entry from a garment, or None if a ratio exceeds its limit. The distance is the
    sum of the squared log ratios, each log ratio divided by the logarithm of its limit before squaring."""
    ratios = [(a / b, SIZE_RATIO) for a, b in zip(entry.size_m, size_m, strict=True)]
    ratios += [(getattr(entry.material, f) / getattr(material, f), r) for f, r in MATERIAL_RATIOS.items()]
    away = [abs(np.log(ratio)) / np.log(limit) for ratio, limit in ratios]
    return None if max(away) > 1.0 else float(np.sum(np.square(away)))


def _body(entry: LibraryEntry) -> dict[str, Any]:
    body = {k: v for k, v in entry.__dict__.items() if k not in ("material", "inner", "size_m")}
    body["size_m"] = list(entry.size_m)
    body["material"] = {**asdict(entry.material), "assumed": list(entry.material.assumed)}
    body["inner"] = {grasp_id.value: points.tolist() for grasp_id, points in sorted(entry.inner.items())}
    return body


def _digest(body: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(body, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _entry(row: object) -> LibraryEntry:
    if not isinstance(row, dict):
        raise _Refused("not an object")
    body = {k: v for k, v in row.items() if k != "sha256"}
    if row.get("sha256") != _digest(body):
        raise _Refused("its content does not match its hash: it was edited or damaged")
    try:
        fabric = body.pop("material")
        # entries of earlier versions have no crease_set, on which no prediction depends
        assumed = (*fabric["assumed"], *(() if "crease_set" in fabric else ("crease_set",)))
        material = Material(**{**fabric, "assumed": assumed})
        inner = {GraspId(s): frozen(np.array(p, dtype=float)) for s, p in body.pop("inner").items()}
        size = body.pop("size_m")
        entry = LibraryEntry(**body, material=material, inner=inner, size_m=(float(size[0]), float(size[1])))
    except (TypeError, ValueError, KeyError, IndexError, AttributeError) as error:
        raise _Refused(f"not an entry of {SCHEMA}: {error}") from None
    _check(entry)
    return entry


def _check(entry: LibraryEntry) -> None:
    """Refuse implausible content, which a correct hash does not exclude."""
    points = list(entry.inner.values())
    if not points or any(p.ndim != 2 or p.shape[1] != 3 or len(p) < 1 for p in points):
        raise _Refused("its control points are not (n, 3)")
    if not all(np.isfinite(p).all() and np.abs(p).max() <= SANE for p in points):
        raise _Refused("its control points are not near the fold")
    promised = entry.dissimilarity, entry.dissimilarity_initial
    if not _positive((entry.edge_length, entry.max_tool_speed, *promised, *entry.size_m)):
        raise _Refused("a length, speed or dissimilarity is not positive")
    if not _positive(getattr(entry.material, name) for name in MATERIAL_RATIOS):
        raise _Refused("a material figure is not positive")


def _positive(values: Iterable[object]) -> bool:
    return all(isinstance(v, int | float) and v is not True and np.isfinite(v) and v > 0 for v in values)
