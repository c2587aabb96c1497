"""The simulated crease recovery test (AATCC 66 kind), and the calibration by it."""

import math
from functools import cache

import numpy as np
import pytest

from foldcell.calibration.crease import calibrate_crease, check_crease, kept_angle, load_pressure, press_coupons
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.cloth.crease_set import STANDARD_PRESSURE
from foldcell.skills.vocabulary import CREASE_SET, Material

COTTON = Material(
    areal_mass=0.135, stretch_fraction=0.02, bending_length=math.sqrt(0.023 * 0.0152), thickness=4e-4,
    friction_static=0.5, friction_dynamic=0.45, friction_layers=0.5,
)  # fmt: skip
"""Unfinished cotton (Fashion and Textiles 2017, s40691-017-0104-2, Table 13); mass and thickness assumed."""
EDGES = [0.002, 0.004, 0.008]


@cache
def kept(pressure, seconds, edge, crease_set=CREASE_SET, specimens=6):
    return math.degrees(press_coupons(COTTON, crease_set, pressure, seconds, edge=edge, specimens=specimens)[0])


def test_the_standard_weight_presses_with_18_kpa():
    assert load_pressure(0.5) == pytest.approx(STANDARD_PRESSURE, rel=1e-3)


def test_unfinished_cotton_keeps_its_measured_angle_on_any_mesh():
    """Crease recovery of warp and weft is 155 of 360 degrees, so a crease keeps 180 - 155 / 2 in the mean."""
    few = {EDGES[0]: 3}  # three specimens of the finest mesh take as long as twenty of the coarsest
    found = [kept(STANDARD_PRESSURE, 300.0, edge, specimens=few.get(edge, 6)) for edge in EDGES]
    assert found == pytest.approx([102.5] * 3, abs=15.0)
    assert np.ptp(found) < 15.0


def test_a_crease_keeps_more_after_a_longer_time_and_under_a_greater_load():
    edge = EDGES[-1]
    most = kept(STANDARD_PRESSURE, 300.0, edge)
    times = [*(kept(STANDARD_PRESSURE, t, edge, specimens=3) for t in (1.0, 30.0)), most]
    loads = [*(kept(p, 300.0, edge, specimens=3) for p in (0.0, 5e3)), most]
    assert min(np.diff(times)) > 8.0 and min(np.diff(loads)) > 8.0


@pytest.mark.parametrize("edge", EDGES[1:])
def test_a_fold_without_load_keeps_what_bending_friction_holds(edge):
    with_set, without = (kept(0.0, 30.0, edge, crease_set, 2) for crease_set in (CREASE_SET, 0.0))
    assert with_set == pytest.approx(without, rel=0.10)


def test_the_calibration_finds_the_set_of_a_simulated_fabric():
    true, pressure, edge = 0.35, load_pressure(1.0), EDGES[-1]
    measured = press_coupons(COTTON, true, pressure, 60.0, edge=edge)[0]
    test = calibrate_crease(COTTON, measured, 1.0, 60.0, edge=edge)
    assert test.agrees and test.crease_set == pytest.approx(true, abs=0.02)
    assert kept_angle(test.coupon.mesh, test.coupon.pictures[0]) == pytest.approx(math.pi, abs=0.02)
    assert test.coupon.times[-1] > 60.0


def test_an_angle_that_no_set_gives_does_not_agree():
    assert not calibrate_crease(COTTON, math.radians(5.0), 0.5, 300.0, edge=EDGES[-1]).agrees


@pytest.mark.parametrize(
    ("angle", "load", "time"), [(0.0, 0.5, 300.0), (100.0, 50.0, 300.0), (100.0, 0.5, math.nan)]
)
def test_impossible_measurements_are_refused(angle, load, time):
    with pytest.raises(ConfigurationError) as error:
        check_crease(math.radians(angle), load, time)
    assert error.value.hint and error.value.values
