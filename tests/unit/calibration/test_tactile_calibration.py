"""Tactile noise, drift and thresholds from readings of known noise and drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from foldcell.calibration.effects import RecordTactile, Touch
from foldcell.calibration.tactile import (
    FingerFigures,
    calibrate_tactile,
    false_contacts,
    finger_figures,
    thresholds,
)
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Side, TactileReading
from foldcell.skills.grasping.confirm import CONFIRM_READINGS
from foldcell.skills.grasping.tare import TARE_READINGS
from foldcell.skills.vocabulary import Outcome, Table
from tests.unit.calibration.conftest import run
from tests.unit.calibration.test_table_calibration import TABLE, press

CELL, TIP = 0.01, 0.03


def readings(seed: int = 0, cell: float = CELL, tip: float = TIP, slope: float = 0.0, seconds: float = 60.0):
    """Readings at 100 Hz. slope: drift of every cell [N/s]."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(100 * seconds)) / 100
    cells = cell * rng.standard_normal((len(t), 2, 4, 3)) + slope * t[:, None, None, None]
    tips = tip * rng.standard_normal((len(t), 2))
    return [TactileReading(float(a), Side.LEFT, b, c) for a, b, c in zip(t, cells, tips, strict=True)]


def test_noise_is_measured_in_spite_of_a_drift() -> None:
    for slope in (0.0, 0.002):
        f = finger_figures(Side.LEFT, readings(slope=slope)).unwrap()
        assert f.cell_noise == pytest.approx(CELL, rel=0.03) and f.tip_noise == pytest.approx(TIP, rel=0.05)
        assert f.pad_noise == pytest.approx(CELL * np.sqrt(12), rel=0.05) and f.rate == pytest.approx(100.0)
        # twelve cells per pad, fifteen seconds
        assert f.pad_drift == pytest.approx(12 * 15 * slope, abs=0.06) and f.tip_drift < 0.03


@pytest.mark.parametrize("period", [60.0, 20.0, 15.0, 7.5, 5.0])
def test_a_drift_that_returns_within_the_horizon_counts(period: float) -> None:
    """A sine of amplitude A changes by at most 2 A sin(pi t / period) in a time t, and by 2 A from half a period
    on. The zero may be taken and used at the worst moments."""
    swing = 0.25
    heard = [
        TactileReading(r.stamp, r.side, r.cells + swing / 12 * np.sin(2 * np.pi * r.stamp / period), r.tip)
        for r in readings()
    ]
    drift = 2 * swing * np.sin(np.pi * min(15.0 / period, 0.5))
    assert finger_figures(Side.LEFT, heard).unwrap().pad_drift == pytest.approx(drift, abs=0.06)


def test_noise_is_not_reported_as_drift() -> None:
    for seed in range(10):
        f = finger_figures(Side.LEFT, readings(seed)).unwrap()
        assert f.pad_drift < 0.02 and f.tip_drift < 0.02


@pytest.mark.parametrize("gain", [0.0, 0.05, 30.0])
def test_a_dead_or_erratic_cell_is_reported_by_name(gain: float) -> None:
    heard = readings()
    for r in heard:
        r.cells[1, 2, 0] *= gain
    refused = finger_figures(Side.RIGHT, heard).failure
    assert refused and refused.kind is FailureKind.HARDWARE_FAULT
    assert "right" in refused.what and "pad 1" in refused.what and "row 2, column 0" in refused.what


def test_too_few_readings_and_dead_tips_are_faults() -> None:
    assert finger_figures(Side.LEFT, readings()[:100]).failure
    assert finger_figures(Side.LEFT, []).failure
    still = [TactileReading(r.stamp, r.side, r.cells, np.zeros(2)) for r in readings()]
    refused = finger_figures(Side.LEFT, still).failure
    assert refused and "tip" in refused.what


def figures(tip_noise: float = TIP, pad_drift: float = 0.0, pad_noise: float = 0.035) -> FingerFigures:
    return FingerFigures(CELL, pad_noise, tip_noise, pad_drift, 0.0, 100.0)


def test_thresholds_are_ten_standard_deviations_of_the_compared_signal() -> None:
    contact, held = thresholds({Side.LEFT: figures()}).unwrap()
    assert contact == pytest.approx(10 * TIP * np.sqrt(1 + 1 / TARE_READINGS), abs=1e-3)
    mean = np.sqrt(1 / CONFIRM_READINGS + 1 / TARE_READINGS)
    assert held == pytest.approx(10 * 0.035 * mean, abs=1e-3)


def test_the_worse_hand_decides_and_more_noise_never_lowers_a_threshold() -> None:
    calm, loud = figures(), figures(0.05, 0.2, 0.06)
    both = thresholds({Side.LEFT: calm, Side.RIGHT: loud}).unwrap()
    assert both == thresholds({Side.LEFT: loud}).unwrap()
    assert np.all(np.array(both) > thresholds({Side.LEFT: calm}).unwrap())


@pytest.mark.parametrize("bad", [figures(tip_noise=0.4), figures(pad_drift=3.0), figures(tip_noise=float("nan"))])
def test_cells_that_no_threshold_helps_are_refused(bad: FingerFigures) -> None:
    refused = thresholds({Side.LEFT: bad}).failure
    assert refused and refused.kind is FailureKind.LOW_CONFIDENCE and refused.hint


def test_the_procedure_listens_then_presses_with_each_hand() -> None:
    heard = Outcome({side: tuple(readings(seed)) for seed, side in enumerate(Side)})
    answers = {RecordTactile: lambda _: heard, Touch: lambda e: Outcome(press(-0.1, 0.042, side=e.side))}
    outcome, asked = run(calibrate_tactile(TABLE), answers)
    c = outcome.unwrap()
    assert c.false_contacts == 0 and c.zeros == 12
    for side in Side:  # the press is detected when a tip bears the threshold, after two more readings at 3 mm/s
        assert c.stiffness[side] == pytest.approx(1150.0, rel=0.05)
        assert c.noticed[side] == pytest.approx(2 * c.contact_force / 1150.0 + 6e-5, abs=1.5e-4)
    assert {e.side for e in asked if isinstance(e, Touch)} == set(Side)


def test_a_hand_that_feels_the_table_late_is_refused() -> None:
    heard = Outcome({side: tuple(readings(seed, tip=0.09)) for seed, side in enumerate(Side)})
    answers = {RecordTactile: lambda _: heard, Touch: lambda e: Outcome(press(-0.1))}
    outcome, _ = run(calibrate_tactile(TABLE), answers)
    assert outcome.failure and outcome.failure.kind is FailureKind.LOW_CONFIDENCE and "mm" in outcome.failure.what


def test_a_threshold_above_the_press_force_is_reported() -> None:
    heard = Outcome({side: tuple(readings(seed, tip=0.17)) for seed, side in enumerate(Side)})
    answers = {RecordTactile: lambda _: heard, Touch: lambda e: Outcome(press(-0.1))}
    refused = run(calibrate_tactile(TABLE), answers)[0].failure
    assert refused and refused.kind is FailureKind.LOW_CONFIDENCE
    assert "was not detected: 1.4" in refused.what and all(np.isfinite(v) for v in refused.values.values())


@pytest.mark.parametrize("first", [1e-3, 2e-3, 0.01, 0.02])
def test_false_contacts_are_counted_over_the_horizon_after_a_late_first_reading(first: float) -> None:
    """Over a network a stamp is the time of arrival, so the first two may be any time apart."""
    heard = readings(tip=0.09)
    heard[0] = replace(heard[0], stamp=heard[1].stamp - first)
    assert false_contacts(heard, 0.05) == (6, 6), "the cells are far too noisy for the threshold"
    assert false_contacts(heard, 5.0) == (0, 6)


def test_readings_shorter_than_the_horizon_report_zero_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Zero windows are reported, because 0 of 0 would look as good as 0 of 12."""
    monkeypatch.setattr("foldcell.calibration.tactile.false_contacts", lambda *_: (0, 0))
    heard = Outcome({side: tuple(readings(seed)) for seed, side in enumerate(Side)})
    answers = {RecordTactile: lambda _: heard, Touch: lambda e: Outcome(press(-0.1, side=e.side))}
    refused = run(calibrate_tactile(TABLE), answers)[0].failure
    assert refused and refused.kind is FailureKind.LOW_CONFIDENCE and "could not be counted" in refused.what


@pytest.mark.parametrize("y", [(-0.28, 0.75), (-0.75, 0.28)])
def test_no_hand_presses_beside_a_narrow_table(y: tuple[float, float]) -> None:
    outcome, asked = run(calibrate_tactile(Table(-0.1, (0.20, 1.10), y)), {})
    assert outcome.failure and outcome.failure.kind is FailureKind.UNREACHABLE and outcome.failure.hint
    assert "not on the table" in outcome.failure.what and not asked
