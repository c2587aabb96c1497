"""Sweeps over contacts against least-distance programming, and the stopping rule."""

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError
from scipy.optimize import nnls
from scipy.sparse import coo_array
from scipy.spatial.transform import Rotation

from foldcell.skills.cloth.contact.contact_order import PARTS, group_contacts, take_turns
from foldcell.skills.cloth.contact.contacts import (
    APART,
    BORNE,
    MEMORY,
    OVERLAP_SHARE,
    PLACES,
    apply_impulses,
    average_impulses,
    edge_distance,
    lay_out,
    release_overlaps,
    solve_contacts,
)
from foldcell.skills.cloth.simd.f64x8 import EIGHT, blocks, coordinates, gather, load_f64x8, store_f64x8
from tests.builders.cloth import call, rows

THICK = 0.003


class Contacts:
    """n random contacts among m vertices: of a vertex and a triangle, or of two edges. Some overlap, some are
    apart."""

    def __init__(self, seed, n, m):
        rng = np.random.default_rng(seed)
        self.n, self.w = n, rng.uniform(500.0, 2000.0, m)
        self.w[rng.random(m) < 0.1] = 0.0  # sleeping vertices
        self.members = np.array([rng.choice(m, 4, replace=False) for _ in range(n)], np.uint32)
        over = rng.dirichlet(np.ones(3), n)
        s, t = rng.uniform(0.1, 0.9, (2, n))
        face = np.column_stack([np.ones(n), -over])
        edges = np.column_stack([1.0 - s, s, t - 1.0, -t])
        self.weight = np.where(rng.random((n, 1)) < 0.5, face, edges)
        self.share = self.weight * self.w[self.members]
        self.normal = rows(n)
        self.normal[:, :3] = Rotation.random(n, random_state=seed).as_matrix()[:, 0]
        self.den = (self.weight * self.share).sum(axis=1)
        self.inverse = 1.0 / np.maximum(self.den, 1.0)
        self.borne, self.apart = rows(n), rows(n)
        self.x = rows(m)
        self.x[:, :3] = 0.02 * rng.standard_normal((m, 3))
        self.aim = self.gaps() + 0.3 * THICK * rng.standard_normal(n)
        self.apart[:] = (self.aim + 1.0)[:, None] * self.normal  # no overlap existed before

    def gaps(self):
        between = np.einsum("nk,nkd->nd", self.weight, self.x[self.members])
        return np.einsum("nd,nd->n", self.normal, between)

    def groups(self):
        order, filled = np.zeros((self.n, EIGHT), np.uint32), np.zeros(self.n, np.uint8)
        count = call(group_contacts, self.n, self.members, np.zeros(len(self.w), np.int32), order, filled)
        return count, order, filled

    def sweep(self, tolerance, friction=0.0, back=False, groups=None):
        """One sweep over all contacts, or over these groups."""
        count, order, filled = self.groups() if groups is None else groups
        member, weight = np.zeros((EIGHT * count, 4), np.uint32), rows(EIGHT * count)
        share, block = rows(EIGHT * count), blocks(count, PLACES)
        call(lay_out,
            count, order, self.members, self.weight, self.share, self.normal, self.aim, self.inverse, self.borne,
            member, weight, share, block,
        )  # fmt: skip
        block[:, APART : APART + 3] = self.apart[order[:count], :3].transpose(0, 2, 1)
        moved = call(
            solve_contacts,
            count,
            order,
            filled,
            member,
            weight,
            share,
            block,
            self.x,
            friction,
            back,
            tolerance,
            rows(self.n),
        )
        self.borne[order[:count], :3] = block[:, BORNE : BORNE + 3].transpose(0, 2, 1)
        return moved

    def turns(self):
        turn, level, first = (np.zeros(self.n + k, np.uint32) for k in (0, 0, 1))
        call(take_turns, self.n, self.members, np.zeros(len(self.w), np.int32), turn, level, first)
        return turn


def least_motion(contacts):
    """The positions with the smallest mass-weighted motion in which no contact is too near (Lawson & Hanson 1974,
    chapter 23)."""
    n, m = contacts.n, len(contacts.w)
    entries = contacts.weight[:, :, None] * contacts.normal[:, None, :3]
    column = 3 * contacts.members.astype(int)[:, :, None] + np.arange(3)
    row = np.broadcast_to(np.arange(n)[:, None, None], column.shape)
    jacobian = coo_array((entries.ravel(), (row.ravel(), column.ravel())), shape=(n, 3 * m)).toarray()
    root = np.sqrt(np.repeat(contacts.w, 3))
    lack = contacts.aim - contacts.gaps()
    scale = np.abs(lack).max()
    y = np.append(np.zeros(3 * m), 1.0)
    e = np.vstack([(jacobian * root).T / np.sqrt(contacts.w.max()), lack / scale])
    r = e @ nnls(e, y, maxiter=100 * n)[0] - y
    moved = -r[:-1] / r[-1] * scale / np.sqrt(contacts.w.max())
    return contacts.x[:, :3] + (root * moved).reshape(m, 3)


@pytest.mark.parametrize("n, m", [(1, 4), (30, 60), (301, 200), (40, 9)])
def test_groups_keep_the_order_of_contacts_that_share_a_vertex(n, m):
    contacts = Contacts(3, n, m)
    count, order, filled = contacts.groups()
    members = [order[g, : filled[g]] for g in range(count)]
    assert sorted(np.concatenate(members)) == list(range(n))
    assert all(len(np.unique(contacts.members[c])) == 4 * len(c) for c in members)
    length = -(-n // PARTS)
    group, turn = np.empty(n, int), np.empty(n, int)
    for g, c in enumerate(members):
        group[c] = g
    turn[np.lexsort((np.arange(n) // length, np.arange(n) % length))] = np.arange(n)
    shared = (contacts.members[:, None, :, None] == contacts.members[None, :, None, :]).any(axis=(2, 3))
    later = shared & (turn[:, None] < turn[None, :])
    assert (group[:, None] < group[None, :])[later].all()
    assert all((order[g, filled[g] :] == order[g, 0]).all() for g in range(count))


@pytest.mark.parametrize("friction", [0.0, 0.6])
@pytest.mark.parametrize("n, m", [(1, 4), (7, 60), (301, 200), (40, 9)])
def test_contacts_in_groups_of_eight_give_the_same_bits_as_one_by_one(n, m, friction):
    """This holds for forward and backward sweeps."""
    together, alone = Contacts(3, n, m), Contacts(3, n, m)
    length = -(-n // PARTS)
    turn = np.lexsort((np.arange(n) // length, np.arange(n) % length)).astype(np.uint32)
    one_by_one = n, np.repeat(turn[:, None], EIGHT, axis=1), np.ones(n, np.uint8)
    for sweep in range(5):
        moved = alone.sweep(1e-3 * THICK, friction, sweep % 2 == 1, one_by_one)
        assert together.sweep(1e-3 * THICK, friction, sweep % 2 == 1) == moved
        assert together.x.tobytes() == alone.x.tobytes() and together.borne.tobytes() == alone.borne.tobytes()


@pytest.mark.parametrize("n, m", [(1, 4), (30, 60), (301, 200), (40, 9)])
def test_turns_keep_the_order_of_contacts_that_share_a_vertex(n, m):
    contacts = Contacts(3, n, m)
    turn = contacts.turns()
    assert sorted(turn) == list(range(n))
    place = np.argsort(turn)
    shared = (contacts.members[:, None, :, None] == contacts.members[None, :, None, :]).any(axis=(2, 3))
    assert (place[:, None] < place[None, :])[np.triu(shared, 1)].all()


def test_consecutive_contacts_in_turns_rarely_share_vertices():
    contacts = Contacts(3, 300, 600)
    # groups of three consecutive contacts share all four vertices
    contacts.members[:] = np.arange(300)[:, None] // 3 + np.arange(4) * 110
    turn = contacts.turns()
    after = contacts.members[turn]
    assert (after[1:] == after[:-1]).any(axis=1).sum() <= 2


@pytest.mark.parametrize("n, m", [(1, 4), (301, 200), (40, 9)])
def test_contacts_in_turns_give_the_same_bits_as_in_listed_order(n, m):
    """This holds for releasing overlaps and for applying impulses. The reversed order gives other bits."""
    x, listed = [], np.arange(n, dtype=np.uint32)
    for turn in (Contacts(3, n, m).turns(), listed, listed[::-1].copy()):
        contacts = Contacts(3, n, m)
        before, contacts.borne[:, :3] = contacts.x.copy(), 1e-6 * contacts.normal[:, :3]
        contacts.borne[::3] = 0.0
        call(release_overlaps,
            n, turn, contacts.members, contacts.weight, contacts.share, contacts.normal, contacts.aim,
            contacts.inverse, contacts.x, before, 1e-3,
        )  # fmt: skip
        # both arrays are shifted equally
        assert contacts.x.tobytes() == before.tobytes() != Contacts(3, n, m).x.tobytes()
        call(apply_impulses, n, turn, contacts.members, contacts.share, contacts.borne, contacts.x)
        x.append(contacts.x.tobytes() + before.tobytes())
    assert x[0] == x[1] and (x[1] != x[2] or n == 1)


def test_only_a_share_of_an_overlap_is_released():
    for way in (-0.1, 0.1):
        contacts = Contacts(7, 1, 4)
        contacts.w[:] = 1000.0
        contacts.share = contacts.weight * contacts.w[contacts.members]
        contacts.inverse = 1.0 / (contacts.weight * contacts.share).sum(axis=1)
        contacts.aim = contacts.gaps() + way * THICK
        begun, before = contacts.gaps(), contacts.x.copy()
        call(release_overlaps,
            1, contacts.turns(), contacts.members, contacts.weight, contacts.share, contacts.normal, contacts.aim,
            contacts.inverse, contacts.x, before, 1.0,
        )  # fmt: skip
        released = OVERLAP_SHARE * max(way, 0.0) * THICK
        assert contacts.gaps() == pytest.approx(begun + released, abs=1e-12)


def test_the_contact_memory_follows_the_load():
    contacts = Contacts(3, 21, 40)
    contacts.borne[:, :3] = np.random.default_rng(0).standard_normal((21, 3))
    count, order, _ = contacts.groups()
    member, weight = np.zeros((EIGHT * count, 4), np.uint32), rows(EIGHT * count)
    share, block, memory = rows(EIGHT * count), blocks(count, PLACES), contacts.borne.copy()
    call(lay_out,
        count, order, contacts.members, contacts.weight, contacts.share, contacts.normal, contacts.aim,
        contacts.inverse, memory, member, weight, share, block,
    )  # fmt: skip
    for now in (3.0, 1.0):  # factor on the recent impulses
        block[:, BORNE : BORNE + 3] *= now
        wanted = memory * (1.0 + MEMORY * (now - 1.0))
        call(average_impulses, count, order, block, memory)
        np.testing.assert_allclose(memory, wanted, rtol=1e-12)
        begun = block[:, BORNE : BORNE + 3].transpose(0, 2, 1)
        assert (begun == memory[order[:count], :3]).all()  # the next substep begins with the averaged impulses


@pytest.mark.parametrize("seed", range(6))
def test_sweeps_converge_to_the_smallest_motion_without_overlaps(seed):
    contacts = Contacts(seed, 30, 60)
    wanted = least_motion(contacts)
    start = contacts.x[:, :3].copy()
    sweeps = 0
    while contacts.sweep(1e-12, back=sweeps % 2 == 1):
        sweeps += 1
        assert sweeps < 20000
    assert np.linalg.norm(wanted - start, axis=1).max() > 0.1 * THICK
    np.testing.assert_allclose(contacts.x[:, :3], wanted, atol=1e-7)


@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_a_sweep_returns_whether_it_moved_the_sides_of_a_contact(friction):
    """The motion is that of a removed overlap or of friction."""
    contacts = Contacts(7, 1, 4)
    contacts.w[:] = 1000.0
    contacts.share = contacts.weight * contacts.w[contacts.members]
    contacts.inverse = 1.0 / (contacts.weight * contacts.share).sum(axis=1)
    contacts.aim = contacts.gaps() + 0.1 * THICK
    begun = contacts.x.copy()
    between = np.einsum("nk,nkd->nd", contacts.weight, contacts.x[contacts.members])
    # the sides have approached each other by this distance along the normal
    contacts.apart[:] = between + 0.1 * THICK * contacts.normal
    assert contacts.sweep(0.099 * THICK, friction)
    assert contacts.gaps() == pytest.approx(contacts.aim, abs=1e-12)
    assert not contacts.sweep(1e-9 * THICK, friction)
    contacts.x[:], contacts.borne[:] = begun, 0.0
    assert not contacts.sweep(0.101 * THICK, friction)
    across = np.cross(contacts.normal[0, :3], [0.3, 0.5, 0.8])
    contacts.x[contacts.members[0, 0], :3] += (
        0.02 * THICK * across / np.linalg.norm(across) / contacts.weight[0, 0]
    )
    assert contacts.sweep(0.019 * THICK, friction) == (friction > 0.0)


def test_edges_push_at_less_than_the_distance_of_layers():
    for thick in np.linspace(0.0003, 0.01, 98):
        assert 0.5 * thick <= edge_distance(thick) <= 0.8 * thick
    assert edge_distance(0.0012) > 0.75 * 0.0012
    assert edge_distance(0.003) == 0.0015


WRONG = [np.zeros((8, 4), np.float32), np.zeros((4, 8)).T, np.zeros(32), np.zeros((8, 4), np.int64)]


@pytest.mark.parametrize("wrong", WRONG)
def test_arrays_of_another_type_or_layout_are_refused(wrong):
    """Otherwise their memory would be misread or overrun."""
    x, members, block = rows(8), np.zeros((8, 4), np.uint32), blocks(1, 1)
    order = np.zeros((1, EIGHT), np.uint32)
    for of in (
        lambda a: gather(a, members, x, 0), lambda a: gather(x, members, a, 0), lambda a: gather(x, a, x, 0),
        lambda a: coordinates(a, order, 0), lambda a: coordinates(x, a, 0), lambda a: load_f64x8(a, 0, 0),
        lambda a: store_f64x8(a, 0, 0, load_f64x8(block, 0, 0)),
    ):  # fmt: skip
        with pytest.raises(TypingError, match="C-ordered"):
            njit(of)(wrong)
