"""A `Robot` from its description."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from foldcell.robots.robot import Robot, RobotVisual, SimulatedBody, Simulation
from foldcell.robots.urdf.description import RobotDescription

if TYPE_CHECKING:
    from foldcell.robots.model import RobotModel


def robot_of(description: RobotDescription) -> Robot:
    """Return the robot that a description describes. Nothing is read before it is used."""

    @lru_cache(maxsize=1)
    def model() -> RobotModel:
        from foldcell.robots.urdf.model import build_model

        return build_model(description)

    def visual() -> RobotVisual:
        from foldcell.robots.urdf.converted import viewer_urdf

        return RobotVisual(
            urdf=viewer_urdf(description),
            joint_names=description.joint_names,
            head_joint=description.camera.head_joint,
            finger_joints=description.gripper.finger_joints,
            floor=description.floor,
        )

    def body(client: int) -> SimulatedBody:
        from foldcell.robots.urdf.bullet_body import BulletBody
        from foldcell.robots.urdf.converted import moving_urdf

        return BulletBody(client, moving_urdf(description), description)

    def seen() -> Path:
        from foldcell.robots.urdf.converted import seen_urdf

        return seen_urdf(description)

    return Robot(
        name=description.name,
        title=description.title,
        load_model=model,
        model_file=description.source,
        camera=description.camera,
        gripper=description.gripper,
        visual=visual,
        simulation=Simulation(
            body=body,
            seen_urdf=seen,
            shoulder=description.shoulder,
            drop_joint=description.drop_joint,
            drop_sign=description.drop_sign,
            head_range=description.head_range,
        ),
        driver=description.driver,
    )
