# mypy: allow-untyped-defs, allow-incomplete-defs
"""Moves the cloth between the pads: material points follow the tools and slip out when they are pulled too
hard."""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.inner import inner

CLOSING = 0.12  # [s] time in which a closing pinch draws the cloth to the middle of the pads


@inner(error_model="numpy", fastmath={"contract"})
def hold(
    points, age, owner, vertex, bary, offset, height, impulse, soft, x, wa, since, position0, rotation0, position1,
    rotation1, a, pose
):  # fmt: skip
    """Move the pinched points towards their places in the tools. The poses of both hands are interpolated: a = 0
    gives position0 (2, 3) and rotation0 (2, 3, 3), a = 1 gives position1 and rotation1. since: time from the
    beginning of the frame [s]. pose: (4, 3) scratch."""
    for hand in range(2):
        if points[hand] == 0:
            continue
        for d in range(3):
            pose[0, d] = position0[hand, d] + a * (position1[hand, d] - position0[hand, d])
            for m in range(3):
                pose[1 + m, d] = rotation0[hand, d, m] + a * (rotation1[hand, d, m] - rotation0[hand, d, m])
        ramp = max(0.0, 1.0 - (age[hand] + since) / CLOSING)
        _hold_line(hand, points[hand], pose, ramp, soft, x, wa, vertex, bary, offset, height, owner, impulse)


@inner(error_model="numpy", fastmath={"contract"})
def _hold_line(hand, count, pose, ramp, soft, x, wa, vertex, bary, offset, height, owner, impulse):
    """Hold the `count` points of one hand. Several layers are held as a stack with fixed distances. The stack
    turns freely, like a hinge, about the held line, which is parallel to the tool's x axis at the mean height of
    the stack: the pads transmit no moment about it. The angle of the stack is computed from the present positions
    of the cloth."""
    # mean height of the stack, and the moments of its layers about the line
    mean = 0.0
    end, n = 0, 0
    while n < count and end < len(owner):
        if owner[end] == hand:
            mean += height[end]
            n += 1
        end += 1
    mean /= count
    along, across = 0.0, 0.0
    for k in range(end):
        if owner[k] != hand:
            continue
        i, j, m = vertex[k, 0], vertex[k, 1], vertex[k, 2]
        y, z = 0.0, -mean
        for d in range(3):
            p = bary[k, 0] * x[i, d] + bary[k, 1] * x[j, d] + bary[k, 2] * x[m, d] - pose[0, d]
            y += p * pose[2, d]
            z += p * pose[3, d]
        along += (height[k] - mean) * z
        across += (height[k] - mean) * y
    size = np.sqrt(along * along + across * across)
    c, s = (along / size, across / size) if size > 1e-12 else (1.0, 0.0)
    for k in range(end):
        if owner[k] != hand:
            continue
        i, j, m = vertex[k, 0], vertex[k, 1], vertex[k, 2]
        bi, bj, bm = bary[k, 0], bary[k, 1], bary[k, 2]
        inv = 1.0 / (wa[i] * bi * bi + wa[j] * bj * bj + wa[m] * bm * bm + soft)
        r = height[k] - mean
        ox, oy = offset[k, 0], s * r + (offset[k, 1] - s * r) * ramp
        oz = mean + c * r + (offset[k, 2] - mean - c * r) * ramp
        for d in range(3):
            p = pose[0, d] + pose[1, d] * ox + pose[2, d] * oy + pose[3, d] * oz
            g = (p - bi * x[i, d] - bj * x[j, d] - bm * x[m, d]) * inv
            x[i, d] += wa[i] * bi * g
            x[j, d] += wa[j] * bj * g
            x[m, d] += wa[m] * bm * g
            impulse[hand, d] -= g


@inner()
def release_overloaded(holds):
    """Release the cloth of each hand whose pinch force exceeds its limit."""
    for hand in range(2):
        f2 = 0.0
        for m in range(3):
            f2 += holds.force[hand, m] ** 2
        if f2 > holds.limit[hand] ** 2:
            for k in range(len(holds.hand)):
                if holds.hand[k] == hand:
                    holds.hand[k] = -1
            holds.points[hand] = 0
