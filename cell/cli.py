"""The commands: names, flags and exit codes. What a command does stands in cell/subcommands, one file each,
and is imported only when it is called, so that `foldcell --help` answers at once.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from cell.support.process.standard_streams import lasting_streams
from cell.support.process.terminations import BY_SIGNAL, Terminated, unwinding
from robots.errors import CellError, ConfigurationError, StorageError

__all__ = ["FAULT", "INTERRUPTED", "NOT_DONE", "OK", "USAGE", "build_parser", "main"]

OK, NOT_DONE, FAULT, USAGE, INTERRUPTED = 0, 2, 3, 64, 130
"""Done; ended safe but not done; fault; bad usage, configuration or logs; SIGINT. (SIGHUP, 129, and SIGTERM, 143:
cell/support/process/terminations.py.)"""

EPILOG = """exit codes: 0 done, 2 ended safe but not done, 3 fault, 64 bad usage, configuration or logs,
            129 hung up (SIGHUP), 130 interrupted (SIGINT), 143 terminated (SIGTERM)"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code. Never raises, and never shows a traceback. Who stops reading what it
    prints (`| head`) changes nothing; output that could not be written is a fault of its own."""
    with lasting_streams() as output, unwinding():
        code = _perform(arguments)
        lost = output.lost
        if code != OK or not isinstance(lost, OSError) or isinstance(lost, BrokenPipeError):
            return code
        return _say(USAGE, f"standard output cannot be written: {lost.strerror}", "what was done stays done")


def _perform(arguments: Sequence[str] | None) -> int:
    options = argparse.Namespace()
    try:
        try:
            options = build_parser().parse_args(arguments)
        except SystemExit as e:  # argparse: --help is 0, a bad line USAGE
            code = int(e.code or 0)
            if code and "--json" in (sys.argv[1:] if arguments is None else arguments):
                print(json.dumps({"error": "bad usage", "hint": "see foldcell --help", "exit_code": code}))
        else:
            command = importlib.import_module(f"cell.subcommands.{options.module}")
            code = int(command.run(options))
        sys.stdout.flush()
        return code
    except Terminated as e:
        return _fail(options, BY_SIGNAL + e.number, f"ended by {e}", "")
    except KeyboardInterrupt:
        return _fail(options, INTERRUPTED, "interrupted", "")
    except CellError as e:
        wrong_input = isinstance(e, ConfigurationError | StorageError)
        return _fail(options, USAGE if wrong_input else FAULT, e.what, e.hint)
    except Exception as e:
        kept = _keep_traceback(options)
        where = f"the details are in {kept}" if kept else traceback.format_exc()
        return _fail(options, FAULT, f"this is a bug in foldcell: {type(e).__name__}: {e}", where)


def _fail(options: argparse.Namespace, code: int, what: str, hint: str) -> int:
    """Say what is wrong to the person and, with --json, to the program that called."""
    _say(code, what, hint)
    if getattr(options, "json", False):
        print(json.dumps({"error": what, "hint": hint, "exit_code": code}), flush=True)
    return code


def _say(code: int, what: str, hint: str) -> int:
    print(f"foldcell: {what}" + (f"\n  {hint}" if hint else ""), file=sys.stderr, flush=True)
    return code


def _keep_traceback(options: argparse.Namespace) -> Path | None:
    """Write the traceback among the logs, or else among temporary files."""
    from cell.support.files.paths import logs_directory

    name = f"crash-{time.strftime('%Y%m%dT%H%M%S')}-{os.getpid()}.txt"
    for folder in (logs_directory(getattr(options, "logs", None)), Path(tempfile.gettempdir())):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / name
            path.write_text(f"foldcell {' '.join(sys.argv[1:])}\n\n{traceback.format_exc()}", encoding="utf-8")
            return path
        except OSError:
            continue
    return None


# the command line


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """A bad line is a usage error like any other: 64, not argparse's 2 (which means 'not folded' here)."""
        self.print_usage(sys.stderr)
        self.exit(USAGE, f"{self.prog}: {message}\n  see {self.prog} --help\n")


def build_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="foldcell",
        description="The executive of a garment-folding robot cell.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and leave")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for add in (
        _fold,
        _supervise,
        _hil,
        _trials,
        _perceive,
        _optimise,
        _library,
        _calibrate,
        _garment,
        _runs,
        _tidy,
        _report,
        _replay,
        _resume,
        _reset,
        _bench,
        _doctor,
        _chart,
    ):
        add(commands)
    return parser


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"foldcell {version('foldcell')}")
        except PackageNotFoundError:
            print("foldcell (not installed)")
        parser.exit()


Commands = argparse._SubParsersAction  # the only name that argparse has for it


def _add(commands: Commands, name: str, module: str, about: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=about, description=about[:1].upper() + about[1:] + ".", allow_abbrev=False
    )
    parser.set_defaults(module=module)
    return parser


def _json_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="one JSON object as the last line of standard output")


def _logs_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--logs", type=_folder, metavar="DIR", help="where runs are kept (else FOLDCELL_LOGS)")


def _cell_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cell", type=Path, metavar="FILE", help="settings of the cell; else the shipped ones")


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) > 2**31 - 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no seed; a whole number from 0 to {2**31 - 1} is")
    return int(text)


def _folder(text: str) -> Path:
    """As `--logs "$UNSET"` gives it, an empty name would be the folder that one happens to be in."""
    if not text:
        raise argparse.ArgumentTypeError("the name of a folder is expected, this is empty")
    return Path(text)


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 10_000:
        raise argparse.ArgumentTypeError(f"{text!r}: a whole number from 1 to 10000 is expected")
    return int(text)


def _port(text: str) -> int:
    if not text.isdecimal() or not (int(text) == 0 or 1024 <= int(text) <= 65_535):
        raise argparse.ArgumentTypeError(f"{text!r} is no port; a whole number from 1024 to 65535 is, or 0")
    return int(text)


def _driver_option(parser: argparse.ArgumentParser, real: bool = True) -> None:
    robot = ", or the robot (ROS_MASTER_URI)" if real else ""
    parser.add_argument(
        "--driver", choices=["sim", "emulator", *(["ros"] if real else [])], default="sim",
        help=f"what moves: the simulated cell, the same behind ROS in real time{robot}",
    )  # fmt: skip


def _driver_options(parser: argparse.ArgumentParser, real: bool = True) -> None:
    _driver_option(parser, real)
    parser.add_argument(
        "--world", choices=["xpbd", "mujoco"], default="xpbd",
        help="what the simulated cloth is: our solver, or MuJoCo (towels; slow; needs the extra peers)",
    )  # fmt: skip


def _run_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("garment", metavar="GARMENT", help="name or file of the garment expected, or auto")
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="of the simulated cell (0)")
    _driver_options(parser)
    _cell_option(parser)
    _logs_option(parser)
    parser.add_argument("--live", action="store_true", help="show the run in a Rerun viewer as it goes")


def _fold(commands: Commands) -> None:
    parser = _add(commands, "fold", "fold", "fold one garment, from a picture of it to a picture of the result")
    _run_options(parser)
    parser.add_argument("--approve", action="store_true", help="ask before each fold")
    parser.add_argument("--realtime", action="store_true", help="let simulated time pass no faster than the clock")
    parser.set_defaults(page=False, page_port=0)
    _json_option(parser)


def _supervise(commands: Commands) -> None:
    parser = _add(
        commands, "supervise", "fold", "fold under an operator's eyes: each fold is shown and approved first"
    )
    _run_options(parser)
    parser.add_argument("--no-page", dest="page", action="store_false", help="do not serve the operator's page")
    parser.add_argument("--page-port", type=_port, default=0, metavar="N", help="of the page (a free one)")
    parser.set_defaults(approve=True, realtime=True)
    _json_option(parser)


def _hil(commands: Commands) -> None:
    parser = _add(commands, "hil", "hil", "perform scripted runs and hold each to what its script expects")
    parser.add_argument("scripts", nargs="+", type=Path, metavar="SCRIPT", help="YAML files, or folders of them")
    _driver_options(parser)
    _cell_option(parser)
    _logs_option(parser)
    parser.add_argument("--live", action="store_true", help="show the runs in a Rerun viewer as they go")
    parser.add_argument("--realtime", action="store_true", help="let simulated time pass no faster than the clock")
    parser.add_argument("--junit", type=Path, metavar="FILE", help="the results for a build server, as JUnit XML")
    _json_option(parser)


def _trials(commands: Commands) -> None:
    parser = _add(commands, "trials", "trials", "repeat runs over seeds and garments, with Wilson intervals")
    parser.add_argument("--garments", default="all", metavar="A,B", help="names with commas between, or all (all)")
    parser.add_argument("--n", type=_count, default=10, metavar="N", help="runs of each garment (10)")
    parser.add_argument("--first-seed", type=_seed, default=1, metavar="N", help="(1)")
    parser.add_argument("--workers", type=_count, default=1, metavar="N", help="runs at a time (1)")
    _driver_options(parser, real=False)  # nobody lays garments out for hundreds of runs
    _cell_option(parser)
    _logs_option(parser)
    _json_option(parser)


def _perceive(commands: Commands) -> None:
    parser = _add(commands, "perceive", "perceive", "key points of the garment in a picture, and an overlay PNG")
    parser.add_argument("image", type=Path, metavar="IMAGE", help="colour picture from the cell's camera")
    parser.add_argument("--depth", type=Path, help="its depth: 16-bit PNG in millimetres, or .npy in metres")
    parser.add_argument("--garment", default="auto", metavar="G", help="what is expected, or auto (auto)")
    parser.add_argument("--reference", type=Path, metavar="EMPTY", help="picture of the empty table")
    parser.add_argument("--reference-depth", type=Path, metavar="D", help="depth of the empty table")
    parser.add_argument("--output", type=Path, metavar="PNG", help="the overlay (IMAGE-perceived.png)")
    parser.add_argument(
        "--unit", choices=["m", "px"], default="m", help="px: seen from above by an unknown camera (m)"
    )
    _cell_option(parser)
    _json_option(parser)


def _optimise(commands: Commands) -> None:
    parser = _add(commands, "optimise", "optimise", "find the trajectory of a garment's folds by cloth simulation")
    parser.add_argument("garment", metavar="GARMENT", help="name or file")
    parser.add_argument("--step", type=_count, metavar="N", help="only the N-th fold, from 1 (all)")
    parser.add_argument(
        "--method", choices=["default", "paper", "initial", "two_parameter"], help="(of the settings)"
    )
    parser.add_argument("--budget", type=_count, metavar="N", help="simulations of one fold (of the settings)")
    parser.add_argument("--export", type=Path, metavar="FILE", help="tool poses and times, as .csv or .json")
    _cell_option(parser)
    _json_option(parser)


def _cores() -> int:
    import os

    return os.cpu_count() or 1


def _library(commands: Commands) -> None:
    parser = _add(commands, "library", "library", "the library of optimised trajectories")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    build = _add(actions, "build", "library", "optimise every fold of the garments and keep the trajectories")
    build.add_argument("garments", nargs="*", metavar="GARMENT", help="names or files (all that are shipped)")
    build.add_argument(
        "--method", choices=["default", "paper", "initial", "two_parameter"], help="(of the settings)"
    )
    build.add_argument("--output", type=Path, metavar="FILE", help="library file (the user's own, among the logs)")
    build.add_argument("--workers", type=_count, default=_cores(), metavar="N", help="processes (one a core)")
    show = _add(actions, "show", "library", "what the library holds")
    for action, name in ((build, "build"), (show, "show")):
        action.set_defaults(action=name)
        _cell_option(action)
        _logs_option(action)
        _json_option(action)


def _calibrate(commands: Commands) -> None:
    parser = _add(
        commands, "calibrate", "calibrate_cell", "measure what the cell has to know, and write it to a file"
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)

    def add(name: str, module: str, about: str) -> argparse.ArgumentParser:
        action = _add(actions, name, module, about)
        action.set_defaults(action=name)
        action.add_argument("--seed", type=_seed, default=0, metavar="N", help="of the simulated cell (0)")
        action.add_argument("--output", type=Path, metavar="FILE", help="where to write (in the run's folder)")
        _cell_option(action)
        _logs_option(action)
        _json_option(action)
        return action

    def of_cell(name: str, about: str) -> argparse.ArgumentParser:
        action = add(name, "calibrate_cell", about)
        _driver_option(action)
        action.add_argument(
            "--realtime", action="store_true", help="simulated time passes no faster than the clock"
        )
        return action

    _calibrate_board(actions)
    table = of_cell("table", "the table's height, touched off by both hands")
    table.add_argument("--points", type=_count, default=8, metavar="N", help="where it is touched, 3 to 10 (8)")
    camera = of_cell("camera", "the camera's focal lengths and centre, from views of the calibration board")
    camera.add_argument("--views", type=_count, default=20, metavar="N", help="pictures that show the board (20)")
    eye = of_cell("hand-eye", "where the camera hangs, from views of the calibration board in each hand")
    eye.add_argument(
        "--views", type=_count, default=12, metavar="N", help="pictures with the board in each hand (12)"
    )
    of_cell("tactile", "the fingers' noise, drift and thresholds")
    _calibrate_material(actions)


def _calibrate_board(actions: Commands) -> None:
    """The sheet to print; no cell takes part."""
    board = _add(
        actions, "board", "calibrate_board", "write the calibration board as a page to print, A4 and true to scale"
    )
    board.set_defaults(action="board")
    board.add_argument(
        "--output", type=Path, required=True, metavar="FILE", help="the page: .pdf, or .png of 304.8 dots an inch"
    )
    _json_option(board)


def _calibrate_material(actions: Commands) -> None:
    """What an operator measures of a fabric. The garment file that comes of it names where each value is from."""

    def add(name: str, about: str) -> argparse.ArgumentParser:
        action = _add(actions, name, "calibrate_material", about)
        action.set_defaults(action=name)
        _cell_option(action)
        _logs_option(action)
        _json_option(action)
        return action

    for name, about, lengths in (
        ("shear", "a garment's stretch, from its length hung and laid", (
            ("--l1", "of the hung garment, from the clip to the lowest point"),
            ("--l2", "of the same two points on the laid garment, spread"))),
        ("friction", "a garment's friction with the table, from the slope on which it slides", (
            ("--height", "by which one side of the table is lifted when the garment begins to slide"),
            ("--length", "of the table"))),
        ("bending", "a fabric's bending length, from a strip that hangs over an edge (ASTM D1388)", (
            ("--overhang", "at which the strip's tip touches the plane of 41.5 degrees"),)),
    ):  # fmt: skip
        action = add(name, about)
        action.add_argument("garment", metavar="GARMENT", help="name or file")
        for option, help_text in lengths:
            action.add_argument(option, type=float, required=True, metavar="M", help=f"metres {help_text}")
        if name == "shear":
            action.add_argument("--held", metavar="KEYPOINT", help="by which it hung (an end of its longest line)")
        action.add_argument("--output", type=Path, metavar="FILE", help="garment file to write (among the logs)")
        action.add_argument("--replace", action="store_true", help="write over a file that exists")
    paper = add("paper", "the paper's table of garments, calibrated here and printed beside the paper's")
    paper.add_argument("garments", nargs="*", metavar="GARMENT", help="names (all seven)")
    paper.add_argument("--output", type=Path, metavar="DIR", help="write their garment files, calibrated, there")
    paper.add_argument("--replace", action="store_true", help="write over files that exist")


def _garment(commands: Commands) -> None:
    parser = _add(commands, "garment", "garment", "the garments that the cell knows")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    listed = _add(actions, "list", "garment", "names, sizes and folds")
    check = _add(actions, "check", "garment", "say whether garment files are good, and draw them")
    check.add_argument("garments", nargs="+", metavar="FILE", help="files or names")
    show = _add(actions, "show", "garment", "all that is known of one garment")
    show.add_argument("garments", nargs=1, metavar="GARMENT", help="name or file")
    _new_garment(actions)
    for action in (check, show):
        action.add_argument(
            "--draw", type=Path, metavar="DIR", help="draw outline and folds as PNG into this folder"
        )
    for action, name in ((listed, "list"), (check, "check"), (show, "show")):
        action.set_defaults(action=name)
        _cell_option(action)
        _json_option(action)


def _new_garment(actions: Commands) -> None:
    new = _add(actions, "new", "new_garment", "make the file of a garment of one's own from a photograph of it")
    new.add_argument("image", type=Path, metavar="IMAGE", help="it lies flat, seen from above, nothing else on it")
    new.add_argument("--like", required=True, metavar="GARMENT", help="name or file of one that folds alike")
    new.add_argument("--length", type=float, metavar="M", help="metres measured on it between two key points")
    new.add_argument("--between", metavar="A,B", help="these (the two that are farthest apart along the cloth)")
    new.add_argument("--title", help="what it is called")
    new.add_argument("--output", type=Path, metavar="FILE", help="garment file to write (IMAGE's name, here)")
    new.add_argument("--replace", action="store_true", help="write over a file that exists")
    new.add_argument("--depth", type=Path, help="its depth: 16-bit PNG in millimetres, or .npy in metres")
    new.add_argument("--reference", type=Path, metavar="EMPTY", help="picture of the empty table")
    new.add_argument("--reference-depth", type=Path, metavar="D", help="depth of the empty table")
    new.add_argument("--unit", choices=["m", "px"], default="px", help="m: taken by the cell's own camera (px)")
    _cell_option(new)
    _json_option(new)


def _runs(commands: Commands) -> None:
    parser = _add(commands, "runs", "runs", "the runs in the ledger and how each ended")
    parser.add_argument("--last", type=_count, metavar="N", help="only the last N")
    _logs_option(parser)
    _json_option(parser)


def _tidy(commands: Commands) -> None:
    parser = _add(commands, "tidy", "tidy", "free the disk of old recordings; reports and the ledger stay")
    parser.add_argument("--keep", type=_count, default=50, metavar="N", help="leave the newest N as they are (50)")
    parser.add_argument(
        "--unfinished", action="store_true", help="also of runs that could still be gone on with (resume)"
    )
    parser.add_argument("--yes", action="store_true", help="remove them; without it they are only listed")
    _logs_option(parser)
    _json_option(parser)


def _run_name(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", metavar="RUN", help="id or the beginning of one, a run's folder, or last")


def _report(commands: Commands) -> None:
    parser = _add(commands, "report", "report", "what happened in a run, and where its report page is")
    _run_name(parser)
    _logs_option(parser)
    _json_option(parser)


def _replay(commands: Commands) -> None:
    parser = _add(commands, "replay", "replay", "open a run's recording in the Rerun viewer, or decide it again")
    _run_name(parser)
    parser.add_argument(
        "--decide", dest="module", action="store_const", const="decide",
        help="take the run's decisions again by what was read then, and compare (2: the first that differs)",
    )  # fmt: skip
    parser.add_argument("--no-viewer", action="store_true", help="only say where the recording is")
    _logs_option(parser)
    _json_option(parser)


def _reset(commands: Commands) -> None:
    parser = _add(commands, "reset", "reset", "leave the robot's stop, once its cause is cleared (driver ros)")
    parser.add_argument("--yes", action="store_true", help="the cause is cleared and nobody is near: do not ask")
    _json_option(parser)


def _resume(commands: Commands) -> None:
    parser = _add(
        commands, "resume", "resume", "go on with a run that was killed, stopped or ended before it had folded"
    )
    _run_name(parser)
    _logs_option(parser)
    parser.add_argument("--live", action="store_true", help="show the run in a Rerun viewer as it goes")
    parser.add_argument("--approve", action="store_true", help="ask before each fold, though the run did not")
    _json_option(parser)


def _bench(commands: Commands) -> None:
    parser = _add(commands, "bench", "bench", "measure a part of the program beside its peers")
    names = ["cell", "cloth", "execution", "motion", "optimise", "perception"]
    parser.add_argument("name", choices=names, metavar="NAME", help="%(choices)s")
    parser.add_argument("--peers", action="store_true", help="with peers that take long or need extra packages")
    parser.add_argument("--quick", action="store_true", help="few samples: shows that it works, not how well")
    parser.add_argument("--only", metavar="PART,...", help="of cloth: these parts")
    parser.add_argument(
        "--keep", type=Path, metavar="FILE", help="of cloth: put each part's figures down there, go on from there"
    )
    parser.add_argument("--garment", metavar="A,B", help="only these, by name or file (optimise)")
    _json_option(parser)


def _doctor(commands: Commands) -> None:
    parser = _add(commands, "doctor", "doctor", "what is installed, what is missing, and what to do")
    _logs_option(parser)
    _json_option(parser)


def _chart(commands: Commands) -> None:
    parser = _add(
        commands, "chart", "chart", "draw the states and what leads where (needs Graphviz)"
    )
    parser.add_argument("--output", type=Path, metavar="SVG", help="(the one that report and page show)")
    _json_option(parser)


if __name__ == "__main__":
    sys.exit(main())
