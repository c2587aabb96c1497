"""Names of Baxter's topics (SDK 1.2), each with its message type. In a name with {}, the side takes its place."""

from __future__ import annotations

__all__ = [
    "CLOCK",
    "ENABLE",
    "GRIPPER_COMMAND",
    "GRIPPER_STATE",
    "HEAD_COMMAND",
    "HEAD_STATE",
    "INVERSE_DYNAMICS",
    "JOINT_COMMAND",
    "JOINT_COMMAND_TIMEOUT",
    "JOINT_STATES",
    "JOINT_STATE_RATE",
    "RESET",
    "ROBOT_STATE",
    "SPEED_RATIO",
    "STOP",
    "TACTILE",
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
JOINT_COMMAND = "/robot/limb/{}/joint_command"
"""JointCommand: an arm's commands."""
JOINT_COMMAND_TIMEOUT = "/robot/limb/{}/joint_command_timeout"
"""std_msgs/Float64, latched: validity of an arm's commands [s]."""
INVERSE_DYNAMICS = "/robot/limb/{}/inverse_dynamics_command"
"""trajectory_msgs/JointTrajectoryPoint: an arm's feed-forward, with each command in raw position mode."""
SPEED_RATIO = "/robot/limb/{}/set_speed_ratio"
"""std_msgs/Float64, latched, 0.3 by default: the speed ratio of an arm's position moves."""
GRIPPER_COMMAND = "/robot/end_effector/{}_gripper/command"
"""EndEffectorCommand: a gripper's commands."""
GRIPPER_STATE = "/robot/end_effector/{}_gripper/state"
"""EndEffectorState: a gripper's state."""
TACTILE = "/tactile/{}_gripper"
"""tactile_msgs/TactileState, 100 Hz: a hand's pads, with the channels `pad_0`, `pad_1` (cells row by row, row 0 at
the tips, [N]) and `tips` (two, [N]). The pads' reader publishes it, not Baxter itself."""
