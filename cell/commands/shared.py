"""What the commands share: their options, the types of their values, and their answers.

An answer is text for people, or one JSON line for programs.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foldcell.cell.support.files.whole_file import PNG_MARK, refuse_foreign, refuse_unwritable
from foldcell.robots.errors import ConfigurationError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

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


def driver_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--driver", choices=["sim", "emulator", "ros"], default="sim",
        help="the simulated cell, the simulated cell behind ROS in real time, or the robot (ROS_MASTER_URI)",
    )  # fmt: skip


def driver_options(parser: argparse.ArgumentParser) -> None:
    driver_option(parser)
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


# answers


def answer(options: argparse.Namespace, figures: Mapping[str, Any], lines: Iterable[str], code: int = 0) -> int:
    """Print the result of a command: with --json the figures for programs, else the lines for people. Returns the
    exit code of the command."""
    from foldcell.cell.support.json_values import to_json

    if options.json:  # one line, in ASCII, which every stream can encode
        lines = [json.dumps(to_json(figures), allow_nan=False)]
    for line in lines:
        print(line, flush=True)
    return code


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> Iterator[str]:
    """Yield the lines of a table. Columns of numbers are aligned to the right."""
    cells = [[_text(v) for v in row] for row in rows]
    width = [max(len(line[i]) for line in (list(head), *cells)) for i in range(len(head))]
    right = [
        bool(rows) and all(isinstance(row[i], int | float) or row[i] is None for row in rows)
        for i in range(len(head))
    ]
    for line in (list(head), *cells):
        padded = [c.rjust(w) if r else c.ljust(w) for c, w, r in zip(line, width, right, strict=True)]
        yield "  ".join(padded).rstrip()


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}" if isinstance(value, float) else str(value)


def progress_stream(as_json: bool) -> Any:
    """Return the stream for progress messages: standard error with --json, else standard output."""
    return sys.stderr if as_json else sys.stdout


def teller(as_json: bool) -> Callable[[str], None]:
    """Return a function that prints a progress message at once."""
    return partial(print, file=progress_stream(as_json), flush=True)


def confirmed(question: str) -> bool:
    """Ask the person at the terminal. Whether the answer is yes."""
    print(f"{question} (yes) ", end="", file=sys.stderr, flush=True)
    return sys.stdin is not None and sys.stdin.readline().strip().lower() == "yes"


def write_drawing(folder: Path, name: str, picture: NDArray[np.uint8]) -> str:
    """Write the picture (H, W, 3) as a PNG into the folder, and return its path. Raises like `refuse_drawing`, and
    StorageError if the file cannot be written."""
    from foldcell.cell.support.files.encoded_picture import write_png

    path = refuse_drawing(folder, name)
    write_png(path, picture)
    return str(path)


def refuse_drawing(folder: Path, name: str) -> Path:
    """Return the path of a drawing. Raises ConfigurationError if the folder does not exist, or if a picture that
    foldcell did not draw has this path. Called also before a drawing's content is computed."""
    if not folder.is_dir():
        raise ConfigurationError(
            f"{folder}: there is no such folder", "create it, or give another one with --draw"
        )
    path = folder / f"{name}.png"
    refuse_foreign(path, PNG_MARK)
    return path


def check_garment_output(path: Path | None, replace: bool) -> None:
    """Check the garment file that is to be written, before anything is computed. Raises ConfigurationError,
    StorageError."""
    from foldcell.cell.config.garments.garment_file import shipped_garment_path

    if path is None:
        return
    refuse_unwritable(path)
    if path.suffix not in (".yaml", ".yml"):
        raise ConfigurationError(f"{path}: a garment file ends in .yaml", "give another --output")
    if path.exists() and not replace:
        shipped = path.resolve().parent == shipped_garment_path("").resolve().parent
        what = "is a shipped garment file" if shipped else "exists already"
        raise ConfigurationError(f"{path} {what}", "give another --output, or --replace to write over it")
