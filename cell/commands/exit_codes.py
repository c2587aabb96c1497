"""Runs any command with the same exit codes, and with error messages for people and programs."""

from __future__ import annotations

import argparse
import errno
import json
import os
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from foldcell.cell.support.process.library_messages import quiet_libraries
from foldcell.cell.support.process.signals import BY_SIGNAL, Terminated, unwinding
from foldcell.cell.support.process.standard_streams import lasting_streams
from foldcell.robots.errors import CellError, ConfigurationError, StorageError

OK, FAULT, USAGE, INTERRUPTED = 0, 3, 64, 130
"""Exit codes, in this order: done; fault; bad usage, configuration or logs; SIGINT. The
codes of SIGHUP (129) and SIGTERM (143) follow from BY_SIGNAL in cell/support/process/signals.py."""

UNUSABLE = frozenset({errno.ENAMETOOLONG, errno.EACCES, errno.EPERM})
"""Errors of a name that a user gave: too long for a file, or in a folder that may not be searched. Even asking
whether there is such a file raises them."""
LONGEST = 120
"""Number of characters of a file's name that a message shows."""


def framed(parse: Callable[[], argparse.Namespace], asked_for_json: bool) -> int:
    """Parse a command line, run its command and return the exit code. Never raises.

    A closed pipe (`| head`) does not change the exit code. If standard output cannot be written for another
    reason, a successful command returns USAGE. Messages of libraries are suppressed. If a signal has ended the
    command while code is compiled (skills/compiled.py), the process ends here, because Python would wait for it.
    """
    with lasting_streams() as output, unwinding(), quiet_libraries():
        code = _perform(parse, asked_for_json)
        lost = output.lost
        if code == OK and isinstance(lost, OSError) and not isinstance(lost, BrokenPipeError):
            what = f"standard output cannot be written: {lost.strerror}"
            code = _say(USAGE, what, "the command itself was carried out")
    if any(thread.name == "compiler" for thread in threading.enumerate()):
        os._exit(code)
    return code


def _perform(parse: Callable[[], argparse.Namespace], asked_for_json: bool) -> int:
    options = argparse.Namespace(json=asked_for_json)
    try:
        try:
            options = parse()
        except SystemExit as e:  # raised by argparse: code 0 for --help, USAGE for a bad line
            code = int(e.code or 0)
            if code and asked_for_json:
                print(json.dumps({"error": "bad usage", "hint": "see foldcell --help", "exit_code": code}))
        else:
            code = int(options.run(options))
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
        if isinstance(e, OSError) and e.errno in UNUSABLE and e.filename is not None:
            return _fail(
                options, USAGE, f"{str(e.filename)[:LONGEST]} cannot be used: {e.strerror}", "check the name"
            )
        path = _write_traceback(options)
        hint = f"the details are in {path}" if path else traceback.format_exc()
        return _fail(options, FAULT, f"this is a bug in foldcell: {type(e).__name__}: {e}", hint)


def _fail(options: argparse.Namespace, code: int, what: str, hint: str) -> int:
    """Print the error for people and, with --json, for the calling program; returns `code`."""
    _say(code, what, hint)
    if getattr(options, "json", False):
        print(json.dumps({"error": what, "hint": hint, "exit_code": code}), flush=True)
    return code


def _say(code: int, what: str, hint: str) -> int:
    print(f"foldcell: {what}" + (f"\n  {hint}" if hint else ""), file=sys.stderr, flush=True)
    return code


def _write_traceback(options: argparse.Namespace) -> Path | None:
    """Write the traceback to the logs folder, else to the temporary folder. Returns its path, or None if neither
    folder can be written. Never raises."""
    from foldcell.cell.support.files.paths import logs_directory

    name = f"crash-{time.strftime('%Y%m%dT%H%M%S')}-{os.getpid()}.txt"
    text = f"foldcell {' '.join(sys.argv[1:])}\n\n{traceback.format_exc()}".encode(errors="backslashreplace")
    folders: tuple[Callable[[], Path], ...] = (
        lambda: logs_directory(getattr(options, "logs", None)),
        lambda: Path(tempfile.gettempdir()),
    )
    for folder in folders:
        with suppress(OSError, ValueError, CellError):  # ValueError: a zero byte in a name
            path = folder() / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(text)
            return path
    return None
