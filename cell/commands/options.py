"""Flags that several commands share, and the types of their values."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

Commands = argparse._SubParsersAction  # argparse has no public name for this type
Run = Callable[[argparse.Namespace], int]


def add_command(commands: Commands, name: str, about: str, run: Run | None = None) -> argparse.ArgumentParser:
    """Add a command, or an action of a command. run: performs it with the parsed options and returns the exit
    code."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=about, description=about[:1].upper() + about[1:] + ".", allow_abbrev=False
    )
    if run is not None:
        performed_by(parser, run)
    return parser


def performed_by(parser: argparse.ArgumentParser, run: Run) -> None:
    """Let `run` perform a command, and add the option that all commands have."""
    parser.set_defaults(run=run)
    parser.add_argument("--json", action="store_true", help="one JSON object as the last line of standard output")


def logs_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--logs", type=folder, metavar="DIR", help="folder of the runs (else FOLDCELL_LOGS)")


def cell_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cell", type=Path, metavar="FILE", help="settings of the cell (the shipped ones)")


def seed(text: str) -> int:
    if not text.isdecimal() or int(text) > 2**31 - 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no seed; a whole number from 0 to {2**31 - 1} is")
    return int(text)


def folder(text: str) -> Path:
    """Convert the name of a folder. An empty name is refused: it would mean the present folder, and `--logs
    "$UNSET"` passes an empty name."""
    if not text:
        raise argparse.ArgumentTypeError("the name of a folder is expected, but it is empty")
    return Path(text)


def count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 10_000:
        raise argparse.ArgumentTypeError(f"{text!r}: a whole number from 1 to 10000 is expected")
    return int(text)


def port(text: str) -> int:
    if not text.isdecimal() or not (int(text) == 0 or 1024 <= int(text) <= 65_535):
        raise argparse.ArgumentTypeError(f"{text!r} is no port; a whole number from 1024 to 65535 is, or 0")
    return int(text)


def origin(text: str) -> str:
    """Convert the origin of a page, as in http://localhost:9000: a scheme, a host and perhaps a port."""
    if not re.fullmatch(r"https?://[A-Za-z0-9.-]+(:[0-9]{1,5})?/?", text):
        raise argparse.ArgumentTypeError(f"{text!r}: http:// or https://, a host and perhaps :PORT are expected")
    return text.rstrip("/").lower()


def page_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--page-port", type=port, default=0, metavar="N", help="port of the page (a free one)")
    parser.add_argument(
        "--page-origin", type=origin, metavar="URL",
        help="where a browser opens the page through a forwarded port, as http://localhost:9000",
    )  # fmt: skip


def driver_option(parser: argparse.ArgumentParser, real: bool = True) -> None:
    robot = ", or the robot (ROS_MASTER_URI)" if real else ""
    parser.add_argument(
        "--driver", choices=["sim", "emulator", *(["ros"] if real else [])], default="sim",
        help=f"the simulated cell, the simulated cell behind ROS in real time{robot}",
    )  # fmt: skip


def driver_options(parser: argparse.ArgumentParser, real: bool = True) -> None:
    driver_option(parser, real)
    parser.add_argument(
        "--world", choices=["xpbd", "mujoco"], default="xpbd",
        help="solver of the simulated cloth: foldcell's own, or MuJoCo (towels; slow; needs the extra peers)",
    )  # fmt: skip


def run_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("garment", metavar="GARMENT", help="name or file of the expected garment, or auto")
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of the simulated cell (0)")
    driver_options(parser)
    cell_option(parser)
    logs_option(parser)
    parser.add_argument("--live", action="store_true", help="show the run in a Rerun viewer while it lasts")


def run_name(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", metavar="RUN", help="id of a run or its beginning, a run's folder, or last")
