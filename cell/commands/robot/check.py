"""`foldcell robot check NAME`: checks whether a robot's model fits the cell."""

from __future__ import annotations

import argparse

from cell.commands.options import Commands, add_command, cell_option, json_option
from cell.commands.output import print_json, print_table
from cell.config.cell_settings import load_settings
from cell.hardware.cell_check import robot_findings
from robots.registry import find_robot

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    action = add_command(actions, "check", "check whether a robot's model fits the cell", _run)
    action.add_argument("robot", metavar="NAME", help="a robot of `foldcell robot list`")
    cell_option(action)
    json_option(action)


def _run(options: argparse.Namespace) -> int:
    """Returns 0 if the model fits, 2 if not. Raises ConfigurationError for a robot that cannot be loaded."""
    robot = find_robot(options.robot)
    findings = list(robot_findings(robot, robot.load_model(), robot.camera, load_settings(options.cell).table))
    good = all(finding.good for finding in findings)
    if options.json:
        print_json({"robot": options.robot, "good": good, "findings": [vars(finding) for finding in findings]})
    else:
        print_table(("check", "", "found"), [(f.name, "good" if f.good else "BAD", f.found) for f in findings])
    return 0 if good else 2
