"""The table's height, touched off: both hands press the table at several points, a plane through the contacts.

A press is slow and its readings are fitted by a spring on a stop, force = k (z0 - z) below z0, over what the tips
read above it: the height of first contact z0 depends neither on a threshold nor on how late it was noticed. A
press that is no straight spring (something soft lies there, the tips' zero jumped) is none. What remains is the
arms' own error, which differs from arm to arm: with more than three points both arms touch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.effects import Procedure, Touched, note, touch
from robots.ports import Array, Side
from skills.vocabulary import Failure, FailureKind, Outcome, Table

__all__ = [
    "MOST_POINTS",
    "TableCalibration",
    "TableSettings",
    "calibrate_table",
    "contact_height",
    "fit_plane",
    "on_table",
]

# Reachable straight down. The first three span a triangle; both arms touch the middle.
LAYOUT = (
    (Side.LEFT, 0.45, 0.40),
    (Side.RIGHT, 0.45, -0.40),
    (Side.LEFT, 0.72, 0.15),
    (Side.RIGHT, 0.72, -0.15),
    (Side.LEFT, 0.60, 0.0),
    (Side.RIGHT, 0.60, 0.0),
    (Side.LEFT, 0.68, 0.40),
    (Side.RIGHT, 0.68, -0.40),
    (Side.LEFT, 0.50, 0.20),
    (Side.RIGHT, 0.50, -0.20),
)
MOST_POINTS = len(LAYOUT)
FEWEST = 3
SOFTEST = -50.0
"""Slope of force against height from which on nothing was pressed [N/m]."""
MARGIN = 0.05
"""Of a touched point from the table's edge [m]: half a closed hand's breadth, and what the table stands off."""


@dataclass(frozen=True)
class TableSettings:
    """Lengths [m], forces [N], angles [rad]."""

    points: int = 8
    least_force: float = 0.25
    """Of the readings that the spring is fitted to: over the tips' noise."""
    fewest_readings: int = 6
    straight: float = 0.00025
    """How far the contact by the first half of a press may lie from that by all of it."""
    residual: float = 0.006
    """Of one point from the plane: more is no table top."""
    tilt: float = float(np.deg2rad(1.0))
    least_spread: float = 0.08
    """Of the points across their longest direction, as a standard deviation: less leaves the tilt open."""

    def __post_init__(self) -> None:
        if not FEWEST <= self.points <= MOST_POINTS:
            raise ValueError(f"{self.points} points: a table is touched at {FEWEST} to {MOST_POINTS}")


@dataclass(frozen=True, eq=False)
class TableCalibration:
    """height: of the top in the base frame at the middle of the points [m]; tilt_x, tilt_y: its rise along x and y
    [rad]. points: (n, 3) contacts, base frame; residual: (n,) of each from the plane [m]; sides: of each.
    stiffness: (n,) of arm and tips in series [N/m]."""

    height: float
    tilt_x: float
    tilt_y: float
    points: Array
    residual: Array
    sides: tuple[Side, ...]
    stiffness: Array

    @property
    def residual_rms(self) -> float | None:
        """[m]; None for three points, through which every plane goes."""
        free = len(self.points) - FEWEST
        return float(np.sqrt((self.residual**2).sum() / free)) if free > 0 else None

    @property
    def arms_differ(self) -> float | None:
        """How much higher the left arm feels the table than the right one at the points that both touched [m]."""
        pairs = [
            self.points[i, 2] - self.points[j, 2]
            for i, a in enumerate(self.sides)
            for j, b in enumerate(self.sides)
            if a is Side.LEFT
            and b is Side.RIGHT
            and np.linalg.norm(self.points[i, :2] - self.points[j, :2]) < 0.02
        ]
        return float(np.mean(pairs)) if pairs else None


def calibrate_table(table: Table, settings: TableSettings | None = None) -> Procedure[TableCalibration]:
    """Touch the table at `settings.points` points. table: as it is believed to be; places beside it are left out.

    Failures: NO_CONTACT (nothing there), UNREACHABLE (too few points), LOW_CONFIDENCE (no plane, points in a
    line, a table that leans).
    """
    settings = settings or TableSettings()
    contacts: list[tuple[Side, Array, float]] = []
    left_out = next((_beside(x, y) for _, x, y in LAYOUT if not on_table(table, x, y)), None)
    there = [place for place in LAYOUT if on_table(table, *place[1:])]
    if len(there) < settings.points:  # before anything moves
        return Outcome(failure=_too_few(len(there), settings.points, left_out))
    for k, (side, x, y) in enumerate(there):
        if len(contacts) == settings.points:
            break
        touched = yield from touch(side, x, y)
        if touched.failure and touched.failure.kind in {FailureKind.UNREACHABLE, FailureKind.IN_COLLISION}:
            left_out = touched.failure
            yield from note(f"point {k + 1} at ({x:.2f}, {y:.2f}) left out: {touched.failure.what}")
            continue
        if touched.failure:
            return Outcome(failure=touched.failure)
        contact = contact_height(touched.unwrap(), settings)
        if contact.failure:
            return Outcome(failure=contact.failure)
        z, stiffness = contact.unwrap()
        contacts.append((side, np.array([touched.unwrap().x, touched.unwrap().y, z]), stiffness))
        place = f"{side} at ({x:.2f}, {y:.2f})"
        yield from note(f"point {len(contacts)} of {settings.points}, {place}: z {1e3 * z:.2f} mm, base frame")
    if len(contacts) < settings.points:
        return Outcome(failure=_too_few(len(contacts), settings.points, left_out))
    points, stiffnesses = np.array([p for _, p, _ in contacts]), np.array([k for _, _, k in contacts])
    return fit_plane(points, tuple(side for side, _, _ in contacts), stiffnesses, settings)


def on_table(table: Table, x: float, y: float) -> bool:
    """Whether a closed hand that comes down at (x, y) [m] meets the table, and not its edge."""
    inside_x = table.x[0] + MARGIN <= x <= table.x[1] - MARGIN
    return inside_x and table.y[0] + MARGIN <= y <= table.y[1] - MARGIN


def contact_height(touched: Touched, settings: TableSettings | None = None) -> Outcome[tuple[float, float]]:
    """Height of first contact [m] and stiffness [N/m] of a press: the line through its loaded readings, over what
    the tips read in the air. Fails with LOW_CONFIDENCE where there is no such line."""
    settings = settings or TableSettings()
    force = touched.force - _in_the_air(touched, settings)
    loaded = force >= settings.least_force
    if loaded.any():  # from the last reading that was not loaded: a lone kick before it is noise
        free = np.flatnonzero(~loaded)
        loaded[: free[-1] + 1 if len(free) else 0] = False
    if np.count_nonzero(loaded) < settings.fewest_readings:
        return Outcome(failure=_soft(touched, int(np.count_nonzero(loaded))))
    z, force = touched.height[loaded], force[loaded]
    contact, slope, _ = _spring(z, force)
    if slope > SOFTEST:
        return Outcome(failure=_soft(touched, len(z)))
    begun = slice(0, max(len(z) // 2, settings.fewest_readings))
    first, first_slope, sigma = _spring(z[begun], force[begun])
    if first_slope > SOFTEST or abs(first - contact) > settings.straight + 2.0 * sigma:
        return Outcome(failure=_bent(touched, first_slope, slope))
    return Outcome((contact, -slope))


def _in_the_air(touched: Touched, settings: TableSettings) -> float:
    """What the tips read before they touch [N]: their zero is from before the touch that found the table, which
    may have shifted it. 0 for a press that begins in contact."""
    n = max(len(touched.force) // 4, settings.fewest_readings)
    z, force = touched.height[:n], touched.force[:n]
    if len(z) < settings.fewest_readings or _spring(z, force)[1] <= SOFTEST:
        return 0.0
    return float(np.median(force))


def _spring(z: Array, force: Array) -> tuple[float, float, float]:
    """The line through readings (n,), force against height, since it is the force's noise that is fitted and the
    joints are read far more finely: where it is 0 [m], its slope [N/m], and that place's deviation [m]."""
    off = z - z.mean()
    spread = float(off @ off)
    slope = float(off @ force) / spread if spread > 0.0 else 0.0
    if slope == 0.0:
        return np.nan, 0.0, np.inf
    contact = float(z.mean() - force.mean() / slope)
    misses = force - slope * (z - contact)
    variance = float(misses @ misses) / max(len(z) - 2, 1)
    sigma = np.sqrt(variance * (1.0 / len(z) + (contact - z.mean()) ** 2 / spread)) / abs(slope)
    return contact, slope, float(sigma)


def fit_plane(
    points: Array, sides: tuple[Side, ...], stiffness: Array, settings: TableSettings | None = None
) -> Outcome[TableCalibration]:
    """Least-squares plane z = h + a (x - x_mean) + b (y - y_mean) through contacts (n, 3), base frame."""
    settings = settings or TableSettings()
    middle = points[:, :2].mean(axis=0)
    off = points[:, :2] - middle
    spread = float(np.linalg.svd(off, compute_uv=False)[-1] / np.sqrt(len(points)))
    if len(points) < FEWEST or spread < settings.least_spread:
        return Outcome(
            failure=Failure(
                FailureKind.LOW_CONFIDENCE, "the points lie too near to one line to give a plane",
                "touch the table at points farther apart", {"spread_m": spread, "points": len(points)},
            )
        )  # fmt: skip
    A = np.column_stack((np.ones(len(points)), off))
    fit = np.linalg.lstsq(A, points[:, 2], rcond=None)[0]
    residual = points[:, 2] - A @ fit
    worst = int(np.abs(residual).argmax())
    if abs(residual[worst]) > settings.residual:
        x, y, _ = points[worst]
        return Outcome(
            failure=Failure(
                FailureKind.LOW_CONFIDENCE,
                f"the contact at ({x:.2f}, {y:.2f}) is {1e3 * residual[worst]:+.1f} mm off the plane of them all",
                "see whether something lies on the table there", {"residual_m": float(residual[worst])},
            )
        )  # fmt: skip
    tilt = float(np.hypot(fit[1], fit[2]))
    if tilt > settings.tilt:
        return Outcome(
            failure=Failure(
                FailureKind.LOW_CONFIDENCE, f"the table leans by {np.rad2deg(tilt):.2f} degrees",
                "level the table: the cell takes its top for horizontal", {"tilt_rad": tilt},
            )
        )  # fmt: skip
    height, tilt_x, tilt_y = (float(v) for v in fit)
    return Outcome(TableCalibration(height, tilt_x, tilt_y, points, residual, sides, stiffness))


def _beside(x: float, y: float) -> Failure:
    return Failure(
        FailureKind.UNREACHABLE,
        f"the point at ({x:.2f}, {y:.2f}) is not on the table, or less than {100 * MARGIN:.0f} cm from its edge",
    )


def _too_few(found: int, wanted: int, why: Failure | None) -> Failure:
    return Failure(
        FailureKind.UNREACHABLE,
        f"only {found} of {wanted} points could be touched" + (f": {why.what}" if why else ""),
        "clear the table's surroundings, or ask for fewer points with --points",
        {"points": found},
    )


def _bent(touched: Touched, first: float, all_: float) -> Failure:
    return Failure(
        FailureKind.LOW_CONFIDENCE,
        f"the {touched.side} hand's press at ({touched.x:.2f}, {touched.y:.2f}) is not that of a spring:"
        f" {-first:.0f} N/m at first, {-all_:.0f} N/m in the mean",
        "take soft things off the table; check the fingertips' cells",
        {"first_stiffness_n_m": -first, "stiffness_n_m": -all_},
    )


def _soft(touched: Touched, readings: int) -> Failure:
    peak = float(touched.force.max()) if len(touched.force) else 0.0
    return Failure(
        FailureKind.LOW_CONFIDENCE,
        f"the {touched.side} hand's press at ({touched.x:.2f}, {touched.y:.2f}) gives no contact height:"
        f" {readings} loaded readings, {peak:.2f} N at most",
        "take soft things off the table; check the fingertips' cells",
        {"readings": readings, "force_n": peak},
    )
