"""Free memory is returned to the operating system."""

from __future__ import annotations

import subprocess
import sys

GROW = """
from pathlib import Path
from threading import Thread
from foldcell.cell.support.process.memory import return_free_memory

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20

def fill():
    kept.append([bytes(3000) for _ in range(20_000)])

kept = []
for _ in range(4):
    thread = Thread(target=fill)
    thread.start()
    thread.join()
full = resident()
last = [part.pop() for part in kept]  # the end of each arena stays in use, so that it cannot shrink
kept.clear()
return_free_memory()
print(full, resident())
"""


def test_the_memory_of_ended_threads_is_given_back() -> None:
    """60 MiB each in four threads; what an arena's last block holds back is returned too."""
    answer = subprocess.run([sys.executable, "-c", GROW], capture_output=True, text=True, check=True)
    full, after = map(float, answer.stdout.split())
    assert full > 200.0 and after < full - 150.0
