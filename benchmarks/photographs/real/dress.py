"""The look of real garments: colours that change at a seam, prints, the neck, hems, folds in the cloth."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.cloth import Colour, inwards, over, pattern, relief, wrinkles
from benchmarks.photographs.noise import Field, smooth
from benchmarks.photographs.outline import Points, bezier, edge
from benchmarks.photographs.real.grounds import hue
from benchmarks.photographs.real.outlines import Flat

SHIRTS = ("t_shirt", "long_sleeve_shirt", "vest")


def dress(
    rng: np.random.Generator, canvas: Canvas, lying: Flat, mask: Field, main: Colour, angle: float, light: Points
) -> tuple[list[str], Field]:
    """What was chosen, and the lit colours of the garment as it lies. angle: by which it is turned."""
    middle = lying.outline.mean(axis=0)
    kind, colours = pattern(rng, canvas, main, middle, angle)
    words = [kind]
    if lying.category in ("t_shirt", "long_sleeve_shirt") and rng.random() < 0.35:
        word, cover = zone(rng, canvas, lying, mask, angle)
        second = np.clip(main * rng.uniform(0.35, 1.7) + rng.normal(0, 0.15, 3), 0.04, 0.93).astype(np.float32)
        colours, words = over(colours, cover, second), [*words, word]
    if lying.category in SHIRTS and rng.random() < 0.35:
        word, colours = printed(rng, canvas, lying, colours, middle, angle)
        words.append(word)
    colours = sewing(rng, canvas, lying, colours, main, middle)
    weave = smooth(rng, canvas.shape, (1.5, 1.5)) * rng.uniform(0.008, 0.035)
    shade = rng.uniform(0.03, 0.09) * relief(wrinkles(rng, canvas), canvas, light)
    shade = shade + rng.uniform(0.0, 0.05) * relief(_long_folds(rng, canvas), canvas, light)
    rim = relief(cv2.GaussianBlur(mask, (0, 0), 0.003 / canvas.pixel), canvas, light)
    factor = 1 + weave + np.clip(shade, -0.3, 0.25) - np.clip(0.035 * rim, -0.14, 0.14)
    return words, np.asarray(colours * factor[..., None] + 0.01, np.float32)


def zone(rng: np.random.Generator, canvas: Canvas, lying: Flat, mask: Field, angle: float) -> tuple[str, Field]:
    """Part of a shirt that has another colour."""
    word = str(rng.choice(["yoke", "raglan", "sleeves", "bands"]))
    points = lying.keypoints
    if word == "yoke":
        armpits = (points["armpit_left"] + points["armpit_right"]) / 2
        shoulders = (points["shoulder_left"] + points["shoulder_right"]) / 2
        level = armpits + rng.uniform(0.15, 0.75) * (shoulders - armpits)
        up = np.array([np.cos(angle), -np.sin(angle)])
        v, u = np.mgrid[: canvas.shape[0], : canvas.shape[1]].astype(np.float32)
        column, row = canvas.at(level[None])[0]
        step = -((v - row) * up[0] + (u - column) * up[1])
        body = 1 - np.maximum(*(_sleeve(canvas, lying, side, "shoulder") for side in ("left", "right")))
        return word, np.asarray(np.clip(step + 0.5, 0, 1) * body, np.float32)
    if word == "bands":  # cuffs and hem
        cover = canvas.line(lying.arc("hem_left", "hem_right"), rng.uniform(0.04, 0.1))
        for side in ("left", "right"):
            cuff = lying.arc(f"cuff_upper_{side}", f"cuff_lower_{side}")
            cover = np.maximum(cover, canvas.line(cuff, rng.uniform(0.04, 0.1)))
        return word, cover
    start = "collar" if word == "raglan" else "shoulder"
    return word, np.maximum(*(_sleeve(canvas, lying, side, start) for side in ("left", "right")))


def _sleeve(canvas: Canvas, lying: Flat, side: str, start: str) -> Field:
    line = lying.arc(f"{start}_{side}", f"armpit_{side}")
    seam = armhole(line[-1], line[0], lying.outline.mean(axis=0), 0.12)
    return canvas.mask(np.vstack([line, seam]))


def armhole(armpit: Points, top: Points, middle: Points, depth: float) -> Points:
    """The curved seam from the armpit upwards, hollow towards the body."""
    half = (armpit + top) / 2
    inwards_ = middle - half
    along = top - armpit
    inwards_ = inwards_ - along * float(inwards_ @ along) / float(along @ along)
    control = half + inwards_ / max(float(np.linalg.norm(inwards_)), 1e-9) * depth * np.linalg.norm(along)
    return bezier(armpit, control, top, 40)


def printed(
    rng: np.random.Generator, canvas: Canvas, lying: Flat, colours: Field, middle: Points, angle: float
) -> tuple[str, Field]:
    """A printed picture, badge or lines of text on the chest; some are rectangles as large as a small towel."""
    points = lying.keypoints
    width = float(np.linalg.norm(points["armpit_left"] - points["armpit_right"]))
    half = np.array([rng.uniform(0.12, 0.3), rng.uniform(0.15, 0.34)]) * width
    up, left = np.array([np.cos(angle), -np.sin(angle)]), np.array([np.sin(angle), np.cos(angle)])
    chest = (points["armpit_left"] + points["armpit_right"]) / 2 - up * rng.uniform(0.0, 0.12)

    def box(scale: float, at: Points = chest) -> Field:
        sides = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        return canvas.mask(np.array([at + scale * (a * half[0] * up + b * half[1] * left) for a, b in sides]))

    ink, paper = hue(rng, (0.1, 0.9), (0.1, 0.95)), hue(rng, (0.0, 0.9), (0.1, 0.95))
    word = str(rng.choice(["printed rectangle", "printed picture", "badge", "text"], p=[0.35, 0.25, 0.15, 0.25]))
    if word in ("printed rectangle", "printed picture"):
        colours = over(colours, box(1.0), paper)
        if word == "printed picture":
            size = 0.3 * half.min() / canvas.pixel
            blot = (smooth(rng, canvas.shape, (size, size)) > 0.1).astype(np.float32)
            colours = over(colours, box(0.92) * cv2.GaussianBlur(blot, (0, 0), 1.0), ink)
        elif rng.random() < 0.5:
            colours = over(colours, box(0.85), ink)
    elif word == "badge":
        turn = np.linspace(0, 2 * np.pi, 60)[:, None]
        for k, colour in ((1.0, ink), (0.8, paper), (0.35, ink)):
            ring = chest + k * half.min() * (np.cos(turn) * up + np.sin(turn) * left)
            colours = over(colours, canvas.mask(ring), colour)
    else:
        for level in np.linspace(0.8, -0.8, rng.integers(1, 5)):
            for t in np.arange(-0.95, 0.9, 0.13):
                if rng.random() < 0.85:
                    at = chest + half[0] * level * up + half[1] * (t + 0.05) * left
                    letter = (
                        at + 0.05 * half[1] * rng.normal(0, 1, (5, 2)) + np.outer([0, 1, 0, 1, 0.5], up) * 0.012
                    )
                    colours = over(colours, canvas.line(letter, 0.005), ink)
    return word, colours


def sewing(
    rng: np.random.Generator, canvas: Canvas, lying: Flat, colours: Field, main: Colour, middle: Points
) -> Field:
    """Hems, seams, the neck with its label, collar, buttons, pockets, waistband."""
    points = lying.keypoints
    thread = np.asarray(np.clip(main * rng.choice([0.6, 1.4]), 0.0, 0.95), np.float32)
    for first, last, inset in hems(lying.category):
        line = inwards(lying.arc(first, last), middle, rng.uniform(0.012, 0.025) if inset == 0 else inset)
        colours = over(colours, 0.6 * canvas.line(line, 0.0015), thread)
    if lying.category in ("t_shirt", "long_sleeve_shirt"):
        for side in ("left", "right"):
            seam = armhole(points[f"armpit_{side}"], points[f"shoulder_{side}"], middle, 0.12)
            colours = over(colours, rng.uniform(0.3, 0.8) * canvas.line(seam, 0.002), main * 0.6)
        left, right = points["collar_left"], points["collar_right"]
        across = left - right
        down = np.array([-across[1], across[0]])
        down = down * np.sign(down @ (middle - (left + right) / 2))
        dip = bezier(left, (left + right) / 2 + down * rng.uniform(0.7, 1.5), right, 40)
        neck = np.vstack([lying.arc("collar_left", "collar_right"), dip[::-1]])
        if lying.stand:
            colours = _collar(rng, canvas, lying, colours, main, down)
        else:
            colours = over(colours, canvas.mask(neck), colours * rng.uniform(0.5, 0.8))
            colours = over(colours, 0.7 * canvas.line(dip - down * 0.02, 0.002), thread)
            if rng.random() < 0.6:
                at = (left + right) / 2 + down * 0.12
                sides = [(-0.1, 0.0), (0.1, 0.0), (0.1, 0.16), (-0.1, 0.16)]
                label = np.array([at + a * across + b * down for a, b in sides])
                colours = over(colours, canvas.mask(label), np.float32([0.85, 0.85, 0.86]))
    if lying.category in ("pants", "shorts"):
        top = (points["waist_near"] + points["waist_far"]) / 2
        fly = np.array([top, points["crotch"] + 0.15 * (top - points["crotch"])])
        colours = over(colours, 0.6 * canvas.line(fly, 0.002), main * 0.6)
        for side in ("near", "far"):
            waist, ankle = points[f"waist_{side}"], points[f"ankle_outer_{side}"]
            way = (ankle - waist) / max(float(np.linalg.norm(ankle - waist)), 1e-9)
            pocket = edge(waist + 0.3 * (top - waist) + 0.04 * way, waist + 0.17 * way, 0.01)
            colours = over(colours, 0.6 * canvas.line(pocket, 0.002), thread)
    return colours


def _collar(
    rng: np.random.Generator, canvas: Canvas, lying: Flat, colours: Field, main: Colour, down: Points
) -> Field:
    """A collar's two leaves over the shoulders' inner ends, and a row of buttons."""
    points = lying.keypoints
    left, right = points["collar_left"], points["collar_right"]
    centre, front = (left + right) / 2, (left + right) / 2 + 0.45 * down
    stand = lying.arc("collar_left", "collar_right")
    colours = over(colours, canvas.mask(np.vstack([stand, front[None]])), colours * rng.uniform(0.45, 0.75))
    high = stand[len(stand) // 2]
    for corner in (left, right):
        tip = front + (corner - centre) * 0.85 + 0.12 * down
        inner = high + 0.75 * (corner - centre)
        leaf = np.vstack([inner, corner, tip, front])
        colours = over(colours, canvas.mask(leaf), colours * rng.uniform(0.88, 1.08))
        colours = over(colours, 0.6 * canvas.line(np.vstack([corner, tip, front]), 0.002), main * 0.55)
    hem = (points["hem_left"] + points["hem_right"]) / 2
    length = 1.0 if lying.category == "long_sleeve_shirt" else 0.25
    end = front + (hem - front) * length
    colours = over(colours, 0.6 * canvas.line(np.array([front, end]), 0.003), main * 0.6)
    turn = np.linspace(0, 6.3, 16)
    for t in np.linspace(0.1, 0.95, 7 if length == 1.0 else 3):
        ring = front + t * (end - front) + 0.006 * np.column_stack([np.cos(turn), np.sin(turn)])
        colours = over(colours, canvas.mask(ring), np.float32([0.8, 0.82, 0.85]))
    return colours


def hems(category: str) -> list[tuple[str, str, float]]:
    """First and last key point of each hem, and the stitching's distance from it [m], 0 for any."""
    if category in ("t_shirt", "long_sleeve_shirt"):
        cuffs = [(f"cuff_upper_{side}", f"cuff_lower_{side}", 0.0) for side in ("left", "right")]
        return [("hem_left", "hem_right", 0.0), *cuffs]
    if category == "vest":
        return [
            ("hem_left", "hem_right", 0.0), ("collar_left", "neck", 0.01), ("collar_right", "neck", 0.01),
            ("armpit_left", "shoulder_left", 0.01), ("armpit_right", "shoulder_right", 0.01),
        ]  # fmt: skip
    if category in ("pants", "shorts"):
        legs = [(f"ankle_outer_{side}", f"ankle_inner_{side}", 0.0) for side in ("near", "far")]
        return [("waist_near", "waist_far", 0.035), *legs]
    if category == "skirt":
        return [("waist_left", "waist_right", 0.035), ("hem_left", "hem_right", 0.0)]
    names = ["near_right", "far_right", "far_left", "near_left"]
    return [(a, b, 0.01) for a, b in zip(names, names[1:] + names[:1], strict=True)]


def _long_folds(rng: np.random.Generator, canvas: Canvas) -> Field:
    """A few long soft folds, as cloth has that was folded in a drawer."""
    total = np.zeros(canvas.shape, np.float32)
    v, u = np.mgrid[: canvas.shape[0], : canvas.shape[1]].astype(np.float32)
    for _ in range(rng.integers(1, 5)):
        angle = rng.uniform(0, np.pi)
        way = (u - rng.uniform(0.2, 0.8) * canvas.shape[1]) * np.cos(angle)
        way = (way + (v - rng.uniform(0.2, 0.8) * canvas.shape[0]) * np.sin(angle)) * canvas.pixel
        way = way + 0.01 * smooth(rng, canvas.shape, (canvas.shape[0] / 3, canvas.shape[1] / 3))
        total += np.exp(-((way / rng.uniform(0.006, 0.02)) ** 2))
    return np.asarray(total + 1e-3 * smooth(rng, canvas.shape, (50, 50)), np.float32)
