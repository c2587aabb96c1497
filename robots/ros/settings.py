"""Settings of a robot's driver over ROS."""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["CameraTopics", "RosSettings"]


@dataclass(frozen=True)
class CameraTopics:
    """Topics of the camera: the colour picture as sensor_msgs/Image (rgb8 or bgr8), the depth registered to it as
    Image (32FC1 [m] or 16UC1 [mm]), and CameraInfo. The defaults are the names of openni2_launch with
    depth_registration."""

    rgb: str = "/camera/rgb/image_raw"
    depth: str = "/camera/depth_registered/image_raw"
    info: str = "/camera/rgb/camera_info"


@dataclass(frozen=True)
class RosSettings:
    """Settings of the connection.

    raw_position: switches the robot's own collision avoidance off and uses feed-forward for closer tracking.
    tactile_rows: rows of cells on each pad. camera_settle: streaming time before a picture is used [s].
    """

    camera: CameraTopics = field(default_factory=CameraTopics)
    raw_position: bool = False
    tactile_rows: int = 4
    camera_settle: float = 0.5
