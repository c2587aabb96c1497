"""`foldcell robot`: lists the robots, checks whether a model fits the cell, writes the skeleton of a new one."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from foldcell.cell.commands.shared import Commands, add_command, answer, cell_option, folder, table, teller
from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.hardware.cell_check import robot_findings
from foldcell.cell.hardware.contract.clauses import CLAUSES, ClauseResult, check_driver
from foldcell.cell.hardware.contract.opening import opened_rig
from foldcell.cell.hardware.contract.rig import Rig
from foldcell.cell.support.files.whole_file import make_folder, refuse_foreign, write_whole
from foldcell.cell.support.junit import junit_text
from foldcell.cell.support.process.signals import BY_SIGNAL, taking_signals
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.registry import find_robot, list_robots
from foldcell.robots.urdf.skeleton import skeleton_files

SUITE = "foldcell robot"


def add_options(actions: Commands) -> None:
    add_command(actions, "list", "list the robots that `robot:` in cell.yaml can name", _list)
    check = add_command(actions, "check", "check whether a robot's model, and its driver, fit the cell", _check)
    check.add_argument("robot", metavar="NAME", help="a robot of `foldcell robot list`")
    check.add_argument(
        "--driver", metavar="DRIVER",
        help="also check this driver against the contract of the ports, which moves the arms a little: "
        "sim, emulator, ros, or MODULE:FACTORY",
    )  # fmt: skip
    check.add_argument("--junit", type=Path, metavar="FILE", help="write the results of the driver as JUnit XML")
    cell_option(check)
    new = add_command(actions, "new", "write the skeleton of a package that brings a robot", _new)
    new.add_argument("name", metavar="NAME", help="name of the robot, its package and its folder")
    new.add_argument("--into", type=folder, default=Path(), metavar="DIR", help="where the folder is made (here)")


def _list(options: argparse.Namespace) -> int:
    rows = [_row(name) for name in list_robots()]
    keys = ("name", "title", "arm_joints", "drivers")
    figures = {"robots": [dict(zip(keys, row, strict=True)) for row in rows]}
    return answer(options, figures, table(("name", "title", "joints of an arm", "drivers"), rows))


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
    """Returns 0 if the model and the driver fit, 2 if not, and 128 + its number after a signal. Raises
    ConfigurationError for a robot or driver that cannot be loaded."""
    if options.junit is not None:
        refuse_foreign(options.junit, f'<testsuite name="{SUITE}"'.encode())
    robot, settings = find_robot(options.robot), load_settings(options.cell)
    findings = list(robot_findings(robot, robot.load_model(), robot.camera, settings.table))
    rows = [(f.name, "good" if f.good else "BAD", f.found) for f in findings]
    if not options.json:
        print(*table(("check", "", "found"), rows), sep="\n")
    results, interrupted = list[ClauseResult](), 0
    if options.driver is not None:
        results, interrupted = _driver_results(options, settings.model_copy(update={"robot": options.robot}))
    good = all(finding.good for finding in findings) and all(r.state != "failed" for r in results)
    report = {"robot": options.robot, "good": good, "findings": [vars(finding) for finding in findings]}
    driver = {"driver": options.driver, "clauses": [r.as_json() for r in results]} if results else {}
    return answer(options, report | driver, (), interrupted or (0 if good else 2))


def _driver_results(options: argparse.Namespace, settings: CellSettings) -> tuple[list[ClauseResult], int]:
    """Check the driver and show each result when it is there. Returns the results, and the exit code of a signal
    or 0."""
    results: list[ClauseResult] = []
    tell = teller(options.json)
    tell(f"\n{len(CLAUSES)} clauses of the contract; both arms move a little: stay out of their reach")
    with taking_signals() as interrupts:

        @contextmanager
        def opened() -> Iterator[Rig]:
            ended = lambda: bool(interrupts.received)  # noqa: E731
            with opened_rig(options.driver, settings, ended) as rig, interrupts.stop(rig.ports, asked=False):
                yield rig

        for result in check_driver(opened):
            results.append(result)
            tell(str(result))
    if options.junit is not None:
        write_whole(options.junit, junit_text(SUITE, [result.as_case() for result in results]))
    return results, BY_SIGNAL + interrupts.received[0] if interrupts.received else 0


def _new(options: argparse.Namespace) -> int:
    """Raises ConfigurationError for a name that cannot be used or a folder that exists, StorageError if a file
    cannot be written."""
    files, target = skeleton_files(options.name), options.into / options.name
    if target.exists():
        raise ConfigurationError(f"{target} exists", "choose another name, or another folder with --into")
    for name, text in files.items():
        path = target / name
        make_folder(path.parent, "choose another --into")
        write_whole(path, text.encode())
    lines = [
        f"wrote {target}: {', '.join(sorted(files))}",
        f"install it: pip install --no-deps -e {target}",
        f"then: foldcell robot check {options.name}; foldcell fold small_towel --cell {target / 'cell.yaml'}",
    ]
    return answer(options, {"robot": options.name, "folder": str(target), "files": sorted(files)}, lines)
