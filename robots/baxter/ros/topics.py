"""Names of Baxter's topics (SDK 1.2), each with its message type."""

from __future__ import annotations

from foldcell.robots.ports import Side

__all__ = [
    "CLOCK",
    "ENABLE",
    "HEAD_COMMAND",
    "HEAD_STATE",
    "JOINT_STATES",
    "JOINT_STATE_RATE",
    "RESET",
    "ROBOT_STATE",
    "STOP",
    "command_timeout",
    "gripper_command",
    "gripper_state",
    "inverse_dynamics",
    "joint_command",
    "speed_ratio",
    "tactile",
]

CLOCK = "/clock"
"""rosgraph_msgs/Clock, only if the parameter /use_sim_time is true."""
JOINT_STATES = "/robot/joint_states"
"""sensor_msgs/JointState of arms and head_pan, in any order of names."""
JOINT_STATE_RATE = "/robot/joint_state_publish_rate"
"""std_msgs/UInt16: rate of JOINT_STATES [Hz], 100 by default."""
ROBOT_STATE = "/robot/state"
"""AssemblyState: motors, stop and emergency button."""
ENABLE = "/robot/set_super_enable"
"""std_msgs/Bool: true switches the motors on. Published repeatedly until the robot's state agrees."""
RESET = "/robot/set_super_reset"
"""std_msgs/Empty: clears the stop. The motors are then off."""
STOP = "/robot/set_super_stop"
"""std_msgs/Empty: stops the robot."""
HEAD_COMMAND = "/robot/head/command_head_pan"
"""HeadPanCommand: turns the head."""
HEAD_STATE = "/robot/head/head_state"
"""HeadState: the head's pan."""


def joint_command(side: Side) -> str:
    """Return the topic of an arm's commands: JointCommand."""
    return f"/robot/limb/{side}/joint_command"


def command_timeout(side: Side) -> str:
    """Return the topic of the validity of an arm's commands: std_msgs/Float64 [s], latched."""
    return f"/robot/limb/{side}/joint_command_timeout"


def inverse_dynamics(side: Side) -> str:
    """Return the topic of an arm's feed-forward: trajectory_msgs/JointTrajectoryPoint. It accompanies each command
    in raw position mode."""
    return f"/robot/limb/{side}/inverse_dynamics_command"


def speed_ratio(side: Side) -> str:
    """Return the topic of the speed ratio of position moves: std_msgs/Float64, latched, 0.3 by default."""
    return f"/robot/limb/{side}/set_speed_ratio"


def gripper_command(side: Side) -> str:
    """Return the topic of a gripper's commands: EndEffectorCommand."""
    return f"/robot/end_effector/{side}_gripper/command"


def gripper_state(side: Side) -> str:
    """Return the topic of a gripper's state: EndEffectorState."""
    return f"/robot/end_effector/{side}_gripper/state"


def tactile(side: Side) -> str:
    """Return the topic of a hand's pads: tactile_msgs/TactileState, 100 Hz, with the channels `pad_0`, `pad_1`
    (cells row by row, row 0 at the tips, [N]) and `tips` (two, [N]). The pads' reader publishes it, not Baxter
    itself."""
    return f"/tactile/{side}_gripper"
