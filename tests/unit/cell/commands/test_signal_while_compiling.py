"""A signal that arrives while code is compiled ends the command at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = """
import argparse, hashlib, sys
from numba.core.dispatcher import Dispatcher
from foldcell.cell.commands.exit_codes import framed

def compile(self, signature):  # in C, without the interpreter's lock and without an end, like LLVM
    print("compiling", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)

Dispatcher.compile = compile
from foldcell.skills.compiled import cached

@cached()
def twice(x):
    return 2 * x

sys.exit(framed(lambda: argparse.Namespace(run=lambda options: twice(21)), False))
"""


@pytest.mark.parametrize(
    ("number", "code", "words"),
    [(signal.SIGINT, 130, "foldcell: interrupted"), (signal.SIGTERM, 143, "foldcell: ended by SIGTERM")],
)
def test_a_signal_while_compiling_ends_the_command(
    number: signal.Signals, code: int, words: str, tmp_path: Path
) -> None:
    script = tmp_path / "command.py"
    script.write_text(COMMAND, encoding="utf-8")
    with subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    ) as process:  # fmt: skip
        try:
            assert process.stdout is not None and process.stdout.readline() == "compiling\n"
            process.send_signal(number)
            _, errors = process.communicate(timeout=60)  # it hangs for an hour if the signal is not handled
        finally:
            process.kill()
    assert process.returncode == code and errors.startswith(words)
