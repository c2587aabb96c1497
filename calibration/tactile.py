"""Thresholds of the fingers' pressure cells, from what they read of nothing and of the table.

First both hands hang open in the air: how noisy each cell is, and how far it drifts between the moment it was
zeroed and the end of a fold. The thresholds stand clear of both, with as much again in hand. Then each hand
presses the table: a contact has to be noticed by them, and soon.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.effects import Procedure, Touched, listen, note, touch
from calibration.table import contact_height, on_table
from robots.ports import Array, Side, TactileReading
from skills.grasping.settings import GraspSettings
from skills.vocabulary import Failure, FailureKind, Outcome, Table

__all__ = [
    "FingerFigures",
    "TactileCalibration",
    "TactileSettings",
    "calibrate_tactile",
    "false_contacts",
    "finger_figures",
    "thresholds",
]

POINTS = {Side.LEFT: (0.55, 0.25), Side.RIGHT: (0.55, -0.25)}


@dataclass(frozen=True)
class TactileSettings:
    """Times [s], forces [N]."""

    seconds: float = 60.0
    horizon: float = 15.0
    """How old a zero gets: from above the grasp to the release."""
    sigmas: float = 5.0
    reserve: float = 2.0
    """Noise that thresholds are made for, over today's."""
    highest_contact: float = 2.0
    """A contact threshold above this lets a hand press the garment before it is noticed."""
    highest_held: float = 4.0
    odd: float = 5.0
    """A cell this many times as noisy as its hand's median is broken."""
    latest: float = 0.0015
    """How far below first contact it has to be noticed in a slow press [m]."""

    def __post_init__(self) -> None:
        if self.seconds < 2.0 * self.horizon:
            raise ValueError(f"{self.seconds} s do not show the drift over {self.horizon} s: listen twice as long")


@dataclass(frozen=True, eq=False)
class FingerFigures:
    """One hand, unloaded. Standard deviations of one reading of a cell, of a pad's sum, of a tip [N]; drift: the
    largest change of a pad's sum and of a tip within the horizon [N]. rate: readings a second."""

    cell_noise: float
    pad_noise: float
    tip_noise: float
    pad_drift: float
    tip_drift: float
    rate: float


@dataclass(frozen=True, eq=False)
class TactileCalibration:
    """contact_force, held_force [N]: as in GraspSettings. By hand: figures; stiffness of arm and tips on the table
    [N/m]; noticed: how far under first contact the threshold noticed it [m]. false_contacts: how often the
    threshold would have been met by nothing, in `zeros` times of listening for the horizon."""

    contact_force: float
    held_force: float
    figures: Mapping[Side, FingerFigures]
    stiffness: Mapping[Side, float]
    noticed: Mapping[Side, float]
    false_contacts: int
    zeros: int


def calibrate_tactile(
    table: Table, grasp: GraspSettings, settings: TactileSettings | None = None
) -> Procedure[TactileCalibration]:
    """Listen, then press the table with each hand. table: as it is believed to be.

    Failures: UNREACHABLE (the places to press are not on the table), HARDWARE_FAULT (a dead or broken cell),
    LOW_CONFIDENCE (so much noise or drift that no threshold is of use; a contact noticed late), and those of a
    touch.
    """
    settings = settings or TactileSettings()
    for side, (x, y) in POINTS.items():  # before anything moves
        if not on_table(table, x, y):
            return Outcome(failure=_beside(side, x, y))
    yield from note(f"listening for {settings.seconds:.0f} s, hands open")
    heard = yield from listen(settings.seconds)
    if heard.failure:
        return Outcome(failure=heard.failure)
    figures: dict[Side, FingerFigures] = {}
    for side, readings in heard.unwrap().readings.items():
        found = finger_figures(side, readings, settings)
        if found.failure:
            return Outcome(failure=found.failure)
        figures[side] = found.unwrap()
    levels = thresholds(figures, grasp, settings)
    if levels.failure:
        return Outcome(failure=levels.failure)
    contact, held = levels.unwrap()
    yield from note(f"contact from {contact:.2f} N, held from {held:.2f} N; pressing the table")
    stiffness, noticed = {}, {}
    for side, (x, y) in POINTS.items():
        touched = yield from touch(side, x, y)
        if touched.failure:
            return Outcome(failure=touched.failure)
        judged = _noticed(touched.unwrap(), contact, grasp.contact_readings, settings)
        if judged.failure:
            return Outcome(failure=judged.failure)
        stiffness[side], noticed[side] = judged.unwrap()
    counts = [false_contacts(r, contact, grasp, settings) for r in heard.unwrap().readings.values()]
    false, zeros = (sum(c) for c in zip(*counts, strict=True))
    if zeros == 0:
        what = f"the hands were heard for less than {settings.horizon:.0f} s: false contacts could not be counted"
        return Outcome(failure=Failure(FailureKind.LOW_CONFIDENCE, what, "check the hands' connection"))
    return Outcome(TactileCalibration(contact, held, figures, stiffness, noticed, false, zeros))


def finger_figures(
    side: Side, readings: Sequence[TactileReading], settings: TactileSettings | None = None
) -> Outcome[FingerFigures]:
    """Noise from the differences of neighbouring readings (a drift does not show in them), drift from means over
    a tenth of a second. Fails with HARDWARE_FAULT for too few readings and for cells that are dead or odd."""
    settings = settings or TactileSettings()
    stamps = np.array([r.stamp for r in readings])
    span = float(stamps[-1] - stamps[0]) if len(stamps) > 1 else 0.0
    if len(stamps) < 200 or span < 0.9 * settings.seconds:
        what = f"the {side} hand gave {len(stamps)} readings in {span:.0f} s"
        return _broken(what, "check the hand's connection", {"readings": len(stamps)})
    cells = np.array([r.cells for r in readings])
    tips = np.array([r.tip for r in readings])
    noise = np.diff(cells, axis=0).std(axis=0) / np.sqrt(2.0)
    tip_noise = np.diff(tips, axis=0).std(axis=0) / np.sqrt(2.0)
    usual = float(np.median(noise))
    bad = ~np.isfinite(noise) | (noise > settings.odd * usual) | (noise < usual / settings.odd) | (noise == 0.0)
    if bad.any():
        pad, row, column = (int(i) for i in np.argwhere(bad)[0])
        what = f"the {side} hand's pad {pad} has a cell that does not work: row {row}, column {column}"
        return _broken(what, "replace the pad", {"noise_n": float(noise[pad, row, column]), "usual_n": usual})
    if not np.isfinite(tip_noise).all() or tip_noise.min() == 0.0:
        return _broken(f"a tip of the {side} hand is dead", "replace the pad", {})
    rate = (len(stamps) - 1) / span
    pads = cells.sum(axis=(2, 3))
    pad_drift, tip_drift = (_drift(x, rate, settings.horizon) for x in (pads, tips))
    pad_noise = float((np.diff(pads, axis=0).std(axis=0) / np.sqrt(2.0)).max())
    return Outcome(
        FingerFigures(
            float(np.sqrt((noise**2).mean())), pad_noise, float(tip_noise.max()), pad_drift, tip_drift, rate
        )
    )


def thresholds(
    figures: Mapping[Side, FingerFigures], grasp: GraspSettings, settings: TactileSettings | None = None
) -> Outcome[tuple[float, float]]:
    """contact_force and held_force [N] for the worse of the hands.

    A contact is told from single readings, a hold from the mean of some; both against a zero that is a mean.
    """
    settings = settings or TactileSettings()
    worst = {
        name: max(getattr(f, name) for f in figures.values())
        for name in ("pad_noise", "tip_noise", "pad_drift", "tip_drift")
    }
    k = settings.reserve * settings.sigmas
    contact = k * worst["tip_noise"] * np.sqrt(1.0 + 1.0 / grasp.zero_readings) + worst["tip_drift"]
    mean_noise = worst["pad_noise"] * np.sqrt(1.0 / grasp.confirm_readings + 1.0 / grasp.zero_readings)
    held = k * mean_noise + settings.reserve * worst["pad_drift"]
    for name, level, highest in (
        ("contact", contact, settings.highest_contact),
        ("hold", held, settings.highest_held),
    ):
        if not level <= highest:
            return Outcome(
                failure=Failure(
                    FailureKind.LOW_CONFIDENCE,
                    f"the cells are so noisy or drift so much that a {name} shows from {level:.2f} N only",
                    "let the hands warm up; keep draughts off; check their shielding",
                    {**worst, "level_n": float(level)},
                )
            )  # fmt: skip
    return Outcome((max(0.1, round(float(contact), 3)), max(0.1, round(float(held), 3))))


def _noticed(
    touched: Touched, contact: float, in_a_row: int, settings: TactileSettings
) -> Outcome[tuple[float, float]]:
    """Stiffness [N/m], and how far under first contact the threshold noticed it [m]; a tip bears half."""
    fitted = contact_height(touched)
    if fitted.failure:
        return Outcome(failure=fitted.failure)
    first, stiffness = fitted.unwrap()
    over = 0.5 * touched.force >= contact
    at = next((k for k in range(in_a_row - 1, len(over)) if over[k - in_a_row + 1 : k + 1].all()), None)
    if at is None:
        peak = 0.5 * float(touched.force.max())
        felt = f"{peak:.2f} N on a tip, {contact:.2f} N are needed"
        what = f"the {touched.side} hand's contact was not noticed: {felt}"
        hint = "check the fingertips' cells: so noisy or drifting ones need a harder press than is good"
        values: dict[str, object] = {"force_n": peak, "contact_force_n": contact}
        return Outcome(failure=Failure(FailureKind.LOW_CONFIDENCE, what, hint, values))
    late = first - float(touched.height[at])
    if not -0.5 * settings.latest <= late <= settings.latest:
        what = f"the {touched.side} hand's contact was noticed {1e3 * late:.1f} mm under the table's top"
        hint = "check the fingertips' cells"
        return Outcome(failure=Failure(FailureKind.LOW_CONFIDENCE, what, hint, {"depth_m": late}))
    return Outcome((stiffness, late))


def _drift(x: Array, rate: float, horizon: float) -> float:
    """Largest change of any column of x (n, k) between two moments no further apart than the horizon, of means
    over a tenth of a second, the range of their own noise left out (of m normal values 2 sqrt(2 ln m) deviations).
    """
    n = max(1, round(0.1 * rate))
    means = x[: len(x) // n * n].reshape(-1, n, x.shape[1]).mean(axis=1)
    steps = min(len(means) - 1, round(horizon * rate / n))
    within = np.lib.stride_tricks.sliding_window_view(means, steps + 1, axis=0)
    largest = float((within.max(axis=-1) - within.min(axis=-1)).max())
    deviation = float(np.diff(means, axis=0).std()) / np.sqrt(2.0)
    noise = 2.0 * deviation * np.sqrt(2.0 * np.log(max(2, len(means))))
    return float(np.sqrt(max(0.0, largest**2 - noise**2)))


def false_contacts(
    readings: Sequence[TactileReading], contact: float, grasp: GraspSettings, settings: TactileSettings
) -> tuple[int, int]:
    """(times that nothing would have been taken for a contact, zeros that were tried). The horizon in readings is
    by the rate of them all: over a network two stamps lie anyhow apart."""
    tips = np.array([r.tip for r in readings])
    span = readings[-1].stamp - readings[0].stamp
    n, zeros, false = round(settings.horizon * (len(tips) - 1) / span), 0, 0
    for start in range(0, len(tips) - n, n // 2):
        over = (tips[start : start + n] - tips[start : start + grasp.zero_readings].mean(axis=0)).max(
            axis=1
        ) >= contact
        runs = np.convolve(over, np.ones(grasp.contact_readings), "valid")
        false += int(runs.max() >= grasp.contact_readings)
        zeros += 1
    return false, zeros


def _beside(side: Side, x: float, y: float) -> Failure:
    return Failure(
        FailureKind.UNREACHABLE,
        f"the {side} hand presses at ({x:.2f}, {y:.2f}), which is not on the table or too near its edge",
        "see that `table` in cell.yaml says where the table is; the thresholds need a table that reaches there",
        {"x": x, "y": y},
    )


def _broken(what: str, hint: str, values: dict[str, object]) -> Outcome[FingerFigures]:
    return Outcome(failure=Failure(FailureKind.HARDWARE_FAULT, what, hint, values))
