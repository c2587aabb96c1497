"""Flat garments with randomised proportions: outline, key points, hems and seams, in metres.

Frame: x from hem to collar (or to the waist), y to the left; the garment's middle is near the origin. Sizes are
those of clothes in shops; each measure varies by itself, and sleeves and legs lie a little askew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from shapely.geometry import Polygon

from benchmarks.photographs.outline import Corner, Points, edge, trace


@dataclass(frozen=True, eq=False)
class Garment:
    """A drawn garment. template: the shipped garment that its owner would name. hems: edges with a hem. seams:
    lines of stitching on the cloth. inside: the visible inside of the back, below the collar, or None. placket:
    line of the buttons, or None. laid_turn: angle [rad] from this frame to the pose that the cell expects."""

    template: str
    category: str
    outline: Points
    keypoints: dict[str, Points]
    hems: tuple[Points, ...]
    seams: tuple[Points, ...]
    inside: Points | None = None
    placket: Points | None = None
    laid_turn: float = 0.0


def towel(rng: np.random.Generator) -> Garment:
    template, length, width = [
        ("small_towel", 0.30, 0.42),
        ("medium_towel", 0.40, 0.60),
        ("large_towel", 0.50, 0.80),
    ][rng.integers(3)]
    a, b = _size(rng) * np.array([length, width]) / 2 * rng.uniform(0.95, 1.05, 2)
    names = ("near_right", "far_right", "far_left", "near_left")
    places = ((-a, -b), (a, -b), (a, b), (-a, b))
    corners = [
        Corner(name, (x + rng.normal(0, 0.004), y + rng.normal(0, 0.004)), _round(rng), rng.normal(0, 0.003))
        for name, (x, y) in zip(names, places, strict=True)
    ]
    outline, keypoints, edges = trace(corners)
    seams = ()
    if rng.random() < 0.6:  # the woven bands near the short edges
        inset = rng.uniform(0.04, 0.08)
        seams = tuple(np.array([[-a + 0.005, s * (b - inset)], [a - 0.005, s * (b - inset)]]) for s in (-1, 1))
    return Garment(template, "towel", outline, keypoints, tuple(edges), seams)


def shirt(rng: np.random.Generator, long: bool) -> Garment:
    """A T-shirt or a long-sleeve shirt."""
    vary, size = _vary(rng), _size(rng)
    large = long and rng.random() < 0.5
    if not long:
        template, length, chest, collar, shoulder = "t_shirt", 0.66, 0.24, 0.085, 0.20
        sleeve, opening, slant = 0.245, 0.15, np.radians(rng.uniform(18, 32))
    elif large:
        template, length, chest, collar, shoulder = "long_sleeve_shirt_large", 0.66, 0.25, 0.08, 0.20
        sleeve, opening, slant = 0.37, 0.105, np.radians(rng.uniform(34, 46))
    else:
        template, length, chest, collar, shoulder = "long_sleeve_shirt_small", 0.55, 0.21, 0.07, 0.17
        sleeve, opening, slant = 0.31, 0.092, np.radians(rng.uniform(34, 46))
    top = size * length / 2 * vary()
    chest, collar, shoulder = size * np.array([chest, collar, shoulder]) * [vary(), vary(), vary()]
    sleeve, opening = size * sleeve * vary(), size * opening * vary()
    drop = size * rng.uniform(0.03, 0.05)
    armhole = size * (0.17 if not long else 0.155) * vary()
    flare = rng.normal(0, 0.008)
    corners: list[Corner] = []
    for side in (-1, 1):
        angle = slant + np.radians(rng.normal(0, 3))
        shoulder_at = np.array([top - drop, side * shoulder])
        armpit_at = np.array([top - drop - armhole, side * chest])
        out = np.array([-np.sin(angle), side * np.cos(angle)])
        across = np.array([-np.cos(angle), -side * np.sin(angle)])
        upper = shoulder_at + sleeve * out
        lower = upper + opening * across
        name = "right" if side < 0 else "left"
        bow = 0.004
        half = [
            Corner(f"hem_{name}", (-top, side * (chest + flare)), _round(rng), rng.normal(0, 0.004)),
            Corner(f"armpit_{name}", tuple(armpit_at), rng.uniform(0.006, 0.016), rng.normal(0, bow)),
            Corner(f"cuff_lower_{name}", tuple(lower), _round(rng), rng.normal(0, 0.002)),
            Corner(f"cuff_upper_{name}", tuple(upper), _round(rng), rng.normal(0, bow)),
            Corner(f"shoulder_{name}", tuple(shoulder_at), rng.uniform(0.006, 0.016), rng.normal(0, 0.002)),
            Corner(f"collar_{name}", (top, side * collar), _round(rng), rng.uniform(0.002, 0.008)),
        ]
        corners += half if side < 0 else half[::-1]
    corners = [
        Corner(c.name, c.point, c.radius, {"hem_left": -0.004, "collar_left": 0.002}.get(c.name or "", c.bow))
        for c in corners
    ]
    outline, keypoints, edges = trace(corners)
    neck = size * (rng.uniform(0.06, 0.11))
    back, front = (np.array([top, s * (collar - 0.012)]) for s in (-1, 1))
    dip = edge(back, front, neck)
    inside = np.vstack([edge(back, front, corners[5].bow), dip[::-1]])
    seams = tuple(
        edge(np.array([top - drop, s * shoulder]), np.array([top - drop - armhole, s * chest]), s * 0.012)
        for s in (-1, 1)
    )
    placket = None
    if long and rng.random() < 0.5:
        placket = np.array([[top - neck, 0.0], [-top + 0.01, 0.0]])
    hems = (edges[2], edges[8], edges[11])
    category = "long_sleeve_shirt" if long else "t_shirt"
    return Garment(template, category, outline, keypoints, hems, (*seams, dip), inside, placket)


def t_shirt(rng: np.random.Generator) -> Garment:
    return shirt(rng, long=False)


def long_sleeve_shirt(rng: np.random.Generator) -> Garment:
    return shirt(rng, long=True)


def vest(rng: np.random.Generator) -> Garment:
    vary, size = _vary(rng), _size(rng)
    top = size * 0.31 * vary()
    chest, shoulder, collar = size * 0.22 * vary(), size * 0.145 * vary(), size * 0.075 * vary()
    armpit = top - size * 0.23 * vary()
    slope = size * rng.uniform(0.012, 0.03)
    neck = size * rng.uniform(0.07, 0.11)
    flare = rng.normal(0, 0.008)
    corners: list[Corner] = []
    for side in (-1, 1):
        name = "right" if side < 0 else "left"
        arm = side * size * rng.uniform(0.012, 0.03)  # the armhole is cut into the body
        half = [
            Corner(f"hem_{name}", (-top, side * (chest + flare)), _round(rng), rng.normal(0, 0.004)),
            Corner(f"armpit_{name}", (armpit, side * chest), _round(rng)),
            Corner(f"shoulder_{name}", (top - slope, side * shoulder), _round(rng), rng.normal(0, 0.001)),
            Corner(f"collar_{name}", (top, side * collar), _round(rng)),
        ]
        bows = {f"armpit_{name}": abs(arm), f"collar_{name}": neck * 0.12}
        corners += [Corner(c.name, c.point, c.radius, bows.get(c.name or "", c.bow)) for c in half][::-side]
        if side < 0:
            corners.append(Corner("neck", (top - neck, rng.normal(0, 0.003)), 0.03, neck * 0.12))
    # The edges of the left side run the other way round: an edge belongs to the corner that it leaves.
    bow = {"shoulder_left": size * 0.02, "collar_left": 0.0, "armpit_left": 0.0, "hem_left": -0.003}
    corners = [Corner(c.name, c.point, c.radius, bow.get(c.name or "", c.bow)) for c in corners]
    outline, keypoints, edges = trace(corners)
    return Garment("vest", "vest", outline, keypoints, (edges[1], edges[3], edges[4], edges[6], edges[8]), ())


def trousers(rng: np.random.Generator, template: str) -> Garment:
    """Pants, jeans and shorts whose legs lie beside each other. waist_near is on the left when the waist is up."""
    while True:
        garment = _trousers(rng, template)
        if Polygon(garment.outline).is_valid:  # else one leg lies on the other
            return garment


def _trousers(rng: np.random.Generator, template: str) -> Garment:
    vary, size = _vary(rng), _size(rng)
    length, waist, opening, rise, apart = {
        "pants": (0.92, 0.19, 0.16, 0.28, 0.04),
        "jeans": (1.00, 0.21, 0.17, 0.29, 0.05),
        "shorts": (0.50, 0.19, 0.24, 0.27, 0.02),
    }[template]
    top = size * length / 2 * vary()
    waist, opening, rise = size * waist * vary(), size * opening * vary(), size * rise * vary()
    spread = size * apart * rng.uniform(0.6, 1.4)
    crotch = np.array([top - rise, rng.normal(0, 0.003)])
    legs = {}
    for side in (1, -1):
        skew = np.radians(rng.normal(0, 1.0))
        inner = np.array([-top, side * spread])
        outer = np.array([-top + rng.normal(0, 0.004), side * (spread + opening)])
        turn = np.array([[np.cos(skew), -np.sin(skew)], [np.sin(skew), np.cos(skew)]])
        legs[side] = [crotch + turn @ (p - crotch) for p in (outer, inner)]
    hip = size * rng.uniform(0.0, 0.012)
    corners = [
        Corner("waist_near", (top, waist), _round(rng), -hip),
        Corner("ankle_outer_near", tuple(legs[1][0]), _round(rng), rng.normal(0, 0.002)),
        Corner("ankle_inner_near", tuple(legs[1][1]), _round(rng), rng.normal(0, 0.004)),
        Corner("crotch", tuple(crotch), rng.uniform(0.006, 0.015), rng.normal(0, 0.004)),
        Corner("ankle_inner_far", tuple(legs[-1][1]), _round(rng), rng.normal(0, 0.002)),
        Corner("ankle_outer_far", tuple(legs[-1][0]), _round(rng), -hip),
        Corner("waist_far", (top, -waist), _round(rng), rng.uniform(0.0, 0.01)),
    ]
    outline, keypoints, edges = trace(corners)
    fly = np.array([[top, 0.0], [crotch[0] + 0.01, crotch[1]]])
    pockets = tuple(
        edge(np.array([top - 0.02, s * (waist - 0.05)]), np.array([top - 0.15, s * (waist + 0.002)]), s * 0.02)
        for s in (1, -1)
    )
    band = np.array([[top - 0.035, waist - 0.003], [top - 0.035, -waist + 0.003]])
    category = "shorts" if template == "shorts" else "pants"
    hems = (edges[1], edges[4])
    return Garment(template, category, outline, keypoints, hems, (fly, *pockets, band), laid_turn=np.pi / 2)


def pants(rng: np.random.Generator) -> Garment:
    return trousers(rng, "pants" if rng.random() < 0.5 else "jeans")


def shorts(rng: np.random.Generator) -> Garment:
    return trousers(rng, "shorts")


def skirt(rng: np.random.Generator) -> Garment:
    vary, size = _vary(rng), _size(rng)
    top, waist, hem = size * 0.26 * vary(), size * 0.16 * vary(), size * 0.28 * vary()
    curve = size * rng.uniform(0.0, 0.02)
    corners = [
        Corner("hem_right", (-top, -hem), _round(rng), rng.normal(0, 0.006)),
        Corner("waist_right", (top, -waist), _round(rng), rng.normal(0, 0.003)),
        Corner("waist_left", (top, waist), _round(rng), rng.normal(0, 0.006)),
        Corner("hem_left", (-top, hem), _round(rng), -curve),
    ]
    outline, keypoints, edges = trace(corners)
    band = np.array([[top - 0.04, -waist - 0.005], [top - 0.04, waist + 0.005]])
    pleats = ()
    if rng.random() < 0.4:
        pleats = tuple(
            np.array([[top - 0.04, waist * t], [-top + 0.02, hem * t]]) for t in np.linspace(-0.7, 0.7, 5)
        )
    return Garment("skirt", "skirt", outline, keypoints, (edges[3],), (band, *pleats))


GARMENTS: tuple[Callable[[np.random.Generator], Garment], ...] = (
    towel, t_shirt, long_sleeve_shirt, vest, pants, shorts, skirt,
)  # fmt: skip


def _size(rng: np.random.Generator) -> float:
    """Clothes of one kind come in sizes."""
    return float(rng.uniform(0.90, 1.10))


def _vary(rng: np.random.Generator) -> Callable[[], float]:
    """Each measure varies by itself, whatever the size."""
    return lambda: float(rng.uniform(0.94, 1.06))


def _round(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.002, 0.010))
