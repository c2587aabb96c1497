"""Determine the force thresholds of the fingers' pressure cells.

First both hands are open in the air. Their readings give the noise of each cell, and its drift between the tare
and the end of a fold. The thresholds are set above both, with a reserve. Then each hand presses the table. The
thresholds must detect this contact early.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.calibration.effects import Procedure, TouchReadings, listen, note, touch
from foldcell.calibration.table import contact_height, on_table
from foldcell.robots.ports import Array, Side, TactileReading
from foldcell.skills.grasping.confirm import CONFIRM_READINGS
from foldcell.skills.grasping.descend import CONTACT_READINGS
from foldcell.skills.grasping.tare import TARE_READINGS
from foldcell.skills.vocabulary import Failure, FailureKind, Outcome, Table, skill

POINTS = {Side.LEFT: (0.55, 0.25), Side.RIGHT: (0.55, -0.25)}


SECONDS = 60.0
"""Duration of the recording [s]; at least twice the horizon."""
HORIZON = 15.0
"""Largest age that a tare reaches in a fold [s]. The tare is measured above the grasp and used until the
release."""
SIGMAS, RESERVE = 5.0, 2.0
"""A threshold lies SIGMAS standard deviations above the unloaded signal, at RESERVE times the measured noise."""
MAX_CONTACT, MAX_HELD = 2.0, 4.0
"""Largest accepted thresholds of a contact and of a hold [N]. With a higher contact threshold, a hand would press
the garment before the contact is detected."""
ODD = 5.0
"""A cell is defective if its noise is larger than the median of the hand's cells times this factor, or smaller
than the median divided by this factor."""
LATEST = 0.0015
"""Largest accepted depth of the hand below first contact when the threshold detects a slow press [m]."""


@dataclass(frozen=True, eq=False)
class FingerFigures:
    """Figures of one unloaded hand.

    cell_noise, pad_noise, tip_noise: standard deviation of one reading of a cell, of the sum of a pad's cells, and
    of a tip [N]. pad_drift, tip_drift: largest change within HORIZON [N]. rate: readings per second.
    """

    cell_noise: float
    pad_noise: float
    tip_noise: float
    pad_drift: float
    tip_drift: float
    rate: float


@dataclass(frozen=True, eq=False)
class TactileCalibration:
    """Result of a tactile calibration. contact_force, held_force: thresholds as in GraspSettings [N]. For each
    hand: figures; stiffness of arm and tips on the table [N/m]; noticed: depth below first contact at which the
    threshold detected the contact [m].

    zeros: number of periods, each beginning with a tare, that were checked in the recording of the unloaded hands.
    false_contacts: number of these periods in which the readings reach the contact threshold.
    """

    contact_force: float
    held_force: float
    figures: Mapping[Side, FingerFigures]
    stiffness: Mapping[Side, float]
    noticed: Mapping[Side, float]
    false_contacts: int
    zeros: int


def calibrate_tactile(table: Table) -> Procedure[TactileCalibration]:
    """Record the unloaded hands, then press the table with each hand. table: configured position of the table.

    Failures: UNREACHABLE (the places to press are not on the table), HARDWARE_FAULT (a dead or defective cell),
    LOW_CONFIDENCE (too much noise or drift for a useful threshold; a late detection), and those of a touch.
    """
    for side, (x, y) in POINTS.items():  # before anything moves
        if not on_table(table, x, y):
            return Outcome(failure=_beside(side, x, y))
    yield from note(f"recording the open hands for {SECONDS:.0f} s")
    heard = yield from listen(SECONDS)
    figures: dict[Side, FingerFigures] = {}
    for side, readings in heard.items():
        figures[side] = finger_figures(side, readings).unwrap()
    contact, held = thresholds(figures).unwrap()
    yield from note(f"thresholds: contact {contact:.2f} N, held {held:.2f} N; pressing the table")
    stiffness, noticed = {}, {}
    for side, (x, y) in POINTS.items():
        touched = (yield from touch(side, x, y)).unwrap()
        stiffness[side], noticed[side] = _detection(touched, contact).unwrap()
    counts = [false_contacts(r, contact) for r in heard.values()]
    false, zeros = (sum(c) for c in zip(*counts, strict=True))
    if zeros == 0:
        what = f"the hands sent less than {HORIZON:.0f} s of data: false contacts could not be counted"
        return Outcome(failure=Failure(FailureKind.LOW_CONFIDENCE, what, "check the connection of the hands"))
    return Outcome(TactileCalibration(contact, held, figures, stiffness, noticed, false, zeros))


def finger_figures(side: Side, readings: Sequence[TactileReading]) -> Outcome[FingerFigures]:
    """Compute the noise and drift of one hand. The noise comes from the differences of successive readings, which
    a drift does not affect. The drift comes from means over a tenth of a second. Fails with HARDWARE_FAULT for too
    few readings and for dead or defective cells."""
    stamps = np.array([r.stamp for r in readings])
    span = float(stamps[-1] - stamps[0]) if len(stamps) > 1 else 0.0
    if len(stamps) < 200 or span < 0.9 * SECONDS:
        what = f"the {side} hand sent only {len(stamps)} readings in {span:.0f} s"
        return _broken(what, "check the connection of the hand", {"readings": len(stamps)})
    cells = np.array([r.cells for r in readings])
    tips = np.array([r.tip for r in readings])
    noise = np.diff(cells, axis=0).std(axis=0) / np.sqrt(2.0)
    tip_noise = np.diff(tips, axis=0).std(axis=0) / np.sqrt(2.0)
    usual = float(np.median(noise))
    bad = ~np.isfinite(noise) | (noise > ODD * usual) | (noise < usual / ODD) | (noise == 0.0)
    if bad.any():
        pad, row, column = (int(i) for i in np.argwhere(bad)[0])
        what = f"the {side} hand's pad {pad} has a defective cell: row {row}, column {column}"
        return _broken(what, "replace the pad", {"noise_n": float(noise[pad, row, column]), "usual_n": usual})
    if not np.isfinite(tip_noise).all() or tip_noise.min() == 0.0:
        return _broken(f"a tip of the {side} hand is dead", "replace the pad", {})
    rate = (len(stamps) - 1) / span
    pads = cells.sum(axis=(2, 3))
    pad_drift, tip_drift = (_drift(x, rate) for x in (pads, tips))
    pad_noise = float((np.diff(pads, axis=0).std(axis=0) / np.sqrt(2.0)).max())
    return Outcome(
        FingerFigures(
            float(np.sqrt((noise**2).mean())), pad_noise, float(tip_noise.max()), pad_drift, tip_drift, rate
        )
    )


def thresholds(figures: Mapping[Side, FingerFigures]) -> Outcome[tuple[float, float]]:
    """Return contact_force and held_force [N], computed for the worse of the two hands.

    A contact is detected from single readings, and a hold from the mean of several readings. Both are relative to
    a tare, which is a mean too.
    """
    worst = {
        name: max(getattr(f, name) for f in figures.values())
        for name in ("pad_noise", "tip_noise", "pad_drift", "tip_drift")
    }
    k = RESERVE * SIGMAS
    contact = k * worst["tip_noise"] * np.sqrt(1.0 + 1.0 / TARE_READINGS) + worst["tip_drift"]
    mean_noise = worst["pad_noise"] * np.sqrt(1.0 / CONFIRM_READINGS + 1.0 / TARE_READINGS)
    held = k * mean_noise + RESERVE * worst["pad_drift"]
    for name, level, highest in (
        ("contact", contact, MAX_CONTACT),
        ("hold", held, MAX_HELD),
    ):
        if not level <= highest:
            return Outcome(
                failure=Failure(
                    FailureKind.LOW_CONFIDENCE,
                    f"noise or drift of the cells is too large: a {name} is detected from {level:.2f} N only",
                    "let the hands warm up; avoid draughts; check the shielding of the hands",
                    {**worst, "level_n": float(level)},
                )
            )  # fmt: skip
    return Outcome((max(0.1, round(float(contact), 3)), max(0.1, round(float(held), 3))))


@skill
def _detection(touched: TouchReadings, contact: float) -> Outcome[tuple[float, float]]:
    """Return the stiffness [N/m], and the depth below first contact at which the threshold detects the contact
    [m]. It is assumed that each tip bears half of the force."""
    first, stiffness = contact_height(touched).unwrap()
    over = 0.5 * touched.force >= contact
    in_a_row = CONTACT_READINGS
    at = next((k for k in range(in_a_row - 1, len(over)) if over[k - in_a_row + 1 : k + 1].all()), None)
    if at is None:
        peak = 0.5 * float(touched.force.max())
        measured = f"{peak:.2f} N on a tip, {contact:.2f} N are needed"
        what = f"the {touched.side} hand's contact was not detected: {measured}"
        hint = "check the fingertips' cells: with this noise or drift a contact needs too much force"
        values: dict[str, object] = {"force_n": peak, "contact_force_n": contact}
        return Outcome(failure=Failure(FailureKind.LOW_CONFIDENCE, what, hint, values))
    late = first - float(touched.height[at])
    if not -0.5 * LATEST <= late <= LATEST:
        what = f"the {touched.side} hand's contact was detected {1e3 * late:.1f} mm below the table top"
        hint = "check the fingertips' cells"
        return Outcome(failure=Failure(FailureKind.LOW_CONFIDENCE, what, hint, {"depth_m": late}))
    return Outcome((stiffness, late))


def _drift(x: Array, rate: float) -> float:
    """Return the largest change of any column of x (n, k) within the horizon, computed from means over a tenth of
    a second. The expected range of the noise of these means, 2 sqrt(2 ln m) standard deviations for m normal
    values, is subtracted in quadrature."""
    n = max(1, round(0.1 * rate))
    means = x[: len(x) // n * n].reshape(-1, n, x.shape[1]).mean(axis=1)
    steps = min(len(means) - 1, round(HORIZON * rate / n))
    within = np.lib.stride_tricks.sliding_window_view(means, steps + 1, axis=0)
    largest = float((within.max(axis=-1) - within.min(axis=-1)).max())
    deviation = float(np.diff(means, axis=0).std()) / np.sqrt(2.0)
    noise = 2.0 * deviation * np.sqrt(2.0 * np.log(max(2, len(means))))
    return float(np.sqrt(max(0.0, largest**2 - noise**2)))


def false_contacts(readings: Sequence[TactileReading], contact: float) -> tuple[int, int]:
    """Count false contacts in the recording of an unloaded hand. Returns (number of periods with a false contact,
    number of periods). Each period begins with a tare and lasts for the horizon.

    The horizon is converted to a number of readings by the mean rate, because the stamps of single readings jitter
    over a network.
    """
    tips = np.array([r.tip for r in readings])
    span = readings[-1].stamp - readings[0].stamp
    n, zeros, false = round(HORIZON * (len(tips) - 1) / span), 0, 0
    for start in range(0, len(tips) - n, n // 2):
        over = (tips[start : start + n] - tips[start : start + TARE_READINGS].mean(axis=0)).max(axis=1) >= contact
        runs = np.convolve(over, np.ones(CONTACT_READINGS), "valid")
        false += int(runs.max() >= CONTACT_READINGS)
        zeros += 1
    return false, zeros


def _beside(side: Side, x: float, y: float) -> Failure:
    return Failure(
        FailureKind.UNREACHABLE,
        f"the {side} hand presses at ({x:.2f}, {y:.2f}), which is not on the table or too close to its edge",
        "check the position of `table` in cell.yaml; the calibration needs a table at that place",
        {"x": x, "y": y},
    )


def _broken(what: str, hint: str, values: dict[str, object]) -> Outcome[FingerFigures]:
    return Outcome(failure=Failure(FailureKind.HARDWARE_FAULT, what, hint, values))
