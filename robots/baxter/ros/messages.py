"""Message classes of Baxter, its camera and its pads.

Baxter's own messages come only with its SDK, so they are defined here. The names and types of the fields and
constants define the wire format. When two nodes connect, ROS compares a hash of this format. genpy generates the
classes.
"""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

from foldcell.robots.ros.installation import import_ros

POSITION = 1
"""Mode of a JointCommand: joint angles, with the robot's own collision avoidance and its speed limit
(`topics.speed_ratio`)."""
VELOCITY, TORQUE = 2, 3
"""Modes of a JointCommand."""
RAW_POSITION = 4
"""Mode of a JointCommand: joint angles, without the robot's own collision avoidance, speed limit and filter."""

ASSEMBLY_STATE = """
bool ready
bool enabled
bool stopped
bool error
uint8 estop_button
uint8 ESTOP_BUTTON_UNPRESSED=0
uint8 ESTOP_BUTTON_PRESSED=1
uint8 ESTOP_BUTTON_UNKNOWN=2
uint8 ESTOP_BUTTON_RELEASED=3
uint8 estop_source
uint8 ESTOP_SOURCE_NONE=0
uint8 ESTOP_SOURCE_USER=1
uint8 ESTOP_SOURCE_UNKNOWN=2
uint8 ESTOP_SOURCE_FAULT=3
uint8 ESTOP_SOURCE_BRAIN=4
"""
JOINT_COMMAND = f"""
int32 mode
float64[] command
string[] names
int32 POSITION_MODE={POSITION}
int32 VELOCITY_MODE={VELOCITY}
int32 TORQUE_MODE={TORQUE}
int32 RAW_POSITION_MODE={RAW_POSITION}
"""
HEAD_PAN_COMMAND = """
float32 target
float32 speed_ratio
float32 MAX_SPEED_RATIO=1.0
float32 MIN_SPEED_RATIO=0.0
uint8 enable_pan_request
uint8 REQUEST_PAN_DISABLE=0
uint8 REQUEST_PAN_ENABLE=1
uint8 REQUEST_PAN_VOID=2
"""
HEAD_STATE = """
float32 pan
bool isTurning
bool isNodding
bool isPanEnabled
"""
END_EFFECTOR_COMMAND = """
uint32 id
string command
string CMD_NO_OP=no_op
string CMD_SET=set
string CMD_CONFIGURE=configure
string CMD_REBOOT=reboot
string CMD_RESET=reset
string CMD_CALIBRATE=calibrate
string CMD_CLEAR_CALIBRATION=clear_calibration
string CMD_PREPARE_TO_GRIP=prepare_to_grip
string CMD_GRIP=grip
string CMD_RELEASE=release
string CMD_GO=go
string CMD_STOP=stop
string args
string sender
uint32 sequence
"""
END_EFFECTOR_STATE = """
time timestamp
uint32 id
uint8 STATE_FALSE=0
uint8 STATE_TRUE=1
uint8 STATE_UNKNOWN=2
uint8 enabled
uint8 calibrated
uint8 ready
uint8 moving
uint8 gripping
uint8 missed
uint8 error
uint8 reverse
float32 position
float32 POSITION_CLOSED=0.0
float32 POSITION_OPEN=100.0
float32 force
float32 FORCE_MIN=0.0
float32 FORCE_MAX=100.0
string state
string command
string command_sender
uint32 command_sequence
"""
TACTILE_STATE = """
std_msgs/Header header
sensor_msgs/ChannelFloat32[] sensors
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: sensor_msgs/ChannelFloat32
string name
float32[] values
"""


Messages = SimpleNamespace
"""The message classes, by name."""


@cache
def load_messages() -> Messages:
    """Load the message classes: those that are generated from the definitions above, and others that come with
    ROS. Raises ConfigurationError if ROS is not installed."""
    sensor, std = import_ros("sensor_msgs.msg"), import_ros("std_msgs.msg")
    tactile = _made("tactile_msgs/TactileState", TACTILE_STATE)
    return Messages(
        assembly_state=_core("AssemblyState", ASSEMBLY_STATE),
        joint_command=_core("JointCommand", JOINT_COMMAND),
        head_pan_command=_core("HeadPanCommand", HEAD_PAN_COMMAND),
        head_state=_core("HeadState", HEAD_STATE),
        end_effector_command=_core("EndEffectorCommand", END_EFFECTOR_COMMAND),
        end_effector_state=_core("EndEffectorState", END_EFFECTOR_STATE),
        tactile_state=tactile["tactile_msgs/TactileState"],
        tactile_channel=tactile["sensor_msgs/ChannelFloat32"],
        joint_state=sensor.JointState,
        joint_trajectory_point=import_ros("trajectory_msgs.msg").JointTrajectoryPoint,
        image=sensor.Image,
        camera_info=sensor.CameraInfo,
        clock=import_ros("rosgraph_msgs.msg").Clock,
        bool=std.Bool,
        empty=std.Empty,
        float64=std.Float64,
        uint16=std.UInt16,
        header=std.Header,
        time=import_ros("genpy").Time,
    )


def _core(name: str, fields: str) -> Any:
    kind = f"baxter_core_msgs/{name}"
    return _made(kind, fields)[kind]


def _made(kind: str, text: str) -> dict[str, Any]:
    return import_ros("genpy.dynamic").generate_dynamic(kind, text)
