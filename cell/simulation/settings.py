"""Settings of a simulated cell."""

from __future__ import annotations

from dataclasses import dataclass, field

from foldcell.robots.camera_mount import CameraMount
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.registry import DEFAULT
from foldcell.skills.cloth.pinch import PadGeometry
from foldcell.skills.vocabulary import Table

DEFAULT_TABLE = Table(height=-0.10, x=(0.20, 1.10), y=(-0.75, 0.75))
"""The default table. Its top is 0.82 m above the floor, within the reach of both arms and the camera's view."""

WORLDS = ("xpbd", "mujoco")


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of a simulated cell. Raises ConfigurationError for invalid ones.

    robot: its name. garment: a name, a path, or 'auto' (drawn by the seed). surface: the table's surface, which
    selects the garment's friction. realtime: pace the world by the wall clock. world: solver of the cloth,
    foldcell's own ('xpbd') or MuJoCo's flex ('mujoco', for towels). robot_noise, camera_noise, garment_noise: off
    for an ideal cell. render: if off, the camera raises a fault. as_built: table height and camera intrinsics
    differ from the drawing, and there is a calibration board. q_start: (joints,) configuration of the arms at the
    start [rad]; None: the park configuration. camera: its mount and lens; None: the robot's own. pads: of the
    grippers; their friction is drawn by the seed.
    """

    robot: str = DEFAULT
    garment: str = "medium_towel"
    surface: str = "bare_table"
    table: Table = DEFAULT_TABLE
    realtime: bool = False
    world: str = "xpbd"
    robot_noise: bool = True
    camera_noise: bool = True
    garment_noise: bool = True
    render: bool = True
    as_built: bool = False
    q_start: tuple[float, ...] | None = None
    camera: CameraMount | None = None
    pads: PadGeometry = field(default_factory=PadGeometry)

    def __post_init__(self) -> None:
        if self.world not in WORLDS:
            raise ConfigurationError(f"unknown world '{self.world}'", f"it is one of {', '.join(WORLDS)}")
