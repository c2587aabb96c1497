"""Measure the table's height by touch: both hands press the table at several points, and a plane is fitted to the
contacts.

A press is slow. Its readings are fitted by a linear spring: force = k (z0 - z) below the height of first contact
z0, plus the offset that the tips read above z0. Therefore z0 depends neither on a threshold nor on the delay of a
detection. A press that is not linear is rejected (a soft object, a jump of the tips' zero). The remaining error is
the position error of the arms, which differs between the arms. The points alternate between the arms, so that both
contribute.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foldcell.calibration.effects import Procedure, TouchReadings, note, touch
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array, Side
from foldcell.skills.vocabulary import Failure, FailureKind, Outcome, Table

# (side, x, y [m]) of the touched points, all reachable from above. The first three points span a triangle. Both
# arms touch the middle.
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
MIN_POINTS = 3
SOFTEST = -50.0
"""Slope of force over height in the softest valid press [N/m]. Slopes are negative, because the force grows as the
hand moves down. If the slope of a press is above this limit, the hand pressed on nothing and the press is
rejected."""
MARGIN = 0.05
"""Smallest distance of a touched point from the table's edge [m]: half the width of a closed hand plus the error
of the table's placement."""


POINTS = 8
"""Usual number of points to touch."""
MIN_FORCE = 0.25
"""Smallest force of a reading that is used in the spring fit [N]. It is above the noise of the tips."""
MIN_READINGS = 6
"""Smallest number of readings in a fit."""
STRAIGHT = 0.00025
"""Largest accepted difference between the contact heights from the first half of a press and from the whole press
[m]."""
MAX_RESIDUAL = 0.006
"""Largest accepted distance of a point from the plane [m]."""
MAX_TILT = float(np.deg2rad(1.0))
"""Largest accepted tilt of the table [rad]."""
MIN_SPREAD = 0.08
"""Smallest accepted standard deviation of the points perpendicular to the direction in which they spread most [m].
If the points lie almost on one line, the tilt about that line is undetermined."""


@dataclass(frozen=True, eq=False)
class TableCalibration:
    """Result of the table calibration. height: height of the table top in the base frame at the centre of the
    points [m]; tilt_x, tilt_y: slope along x and y [rad]. points: (n, 3) contacts, base frame [m]; residual: (n,)
    distances from the plane [m]; sides: arm of each contact; stiffness: (n,) stiffness of arm and tips in series
    [N/m]."""

    height: float
    tilt_x: float
    tilt_y: float
    points: Array
    residual: Array
    sides: tuple[Side, ...]
    stiffness: Array

    @property
    def residual_rms(self) -> float | None:
        """Root mean square residual per degree of freedom [m]; None for three points, because a plane always fits
        them exactly."""
        free = len(self.points) - MIN_POINTS
        return float(np.sqrt((self.residual**2).sum() / free)) if free > 0 else None

    @property
    def arms_differ(self) -> float | None:
        """Mean of the left arm's contact heights minus the right arm's, at the points that both arms touched [m];
        None if there are no such points."""
        pairs = [
            self.points[i, 2] - self.points[j, 2]
            for i, a in enumerate(self.sides)
            for j, b in enumerate(self.sides)
            if a is Side.LEFT
            and b is Side.RIGHT
            and np.linalg.norm(self.points[i, :2] - self.points[j, :2]) < 0.02
        ]
        return float(np.mean(pairs)) if pairs else None


def check_points(points: int) -> None:
    """Raise ConfigurationError if a table cannot be touched at this number of points."""
    if not MIN_POINTS <= points <= MOST_POINTS:
        raise ConfigurationError(
            f"{points} points: give {MIN_POINTS} to {MOST_POINTS} points to touch the table at",
            "see foldcell calibrate --help",
        )


def calibrate_table(table: Table, wanted: int = POINTS) -> Procedure[TableCalibration]:
    """Touch the table at `wanted` points and fit a plane. table: configured position of the table; points that are
    not on the table are skipped.

    Failures: NO_CONTACT (no table), UNREACHABLE (too few points), LOW_CONFIDENCE (no plane, points on one line, a
    tilted table).
    """
    contacts: list[tuple[Side, Array, float]] = []
    skipped = next((_beside(x, y) for _, x, y in LAYOUT if not on_table(table, x, y)), None)
    places = [place for place in LAYOUT if on_table(table, *place[1:])]
    if len(places) < wanted:  # before anything moves
        return Outcome(failure=_too_few(len(places), wanted, skipped))
    for k, (side, x, y) in enumerate(places):
        if len(contacts) == wanted:
            break
        touched = yield from touch(side, x, y)
        if touched.failure:
            skipped = touched.failure
            yield from note(f"point {k + 1} at ({x:.2f}, {y:.2f}) skipped: {touched.failure.what}")
            continue
        z, stiffness = contact_height(touched.unwrap()).unwrap()
        contacts.append((side, np.array([touched.unwrap().x, touched.unwrap().y, z]), stiffness))
        place = f"{side} at ({x:.2f}, {y:.2f})"
        yield from note(f"point {len(contacts)} of {wanted}, {place}: z {1e3 * z:.2f} mm, base frame")
    if len(contacts) < wanted:
        return Outcome(failure=_too_few(len(contacts), wanted, skipped))
    points, stiffnesses = np.array([p for _, p, _ in contacts]), np.array([k for _, _, k in contacts])
    return fit_plane(points, tuple(side for side, _, _ in contacts), stiffnesses)


def on_table(table: Table, x: float, y: float) -> bool:
    """Whether a closed hand that descends at (x, y) [m] meets the table, at least MARGIN from its edge."""
    inside_x = table.x[0] + MARGIN <= x <= table.x[1] - MARGIN
    return inside_x and table.y[0] + MARGIN <= y <= table.y[1] - MARGIN


def contact_height(touched: TouchReadings) -> Outcome[tuple[float, float]]:
    """Return the height of first contact [m] and the stiffness [N/m] of a press. Both come from a line through the
    loaded readings, from which the unloaded offset is subtracted. Fails with LOW_CONFIDENCE if the readings are
    not linear."""
    force = touched.force - _unloaded_force(touched)
    loaded = force >= MIN_FORCE
    if loaded.any():  # use only readings after the last unloaded one: a peak before it is noise
        free = np.flatnonzero(~loaded)
        loaded[: free[-1] + 1 if len(free) else 0] = False
    if np.count_nonzero(loaded) < MIN_READINGS:
        return Outcome(failure=_no_contact_height(touched, int(np.count_nonzero(loaded))))
    z, force = touched.height[loaded], force[loaded]
    contact, slope, _ = _spring(z, force)
    if slope > SOFTEST:
        return Outcome(failure=_no_contact_height(touched, len(z)))
    half = slice(0, max(len(z) // 2, MIN_READINGS))
    half_contact, half_slope, sigma = _spring(z[half], force[half])
    if half_slope > SOFTEST or abs(half_contact - contact) > STRAIGHT + 2.0 * sigma:
        return Outcome(failure=_not_linear(touched, half_slope, slope))
    return Outcome((contact, -slope))


def _unloaded_force(touched: TouchReadings) -> float:
    """Return the force that the tips read before the contact [N]. It can differ from zero, because the first touch
    may have shifted the zero since the tare. Returns 0 for a press that begins in contact."""
    n = max(len(touched.force) // 4, MIN_READINGS)
    z, force = touched.height[:n], touched.force[:n]
    if len(z) < MIN_READINGS or _spring(z, force)[1] <= SOFTEST:
        return 0.0
    return float(np.median(force))


def _spring(z: Array, force: Array) -> tuple[float, float, float]:
    """Fit a line of force over height to readings (n,). Only the force is assumed to have errors, because the
    joints are read far more finely. Returns the height of zero force [m], the slope [N/m] and the standard
    deviation of this height [m]."""
    centred = z - z.mean()
    spread = float(centred @ centred)
    slope = float(centred @ force) / spread if spread > 0.0 else 0.0
    if slope == 0.0:
        return np.nan, 0.0, np.inf
    contact = float(z.mean() - force.mean() / slope)
    residual = force - slope * (z - contact)
    variance = float(residual @ residual) / max(len(z) - 2, 1)
    sigma = np.sqrt(variance * (1.0 / len(z) + (contact - z.mean()) ** 2 / spread)) / abs(slope)
    return contact, slope, float(sigma)


def fit_plane(points: Array, sides: tuple[Side, ...], stiffness: Array) -> Outcome[TableCalibration]:
    """Fit the plane z = h + a (x - x_mean) + b (y - y_mean) by least squares to contacts (n, 3), base frame [m].
    Fails with LOW_CONFIDENCE."""
    centred = points[:, :2] - points[:, :2].mean(axis=0)
    spread = float(np.linalg.svd(centred, compute_uv=False)[-1] / np.sqrt(len(points)))
    if len(points) < MIN_POINTS or spread < MIN_SPREAD:
        return Outcome(
            failure=Failure(
                FailureKind.LOW_CONFIDENCE, "the points are too close to one line to fit a plane",
                "touch the table at points farther apart", {"spread_m": spread, "points": len(points)},
            )
        )  # fmt: skip
    A = np.column_stack((np.ones(len(points)), centred))
    fit = np.linalg.lstsq(A, points[:, 2], rcond=None)[0]
    residual = points[:, 2] - A @ fit
    worst = int(np.abs(residual).argmax())
    if abs(residual[worst]) > MAX_RESIDUAL:
        x, y, _ = points[worst]
        return Outcome(
            failure=Failure(
                FailureKind.LOW_CONFIDENCE,
                f"the contact at ({x:.2f}, {y:.2f}) is {1e3 * residual[worst]:+.1f} mm off the plane of them all",
                "check whether something lies on the table there", {"residual_m": float(residual[worst])},
            )
        )  # fmt: skip
    tilt = float(np.hypot(fit[1], fit[2]))
    if tilt > MAX_TILT:
        return Outcome(
            failure=Failure(
                FailureKind.LOW_CONFIDENCE, f"the table leans by {np.rad2deg(tilt):.2f} degrees",
                "level the table: the cell assumes a horizontal top", {"tilt_rad": tilt},
            )
        )  # fmt: skip
    height, tilt_x, tilt_y = (float(v) for v in fit)
    return Outcome(TableCalibration(height, tilt_x, tilt_y, points, residual, sides, stiffness))


def _beside(x: float, y: float) -> Failure:
    return Failure(
        FailureKind.UNREACHABLE,
        f"the point at ({x:.2f}, {y:.2f}) is not on the table or is less than {100 * MARGIN:.0f} cm from its edge",
    )


def _too_few(found: int, wanted: int, why: Failure | None) -> Failure:
    return Failure(
        FailureKind.UNREACHABLE,
        f"only {found} of {wanted} points could be touched" + (f": {why.what}" if why else ""),
        "clear the table's surroundings, or ask for fewer points with --points",
        {"points": found},
    )


def _not_linear(touched: TouchReadings, half_slope: float, slope: float) -> Failure:
    return Failure(
        FailureKind.LOW_CONFIDENCE,
        f"the press of the {touched.side} hand at ({touched.x:.2f}, {touched.y:.2f}) is not linear like a spring:"
        f" {-half_slope:.0f} N/m in its first half, {-slope:.0f} N/m in total",
        "take soft objects off the table; check the fingertips' cells",
        {"first_stiffness_n_m": -half_slope, "stiffness_n_m": -slope},
    )


def _no_contact_height(touched: TouchReadings, readings: int) -> Failure:
    peak = float(touched.force.max()) if len(touched.force) else 0.0
    return Failure(
        FailureKind.LOW_CONFIDENCE,
        f"the press of the {touched.side} hand at ({touched.x:.2f}, {touched.y:.2f}) gives no contact height:"
        f" {readings} loaded readings, {peak:.2f} N at most",
        "take soft objects off the table; check the fingertips' cells",
        {"readings": readings, "force_n": peak},
    )
