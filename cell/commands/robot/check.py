"""`foldcell robot check NAME`: checks whether a robot's model fits the cell."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

from cell.commands.options import Commands, add_command, cell_option, json_option
from cell.commands.output import print_json, print_table
from cell.config.cell_settings import load_settings
from cell.hardware.robot_check import reached_places, view_margins
from robots.registry import find_robot
from robots.robot import Robot
from skills.motion.validation.collision import CollisionChecker
from skills.vocabulary import Table

__all__ = ["add_options"]

LEAST_VIEW_MARGIN = 0.01
"""Distance by which the parked arms have to be out of the camera's picture [m]."""
LEAST_REACHED = 0.9
"""Share of the places where garments lie that each arm has to reach."""


@dataclass(frozen=True)
class _Finding:
    name: str
    good: bool
    found: str


def add_options(actions: Commands) -> None:
    action = add_command(actions, "check", "check whether a robot's model fits the cell", _run)
    action.add_argument("robot", metavar="NAME", help="a robot of `foldcell robot list`")
    cell_option(action)
    json_option(action)


def _run(options: argparse.Namespace) -> int:
    """Returns 0 if the model fits, 2 if not. Raises ConfigurationError for a robot that cannot be loaded."""
    findings = list(_findings(find_robot(options.robot), load_settings(options.cell).table))
    good = all(finding.good for finding in findings)
    if options.json:
        print_json({"robot": options.robot, "good": good, "findings": [vars(finding) for finding in findings]})
    else:
        print_table(("check", "", "found"), [(f.name, "good" if f.good else "BAD", f.found) for f in findings])
    return 0 if good else 2


def _findings(robot: Robot, table: Table) -> Iterator[_Finding]:
    model = robot.load_model()
    inside = (model.q_park >= model.planning.lower) & (model.q_park <= model.planning.upper)
    outside = [name for name, good in zip(model.joint_names, inside, strict=True) if not good]
    yield _Finding("model", True, f"{len(model.joint_names) // 2} joints an arm, {robot.model_file()}")
    yield _Finding(
        "parked joints", not outside, f"outside their limits: {', '.join(outside)}" if outside else "within limits"
    )
    contact = CollisionChecker(model, table).contact(model.q_park)
    yield _Finding("parked arms", contact is None, f"too near: {contact}" if contact else "touch nothing")
    margins = view_margins(robot, model.q_park)
    shape, margin = min(margins.items(), key=lambda item: item[1])
    yield _Finding(
        "camera's view", margin >= LEAST_VIEW_MARGIN, f"{shape} is {1000 * margin:.0f} mm out of the picture"
    )
    for side, places in reached_places(robot, table).items():
        missed = [f"({x:.2f}, {y:.2f})" for x, y, reached in places if not reached]
        share = 1.0 - len(missed) / len(places)
        found = f"{share:.0%} of {len(places)} places" + (f", not {', '.join(missed[:4])}" if missed else "")
        yield _Finding(f"{side} arm's reach", share >= LEAST_REACHED, found)
