"""Conversion of the ports' values to the messages that Baxter, its camera and its pads publish."""

from __future__ import annotations

from typing import Any

import numpy as np

from foldcell.robots.baxter.emulator.grippers import GripperReport
from foldcell.robots.baxter.emulator.motors import Button, MotorState
from foldcell.robots.baxter.names import JOINT_NAMES
from foldcell.robots.baxter.ros.electric_gripper import HARDWARE_ID
from foldcell.robots.baxter.ros.messages import Messages
from foldcell.robots.ports import CameraFrame, JointState, TactileReading

NOD, PAN, TORSO = "head_nod", "head_pan", "torso_t0"
PUBLISHED = (NOD, PAN, *sorted(JOINT_NAMES), TORSO)
"""Joint names in Baxter's order, which is alphabetical."""
INDEX = [JOINT_NAMES.index(name) for name in PUBLISHED[2:-1]]
OPTICAL_FRAME = "camera_rgb_optical_frame"


def ros_time(messages: Messages, t: float) -> Any:
    seconds, nanoseconds = divmod(round(t * 1e9), 1_000_000_000)
    return messages.time(seconds, nanoseconds)


def header(messages: Messages, t: float, frame: str = "") -> Any:
    return messages.header(stamp=ros_time(messages, t), frame_id=frame)


def joint_state(messages: Messages, state: JointState) -> Any:
    """Return the JointState message of arms and head, with the joints in the robot's order."""
    return messages.joint_state(
        header=header(messages, state.stamp),
        name=list(PUBLISHED),
        position=[0.0, state.head_pan, *state.q[INDEX].tolist(), 0.0],
        velocity=[0.0, 0.0, *state.qd[INDEX].tolist(), 0.0],
        effort=[0.0, 0.0, *state.effort[INDEX].tolist(), 0.0],
    )


def assembly_state(messages: Messages, state: MotorState) -> Any:
    kind = messages.assembly_state
    button, source = {
        Button.UNPRESSED: (kind.ESTOP_BUTTON_UNPRESSED, kind.ESTOP_SOURCE_NONE),
        Button.PRESSED: (kind.ESTOP_BUTTON_PRESSED, kind.ESTOP_SOURCE_USER),
        Button.RELEASED: (kind.ESTOP_BUTTON_RELEASED, kind.ESTOP_SOURCE_USER),
    }[state.button]
    if state.stopped and state.button is Button.UNPRESSED:
        button, source = kind.ESTOP_BUTTON_UNKNOWN, kind.ESTOP_SOURCE_UNKNOWN
    return kind(
        ready=state.enabled and not state.stopped,
        enabled=state.enabled,
        stopped=state.stopped,
        error=False,
        estop_button=button,
        estop_source=source,
    )


def gripper_state(messages: Messages, report: GripperReport) -> Any:
    return messages.end_effector_state(
        timestamp=ros_time(messages, report.stamp),
        id=HARDWARE_ID,
        enabled=1,
        calibrated=int(report.calibrated),
        ready=int(report.ready),
        moving=int(report.moving),
        gripping=int(report.gripping),
        missed=int(report.missed),
        error=int(bool(report.refusal)),
        reverse=0,
        position=report.position,
        force=report.force,
        state=report.state,
        command=report.command,
        command_sender=report.sender,
        command_sequence=report.sequence,
    )


def tactile_state(messages: Messages, reading: TactileReading) -> Any:
    pads = {f"pad_{k}": pad.ravel() for k, pad in enumerate(reading.cells)}
    return messages.tactile_state(
        header=header(messages, reading.stamp),
        sensors=[
            messages.tactile_channel(name=name, values=values.tolist())
            for name, values in {**pads, "tips": reading.tip}.items()
        ],
    )


def picture(messages: Messages, frame: CameraFrame) -> tuple[Any, Any, Any]:
    """Return colour (rgb8), depth (16UC1 [mm], 0 where there is no value) and CameraInfo, with the same stamp."""
    h, w = frame.depth.shape
    top = header(messages, frame.stamp, OPTICAL_FRAME)
    k = frame.intrinsics.matrix
    return (
        _image(messages, top, "rgb8", np.ascontiguousarray(frame.rgb, np.uint8)),
        _image(messages, top, "16UC1", np.nan_to_num(1e3 * frame.depth).round().clip(0, 65535).astype("<u2")),
        messages.camera_info(
            header=top,
            height=h,
            width=w,
            distortion_model="plumb_bob",
            D=[0.0] * 5,
            K=k.ravel().tolist(),
            R=np.eye(3).ravel().tolist(),
            P=np.column_stack((k, np.zeros(3))).ravel().tolist(),
        ),
    )


def _image(messages: Messages, top: Any, encoding: str, pixels: np.ndarray) -> Any:
    return messages.image(
        header=top,
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=pixels.strides[0],
        data=pixels.tobytes(),
    )
