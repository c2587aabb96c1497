"""Garments by the measures of size charts: shirts, trousers, towels; the traced real ones; sewn vests and skirts.

A half is a list of nodes [key point or "", x from the middle, y up; "smooth" where there is no corner], in
centimetres, as in `sewn.json`. The two halves of a shirt differ, because no sleeve lies like the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.photographs.real.outlines import Base, Flat, bases, flat, sewn, warped

Half = list[list[Any]]
CATEGORIES = {
    "t_shirt": 0.28, "long_sleeve_shirt": 0.20, "pants": 0.15, "shorts": 0.10, "vest": 0.07, "skirt": 0.07,
    "towel": 0.13,
}  # fmt: skip
TRACED_SHARE = 0.35
"""Of the garments of a category that has outlines of real garments."""


def garment(rng: np.random.Generator, categories: tuple[str, ...] = tuple(CATEGORIES)) -> Flat:
    """A garment of one of the categories, bent and scaled."""
    shares = np.array([CATEGORIES[name] for name in categories])
    category = str(rng.choice(categories, p=shares / shares.sum()))
    charted = category not in ("vest", "skirt")
    kept = [base for base in bases().values() if base.category == category and base.traced == charted]
    base = (
        by_chart(rng, category)
        if not kept or (charted and rng.random() > TRACED_SHARE)
        else kept[rng.integers(len(kept))]
    )
    return warped(rng, flat(base, rng.uniform(0.002, 0.005)))


def by_chart(rng: np.random.Generator, category: str) -> Base:
    stand = category in ("t_shirt", "long_sleeve_shirt") and rng.random() < 0.3
    if category in ("t_shirt", "long_sleeve_shirt"):
        right, left = shirt(rng, category == "long_sleeve_shirt", stand)
    elif category == "towel":
        right = left = towel(rng)
    else:
        right = left = legs(rng, rng.uniform(66, 84) if category == "pants" else rng.uniform(8, 30))
    entry = {"category": category, "stand": stand, "half_cm": right, "other_half_cm": left}
    return sewn(f"{category} by chart", entry)


def shirt(rng: np.random.Generator, long: bool, stand: bool) -> tuple[Half, Half]:
    u = rng.uniform
    size = u(0.62, 0.8) if rng.random() < 0.2 else 1.0  # a child's
    chest, length, drop, depth = size * np.array([u(22, 30), u(62, 76), u(3.0, 6.5), u(19, 25)])
    waist, hem, bow = chest * u(0.88, 1.0), chest * u(0.92, 1.1), size * (u(1.5, 5) if rng.random() < 0.3 else 0)
    shoulder, collar = chest * u(0.82, 0.97), size * u(7.5, 10.0)
    sleeve, opening = size * (u(55, 63) if long else u(15, 25)), size * (u(9, 12) if long else u(15, 19))
    beside, rounded = long and rng.random() < 0.4, ["smooth"] * int(rng.random() < 0.6)
    slant = u(76, 86) if beside else u(20, 55) if long else u(20, 70)
    gap = size * u(1.2, 3.0)
    halves = []
    for angle in np.radians(slant + rng.normal(0, 2 if beside else 4, 2)):
        top, pit = np.array([shoulder, length - drop]), np.array([chest, length - drop - depth])
        out, across = np.array([np.cos(angle), -np.sin(angle)]), np.array([-np.sin(angle), -np.cos(angle)])
        upper = top + sleeve * out
        upper[0] = max(upper[0], max(chest, hem) + gap + (0.93 if beside else 0.45) * opening)
        lower = upper + opening * across
        if (lower - pit) @ out < size or lower[0] < chest + gap:  # the sleeve hangs beside the body
            lower[0] = max(chest, hem * long) + gap
            lower[1] = upper[1] - np.sqrt(max(opening**2 - (upper[0] - lower[0]) ** 2, (0.4 * opening) ** 2))
        half: Half = [["", 0, 0], ["hem", hem, bow], ["", waist, 0.45 * length, "smooth"], ["armpit", *pit]]
        if bow:
            half[0] = ["", 0, 0, "smooth"]
            half.insert(1, ["", 0.5 * hem, 0.2 * bow, "smooth"])
        if beside:
            half.append(["", chest + 0.7 * gap, 0.5 * (pit[1] + lower[1]), "smooth"])
        elif long:
            half.append(["", *(0.5 * (pit + lower) + size * u(-1.2, 1.2) * across), "smooth"])
        half += [["cuff_lower", *lower], ["cuff_upper", *upper]]
        if long:
            half.append(
                ["", *(0.5 * (top + upper) + size * (u(1, 3) if beside else u(-1, 1)) * -across), "smooth"]
            )
        half += [["shoulder", *top, *rounded], ["collar", collar, length]]
        if stand:
            half.append(["", 0.8 * collar, length + size * u(3, 4.5)])
        half.append(["", 0, length + (size * u(3.5, 5) if stand else -size * u(1.0, 3.0)), "smooth"])
        halves.append([[name, *map(float, node[:2]), *node[2:]] for name, *node in half])
    return halves[0], [halves[0][0], *halves[1][1:-1], halves[0][-1]]


def legs(rng: np.random.Generator, inside: float) -> Half:
    """Trousers with an inside leg [cm] of that length; some flare, some lie with legs apart."""
    u = rng.uniform
    waist, rise, apart = u(17, 22), u(24, 31), u(0.7, 2.0) if rng.random() < 0.6 else u(3, 8)
    hip = waist * u(1.1, 1.25)
    opening = u(13, 26) if inside > 40 else u(20, 29)
    bottom = [apart * min(1.0, inside / 40) + 0.3, apart * min(1.0, inside / 40) + 0.3 + opening]
    half: Half = [["crotch", 0, inside]]
    knee = min(opening, u(16, 21)) if inside > 40 else 0.0
    if knee:
        half.append(["", 0.55 * bottom[0] + 0.25 + 0.2 * (opening - knee), 0.42 * inside, "smooth"])
    half += [["ankle_inner", bottom[0], 0], ["ankle_outer", bottom[1], u(0, 2)]]
    if knee:
        half.append(["", 0.55 * bottom[0] + 0.25 + 0.2 * (opening - knee) + knee, 0.42 * inside, "smooth"])
    return [*half, ["", hip, inside + 0.35 * rise, "smooth"], ["waist", waist, inside + rise], 
            ["", 0, inside + rise - u(0.3, 1.6), "smooth"]]  # fmt: skip


def towel(rng: np.random.Generator) -> Half:
    """From a square to a long one, with its long or its short side near."""
    short = rng.uniform(25, 60)
    sides = rng.permutation([short, short * rng.uniform(1.0, 2.5)])
    return [["", 0, 0], ["near", sides[0] / 2, 0], ["far", sides[0] / 2, sides[1]], ["", 0, sides[1]]]
