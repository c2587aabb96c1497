"""The side of a vertex at a triangle, against scipy's least squares."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from foldcell.skills.cloth.contact import vertex_sides as sides
from foldcell.skills.cloth.contact.contacts import MAX_WAIT, RELEASE, STRAY
from foldcell.skills.cloth.simd.i32x16 import LANES

THICK, SPAN, EDGE = 0.003, 0.004, 0.025


def judge(triangle, vertex, slide=None, remembered=None):
    """For each pair: verdict, side, normal (n, 3), weights (n, 3), the distance from which nothing is pushed, and
    all rows.

    triangle: (n, 3, 3). vertex, slide: (n, 3).
    """
    n = len(vertex)
    slide = np.zeros((n, 3)) if slide is None else slide
    remembered = np.zeros(n) if remembered is None else remembered
    rows = []
    for first in range(0, n, LANES):
        k = slice(first, first + LANES)
        work = np.zeros((sides.ROWS, LANES), np.float32)
        m = len(vertex[k])
        for row, value in (
            (sides.TO_SECOND, triangle[k, 1] - triangle[k, 0]), (sides.TO_THIRD, triangle[k, 2] - triangle[k, 0]),
            (sides.TO_VERTEX, vertex[k] - triangle[k, 0]), (sides.SLIDE, slide[k]),
        ):  # fmt: skip
            work[row : row + 3, :m] = value.T
        work[sides.SIDE, :m] = remembered[k]
        flat = work.ravel()
        sides.judge_sides(flat, np.float32(THICK), np.float32(SPAN))
        rows.append(flat.reshape(work.shape)[:, :m])
    out = np.concatenate(rows, axis=1).astype(float)
    second, third = out[sides.SECOND], out[sides.THIRD]
    weights = np.stack([1.0 - second - third, second, third], axis=1)
    return (
        out[sides.VERDICT],
        out[sides.SIDE],
        out[sides.NORMAL : sides.NORMAL + 3].T,
        weights,
        out[sides.LEAST],
        out,
    )


def nearest(triangle, vertex):
    """Barycentric weights of the triangle's point that is nearest to a vertex: non-negative least squares, with a
    heavy row for the sum of the weights."""
    scale = 1e3 / EDGE
    a = np.vstack([triangle.T / EDGE, np.full(3, scale)])
    return nnls(a, np.append(vertex / EDGE, scale))[0]


def some(seed, n, height):
    """Random triangles, and vertices near them, up to `height` from their planes [m]."""
    rng = np.random.default_rng(seed)
    flat = np.array([[0.0, 0.0, 0.0], [EDGE, 0.0, 0.0], [0.5 * EDGE, 0.8 * EDGE, 0.0]])
    triangle = flat + np.array([0.004, 0.004, 0.0]) * rng.standard_normal((n, 3, 3))
    weights = rng.uniform(-0.3, 1.0, (n, 3))
    weights /= weights.sum(axis=1, keepdims=True)
    vertex = np.einsum("nk,nkd->nd", np.clip(weights, -0.4, 1.4), triangle)
    vertex[:, 2] += rng.uniform(-height, height, n)
    turn = Rotation.random(n, random_state=seed).as_matrix()
    shift = rng.standard_normal((n, 3))
    return (
        np.einsum("nij,nkj->nki", turn, triangle) + shift[:, None],
        np.einsum("nij,nj->ni", turn, vertex) + shift,
    )


def test_a_vertex_is_stopped_by_the_nearest_point_of_the_triangle():
    triangle, vertex = some(1, 3000, 0.8 * THICK)
    verdict, _, normal, weights, least, out = judge(triangle, vertex)
    wanted = np.array([nearest(*pair) for pair in zip(triangle, vertex, strict=True)])
    way = vertex - np.einsum("nk,nkd->nd", wanted, triangle)
    away = np.linalg.norm(way, axis=1)
    touch = (verdict == sides.TOUCHES) & (away < THICK) & (away > 1e-4)
    beside = touch & (out[sides.WITHIN] < -1e-3)
    assert touch.sum() > 500
    assert beside.sum() > 100
    np.testing.assert_allclose(weights[touch], wanted[touch], atol=2e-4)
    np.testing.assert_allclose(normal[touch], way[touch] / away[touch, None], atol=2e-3)
    np.testing.assert_allclose(least[touch], THICK, rtol=1e-6)


@given(seed=st.integers(0, 10**6))
def test_no_vertex_farther_than_the_thickness_is_pushed(seed):
    triangle, vertex = some(seed, 64, 1.5 * THICK)
    verdict, _, normal, weights, least, _ = judge(triangle, vertex)
    away = np.array([
        np.linalg.norm(v - nearest(t, v) @ t) for t, v in zip(triangle, vertex, strict=True)
    ])  # fmt: skip
    gap = np.einsum("nd,nd->n", normal, vertex - np.einsum("nk,nkd->nd", weights, triangle))
    apart = (verdict == sides.TOUCHES) & (away > THICK + 1e-7)
    assert (gap[apart] >= least[apart] - 1e-7).all()


@given(seed=st.integers(0, 10**6))
def test_the_push_is_continuous_where_a_vertex_crosses_a_border(seed):
    """The vertex stays on its side, above the plane."""
    rng = np.random.default_rng(seed)
    steps = 400
    triangle = np.array([[0.0, 0.0, 0.0], [EDGE, 0.0, 0.0], [0.4 * EDGE, 0.9 * EDGE, 0.0]])
    ends = rng.uniform(-0.2 * EDGE, 1.2 * EDGE, (2, 2))
    t = np.linspace(0.0, 1.0, steps)[:, None]
    height = rng.uniform(0.4 * THICK, 1.2 * THICK, 2)
    path = np.hstack([ends[0] + t * (ends[1] - ends[0]), height[0] + t * (height[1] - height[0])])
    verdict, _, normal, weights, least, _ = judge(
        np.repeat(triangle[None], steps, axis=0), path, remembered=np.ones(steps)
    )
    gap = np.einsum("nd,nd->n", normal, path - weights @ triangle)
    push = np.where(verdict == sides.TOUCHES, np.maximum(least - gap, 0.0), 0.0)[:, None] * normal
    step = np.linalg.norm(path[1] - path[0])
    assert np.linalg.norm(np.diff(push, axis=0), axis=1).max() < 3.0 * step + 1e-6


def test_a_vertex_out_of_reach_has_no_side_and_its_distance_is_returned():
    triangle, vertex = some(3, 2000, 6.0 * THICK)
    slide = np.random.default_rng(3).standard_normal((2000, 3))
    verdict, side, *_, out = judge(triangle, vertex, slide, remembered=np.ones(2000))
    away = np.array([np.linalg.norm(v - nearest(t, v) @ t) for t, v in zip(triangle, vertex, strict=True)])
    reach = STRAY + 1.5 * SPAN * np.linalg.norm(slide, axis=1)
    np.testing.assert_allclose(out[sides.REACH], reach, rtol=1e-5)
    far = verdict == sides.AWAY
    assert far.sum() > 200
    assert (away[far] > THICK + reach[far] - 1e-7).all()
    wait = 1.0 + np.clip((away - RELEASE * THICK) / reach - 1.0, 0.0, MAX_WAIT)
    np.testing.assert_allclose(out[sides.WAIT], np.where(far, wait, 0.0), atol=1e-3)
    assert (side[far & (away > RELEASE * THICK + 1e-6)] == 0.0).all()


@pytest.mark.parametrize("remembered", [1.0, -1.0])
def test_a_vertex_pressed_through_a_triangle_is_pushed_back_to_its_side(remembered):
    triangle = np.array([[[0.0, 0.0, 0.0], [EDGE, 0.0, 0.0], [0.4 * EDGE, 0.9 * EDGE, 0.0]]])
    vertex = np.array([[0.4 * EDGE, 0.3 * EDGE, -remembered * 0.001]])
    verdict, side, normal, *_ = judge(triangle, vertex, remembered=np.array([remembered]))
    assert (verdict[0], side[0]) == (sides.TOUCHES, remembered)
    np.testing.assert_allclose(normal[0], [0.0, 0.0, remembered], atol=1e-6)


def test_a_triangle_without_area_touches_nothing():
    triangle = np.array([[[0.0, 0.0, 0.0], [EDGE, 0.0, 0.0], [0.5 * EDGE, 0.0, 0.0]]])
    verdict, *_ = judge(triangle, np.array([[0.5 * EDGE, 0.0, 0.001]]))
    assert verdict[0] != sides.TOUCHES


@pytest.mark.parametrize("edge", [0.015, 0.025, 0.045])
def test_a_loaded_vertex_that_slides_off_a_border_does_not_drop(edge):
    """In each step the vertex falls by at most an eighth of the thickness until it is beside the border, and it
    hardly rises again. A vertex that is raised and lowered in turn would shake."""
    triangle = np.array([[0.0, 0.0, 0.0], [edge, 0.0, 0.0], [0.5 * edge, 0.9 * edge, 0.0]])
    vertex, heights = np.array([0.45 * edge, 0.0, THICK]), [THICK]
    while vertex[1] > -1.5 * THICK:
        vertex[1] -= 2e-5
        verdict, _, normal, weights, least, rows = judge(triangle[None], vertex[None], remembered=np.ones(1))
        if verdict[0] == sides.TOUCHES:
            aim = least[0] if rows[sides.WITHIN][0] < -sides.BORDER else THICK
            room = normal[0] @ (vertex - weights[0] @ triangle) - aim
            if room > 0.0:
                vertex[2] -= room / normal[0, 2]
            else:
                vertex -= room * normal[0]
        else:
            vertex[2] = 0.0
        heights.append(vertex[2])
    step = np.diff(heights)
    assert heights[-1] < 1e-3 * THICK
    assert step.min() > -0.125 * THICK
    assert step.max() < 0.01 * THICK
