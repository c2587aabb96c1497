"""Check that key points which a person has placed in a picture can be those of a garment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely

from foldcell.robots.ports import Array
from foldcell.skills.garments.garment import Garment
from foldcell.skills.garments.outline_check import (
    LARGEST,
    SMALLEST,
    crosses_itself,
    impossible_size,
    runs_clockwise,
    same_places,
)
from foldcell.skills.garments.picture_measure import PictureMeasure, as_laid

PROPORTIONS = 0.35
"""Other proportions than those of the known garment are worth a look beyond this difference: standard deviation,
over the outline's edges, of the logarithm of their relative length. They are no mistake: the sleeves of a T-shirt
are long or short and droop, and its underarm seam may be missing."""
SIDES = (("left", "right"), ("near", "far"))
"""Parts of the names of key points that mirror each other."""
MOST_PAIRS = 10
"""Exchanges are sought for garments with at most this many pairs of mirrored key points."""
OFF_OUTLINE = 0.05
"""A key point may lie this far off the outline that was seen, relative to the garment's size. At a rounded corner,
it lies a little outside."""
UNLIKE = 2.0
"""A garment that is larger or smaller than the known one by more than this factor is probably measured wrong."""


@dataclass(frozen=True)
class KeyPointFinding:
    """What is wrong with key points. names: the key points concerned; empty if all are. what, hint: in words.
    refused: whether no garment can be made of the key points. If it is false, they only look wrong, and a person
    decides."""

    names: tuple[str, ...]
    what: str
    hint: str
    refused: bool = True


def check_key_points(
    points: Mapping[str, Array], like: Garment, picture: PictureMeasure, outline: Array | None = None
) -> tuple[KeyPointFinding, ...]:
    """Return what is wrong with key points, name -> (2,) in pixels of a picture (column, row).

    like: garment with the same key points. outline: (n, 2) [px] outline of the region that the perception takes
    for the garment. It may be wrong; None: not known. Shape and size are judged only if every key point is in the
    picture.
    """
    found = [*_names(points, like), *_places(points, like, picture)]
    if not found:
        pixels = np.array([points[name] for name in like.keypoints], dtype=float)
        found = list(_shape(pixels, like, picture))
        if not any(finding.refused for finding in found):
            found += _size(pixels, like, picture)
    if outline is not None:
        found += _off(points, outline)
    return tuple(found)


def _names(points: Mapping[str, Array], like: Garment) -> Iterator[KeyPointFinding]:
    missing = tuple(name for name in like.keypoints if name not in points)
    if missing:
        yield KeyPointFinding(missing, f"missing: {', '.join(missing)}", f"{like.name} has all of them")
    for name in points:
        if name not in like.keypoints:
            hint = f"the key points of {like.name} are {_listed(like)}"
            yield KeyPointFinding((name,), f"{name} is unknown", hint)


def _places(points: Mapping[str, Array], like: Garment, picture: PictureMeasure) -> Iterator[KeyPointFinding]:
    for name in like.keypoints:
        if name not in points:
            continue
        column, row = (float(v) for v in points[name])
        if not (0 <= column < picture.columns and 0 <= row < picture.rows):
            yield KeyPointFinding(
                (name,),
                f"{name} = [{column}, {row}] lies outside the picture",
                f"the picture has {picture.columns} columns and {picture.rows} rows",
            )


def _shape(pixels: Array, like: Garment, picture: PictureMeasure) -> Iterator[KeyPointFinding]:
    same = same_places(pixels, like.keypoints)
    if same:
        for names in same:
            yield KeyPointFinding(names, f"{names[0]} and {names[1]} lie at the same place", "move one of them")
    elif crosses_itself(pixels):
        yield _wrong_order("the outline through the key points crosses itself", pixels, like, picture)
    elif runs_clockwise(as_laid(pixels)):
        yield _wrong_order("the key points run clockwise", pixels, like, picture)
    else:
        yield from _proportions(picture.to_laid(pixels), like)


def _wrong_order(what: str, pixels: Array, like: Garment, picture: PictureMeasure) -> KeyPointFinding:
    hint = f"in the picture they follow each other counter-clockwise: {_listed(like)}"
    exchanged = _exchanged(picture.to_laid(pixels), like)
    if exchanged is not None:
        sides, pairs = exchanged
        named = ", ".join(f"{a} and {b}" for a, b in pairs)
        names = tuple(name for pair in pairs for name in pair)
        return KeyPointFinding(names, f"{what}: {sides[0]} and {sides[1]} are exchanged ({named})", hint)
    names = _crossing(pixels, like)
    where = f": {names[0]} to {names[1]}, and {names[2]} to {names[3]}" if names else ""
    return KeyPointFinding(tuple(dict.fromkeys(names)), f"{what}{where}", hint)


def _proportions(laid: Array, like: Garment) -> Iterator[KeyPointFinding]:
    lengths = [np.linalg.norm(np.roll(p, -1, axis=0) - p, axis=1) for p in (laid, like.template)]
    relative = np.log(lengths[0] / lengths[1])
    relative -= np.median(relative)
    if float(relative.std()) <= PROPORTIONS:
        return
    worst = int(np.argmax(np.abs(relative)))
    names = _edge(like, worst)
    yield KeyPointFinding(
        names,
        f"the proportions are not those of {like.name}: from {names[0]} to {names[1]} it is "
        f"{np.exp(relative[worst]):.1f} times as far, compared with the other edges",
        "check these key points; they are right if the garment has this shape",
        refused=False,
    )


def _size(pixels: Array, like: Garment, picture: PictureMeasure) -> Iterator[KeyPointFinding]:
    template = picture.template(pixels, like.template)
    size, nominal = np.ptp(template, axis=0), np.array(like.size_m)
    names: tuple[str, ...] = ()
    hint = "check that the cell's camera took this picture"
    if picture.measured is not None:
        names = like.keypoints[picture.measured[0]], like.keypoints[picture.measured[1]]
        hint = (
            f"check the measured length ({picture.length:g} m from {names[0]} to {names[1]}) and these key points"
        )
    what = f"the garment would be {size[0]:.3f} x {size[1]:.3f} m"
    if impossible_size(template):
        yield KeyPointFinding(names, f"{what}; {SMALLEST:g} to {LARGEST:g} m is possible", hint)
    elif not 1 / UNLIKE <= float(np.exp(np.log(size / nominal).mean())) <= UNLIKE:
        compared = f"{what}, {like.name} is {nominal[0]:.3f} x {nominal[1]:.3f} m"
        yield KeyPointFinding(names, compared, hint, refused=False)


def _off(points: Mapping[str, Array], outline: Array) -> Iterator[KeyPointFinding]:
    seen = shapely.Polygon(outline)
    away = {name: seen.exterior.distance(shapely.Point(*point)) for name, point in points.items()}
    off = {name: distance for name, distance in away.items() if distance > OFF_OUTLINE * seen.area**0.5}
    if off:
        yield KeyPointFinding(
            tuple(off),
            f"off the outline that was seen: {', '.join(f'{name} by {d:.0f} px' for name, d in off.items())}",
            "a key point lies on the garment's edge; this is right where that outline is wrong",
            refused=False,
        )


def _exchanged(laid: Array, like: Garment) -> tuple[tuple[str, str], list[tuple[str, str]]] | None:
    """Return the sides, such as left and right, and the pairs of key points whose exchange makes these points like
    the template; None if no exchange does. laid: (k, 2)."""
    best, found = _unlike(laid, like.template), None
    for sides in SIDES:
        pairs = [(n, n.replace(*sides)) for n in like.keypoints if n.replace(*sides) in set(like.keypoints) - {n}]
        sizes = range(1, len(pairs) + 1) if len(pairs) <= MOST_PAIRS else ()
        for chosen in (chosen for size in sizes for chosen in combinations(pairs, size)):
            points = laid[_order(like, chosen)]
            polygon, unlike = shapely.Polygon(points), _unlike(points, like.template)
            if unlike < best and polygon.is_valid and polygon.exterior.is_ccw:
                best, found = unlike, (sides, list(chosen))
    return found


def _order(like: Garment, exchanged: Sequence[tuple[str, str]]) -> list[int]:
    """Return, for each key point, the index of the one that takes its place."""
    other = {a: b for pair in exchanged for a, b in (pair, pair[::-1])}
    return [like.keypoints.index(other.get(name, name)) for name in like.keypoints]


def _unlike(points: Array, template: Array) -> float:
    """Return the distance of points (k, 2) from the template (k, 2), laid on them by the best rotation and scale:
    0 if they have its shape, 1 if nothing of it."""
    a, b = ((p - p.mean(axis=0)) @ [1.0, 1.0j] for p in (points, template))
    likeness = abs(np.vdot(a, b)) / (np.linalg.norm(a) * np.linalg.norm(b))
    return float(1.0 - likeness)


def _crossing(pixels: Array, like: Garment) -> tuple[str, ...]:
    """Return the ends of the first two edges that cross: names of four key points, or none."""
    count = len(pixels)
    edges = [shapely.LineString([pixels[i], pixels[(i + 1) % count]]) for i in range(count)]
    for i in range(count):
        for j in range(i + 2, count - (i == 0)):
            if edges[i].intersects(edges[j]):
                return (*_edge(like, i), *_edge(like, j))
    return ()


def _edge(like: Garment, index: int) -> tuple[str, str]:
    return like.keypoints[index], like.keypoints[(index + 1) % len(like.keypoints)]


def _listed(like: Garment) -> str:
    return ", ".join(like.keypoints)
