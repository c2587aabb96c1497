"""The noise table: the values of noise.yaml, checked and typed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np

from foldcell.cell.config.yaml_file import read_yaml

PATH = Path(__file__).with_name("noise.yaml")

T = TypeVar("T")


@dataclass(frozen=True)
class Range:
    """The range of a value. Each world draws its value uniformly between `low` and `high`."""

    low: float
    high: float

    def draw(self, rng: np.random.Generator) -> float:
        return float(rng.uniform(self.low, self.high))


@dataclass(frozen=True)
class RobotNoise:
    encoder_bias: float
    encoder_noise: float
    velocity_noise: float
    effort_time: float
    effort_noise: float
    lag: Range
    jitter: float
    jitter_time: float
    drops_per_minute: float
    drop_depth: Range
    drop_time: Range
    command_timeout: float
    brake: float
    arm_stiffness: float


@dataclass(frozen=True)
class GripperNoise:
    speed: float
    opening_noise: float
    force_noise: float
    force_time: float
    max_force: float
    contact_opening: float
    pad_friction: Range
    calibration_time: float


@dataclass(frozen=True)
class TactileNoise:
    rows: int
    columns: int
    spacing: float
    rate: float
    noise: float
    linearity: float
    drift: float
    tip_noise: float
    tip_stiffness: float
    tip_area: float
    cloth_stiffness: float


@dataclass(frozen=True)
class CameraNoise:
    exposure: float
    white_balance: float
    vignette: float
    rgb: float
    blur_px: float
    depth_sigma: float
    depth_grain_px: float
    depth_lasting: float
    depth_baseline: float
    disparity_step: float
    edge_jump: float
    edge_loss: float
    pixel_loss: float
    pose_position: float
    pose_angle: float
    light_swing: float


@dataclass(frozen=True)
class GarmentNoise:
    size: float
    asymmetry: float
    edge_length: float
    friction: float
    friction_layers: float
    areal_mass: float
    bending_length: float
    stretch_fraction: float
    thickness: float
    anisotropy: float
    damping: float
    residual_curvature: float
    residual_curvature_spread: float
    crease_set: float
    crease_time: Range
    wrinkle_height: float
    wrinkle_length: float
    relief: float
    relief_length: float
    settle_time: float


@dataclass(frozen=True)
class AttendantNoise:
    lay_time: float


@dataclass(frozen=True)
class BuildNoise:
    table_height: float
    focal: float
    centre: float


@dataclass(frozen=True)
class BoardNoise:
    print_scale: float
    shown_distance: Range
    shown_tilt: float
    held_position: float
    held_angle: float


@dataclass(frozen=True)
class NoiseTable:
    """All values. Their units and sources are in noise.yaml."""

    robot: RobotNoise
    gripper: GripperNoise
    tactile: TactileNoise
    camera: CameraNoise
    garment: GarmentNoise
    attendant: AttendantNoise
    build: BuildNoise
    board: BoardNoise


@lru_cache(maxsize=1)
def load_noise() -> NoiseTable:
    """Read noise.yaml, in which each value has its unit and its source."""
    table = read_yaml(PATH, "noise table").data
    return NoiseTable(**{name: _section(kind, table[name]) for name, kind in get_type_hints(NoiseTable).items()})


def _section(kind: type[T], entries: Mapping[str, Mapping[str, Any]]) -> T:
    values: dict[str, float | int | Range] = {}
    for key, type_of_value in get_type_hints(kind).items():
        value = entries[key]["value"]
        values[key] = Range(*map(float, value)) if type_of_value is Range else type_of_value(value)
    return kind(**values)
