"""Measures how often the grasping controllers detect faults, and how often they raise false alarms.

The sensors are simulated. For each trial, a hand (gains and drift of its cells), a garment's cloth and a grip
force are drawn, and the sensors are tared. The controllers of skills.grasping then get only the sensor readings.
They have to detect three faults:

    missed   the pads closed on each other or on nothing, instead of on the planned layers
    double   the pads hold twice the planned layers
    slipped  the cloth leaves the pads during the fold; a detection counts only within 100 ms

A false alarm is a fault that is reported for a grasp as planned. The receiver operating characteristic (pairs of
false alarm rate and detection rate) is obtained by changing the detection threshold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.simulation.noise import load_noise
from foldcell.cell.simulation.robot.tactile import SimulatedTactile
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import GripperState, Side
from foldcell.robots.registry import find_robot
from foldcell.skills.garments.garment import Garment
from foldcell.skills.grasping.confirm import (
    CONFIRM_READINGS,
    Expectation,
    Held,
    LayerCount,
    confirm,
    start_confirm,
)
from foldcell.skills.grasping.hand_reading import HandReading
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.grasping.slip import start_slip_watch, watch_slip
from foldcell.skills.grasping.tare import TactileBias, TareState, start_tare, tare
from foldcell.skills.vocabulary import Outcome

__all__ = ["measure_grasps"]

SCALES = (1.0, 2.0)
STACKED = (1, 2)
"""Factors on the garment's number of layers, one of which is drawn: a later fold grasps layers that an earlier
fold has stacked."""
DESCENT_S = 5.0
"""Time between the tare and the closing of the pads, during which the cells drift [s]."""
FOLD_S = 1.5
TOLD_WITHIN = 0.1
THICKNESS_SPREAD = 0.10
"""Maximum relative deviation of a layer's thickness from that in the garment file, as in the simulated cell."""
DOUBTS = (1e-4, 1e-3, 0.01, 0.05, 0.2, 0.5, 0.9)
HELD_FORCES = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.0)
FRACTIONS = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
"""DOUBTS, HELD_FORCES, FRACTIONS: detection thresholds for the receiver operating characteristics of "double",
"missed" and "slipped". The thresholds of a run are those of `cell.yaml`."""


class _Hand:
    """The sensors of one hand of the simulated cell, without cloth. Force on the pads and opening are set
    directly."""

    def __init__(self, rng: np.random.Generator, scale: float) -> None:
        table = load_noise()
        noise = table.tactile
        tactile = replace(
            noise, noise=scale * noise.noise, drift=scale * noise.drift, linearity=scale * noise.linearity,
            tip_noise=scale * noise.tip_noise,
        )  # fmt: skip
        self.pads, self.opening = 0.0, 0.035
        self.now = float(rng.uniform(0.0, 120.0))
        self._rng, self._scale, self._gripper = rng, scale, table.gripper
        self._cells = SimulatedTactile(
            Side.LEFT, tactile, int(rng.integers(2**31)), False, lambda: self.pads, lambda: np.zeros(2)
        )

    def read(self) -> HandReading:
        self.now += 0.01
        n = self._scale * self._rng.standard_normal(2)
        opening = max(0.0, self.opening + self._gripper.opening_noise * float(n[0]))
        force = max(0.0, self.pads + self._gripper.force_noise * float(n[1]))
        gripper = GripperState(self.now, Side.LEFT, opening, force, False, True)
        return HandReading(self.now, self._cells.reading(self.now), gripper, 0.05, np.zeros(7))


@dataclass(frozen=True, eq=False)
class _Trial:
    """Drawn values of a trial. thickness, real: nominal and true thickness of a layer [m]. layers: planned number
    of layers. force: on each pad [N]."""

    thickness: float
    real: float
    layers: int
    force: float


def measure_grasps(tell: Callable[[str], None], garments: list[Garment], count: int) -> dict[str, Any]:
    """Measure rates and characteristics with `count` seeded trials, at each scale of the sensors' noise."""
    shipped = load_settings()
    settings = shipped.grasp.settings(
        load_robot(shipped).contact_effort,
        shipped.gripper.closed_opening,
        find_robot(shipped.robot).gripper.tip_distance(shipped.gripper.opening),
    )
    figures: dict[str, Any] = {"grasps": count}
    rates: dict[tuple[str, float], tuple[float, float]] = {}
    for scale in SCALES:
        tell(f"{count} grasps of each kind at {scale:g} x the sensors' noise")
        records = [_recorded(seed, scale, garments, settings) for seed in range(count)]
        slips = [_slip_record(seed, scale, garments, settings) for seed in range(count)]
        told = {
            "missed": _told_missed(records, settings),
            "double": _told_double(records, settings),
            "slipped": _told_slipped(slips, settings),
        }
        curves = {
            "missed": [_told_missed(records, replace(settings, held_force=x)) for x in HELD_FORCES],
            "double": [_told_double(records, replace(settings, layer_doubt=x)) for x in DOUBTS],
            "slipped": [
                _told_slipped(slips, replace(settings, slip_fraction=x, slip_opening_fraction=x))
                for x in FRACTIONS
            ],
        }
        for name, (hit, alarm) in told.items():
            rates[name, scale] = hit, alarm
            figures[f"{name}_detection_rate_{scale:g}x"] = hit
            figures[f"{name}_false_alarm_rate_{scale:g}x"] = alarm
        more = [_kind(r, "one_more", settings) for r in records]
        figures[f"one_layer_more_detection_rate_{scale:g}x"] = _share(more, FailureKind.MISSED_LAYER)
        for name, curve in curves.items():
            figures[f"{name}_roc_{scale:g}x"] = [[round(alarm, 4), round(hit, 4)] for hit, alarm in curve]
    figures["roc_thresholds"] = {
        "missed_held_force_n": list(HELD_FORCES), "double_layer_doubt": list(DOUBTS),
        "slipped_fraction": list(FRACTIONS),
    }  # fmt: skip
    figures["grasp_detection_rate_min"] = min(rates[k][0] for k in rates if k[1] == 1.0)
    figures["grasp_false_alarm_rate"] = max(rates[k][1] for k in rates if k[1] == 1.0)
    figures["grasp_detection_rate_min_2x"] = min(rates[k][0] for k in rates if k[1] == 2.0)
    figures["grasp_false_alarm_rate_2x"] = max(rates[k][1] for k in rates if k[1] == 2.0)
    return figures


@dataclass(frozen=True, eq=False)
class _Record:
    """One hand's tare, and its readings in five cases: it holds the planned layers, twice as many layers, one
    layer more, or no cloth, with the pads unloaded ("nothing") or pressing on each other ("closed")."""

    trial: _Trial
    tare: TactileBias
    readings: dict[str, list[HandReading]]


def _draw(rng: np.random.Generator, garments: list[Garment]) -> _Trial:
    garment = garments[int(rng.integers(len(garments)))]
    thickness = garment.material.thickness
    real = thickness * (1.0 + THICKNESS_SPREAD * rng.uniform(-1.0, 1.0))
    layers = garment.layers * int(rng.choice(STACKED))
    return _Trial(thickness, real, layers, float(rng.uniform(8.0, 20.0)))


def _zeroed(hand: _Hand, settings: GraspSettings) -> TactileBias:
    state: TareState | Outcome[TactileBias] = start_tare(settings)
    while not isinstance(state, Outcome):
        state = tare(hand.read(), state)
    return state.unwrap()


def _recorded(seed: int, scale: float, garments: list[Garment], settings: GraspSettings) -> _Record:
    rng = np.random.default_rng([seed, 1])
    hand = _Hand(np.random.default_rng([seed, 2]), scale)
    trial = _draw(rng, garments)
    pads = _zeroed(hand, settings)
    hand.now += DESCENT_S
    held = {
        "planned": (trial.layers * trial.real, trial.force),
        "double": (2 * trial.layers * trial.real, trial.force),
        "one_more": ((trial.layers + 1) * trial.real, trial.force),
        "nothing": (0.0, 0.0),
        "closed": (0.0, trial.force),  # the pads press on each other
    }
    readings = {}
    for name, (opening, force) in held.items():
        hand.opening, hand.pads = opening, force
        readings[name] = [hand.read() for _ in range(CONFIRM_READINGS)]
    return _Record(trial, pads, readings)


def _judged(record: _Record, name: str, settings: GraspSettings) -> Outcome[Held]:
    state = start_confirm(settings, record.tare, Expectation(record.trial.thickness, record.trial.layers))
    for reading in record.readings[name]:
        after = confirm(reading, state)
        if isinstance(after, Outcome):
            return after
        state = after
    raise AssertionError("a confirmation takes as many readings as its settings say")


def _kind(record: _Record, name: str, settings: GraspSettings) -> FailureKind | None:
    failure = _judged(record, name, settings).failure
    return failure.kind if failure else None


def _told_missed(records: list[_Record], settings: GraspSettings) -> tuple[float, float]:
    """Return the detection rate of missed grasps, and the rate of good grasps that are reported as missed. In half
    of the missed grasps the pads press on each other."""
    missed = [_kind(r, "closed" if i % 2 else "nothing", settings) for i, r in enumerate(records)]
    good = [_kind(r, "planned", settings) for r in records]
    return _share(missed, FailureKind.MISSED_GRASP), _share(good, FailureKind.MISSED_GRASP)


def _told_double(records: list[_Record], settings: GraspSettings) -> tuple[float, float]:
    double = [_kind(r, "double", settings) for r in records]
    good = [_kind(r, "planned", settings) for r in records]
    return _share(double, FailureKind.MISSED_LAYER), _share(good, FailureKind.MISSED_LAYER)


def _share(kinds: list[FailureKind | None], wanted: FailureKind) -> float:
    return sum(k is wanted for k in kinds) / len(kinds)


@dataclass(frozen=True, eq=False)
class _SlipRecord:
    """Readings during two folds: one in which the cloth stays between the pads, and one in which it is lost. lost:
    time of the loss after the start of the fold [s]."""

    tare: TactileBias
    held: Held
    begun: float
    lost: float
    stays: list[HandReading]
    goes: list[HandReading]


def _slip_record(seed: int, scale: float, garments: list[Garment], settings: GraspSettings) -> _SlipRecord:
    trial = _draw(np.random.default_rng([seed, 3]), garments)
    lost = float(np.random.default_rng([seed, 4]).uniform(0.2, FOLD_S - 0.2))
    readings: dict[str, list[HandReading]] = {}
    for name, event in (("stays", None), ("goes", lost)):
        hand = _Hand(np.random.default_rng([seed, 5]), scale)
        pads = _zeroed(hand, settings)
        hand.now += DESCENT_S
        begun = hand.now
        readings[name] = list(_fold(hand, trial, event, seed))
    count = LayerCount((0.0, 1.0), 1.0, 0.1)
    held = Held(begun, trial.force, trial.layers * trial.real, count)
    return _SlipRecord(pads, held, begun, lost, readings["stays"], readings["goes"])


def _fold(hand: _Hand, trial: _Trial, lost: float | None, seed: int) -> Iterator[HandReading]:
    """Simulate the readings during a fold. The pull of the cloth makes force and opening oscillate. After the time
    `lost` [s], the pads either close on each other within 25 ms, or stay apart and lose nearly all force."""
    rng = np.random.default_rng([seed, 6])
    rate, phase, shuts = rng.uniform(2.0, 12.0), rng.uniform(0.0, 6.28), bool(rng.integers(2))
    begun, opening = hand.now, trial.layers * trial.real
    while hand.now - begun < FOLD_S:
        t = hand.now - begun + 0.01
        swing = float(np.sin(rate * t + phase))
        hand.pads, hand.opening = trial.force * (1.0 + 0.2 * swing), opening * (1.0 + 0.1 * swing)
        if lost is not None and t >= lost:
            gone = min(1.0, (t - lost) / 0.025)
            if shuts:
                hand.opening *= 1.0 - gone
                hand.pads *= 0.6 if gone < 1.0 else 1.0
            else:
                hand.pads *= 1.0 - 0.95 * gone
        yield hand.read()


def _told_slipped(records: list[_SlipRecord], settings: GraspSettings) -> tuple[float, float]:
    """Return the rate of losses that are detected within 100 ms, and the rate of false alarms in folds without a
    loss."""
    hits, alarms = 0, 0
    for r in records:
        t = _first_alarm(r, r.goes, settings)
        hits += t is not None and -0.005 <= t - r.lost <= TOLD_WITHIN + 1e-9
        alarms += _first_alarm(r, r.stays, settings) is not None
    return hits / len(records), alarms / len(records)


def _first_alarm(record: _SlipRecord, readings: list[HandReading], settings: GraspSettings) -> float | None:
    watch = start_slip_watch(settings, record.tare, record.held)
    for reading in readings:
        after = watch_slip(reading, watch)
        if isinstance(after, Outcome):
            return reading.stamp - record.begun
        watch = after
    return None
