"""The frame of every command: exit codes, and errors told to the person and to the program that called."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from cell.support.process.standard_streams import lasting_streams
from cell.support.process.terminations import BY_SIGNAL, Terminated, unwinding
from robots.errors import CellError, ConfigurationError, StorageError

__all__ = ["FAULT", "INTERRUPTED", "NOT_DONE", "OK", "USAGE", "framed"]

OK, NOT_DONE, FAULT, USAGE, INTERRUPTED = 0, 2, 3, 64, 130
"""Done; ended safe but not done; fault; bad usage, configuration or logs; SIGINT. (SIGHUP, 129, and SIGTERM, 143:
cell/support/process/terminations.py.)"""


def framed(parse: Callable[[], argparse.Namespace], asked_for_json: bool) -> int:
    """Parse a line, run its command, return the exit code. Never raises, and never shows a traceback. Who stops
    reading what it prints (`| head`) changes nothing; output that could not be written is a fault of its own."""
    with lasting_streams() as output, unwinding():
        code = _perform(parse, asked_for_json)
        lost = output.lost
        if code != OK or not isinstance(lost, OSError) or isinstance(lost, BrokenPipeError):
            return code
        return _say(USAGE, f"standard output cannot be written: {lost.strerror}", "what was done stays done")


def _perform(parse: Callable[[], argparse.Namespace], asked_for_json: bool) -> int:
    options = argparse.Namespace()
    try:
        try:
            options = parse()
        except SystemExit as e:  # argparse: --help is 0, a bad line USAGE
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
