"""Cell settings: `cell.yaml` as validated, frozen values.

Lengths in metres, angles in radians unless a key ends in `_deg`, times in seconds of the cell's clock,
forces in newtons. The shipped `cell.yaml` beside this file states the default of every key. A user's file needs
only the keys that differ. An unknown key, a repeated key or a value out of range raises ConfigurationError
before anything moves.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from foldcell.cell.config.calibration_file import (
    load_camera_calibration,
    load_table_height,
    load_tactile_thresholds,
)
from foldcell.cell.config.yaml_file import Document, Key, merge, read_yaml, validated
from foldcell.cell.support.files.paths import checked_name
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.registry import list_robots
from foldcell.robots.ros.driver import CameraTopics, Network, RosSettings
from foldcell.skills.vocabulary import Table

if TYPE_CHECKING:
    from foldcell.skills.cloth.pinch import PadGeometry
    from foldcell.skills.grasping.settings import GraspSettings
    from foldcell.skills.perception.inspection.claim import ClaimSettings
    from foldcell.skills.perception.inspection.result import InspectionSettings
    from foldcell.skills.perception.settings import PerceptionSettings


def _number(low: float, high: float, unit: str, about: str) -> Any:
    return Field(
        ge=low, le=high, strict=True, allow_inf_nan=False, description=about, json_schema_extra={"unit": unit}
    )


def _count(low: int, high: int, about: str) -> Any:
    return Field(ge=low, le=high, strict=True, description=about)


def _span(shape: str, about: str) -> Any:
    """Make a field for two lengths. `_Edge` checks the range of each. The entries `range` and `shape` let error
    messages state this range."""
    return Field(
        description=about,
        json_schema_extra={"unit": "m", "range": [-2.0, 2.0], "shape": f"allowed is {shape} within"},
    )


def _place(shape: str, about: str) -> Any:
    """Make a field for a point of three lengths, or null."""
    return Field(description=about, json_schema_extra={"unit": "m", "shape": f"a place is {shape}"})


def _angles(arm: str) -> Any:
    """Make a field for the parked joints of an arm, or null."""
    return Field(
        description=f"joint angles of {arm} when it is parked, from the shoulder on; null: the robot's own",
        json_schema_extra={
            "unit": "rad",
            "range": [-6.3, 6.3],
            "shape": "allowed is an angle for each joint within",
        },
    )


_Angle = Annotated[float, Field(ge=-6.3, le=6.3, strict=True, allow_inf_nan=False)]
_Edge = Annotated[float, Field(ge=-2.0, le=2.0, strict=True, allow_inf_nan=False)]
_Height = Annotated[float, Field(ge=0.2, le=3.0, strict=True, allow_inf_nan=False)]

LEAST_DOWN = 0.2
"""Least height of the camera above the point that it looks at [m]."""


_TOPIC = r"^(/[A-Za-z][A-Za-z0-9_]*)+$"

RENAMED_KEYS = {
    "perception.lowest_confidence": "min_fit",
    "perception.min_confidence": "min_fit",
    "perception.known_iou": "min_template_iou",
    "motion.state_age": "max_state_age_s",
    "pressing.tries": "max_attempts",
    "pressing.above_flat": "min_excess_height",
    "optimiser.adapt": "learn_friction",
}
"""Former key -> its present name. The error message for a former key states the present name."""


class _Group(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)


class TableConfig(_Group):
    """Position and extent of the table top."""

    height: float = _number(-0.6, 0.5, "m", "the table top's z in the robot's base frame")
    x: tuple[_Edge, _Edge] = _span("[near, far]", "near and far edge in the table frame")
    y: tuple[_Edge, _Edge] = _span("[right, left]", "right and left edge in the table frame")
    calibration: Path | None = Field(
        description="a table calibration file, relative to this file: its height replaces table.height"
    )

    @model_validator(mode="after")
    def _extent(self) -> Self:
        for name, (low, high) in (("x", self.x), ("y", self.y)):
            if high - low < 0.2:
                raise ValueError(
                    f"table.{name} = [{low:g}, {high:g}]: the second edge has to exceed the first by 0.2 m or more"
                )
        return self


class CameraConfig(_Group):
    """The RGB-D camera over the table. If a key is null, the value of the robot's own camera applies."""

    position: tuple[_Edge, _Edge, _Height] | None = _place(
        "[x, y, z]", "place of the camera in the table frame, with the head straight; null: on the robot's bracket"
    )
    target: tuple[_Edge, _Edge, _Edge] | None = _place(
        "[x, y, z]", "point in the table frame in the middle of the picture"
    )
    width: int | None = Field(ge=160, le=4096, strict=True, description="columns of the picture, or null")
    height: int | None = Field(ge=120, le=4096, strict=True, description="rows of the picture, or null")
    view_deg: float | None = Field(
        ge=20.0, le=110.0, strict=True, allow_inf_nan=False,
        description="horizontal angle of view, or null", json_schema_extra={"unit": "degrees"},
    )  # fmt: skip
    calibration: Path | None = Field(
        description="a camera calibration file, relative to this file: it replaces the stated place and lens"
    )
    reference: Literal["photograph", "none"] = Field(
        description="whether the empty table is photographed before the garment is laid on it"
    )

    @model_validator(mode="after")
    def _direction(self) -> Self:
        if (self.position is None) != (self.target is None):
            missing = "target" if self.target is None else "position"
            raise ValueError(f"camera.{missing} is missing: position and target are stated together")
        if self.position is not None and self.target is not None:
            down = self.position[2] - self.target[2]
            if down < LEAST_DOWN:
                raise ValueError(
                    f"camera.target = {list(self.target)}: the camera has to look down on it, from a "
                    f"camera.position that is {LEAST_DOWN:g} m higher or more"
                )
        if (self.width is None) != (self.height is None):
            missing = "height" if self.height is None else "width"
            raise ValueError(f"camera.{missing} is missing: width and height are stated together")
        return self


class ParkConfig(_Group):
    """The parked arms. An arm that is null parks as its robot's model states."""

    left: tuple[_Angle, ...] | None = _angles("the left arm")
    right: tuple[_Angle, ...] | None = _angles("the right arm")


class PerceptionConfig(_Group):
    """Thresholds for accepting a recognised garment (foldcell.skills.perception.settings)."""

    method: Literal["reference", "plain", "grabcut"] = Field(
        description="segmentation: reference (picture of the empty table), plain (table colour) or grabcut "
        "(table pattern)"
    )
    min_fit: float = _number(0.0, 1.0, "", "minimum quality of the fit of a recognised garment's outline")
    least_confidence: float = _number(
        0.0, 1.0, "", "least probability that all key points of a recognised garment lie within 10 mm"
    )
    min_template_iou: float = _number(0.3, 1.0, "", "template overlap (IoU) below which a garment is unknown")
    size_tolerance: float = _number(0.02, 1.0, "", "largest relative difference from a garment's nominal size")
    flat_height: float = _number(0.002, 0.2, "m", "largest 95th percentile of height of a garment that lies flat")

    def settings(self) -> PerceptionSettings:
        """The skill's settings."""
        from foldcell.skills.perception.settings import PerceptionSettings

        return PerceptionSettings(**self.model_dump())


class MotionConfig(_Group):
    """Speeds and tolerances of the arms."""

    velocity_scale: float = _number(0.05, 1.0, "", "fraction of the joints' velocity limits")
    accelerations: Literal["planning", "commissioning"] = Field(
        description="the robot model's set of acceleration and jerk limits"
    )
    tool_speed: float = _number(0.02, 1.0, "m/s", "maximum speed of a gripper that holds a garment")
    approach_height: float = _number(0.03, 0.4, "m", "height above a grasp from which a gripper descends")
    start_tolerance_deg: float = _number(
        0.1, 5.0, "degrees", "largest distance of a joint from the first point of a trajectory"
    )
    tracking_tolerance: float = _number(0.01, 0.5, "rad", "largest lag of a joint behind its set-point")
    latency_s: float = _number(
        0.0, 0.15, "s", "time that a set-point and the reading that shows it are on the network together"
    )
    max_state_age_s: float = _number(0.02, 1.0, "s", "age above which a joint state is too old to act on")


class GripperConfig(_Group):
    """Both grippers and their pads. The robot's model has the shape of their fingers."""

    opening: float = _number(0.005, 0.2, "m", "opening of the pads when a hand goes down to grasp")
    closed_opening: float = _number(0.0, 0.02, "m", "opening that the gripper reports when it is closed and empty")
    pad_width: float = _number(0.003, 0.1, "m", "length of the line of cloth that the pads hold")
    pad_depth: float = _number(0.002, 0.08, "m", "height over the tips up to which the pads hold cloth")
    pad_friction: float = _number(0.1, 3.0, "", "friction coefficient of a pad on cloth")

    @property
    def pads(self) -> PadGeometry:
        """The pads, for planning and prediction."""
        from foldcell.skills.cloth.pinch import PadGeometry

        return PadGeometry(self.pad_width, self.opening, self.pad_depth, self.pad_friction)


class GraspConfig(_Group):
    """Speeds, forces and sensors of a grasp: guarded descent, pinch, confirmation (foldcell.skills.grasping)."""

    approach_speed: float = _number(0.005, 0.3, "m/s", "speed of the descent to just above the garment")
    guarded_speed: float = _number(0.002, 0.1, "m/s", "speed of the descent from there to contact")
    contact_force: float = _number(0.05, 20.0, "N", "rise of a fingertip's force that counts as contact")
    press_force: float = _number(1.0, 60.0, "N", "rise of a fingertip's force at which the descent ends")
    grip_force: float = _number(1.0, 60.0, "N", "grip force of the pads")
    held_force: float = _number(0.05, 20.0, "N", "minimum mean force on each pad of a grasp that holds")
    lift_height: float = _number(0.005, 0.15, "m", "height of the lift that confirms a grasp")
    tactile: bool = Field(
        strict=True, description="use the tactile sensors; false: only the arms' and grippers' own measurements"
    )
    calibration: Path | None = Field(
        description="a tactile calibration file, relative to this file: its thresholds replace those of this group"
    )

    def calibrated(self) -> Self:
        """The group with the thresholds of its calibration file, if it names one."""
        return self.model_copy(update=load_tactile_thresholds(self.calibration) if self.calibration else None)

    def settings(self, contact_effort: float, empty_opening: float, tip_distance: float) -> GraspSettings:
        """The skill's settings. contact_effort: of the robot's model [Nm]. empty_opening: of its closed, empty
        gripper [m]. tip_distance: between the middles of the fingertips of an open hand [m]."""
        from foldcell.skills.grasping.settings import GraspSettings, without_tactile

        values = self.calibrated().model_dump(exclude={"lift_height", "calibration", "tactile"})
        settings = GraspSettings(
            **values, contact_effort=contact_effort, empty_opening=empty_opening, tip_distance=tip_distance
        )
        return settings if self.tactile else without_tactile(settings)


class InspectionConfig(_Group):
    """Thresholds for accepting an observed fold (foldcell.skills.perception.inspection.inspect)."""

    enabled: bool = Field(
        strict=True, description="judge each fold by a picture; false: the plan goes on from the predicted shape"
    )
    iou: float = _number(
        0.3, 1.0, "", "minimum intersection over union of the observed and the predicted silhouette"
    )
    drift: float = _number(0.002, 0.2, "m", "largest translation from the prediction")
    drift_deg: float = _number(0.5, 45.0, "degrees", "largest rotation from the prediction")
    extra_height: float = _number(0.002, 0.1, "m", "largest height above the predicted one")
    deviation: float = _number(0.002, 0.2, "m", "largest distance of an edge from its prediction")
    claim_iou: float = _number(0.3, 1.0, "", "minimum overlap of the folded garment with the plan, for the claim")
    claim_drift: float = _number(0.002, 0.5, "m", "largest displacement since the garment was first seen")
    claim_drift_deg: float = _number(0.5, 90.0, "degrees", "largest rotation since then")
    stack_margin: float = _number(0.0, 0.1, "m", "height allowed above the flat stack, away from creases")
    ideal_margin: float = _number(0.0, 0.1, "m", "height allowed above the ideal fold, away from creases")
    crease_margin: float = _number(
        -0.05,
        0.1,
        "m",
        "height allowed above the ideal fold, near creases; negative: only a pressed crease is flat",
    )
    height_sigma: float = _number(0.0, 0.05, "m", "error of an observed height away from creases (1 sigma)")
    crease_sigma: float = _number(0.0, 0.05, "m", "error of an observed height near creases (1 sigma)")
    first_crease_sigma: float = _number(
        0.0, 0.05, "m", "error with which the first crease's height shows the bending length (1 sigma)"
    )
    ideal_sigma: float = _number(0.0, 0.05, "m", "error of the ideal fold's expected heights (1 sigma)")
    thickness_spread: float = _number(
        0.0, 0.5, "", "error of the thickness of a garment without a class of fabrics, as a share of it (1 sigma)"
    )
    camera_bias: float = _number(-0.02, 0.02, "m", "height by which the camera sees cloth too high")
    camera_bias_sigma: float = _number(0.0001, 0.02, "m", "spread of that bias between runs (1 sigma)")

    def settings(self, perception: PerceptionConfig) -> InspectionSettings:
        """The skill's settings."""
        from foldcell.skills.perception.inspection.result import InspectionSettings

        values = self.model_dump(include={"iou", "drift", "extra_height", "deviation"})
        return InspectionSettings(
            **values,
            drift_angle=math.radians(self.drift_deg),
            perception=perception.settings(),
            claim=self.claim_settings(),
        )

    def claim_settings(self) -> ClaimSettings:
        """Limits and errors of the claim that the garment is folded."""
        from foldcell.skills.perception.inspection.claim import ClaimSettings

        return ClaimSettings(
            iou=self.claim_iou,
            drift=self.claim_drift,
            drift_angle=math.radians(self.claim_drift_deg),
            stack_margin=self.stack_margin,
            ideal_margin=self.ideal_margin,
            crease_margin=self.crease_margin,
            height_sigma=self.height_sigma,
            crease_sigma=self.crease_sigma,
            first_crease_sigma=self.first_crease_sigma,
            ideal_sigma=self.ideal_sigma,
            thickness_spread=self.thickness_spread,
            camera_bias=self.camera_bias,
            camera_bias_sigma=self.camera_bias_sigma,
        )


class PressingConfig(_Group):
    """Pressing of high creases: the least height and the force (foldcell.skills.fold_plan.pressing)."""

    max_attempts: int = _count(0, 5, "how often one fold may be pressed; 0: never")
    min_excess_height: float = _number(
        0.001, 0.1, "m", "height over the flat stack, seen by the camera, above which a fold is pressed"
    )
    force: float = _number(1.0, 60.0, "N", "rise of a fingertip's force at which pressing stops")


class RecoveryConfig(_Group):
    """Limits of automatic recovery. cell/states/recovery_table.py lists the recoveries."""

    attempts_per_step: int = _count(0, 20, "recoveries in one fold step")
    attempts_per_run: int = _count(0, 100, "recoveries in one run")
    pulls: int = _count(0, 10, "pulls that spread a heap, in one run")
    patience: float = _number(0.0, 600.0, "s", "how long the cell looks again after a failure of seeing")
    dwell: float = _number(0.0, 10.0, "s", "shortest pause before a recovery")


class OptimiserConfig(_Group):
    """Optimisation of a fold's trajectory."""

    method: Literal["default", "paper", "initial", "two_parameter"] = Field(description="how arcs are found")
    simulations: int = _count(1, 2000, "largest number of cloth simulations for one fold step")
    threads: int = _count(1, 64, "simulations that run in parallel")
    use_library: bool = Field(strict=True, description="take a stored trajectory where one fits")
    learn_friction: bool = Field(
        strict=True, description="estimate the friction from each fold and use it for the next"
    )


class ComputingConfig(_Group):
    """Cell time that a simulated run charges for each computation [s]. The costs are declared, not measured, so
    that a run depends on its seed alone."""

    perception_s: float = _number(0.0, 60.0, "s", "segmentation, classification and key points")
    planning_s: float = _number(0.0, 60.0, "s", "planning the folds")
    library_s: float = _number(0.0, 60.0, "s", "looking up a stored trajectory")
    simulation_s: float = _number(0.0, 60.0, "s", "one cloth simulation of the optimiser")
    motion_s: float = _number(0.0, 60.0, "s", "planning and checking one step's motion")
    inspection_s: float = _number(0.0, 60.0, "s", "inspecting a fold")
    check_s: float = _number(0.0, 60.0, "s", "comparing the garment's outline in two pictures")


class RosConfig(_Group):
    """Connection to the robot over ROS (robots/ros/driver.py). ROS_MASTER_URI names the ROS master."""

    raw_position: bool = Field(
        strict=True,
        description="feed-forward, and no collision avoidance by the robot itself; the arms track more closely",
    )
    tactile_rows: int = _count(1, 64, "rows of pressure cells on each pad")
    camera_settle: float = _number(0.0, 5.0, "s", "streaming time before a picture is used")
    camera_rgb: str = Field(pattern=_TOPIC, strict=True, description="topic of the colour image")
    camera_depth: str = Field(
        pattern=_TOPIC, strict=True, description="topic of the depth image, registered to colour"
    )
    camera_info: str = Field(pattern=_TOPIC, strict=True, description="topic of the colour camera's intrinsics")

    def settings(self) -> RosSettings:
        """The driver's settings."""
        camera = CameraTopics(self.camera_rgb, self.camera_depth, self.camera_info)
        return RosSettings(camera, self.raw_position, self.tactile_rows, self.camera_settle)


class NetworkConfig(_Group):
    """Network between the emulated robot and its driver (docs/look_up/emulator.md)."""

    delay: float = _number(0.0, 1.0, "s", "delay of each message, either way")
    jitter: float = _number(0.0, 1.0, "s", "largest deviation from the delay")
    loss: float = _number(0.0, 0.5, "1", "share of the messages that are lost")
    reordering: bool = Field(strict=True, description="a message may overtake an earlier one of its topic")
    repeat: float = _number(0.0, 1.0, "s", "delay with which a second node repeats the joint states; 0 for none")
    clock_ahead: float = _number(-60.0, 60.0, "s", "lead of the robot's clock")
    picture_period: float = _number(0.05, 5.0, "s", "time between two pictures of the camera")
    master_silent_from: float = _number(0.0, 3600.0, "s", "when the ROS master stops to answer")
    master_silent_for: float = _number(0.0, 3600.0, "s", "for how long it does not answer; 0 for never")

    def settings(self) -> Network:
        """The emulator's settings."""
        return Network(**self.model_dump())


class RecorderConfig(_Group):
    """Settings of a run's report."""

    key_frames: int = _count(2, 24, "pictures of a fold in the report")


_CALIBRATION_FILES: Mapping[str, Callable[[Path], object]] = {
    "table": load_table_height,
    "camera": load_camera_calibration,
    "grasp": load_tactile_thresholds,
}
"""Settings group -> function that reads the calibration file that the group may name."""


class CellSettings(_Group):
    """All settings of a cell. `load_settings` reads them from a file."""

    schema_: int = Field(alias="schema", ge=1, le=1, strict=True, description="version of this file's layout: 1")
    robot: str = Field(strict=True, description="a robot of robots/registry.py")
    surface: str = Field(
        pattern=r"^[a-z][a-z0-9_]{0,40}$",
        strict=True,
        description="name of the table's surface: garment files state one friction for each surface",
    )
    table_: TableConfig = Field(alias="table")
    camera: CameraConfig
    park: ParkConfig
    perception: PerceptionConfig
    motion: MotionConfig
    gripper: GripperConfig
    grasp: GraspConfig
    inspection: InspectionConfig
    pressing: PressingConfig
    recovery: RecoveryConfig
    optimiser: OptimiserConfig
    computing: ComputingConfig
    recorder: RecorderConfig
    ros: RosConfig
    network: NetworkConfig

    @field_validator("robot")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in list_robots():
            raise ValueError(f"robot = {name!r}: known robots are {', '.join(list_robots())}")
        return name

    @property
    def table(self) -> Table:
        """The table for the skills, at its calibrated height if the settings name a calibration file."""
        if self.table_.calibration is None:
            return self.drawn_table
        return Table(load_table_height(self.table_.calibration), self.table_.x, self.table_.y)

    @property
    def drawn_table(self) -> Table:
        """The table at the height that the settings file states, without calibration."""
        return Table(self.table_.height, self.table_.x, self.table_.y)

    @property
    def calibrations(self) -> dict[str, Path]:
        """Settings group -> the calibration file that it names."""
        named = {
            "table": self.table_.calibration,
            "camera": self.camera.calibration,
            "grasp": self.grasp.calibration,
        }
        return {group: path for group, path in named.items() if path is not None}

    @property
    def calibrated(self) -> bool:
        return bool(self.calibrations)

    def as_yaml(self) -> str:
        """The complete settings as the text of a `cell.yaml`, to store with a run."""
        return yaml.safe_dump(self.model_dump(mode="json", by_alias=True), sort_keys=False, allow_unicode=True)

    def fingerprint(self) -> str:
        """Return a hash of all keys and values. It does not depend on the order of the keys."""
        canonical = json.dumps(self.model_dump(mode="json", by_alias=True), sort_keys=True)
        return hashlib.sha256(canonical.encode()).hexdigest()[:16]


def default_settings_path() -> Path:
    """The shipped `cell.yaml`."""
    return Path(__file__).with_name("cell.yaml")


def load_settings(path: Path | None = None) -> CellSettings:
    """Return the shipped settings, overridden by those of the file `path` if it is given.

    Raises ConfigurationError for an unreadable file, an unknown or repeated key, a value out of range, and a
    calibration file that is named but cannot be used.
    """
    shipped = validated(_shipped(), CellSettings)
    if path is None:
        return shipped
    document = read_yaml(path, "cell settings file")
    return overlaid(shipped, document.data, path, document.lines)


@cache
def _shipped() -> Document:
    """The shipped settings. A program loads settings many times, and this file does not change meanwhile."""
    return read_yaml(default_settings_path(), "cell settings file")


def overlaid(
    settings: CellSettings, over: Mapping[str, Any], path: Path, lines: Mapping[Key, int]
) -> CellSettings:
    """Return `settings` overridden by `over`, which is a part of the file `path`. lines: line number of each of
    its keys in that file.

    Raises ConfigurationError as `load_settings` does.
    """
    document = Document(path, over, lines)
    merged = merge(settings.model_dump(mode="json", by_alias=True), over)
    result = _with_absolute_paths(validated(document, CellSettings, merged, RENAMED_KEYS), path.resolve().parent)
    for group, file in result.calibrations.items():
        try:
            _CALIBRATION_FILES[group](file)
        except ConfigurationError as e:
            where = document.where((group, "calibration"))
            raise ConfigurationError(f"{where}: {group}.calibration: {e.what}", e.hint, **e.values) from e
    return result


def _with_absolute_paths(settings: CellSettings, folder: Path) -> CellSettings:
    """Make file names absolute: in a settings file they are relative to that file, not to the working
    directory."""

    def absolute(name: Path | None) -> Path | None:
        return name and Path(checked_name(str((folder / name.expanduser()).resolve()), "calibration"))

    groups = {name: getattr(settings, name) for name in ("table_", "camera", "grasp")}
    return settings.model_copy(
        update={n: g.model_copy(update={"calibration": absolute(g.calibration)}) for n, g in groups.items()}
    )
