"""Fixtures shared by the tests of the cell."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

NOBODY = 65534


class Locked:
    """A folder that can be made read-only, also for root."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @contextmanager
    def read_only(self) -> Iterator[None]:
        self.folder.chmod(0o555)
        root = os.geteuid() == 0
        if root:
            os.seteuid(NOBODY)  # root ignores permissions
        try:
            yield
        finally:
            if root:
                os.seteuid(0)
            self.folder.chmod(0o755)


@pytest.fixture
def lockable() -> Iterator[Locked]:
    """A folder that every user can reach. Pytest's folders are closed to other users."""
    with tempfile.TemporaryDirectory(prefix="foldcell-test-") as name:
        Path(name).chmod(0o755)
        yield Locked(Path(name))
