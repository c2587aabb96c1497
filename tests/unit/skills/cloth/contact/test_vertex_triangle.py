"""Contacts of a vertex with neighbouring triangles: over the border of nearly coplanar triangles there is one
contact."""

import numpy as np
import pytest

from foldcell.skills.cloth.contact.contacts import RELEASE
from foldcell.skills.cloth.contact.vertex_triangle import narrow_vertex_triangle
from foldcell.skills.cloth.state import new_pairs
from tests.builders.cloth import call, rows

THICK = 0.003


def fan(lift: float = 0.0):
    """Six triangles around the origin with corners raised by `lift` [m], and a vertex above them. Returns
    positions and triangles."""
    a = np.arange(6) * np.pi / 3.0
    ring = np.column_stack([0.02 * np.cos(a), 0.02 * np.sin(a), np.full(6, lift)])
    x = np.vstack([np.zeros(3), ring, [0.0, 0.0, THICK]])
    tri = np.array([[0, 1 + k, 1 + (k + 1) % 6] for k in range(6)], np.int32)
    return x, tri


def contacts(x, tri, order, borne=None, speed=0.0):
    """Contacts of the last vertex with all triangles, listed in this order. Returns triangles, barycentric weights
    and impulses."""
    pairs, kept = narrow(x, tri, order, borne, speed)
    return (
        [int(pairs.vt[c, 1]) for c in pairs.contact_pairs[:kept]],
        pairs.contact_weights[:kept],
        pairs.contact_impulses[:kept, :3],
    )


def pushes(x, tri):
    """Distance by which each contact pushes the last vertex away [m]."""
    pairs, kept = narrow(x, tri, np.arange(len(tri)))
    ends = x[pairs.contact_vertices[:kept]]
    gap = np.einsum("ck,ckd,cd->c", pairs.contact_weights[:kept], ends, pairs.contact_normals[:kept, :3])
    return pairs.contact_distances[:kept] - gap


def narrow(x, tri, order, borne=None, speed=0.0):
    """The narrow phase for the last vertex. speed: upward speed of this vertex [m/s]."""
    m, n = len(order), len(x)
    pairs = new_pairs(m, 0)
    pairs.vt[:, 0], pairs.vt[:, 1] = n - 1, order
    pairs.vt_j[:, :3] = 0.0 if borne is None else borne[order]
    place, v, last = rows(n), rows(n), np.full(n, -1, np.int32)
    place[:, :3], v[-1, 2] = x, speed
    kept, _ = call(narrow_vertex_triangle, m, 0, 4, 0.001, THICK, tri, place, v, np.ones(n), pairs, last)
    assert (last == -1).all()  # the scratch array is reset
    assert not pairs.contact_normals[:, 3].any()
    return pairs, kept


@pytest.mark.parametrize("seed", range(3))
def test_a_vertex_over_a_corner_has_one_contact_with_the_whole_load(seed):
    x, tri = fan()
    borne = np.random.default_rng(seed).normal(size=(6, 3))
    order = np.random.default_rng(seed).permutation(6)
    for t in range(6):
        assert contacts(x, tri, [t])[0] == [t]  # each triangle alone has a contact
    kept, weight, push = contacts(x, tri, order, borne)
    assert len(kept) == 1
    np.testing.assert_allclose(weight[0], [1.0, -1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(push[0], borne.sum(axis=0))


def test_the_kept_triangle_does_not_depend_on_the_order_of_the_pairs():
    x, tri = fan()
    for toward in range(6):
        a = (toward + 0.5) * np.pi / 3.0
        x[-1, :2] = 2e-4 * np.cos(a), 2e-4 * np.sin(a)
        for seed in range(4):
            kept, _, _ = contacts(x, tri, np.random.default_rng(seed).permutation(6))
            assert kept == [toward]


def test_weights_are_continuous_across_a_border():
    x, tri = fan()
    at = []
    for turn in (-1e-6, 1e-6):  # both sides of the edge 0-1
        x[-1, :2] = 0.01 * np.cos(turn), 0.01 * np.sin(turn)
        kept, weight, _ = contacts(x, tri, np.arange(6))
        share = np.zeros(len(x))
        share[tri[kept[0]]] = weight[0, 1:]
        at.append((kept, share))
    assert at[0][0] != at[1][0]
    np.testing.assert_allclose(at[0][1], at[1][1], atol=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_the_load_shares_do_not_depend_on_the_order_of_the_pairs(seed):
    rng = np.random.default_rng(seed)
    x, tri = fan()
    x[1:7, 2] = 0.008 * rng.standard_normal(6)
    x[-1] = *(3e-4 * rng.standard_normal(2)), 0.5 * THICK
    borne = rng.standard_normal((6, 3))
    shares = []
    for _ in range(4):
        kept, _, push = contacts(x, tri, rng.permutation(6), borne)
        shares.append(dict(zip(kept, push.tolist(), strict=True)))
    for other in shares[1:]:
        assert other.keys() == shares[0].keys()
        for t, push in other.items():
            np.testing.assert_allclose(push, shares[0][t])


def test_a_fast_vertex_beside_a_triangle_keeps_its_side():
    """The vertex is further off than the distance at which sides are remembered, but reaches the triangle before
    the next narrow phase. Its side must be known then."""
    x, tri = fan()
    pairs, place, speed, last = new_pairs(1, 0), rows(len(x)), rows(len(x)), np.full(len(x), -1, np.int32)
    pairs.vt[0] = len(x) - 1, 0
    place[:, :3] = x
    place[-1, :3] = -0.0025, 0.0, 0.0035  # beside and above corner 0 of the triangle
    speed[-1, 2] = -1.0
    kept, _ = call(
        narrow_vertex_triangle, 1, 0, 4, 0.001, THICK, tri[:1], place, speed, np.ones(len(x)), pairs, last
    )
    assert np.linalg.norm(place[-1]) > RELEASE * THICK
    assert kept == 1 and pairs.side[0] == 1


def test_a_vertex_in_a_valley_has_a_contact_with_each_wall():
    """The walls are 45 degrees steep. A vertex at the bottom touches the walls on both sides."""
    x, tri = fan(lift=0.02)
    x[-1] = [0.0, 0.0, 0.5 * THICK]
    kept, _, _ = contacts(x, tri, np.arange(6))
    assert len(kept) > 1


def test_a_vertex_over_a_peak_and_over_no_triangle_still_has_a_contact():
    """The vertex is a little beside the peak, over a steep flank, and in no triangle's prism."""
    x, tri = fan(lift=-0.02)
    x[-1] = 1e-4, 2e-5, 0.8 * THICK
    kept, weight, _ = contacts(x, tri, np.arange(6))
    assert len(kept) >= 1
    np.testing.assert_allclose(weight[:, 1:].sum(axis=1), -1.0)
    share = np.zeros((len(kept), len(x)))
    for k, t in enumerate(kept):
        share[k, tri[t]] = -weight[k, 1:]
    assert (share[:, 0] > 0.95).all()  # the peak bears the vertex


def test_a_sheet_beside_a_sheet_has_no_side():
    x, tri = fan()
    x[-1] = 0.022, 0.0, 0.0005  # 2 mm beside a corner, and hardly above it
    kept, _, _ = contacts(x, tri, np.arange(6))
    assert kept == []


@pytest.mark.parametrize("bend", [30.0, 50.0, 80.0])
@pytest.mark.parametrize("seed", range(20))
def test_no_plane_pushes_a_vertex_that_is_clear_of_a_ridge(bend, seed):
    """Both planes of the ridge are nearer to the vertex than the cloth's thickness."""
    rng = np.random.default_rng(seed)
    half = np.deg2rad(bend) / 2.0
    down = np.array([np.cos(half), -np.sin(half)])
    x = np.array([
        [0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.01, *(0.02 * down)], [0.01, *(0.02 * down * [-1.0, 1.0])],
        [0.0, 0.0, 0.0],
    ])  # fmt: skip
    tri = np.array([[0, 1, 2], [1, 0, 3]], np.int32)
    lean = rng.uniform(-half, half)
    x[-1, 0] = rng.uniform(0.002, 0.018)
    x[-1, 1:] = rng.uniform(1.0, 1.08) * THICK * np.array([np.sin(lean), np.cos(lean)])
    push = pushes(x, tri)
    assert len(push) > 0
    assert (push < 1e-7).all()


@pytest.mark.parametrize(("beside", "borne"), [(1e-4, True), (4e-4, True), (7e-4, True), (1.5e-3, False)])
def test_a_hem_rests_on_the_hem_below(beside, borne):
    """A hem vertex up to a millimetre beside the hem below rests at the same height as cloth further inside."""
    hem = [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.01, 0.02, 0.0], [0.04, 0.0, 0.0], [0.03, 0.02, 0.0]]
    vertex = [0.018, -beside, np.sqrt(THICK**2 - 0.9 * beside**2)]  # farther away than the thickness, but lower
    push = pushes(np.array([*hem, vertex]), np.array([[0, 1, 2], [1, 3, 4]], np.int32))
    assert len(push) == 1
    np.testing.assert_allclose(push, THICK - vertex[2] if borne else 0.0, atol=1e-8)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
@pytest.mark.parametrize("inside", [0.0002, -0.0002])
def test_a_vertex_under_two_layers_joined_at_a_hem_meets_the_nearer_one(order, inside):
    """This also holds at the border of the nearer layer, although the vertex is farther inside the other layer,
    which is nearly parallel and within reach before the next narrow phase."""
    x = np.array([
        [0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.01, 0.02, 0.0],
        [0.02, -0.004, THICK], [0.01, 0.02, THICK], [0.012, inside, -THICK],
    ])  # fmt: skip
    tri = np.array([[0, 1, 2], [0, 3, 4]], np.int32)
    borne = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
    kept, _, push = contacts(x, tri, order, borne, speed=1.0)
    assert 0 in kept
    np.testing.assert_allclose(push[kept.index(0)], borne[0])
