"""Collision checks against geometry computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.motion.peers import clearance
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.ports import Side, arm_slice
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.vocabulary import Table, tool_rotation

TABLE = Table(-0.10, (0.20, 1.10), (-0.75, 0.75))


@pytest.fixture(scope="module")
def model():
    return load_model()


@pytest.fixture(scope="module")
def checker(model):
    return CollisionChecker(model, TABLE)


def hand_at(model, side, x, y, height, heading=0.0):
    """Joints (14,) with one hand pointing down, its tip `height` [m] above the table, and the other arm parked."""
    T = np.eye(4)
    T[:3, :3] = tool_rotation(np.array([heading]), np.zeros(1), np.zeros(1))[0]
    T[:3, 3] = [x, y, TABLE.height + height]
    q = np.array(model.q_park)
    seeds = np.random.default_rng(5).uniform(-1, 1, (30, 7)) + model.park(side)
    seeds = np.clip(seeds, model.planning.lower[arm_slice(side, 14)], model.planning.upper[arm_slice(side, 14)])
    q[arm_slice(side, 14)] = ik.solve_seeds(model, side, T, seeds)[0]
    return q


def test_the_parked_arms_are_free_of_collisions(model, checker):
    assert checker.contact(model.q_park) is None
    assert clearance(checker, model.q_park) > 0.1


def test_a_hand_over_the_table_is_free_and_one_through_it_is_not(model, checker):
    high, low = hand_at(model, Side.LEFT, 0.6, 0.2, 0.10), hand_at(model, Side.LEFT, 0.6, 0.2, -0.10)
    assert not checker.in_collision(high)
    assert checker.in_collision(low) and checker.in_collision(low, allow_fingertips=True)
    contact = checker.contact(low)
    assert contact is not None and contact.second == "table" and contact.first.startswith("l")


def test_fingertips_may_touch_only_when_allowed(model, checker):
    touching = hand_at(model, Side.RIGHT, 0.6, -0.2, 0.002)
    assert checker.in_collision(touching)
    assert checker.contact(touching).first in model.fingertips[Side.RIGHT]
    assert not checker.in_collision(touching, allow_fingertips=True)
    assert clearance(checker, touching) < 0.0 < clearance(checker, touching, allow_fingertips=True)


def test_the_clearance_above_the_table_is_the_height_of_the_fingertips(model, checker):
    """The finger boxes of the URDF end 5.15 mm beyond the tool's origin."""
    for height in (0.05, 0.08):
        q = hand_at(model, Side.LEFT, 0.65, 0.25, height)
        assert clearance(checker, q) == pytest.approx(height - 0.00515, abs=5e-5)


def test_hands_collide_with_each_other(model, checker):
    q = hand_at(model, Side.LEFT, 0.6, 0.03, 0.15)
    q[arm_slice(Side.RIGHT, 14)] = hand_at(model, Side.RIGHT, 0.6, -0.03, 0.15)[arm_slice(Side.RIGHT, 14)]
    contact = checker.contact(q)
    assert contact is not None
    assert {contact.first.split("_")[0][0], contact.second.split("_")[0][0]} == {"l", "r"}
    q = hand_at(model, Side.LEFT, 0.6, 0.2, 0.15)
    q[arm_slice(Side.RIGHT, 14)] = hand_at(model, Side.RIGHT, 0.6, -0.2, 0.15)[arm_slice(Side.RIGHT, 14)]
    assert checker.contact(q) is None


def test_a_collision_verdict_agrees_with_the_distances(model, checker):
    """Two code paths of coal agree: the verdict with margins, and the distances."""
    rng = np.random.default_rng(8)
    plain = CollisionChecker(model, TABLE, body_margin=0.0, table_margin=0.0, fingertip_margin=0.0)
    met = 0
    for _ in range(60):
        q = rng.uniform(model.planning.lower, model.planning.upper)
        assert plain.in_collision(q) == (clearance(plain, q) <= 1e-6)
        if plain.in_collision(q):
            met += 1
            assert checker.in_collision(q)
    assert 10 < met < 50


def test_bodies_nearer_than_the_margin_are_in_contact(model):
    """With one margin for all pairs, the smallest distance decides."""
    rng, margin, verdicts = np.random.default_rng(9), 0.03, []
    wide = CollisionChecker(model, TABLE, body_margin=margin, table_margin=margin, fingertip_margin=margin)
    other = hand_at(model, Side.RIGHT, 0.6, -0.1, 0.12)[arm_slice(Side.RIGHT, 14)]
    for _ in range(12):
        q = hand_at(model, Side.LEFT, 0.6, float(rng.uniform(0.0, 0.15)), float(rng.uniform(0.02, 0.12)))
        q[arm_slice(Side.RIGHT, 14)] = other
        verdicts.append(wide.in_collision(q))
        assert verdicts[-1] == (clearance(wide, q) < margin)
    assert {True, False} == set(verdicts)


@pytest.mark.parametrize(("height", "free"), [(0.019, False), (0.021, True)])
def test_free_motions_keep_the_fingers_off_folded_cloth(model, checker, height, free):
    q = hand_at(model, Side.LEFT, 0.65, 0.25, height + 0.00515)
    assert checker.in_collision(q) is not free
    assert checker.first_collision(np.array([q, q])) is None or not free
    assert checker.edge_free(q, q) is free and not checker.in_collision(q, allow_fingertips=True)


def test_a_straight_motion_between_free_poses_can_be_in_collision(model, checker):
    """The hands swap sides, so the straight motion leads them through each other."""
    a, b = hand_at(model, Side.LEFT, 0.75, 0.05, 0.10), hand_at(model, Side.LEFT, 0.45, 0.05, 0.10)
    other = hand_at(model, Side.RIGHT, 0.60, 0.0, 0.10)[arm_slice(Side.RIGHT, 14)]
    assert checker.edge_free(a, b)
    a[arm_slice(Side.RIGHT, 14)] = b[arm_slice(Side.RIGHT, 14)] = other
    assert not checker.in_collision(a) and not checker.in_collision(b)
    assert not checker.edge_free(a, b)
    assert checker.first_collision(np.linspace(a, b, 20)) is not None


def test_contacts_on_a_path_are_located(model, checker):
    up, down = hand_at(model, Side.LEFT, 0.6, 0.2, 0.12), hand_at(model, Side.LEFT, 0.6, 0.2, -0.05)
    contact = checker.first_collision(np.array([up, up, down, up]))
    assert contact is not None and contact.index == 2


@pytest.mark.parametrize("distance", [0.01, 0.2, 0.33])
def test_a_straight_motion_is_checked_at_a_maximum_spacing_and_at_its_end(model, monkeypatch, distance):
    checker, met = CollisionChecker(model, TABLE), []
    monkeypatch.setattr(checker, "in_collision", lambda q, **_: met.append(np.array(q)) or False)
    a, b = model.q_park, model.q_park + distance * np.linspace(-1.0, 0.5, 14)
    assert checker.edge_free(a, b)
    way = np.sort([np.abs(q - a).max() for q in met])
    assert way[-1] == pytest.approx(distance) and np.diff([0.0, *way]).max() <= 0.05 + 1e-9


def hands_at(model, distance):
    """Joints (14,) with both hands `distance` [m] apart, 0.2 m above the table."""
    q = hand_at(model, Side.LEFT, 0.6, distance / 2, 0.2)
    q[arm_slice(Side.RIGHT, 14)] = hand_at(model, Side.RIGHT, 0.6, -distance / 2, 0.2)[arm_slice(Side.RIGHT, 14)]
    return q


def test_hands_that_are_too_near_may_part_but_not_come_nearer_or_stay(model, checker):
    apart, inwards = hands_at(model, 0.3), np.r_[-0.01, np.zeros(6), 0.01, np.zeros(6)]
    near = apart
    while not checker.in_collision(near):
        near = near + inwards
    parting = near + np.linspace(0.0, 1.0, 40)[:, None] * (apart - near)
    assert checker.first_contact_after_parting(parting) is None
    back_and_forth = np.vstack([parting[:3], parting[1::-1], parting])
    for refused in (parting[:1], back_and_forth, parting[0] - 0.2 * (parting - parting[0])):
        contact = checker.first_contact_after_parting(refused)
        assert contact is not None
        assert {contact.first.split("_")[0][0], contact.second.split("_")[0][0]} == {"l", "r"}


def test_hands_that_part_may_touch_nothing_else(model, checker):
    near, down = hands_at(model, 0.13), hand_at(model, Side.LEFT, 0.6, 0.25, -0.05)
    down[arm_slice(Side.RIGHT, 14)] = near[arm_slice(Side.RIGHT, 14)]
    assert checker.in_collision(near)
    path = near + np.linspace(0.0, 1.0, 30)[:, None] * (down - near)
    met = [getattr(checker.contact(q), "second", None) for q in path].index("table")
    for way in (path, np.vstack([path[: met + 1], path[met - 1]])):  # and a touch of one sample
        contact = checker.first_contact_after_parting(way)
        assert contact is not None and (contact.index, contact.second) == (met, "table")
