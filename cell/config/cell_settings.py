"""What the executive is told about its cell: `cell.yaml` as validated, frozen settings.

Lengths in metres, angles in radians unless a key ends in `_deg`, times in seconds of the cell's clock,
forces in newtons. The shipped `cell.yaml` beside this file is complete and states every default; a file of
one's own needs only what differs. An unknown key, a key given twice, or a value out of range is refused
with a ConfigurationError before anything moves.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cell.config.calibration_file import load_camera_calibration, load_table_height, load_tactile_thresholds
from cell.config.yaml_file import Document, Key, merge, read_yaml, validated
from robots.errors import ConfigurationError
from skills.vocabulary import Table

if TYPE_CHECKING:
    from robots.baxter.ros.connection import RosSettings
    from skills.grasping.settings import GraspSettings
    from skills.perception.inspection.inspect import InspectionSettings
    from skills.perception.perceive import PerceptionSettings

__all__ = [
    "CameraConfig",
    "CellSettings",
    "ComputingConfig",
    "GraspConfig",
    "InspectionConfig",
    "MotionConfig",
    "OptimiserConfig",
    "PerceptionConfig",
    "PressingConfig",
    "RecorderConfig",
    "RecoveryConfig",
    "RosConfig",
    "TableConfig",
    "default_settings_path",
    "load_settings",
    "overlaid",
]


def _number(low: float, high: float, unit: str, about: str) -> Any:
    return Field(
        ge=low, le=high, strict=True, allow_inf_nan=False, description=about, json_schema_extra={"unit": unit}
    )


def _count(low: int, high: int, about: str) -> Any:
    return Field(ge=low, le=high, strict=True, description=about)


def _span(shape: str, about: str) -> Any:
    """Two lengths, bounded one by one in `_Edge`; told to messages as one range."""
    return Field(
        description=about,
        json_schema_extra={"unit": "m", "range": [-2.0, 2.0], "shape": f"allowed is {shape} within"},
    )


_Edge = Annotated[float, Field(ge=-2.0, le=2.0, strict=True, allow_inf_nan=False)]


_TOPIC = r"^(/[A-Za-z][A-Za-z0-9_]*)+$"


class _Group(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)


class TableConfig(_Group):
    """The table's top."""

    height: float = _number(
        -0.6, 0.5, "m", "the table top's z in the robot's base frame; Baxter's floor is at z = -0.924"
    )
    x: tuple[_Edge, _Edge] = _span("[near, far]", "near and far edge in the table frame")
    y: tuple[_Edge, _Edge] = _span("[right, left]", "right and left edge in the table frame")
    calibration: Path | None = Field(
        description="a table calibration file, relative to this file: its height replaces the one above"
    )

    @model_validator(mode="after")
    def _extent(self) -> Self:
        for name, (low, high) in (("x", self.x), ("y", self.y)):
            if high - low < 0.2:
                raise ValueError(
                    f"table.{name} = [{low:g}, {high:g}]: a table goes from less to more, by 0.2 m or more"
                )
        return self


class CameraConfig(_Group):
    """The RGB-D camera over the robot's head."""

    calibration: Path | None = Field(
        description="a camera calibration file, relative to this file; null: the bracket as it was designed"
    )
    reference: Literal["photograph", "none"] = Field(
        description="photograph the empty table before the garment is laid, or do without"
    )


class PerceptionConfig(_Group):
    """When the recognised garment is believed (skills.perception.perceive)."""

    method: Literal["reference", "plain", "grabcut", "watershed"] = Field(
        description="segmentation: by the empty table's picture, the table's colour, its pattern, or the paper's"
    )
    lowest_confidence: float = _number(0.0, 1.0, "", "least confidence of a recognised garment")
    known_iou: float = _number(0.3, 1.0, "", "overlap with a template below which a garment is unknown")
    size_tolerance: float = _number(0.02, 1.0, "", "relative difference from a garment's nominal size")
    flat_height: float = _number(0.002, 0.2, "m", "95th percentile of height up to which a garment lies flat")

    def settings(self) -> PerceptionSettings:
        """As the skill takes them; what stands in no file keeps the skill's defaults."""
        from skills.perception.perceive import PerceptionSettings

        return PerceptionSettings(**self.model_dump())


class MotionConfig(_Group):
    """How fast and how near the arms move."""

    velocity_scale: float = _number(0.05, 1.0, "", "fraction of the joints' velocity limits")
    accelerations: Literal["planning", "commissioning"] = Field(
        description="the robot model's set of acceleration and jerk limits"
    )
    tool_speed: float = _number(0.02, 1.0, "m/s", "cap of the grippers' speed while they hold a garment")
    approach_height: float = _number(0.03, 0.4, "m", "height above a grasp from which a gripper descends")
    start_tolerance_deg: float = _number(
        0.1, 5.0, "degrees", "how far a joint may stand from a trajectory's first point"
    )
    tracking_tolerance: float = _number(0.01, 0.5, "rad", "how far a joint may lag behind its set-point")
    state_age: float = _number(0.02, 1.0, "s", "age from which a joint state is too old to act on")


class GraspConfig(_Group):
    """Guarded descent, pinch, confirmation (skills.grasping)."""

    approach_speed: float = _number(0.005, 0.3, "m/s", "down to just above the garment")
    guarded_speed: float = _number(0.002, 0.1, "m/s", "from there to the contact")
    contact_force: float = _number(0.05, 20.0, "N", "rise of a tip's force that counts as contact")
    press_force: float = _number(1.0, 60.0, "N", "rise of a tip's force at which a hand goes no deeper to grasp")
    grip_force: float = _number(1.0, 60.0, "N", "squeeze of the pads")
    held_force: float = _number(0.05, 20.0, "N", "least mean force on each pad of a grasp that holds")
    lift_height: float = _number(0.005, 0.15, "m", "how high a grasp is lifted to be confirmed")
    calibration: Path | None = Field(
        description="a tactile calibration file, relative to this file: its thresholds replace those above"
    )

    def settings(self) -> GraspSettings:
        """As the skill takes them; what stands in no file keeps the skill's defaults."""
        from skills.grasping.settings import GraspSettings

        values = self.model_dump(exclude={"lift_height", "calibration"})
        if self.calibration is not None:
            values |= load_tactile_thresholds(self.calibration)
        return GraspSettings(**values)


class InspectionConfig(_Group):
    """When an observed fold counts as the predicted one (skills.perception.inspection.inspect)."""

    iou: float = _number(0.3, 1.0, "", "least intersection over union of observed and predicted silhouette")
    drift: float = _number(0.002, 0.2, "m", "largest translation against the prediction")
    drift_deg: float = _number(0.5, 45.0, "degrees", "largest rotation against the prediction")
    extra_height: float = _number(0.002, 0.1, "m", "largest height above the predicted one")
    deviation: float = _number(0.002, 0.2, "m", "largest distance of an edge from where it was predicted")

    def settings(self, perception: PerceptionConfig) -> InspectionSettings:
        """As the skill takes them; what stands in no file keeps the skill's defaults."""
        from skills.perception.inspection.inspect import InspectionSettings

        values = self.model_dump(exclude={"drift_deg"})
        return InspectionSettings(
            **values, drift_angle=math.radians(self.drift_deg), perception=perception.settings()
        )


class PressingConfig(_Group):
    """Pressing the crease of a fold that stands high (skills.planning.pressing), where nothing or heights speak
    against it (skills.perception.inspection.diagnosis.diagnosed_by_height)."""

    tries: int = _count(0, 5, "how often one fold is pressed, at most; 0: never")
    above_flat: float = _number(
        0.001, 0.1, "m", "height over the flat stack, as the camera sees it, from which a fold is pressed"
    )
    force: float = _number(1.0, 60.0, "N", "rise of a tip's force at which a hand presses no further")


class RecoveryConfig(_Group):
    """How long the cell tries by itself; what it tries stands in cell/states/recovery_table.py."""

    attempts_per_step: int = _count(0, 20, "recoveries in one fold step")
    attempts_per_run: int = _count(0, 100, "recoveries in one run")
    dwell: float = _number(0.0, 10.0, "s", "shortest pause before a recovery")


class OptimiserConfig(_Group):
    """Finding a fold's trajectory."""

    method: Literal["default", "paper", "initial", "two_parameter"] = Field(description="how arcs are found")
    simulations: int = _count(1, 2000, "budget of one fold step, in cloth simulations")
    threads: int = _count(1, 64, "simulations at a time")
    use_library: bool = Field(strict=True, description="take a stored trajectory where one fits")
    adapt: bool = Field(strict=True, description="learn the friction from each fold, for the next")


class ComputingConfig(_Group):
    """Declared costs of computing in simulation [s of cell time]: charged, never measured, so that a run is a
    function of its seed."""

    perception_s: float = _number(0.0, 60.0, "s", "segmentation, classification, key points")
    planning_s: float = _number(0.0, 60.0, "s", "planning the folds")
    library_s: float = _number(0.0, 60.0, "s", "looking a trajectory up")
    simulation_s: float = _number(0.0, 60.0, "s", "one cloth simulation of the optimiser")
    motion_s: float = _number(0.0, 60.0, "s", "planning and checking one step's motion")
    inspection_s: float = _number(0.0, 60.0, "s", "judging a fold")


class RosConfig(_Group):
    """The robot over ROS (robots.baxter.ros); the master is ROS_MASTER_URI's."""

    raw_position: bool = Field(
        strict=True,
        description="set-points without the robot's own collision avoidance, with feed-forward: it follows more "
        "closely",
    )
    tactile_rows: int = _count(1, 64, "rows of pressure cells on each pad")
    camera_settle: float = _number(0.0, 5.0, "s", "how long the camera streams before a picture counts")
    camera_rgb: str = Field(pattern=_TOPIC, strict=True, description="topic of the colour picture")
    camera_depth: str = Field(pattern=_TOPIC, strict=True, description="topic of the depth, registered to it")
    camera_info: str = Field(pattern=_TOPIC, strict=True, description="topic of the colour camera's figures")

    def settings(self) -> RosSettings:
        """As the driver takes them."""
        from robots.baxter.ros.connection import RosSettings
        from robots.baxter.ros.topics import CameraTopics

        camera = CameraTopics(self.camera_rgb, self.camera_depth, self.camera_info)
        return RosSettings(camera, self.raw_position, self.tactile_rows, self.camera_settle)


class RecorderConfig(_Group):
    """What a run's report shows."""

    key_frames: int = _count(2, 24, "pictures of a fold in the report")


class CellSettings(_Group):
    """All settings of a cell; made by `load_settings`."""

    schema_: Literal[1] = Field(alias="schema", description="version of this file's layout: 1")
    robot: Literal["baxter"] = Field(description="the robot's folder under robots/")
    surface: str = Field(
        pattern=r"^[a-z][a-z0-9_]{0,40}$",
        strict=True,
        description="name of the table's covering: garment files state their friction by it",
    )
    table_: TableConfig = Field(alias="table")
    camera: CameraConfig
    perception: PerceptionConfig
    motion: MotionConfig
    grasp: GraspConfig
    inspection: InspectionConfig
    pressing: PressingConfig
    recovery: RecoveryConfig
    optimiser: OptimiserConfig
    computing: ComputingConfig
    recorder: RecorderConfig
    ros: RosConfig

    @property
    def table(self) -> Table:
        """The table as the skills know it: at its calibrated height where a file is named."""
        if self.table_.calibration is None:
            return self.drawn_table
        return Table(load_table_height(self.table_.calibration), self.table_.x, self.table_.y)

    @property
    def drawn_table(self) -> Table:
        """The table as this file states it, calibrated or not."""
        return Table(self.table_.height, self.table_.x, self.table_.y)

    @property
    def calibrations(self) -> dict[str, Path]:
        """The calibration files that are named, by group."""
        named = {
            "table": self.table_.calibration,
            "camera": self.camera.calibration,
            "grasp": self.grasp.calibration,
        }
        return {group: path for group, path in named.items() if path is not None}

    @property
    def calibrated(self) -> bool:
        """Whether any calibration file is named."""
        return bool(self.calibrations)

    def as_yaml(self) -> str:
        """The exact settings as a `cell.yaml`, to be kept with a run."""
        return yaml.safe_dump(self.model_dump(mode="json", by_alias=True), sort_keys=False, allow_unicode=True)

    def fingerprint(self) -> str:
        """Hash of every value: equal settings have equal fingerprints, in any order of keys."""
        canonical = json.dumps(self.model_dump(mode="json", by_alias=True), sort_keys=True)
        return hashlib.sha256(canonical.encode()).hexdigest()[:16]


def default_settings_path() -> Path:
    """The shipped `cell.yaml`."""
    return Path(__file__).with_name("cell.yaml")


def load_settings(path: Path | None = None) -> CellSettings:
    """The settings of `path` over the shipped ones, or the shipped ones alone.

    Raises ConfigurationError: unreadable file, unknown or repeated key, value out of range, and a
    calibration file that is named but cannot be used.
    """
    default = read_yaml(default_settings_path(), "cell settings file")
    if path is None:
        return validated(default, CellSettings)
    document = read_yaml(path, "cell settings file")
    merged = merge(default.data, document.data)
    settings = _with_absolute_paths(validated(document, CellSettings, merged), path.resolve().parent)
    _check_files(settings, document.where)
    return settings


def overlaid(
    settings: CellSettings, over: Mapping[str, Any], path: Path, lines: Mapping[Key, int]
) -> CellSettings:
    """`settings` with what a part of another file, `path`, says instead. lines: of its keys there. Raises
    ConfigurationError as `load_settings`."""
    document = Document(path, over, lines)
    merged = merge(settings.model_dump(mode="json", by_alias=True), over)
    laid = _with_absolute_paths(validated(document, CellSettings, merged), path.resolve().parent)
    _check_files(laid, document.where)
    return laid


def _with_absolute_paths(settings: CellSettings, folder: Path) -> CellSettings:
    """File names of a settings file are relative to that file, not to where the command was typed."""

    def absolute(name: Path | None) -> Path | None:
        return name and (folder / name.expanduser()).resolve()

    groups = {name: getattr(settings, name) for name in ("table_", "camera", "grasp")}
    return settings.model_copy(
        update={n: g.model_copy(update={"calibration": absolute(g.calibration)}) for n, g in groups.items()}
    )


def _check_files(settings: CellSettings, where: Any) -> None:
    files: dict[str, tuple[Path | None, Callable[[Path], object]]] = {
        "table": (settings.table_.calibration, load_table_height),
        "camera": (settings.camera.calibration, load_camera_calibration),
        "grasp": (settings.grasp.calibration, load_tactile_thresholds),
    }
    for group, (path, load) in files.items():
        if path is None:
            continue
        try:
            load(path)
        except ConfigurationError as e:
            key = (group, "calibration")
            raise ConfigurationError(f"{where(key)}: {group}.calibration: {e.what}", e.hint, **e.values) from e
