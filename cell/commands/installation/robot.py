"""`foldcell robot`: lists the robots, checks whether a model fits the cell, writes the skeleton of a new one."""

from __future__ import annotations

import argparse
from pathlib import Path

from cell.commands.options import Commands, add_command, cell_option, folder, json_option
from cell.commands.output import print_json, print_table
from cell.config.cell_settings import load_settings
from cell.hardware.cell_check import robot_findings
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError, StorageError
from robots.registry import find_robot, list_robots
from robots.urdf.skeleton import skeleton_files

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    listed = add_command(actions, "list", "list the robots that `robot:` in cell.yaml can name", _list)
    json_option(listed)
    check = add_command(actions, "check", "check whether a robot's model fits the cell", _check)
    check.add_argument("robot", metavar="NAME", help="a robot of `foldcell robot list`")
    cell_option(check)
    json_option(check)
    new = add_command(actions, "new", "write the skeleton of a package that brings a robot", _new)
    new.add_argument("name", metavar="NAME", help="name of the robot, its package and its folder")
    new.add_argument("--into", type=folder, default=Path(), metavar="DIR", help="where the folder is made (here)")
    json_option(new)


def _list(options: argparse.Namespace) -> int:
    rows = [_row(name) for name in list_robots()]
    if options.json:
        keys = ("name", "title", "arm_joints", "drivers")
        print_json({"robots": [dict(zip(keys, row, strict=True)) for row in rows]})
        return 0
    print_table(("name", "title", "joints of an arm", "drivers"), rows)
    return 0


def _row(name: str) -> tuple[str, str, int | None, str]:
    """Return name, title, joints of an arm and drivers of a robot. If it cannot be loaded, the error replaces the
    title."""
    try:
        robot = find_robot(name)
        joints = len(robot.load_model().joint_names) // 2
    except ConfigurationError as error:
        return name, error.what, None, ""
    return name, robot.title, joints, "sim" if robot.driver is None else "sim, emulator, ros"


def _check(options: argparse.Namespace) -> int:
    """Returns 0 if the model fits, 2 if not. Raises ConfigurationError for a robot that cannot be loaded."""
    robot = find_robot(options.robot)
    findings = list(robot_findings(robot, robot.load_model(), robot.camera, load_settings(options.cell).table))
    good = all(finding.good for finding in findings)
    if options.json:
        print_json({"robot": options.robot, "good": good, "findings": [vars(finding) for finding in findings]})
    else:
        print_table(("check", "", "found"), [(f.name, "good" if f.good else "BAD", f.found) for f in findings])
    return 0 if good else 2


def _new(options: argparse.Namespace) -> int:
    """Raises ConfigurationError for a name that cannot be used or a folder that exists, StorageError if a file
    cannot be written."""
    files, target = skeleton_files(options.name), options.into / options.name
    if target.exists():
        raise ConfigurationError(f"{target} exists", "choose another name, or another folder with --into")
    for name, text in files.items():
        path = target / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"cannot make {path.parent}: {error.strerror}", "choose another --into") from error
        write_whole(path, text.encode())
    if options.json:
        print_json({"robot": options.name, "folder": str(target), "files": sorted(files)})
        return 0
    print(f"wrote {target}: {', '.join(sorted(files))}")
    print(f"install it: pip install --no-deps -e {target}")
    print(f"then: foldcell robot check {options.name}; foldcell fold small_towel --cell {target / 'cell.yaml'}")
    return 0
