# mypy: allow-untyped-defs, allow-incomplete-defs
"""Time integration of the vertices awake[:count]: predict positions, then compute velocities from displacements
(XPBD, Macklin et al. 2016)."""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.vec3 import dot, load, store, vector


@inner(error_model="numpy", fastmath={"contract"})
def integrate(count, awake, h, drag, max_speed, gravity, x, xp, v):
    """Predict positions x after a substep of h [s] under gravity and air drag alone, and save the old positions in
    xp."""
    keep = 1.0 / (1.0 + drag * h)
    gain = vector(h * gravity[0], h * gravity[1], h * gravity[2])
    for c in range(count):
        i = awake[c]
        speed = keep * load(v, i) + gain
        s2 = dot(speed, speed)
        if s2 > max_speed * max_speed:
            speed = (max_speed / np.sqrt(s2)) * speed
        place = load(x, i)
        store(xp, i, place)
        store(x, i, place + h * speed)


@inner(error_model="numpy", fastmath={"contract"})
def extrapolate(count, awake, g, x, xp, u):
    """Compute u = x + g (x - xp). In terms of u, a damped constraint has the form of an undamped one."""
    for c in range(count):
        i = awake[c]
        place = load(x, i)
        store(u, i, place + g * (place - load(xp, i)))


@inner(error_model="numpy", fastmath={"contract"})
def undo_extrapolation(count, awake, g, x, xp, u):
    """Compute x from u and xp, the inverse of `extrapolate`."""
    scale = 1.0 / (1.0 + g)
    for c in range(count):
        i = awake[c]
        store(x, i, scale * (load(u, i) + g * load(xp, i)))


@inner()
def restore_positions(first, end, awake, x, xp):
    """Reset the vertices awake[first:end] to their positions at the beginning of the substep."""
    for c in range(first, end):
        i = awake[c]
        store(x, i, load(xp, i))


@inner(error_model="numpy", fastmath={"contract"})
def update_velocities(count, awake, h, x, xp, v):
    """Compute the velocities v = (x - xp) / h."""
    inv_h = 1.0 / h
    for c in range(count):
        i = awake[c]
        store(v, i, inv_h * (load(x, i) - load(xp, i)))
