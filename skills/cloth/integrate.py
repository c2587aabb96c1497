# mypy: allow-untyped-defs, allow-incomplete-defs
"""From velocities to positions and back, for the vertices awake[:count] (XPBD, Macklin et al. 2016)."""

from __future__ import annotations

import numpy as np
from numba import njit

from skills.cloth.simd.vec3 import dot, load, store, vector


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def integrate(count, awake, h, drag, max_speed, gravity, x, xp, v):
    """Where the vertices would be after a substep of h [s] if nothing but gravity and the air acted on them. xp:
    where they were."""
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


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def extrapolate(count, awake, g, x, xp, u):
    """u = x + g (x - xp), in which a constraint with damping is one without."""
    for c in range(count):
        i = awake[c]
        place = load(x, i)
        store(u, i, place + g * (place - load(xp, i)))


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def undo_extrapolation(count, awake, g, x, xp, u):
    """The x of which u is what `extrapolate` makes of it."""
    scale = 1.0 / (1.0 + g)
    for c in range(count):
        i = awake[c]
        store(x, i, scale * (load(u, i) + g * load(xp, i)))


@njit(nogil=True)
def restore_positions(first, end, awake, x, xp):
    """Those from `first` to `end` where they were."""
    for c in range(first, end):
        i = awake[c]
        store(x, i, load(xp, i))


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def update_velocities(count, awake, h, x, xp, v):
    """Velocities from displacements."""
    inv_h = 1.0 / h
    for c in range(count):
        i = awake[c]
        store(v, i, inv_h * (load(x, i) - load(xp, i)))
