"""`foldcell robot list`: lists the robots that `robot:` in cell.yaml can name."""

from __future__ import annotations

import argparse

from cell.commands.options import Commands, add_command, json_option
from cell.commands.output import print_json, print_table
from robots.errors import ConfigurationError
from robots.registry import find_robot, list_robots

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    action = add_command(actions, "list", "list the robots that `robot:` in cell.yaml can name", _run)
    json_option(action)


def _run(options: argparse.Namespace) -> int:
    rows = [_row(name) for name in list_robots()]
    if options.json:
        keys = ("name", "title", "arm_joints", "drivers")
        print_json({"robots": [dict(zip(keys, row, strict=True)) for row in rows]})
        return 0
    print_table(("name", "title", "joints of an arm", "drivers"), rows)
    return 0


def _row(name: str) -> tuple[str, str, int | None, str]:
    """Name, title, joints of an arm and drivers of a robot; a robot that cannot be loaded has its error for a
    title."""
    try:
        robot = find_robot(name)
        joints = len(robot.load_model().joint_names) // 2
    except ConfigurationError as error:
        return name, error.what, None, ""
    return name, robot.title, joints, "sim" if robot.driver is None else "sim, emulator, ros"
