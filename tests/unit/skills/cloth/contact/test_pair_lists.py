"""Pair lists after a search: new pairs of stale clusters, old pairs of the others."""

import numpy as np
import pytest

from foldcell.skills.cloth.broad_phase.pairs import _have_room, _renew
from foldcell.skills.cloth.clusters import build_clusters
from foldcell.skills.cloth.contact.contacts import PARKED
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.state import new_pairs
from tests.builders.cloth import call

SHEET = mesh_from_contour(np.array([[-0.15, -0.1], [0.15, -0.1], [0.15, 0.1], [-0.15, 0.1]]), 0.026)
ROOM = 400


def drawn(rng, firsts, seconds, n):
    """n different random pairs."""
    at = rng.choice(firsts * seconds, n, replace=False)
    return np.column_stack([at // seconds, at % seconds]).astype(np.int32)


@pytest.mark.parametrize("seed", range(12))
def test_pairs_of_stale_clusters_are_replaced_and_others_kept(seed):
    """Both lists agree with sets, also when they become full. No pair is lost or duplicated, and the memory of a
    pair stays with it."""
    rng = np.random.default_rng(seed)
    clusters, pairs = build_clusters(SHEET, SHEET.edges), new_pairs(ROOM, ROOM)
    clusters.stale[:] = rng.random(len(clusters.stale)) < rng.choice([0.0, 0.1, 0.5, 1.0])
    none = np.zeros((ROOM, 4))
    kinds = (
        (pairs.vt, pairs.side, pairs.vt_due, pairs.vt_j, none, clusters.of_vertex, clusters.of_tri, pairs.new_vt),
        (pairs.ee, pairs.near, pairs.ee_due, pairs.ee_j, pairs.normal, clusters.of_edge, clusters.of_edge,
         pairs.new_ee),
    )  # fmt: skip
    for pair, known, due, borne, normal, of_first, of_second, new in kinds:
        flat = normal is none  # pairs of a vertex and a triangle have a side, but no normal
        n = rng.integers(0, ROOM + 1)
        pair[:n] = drawn(rng, len(of_first), len(of_second), n)
        known[:n] = rng.integers(-1 if flat else 0, 2, n)
        due[:n] = rng.choice([PARKED, 990], n)
        for memory in (borne, normal):
            memory[:n, :3] = rng.random((n, 3)) * (known[:n, None] != 0)
        if flat:
            normal[:] = 0.0

        def held(m, pair=pair, known=known, due=due, borne=borne, normal=normal):
            rows = zip(
                pair[:m].tolist(), known.tolist(), due.tolist(), borne.tolist(), normal.tolist(), strict=False
            )
            return {(i, j): (int(k), d, b, v if k else None) for (i, j), k, d, b, v in rows}

        before = held(n)
        stale = {p for p in before if clusters.stale[of_first[p[0]]] or clusters.stale[of_second[p[1]]]}
        # some earlier pairs are found again
        again = [p for p in sorted(stale) if rng.random() < 0.5]
        fresh = [tuple(p) for p in drawn(rng, len(of_first), len(of_second), ROOM).tolist()]
        found = [p for p in dict.fromkeys(again + fresh) if p in stale or p not in before]
        found = found[: rng.choice([len(stale) // 2, ROOM - n + len(stale)])]
        rng.shuffle(found)
        assert call(_have_room, len(found), n, pair, clusters.stale, of_first, of_second)
        new[: len(found)] = np.array(found, np.int32).reshape(-1, 2)
        count = call(
            _renew,
            n, 1000, clusters.stale, of_first.view(np.uint32), of_second.view(np.uint32), pair.view(np.uint32),
            known, due, borne, none[:0] if flat else normal, len(found), new, np.int64(len(of_second)),
            pairs.contact_vertices, pairs.kept, pairs.kept_normal, pairs.near_c, pairs.key, pairs.row,
        )  # fmt: skip
        after = held(count)
        assert len(after) == count
        kept = {p: v for p, v in before.items() if p not in stale and (v[0] != 0 or v[1] != PARKED)}
        nothing = (0, 1000, [0.0] * 4, None)
        renewed = {
            p: (v[0], 1000, *v[2:]) if (v := before.get(p, nothing))[0] and p in stale else nothing for p in found
        }
        assert after == kept | renewed


def test_the_room_for_new_pairs_includes_the_pairs_of_stale_clusters():
    pair = np.array([[0, 0], [1, 1], [0, 1], [7, 7]], np.int32)
    of = np.array([0, 1], np.int32)
    for stale, room in (((False, False), 1), ((True, False), 3), ((True, True), 4)):
        flags = np.array(stale)
        assert call(_have_room, room, 3, pair, flags, of, of) and not call(
            _have_room, room + 1, 3, pair, flags, of, of
        )
