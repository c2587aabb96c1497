"""The cache of compiled functions may be damaged, or have no place: the functions give the same values."""

from __future__ import annotations

import fcntl
import importlib.util
import itertools
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
import pytest
from numba.core.event import Event, Listener, install_listener

from foldcell.cell.commands.installation import checks
from foldcell.skills.compiled import WAITING, FallibleCache

ROOT = Path(__file__).resolve().parents[3]
SOURCE = """from foldcell.skills.compiled import cached

@cached()
def twice(x):
    return 2 * x
"""
DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda data: b"",
    "cut in half": lambda data: data[: len(data) // 2],
    "zeros": lambda data: bytes(len(data)),
    "another file": lambda data: b"%PDF-1.7\n",
}
numbers = itertools.count()


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(FallibleCache, "caches", [])
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    (tmp_path / "module.py").write_text(SOURCE, encoding="utf-8")
    return tmp_path


def imported(folder: Path) -> Any:
    """The function of a new process: a module that has compiled and loaded nothing."""
    spec = importlib.util.spec_from_file_location(f"module_{next(numbers)}", folder / "module.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.twice


def loads(twice: Any) -> int:
    """Calls the function; returns how often it was loaded from the cache."""
    assert twice(21) == 42
    return sum(twice.stats.cache_hits.values())


def test_the_code_is_kept_and_loaded(folder: Path) -> None:
    assert loads(imported(folder)) == 0
    assert loads(imported(folder)) == 1
    assert FallibleCache.caches[-1].check() == 1


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_a_damaged_entry_is_compiled_again_and_replaced(ending: str, damage: str, folder: Path) -> None:
    loads(imported(folder))
    (entry,) = (folder / "__pycache__").glob(f"*.{ending}")
    entry.write_bytes(DAMAGE[damage](entry.read_bytes()))
    assert loads(imported(folder)) == 0
    assert loads(imported(folder)) == 1


def test_an_entry_that_cannot_be_replaced_does_no_harm(folder: Path) -> None:
    loads(imported(folder))
    (index,) = (folder / "__pycache__").glob("*.nbi")
    index.unlink()
    index.mkdir()
    assert loads(imported(folder)) == 0
    assert loads(imported(folder)) == 0


def test_without_a_place_the_code_is_not_kept(folder: Path) -> None:
    (folder / "__pycache__").write_text("a file", encoding="utf-8")
    (folder / "user").write_text("a file", encoding="utf-8")
    before = sorted(folder.rglob("*"))
    assert loads(imported(folder)) == 0
    assert sorted(folder.rglob("*")) == before


def test_the_code_in_a_folder_that_is_read_only_is_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loads(imported(folder))

    def refuse(**_: Any) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    assert loads(imported(folder)) == 1


def test_the_folder_that_the_user_names_is_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder / "named"))
    loads(imported(folder))
    (code,) = folder.rglob("*.nbc")
    assert code.is_relative_to(folder / "named")
    assert loads(imported(folder)) == 1


@contextmanager
def another_process(folder: Path, leaves: Callable[[], None]) -> Iterator[None]:
    """Another process compiles. It ends when this one begins to wait for it, and `leaves` its code."""
    lock = lock_file(folder).open("ab")
    fcntl.flock(lock, fcntl.LOCK_EX)

    class Ends(Listener):
        def on_start(self, event: Event) -> None:
            leaves()
            lock.close()

        def on_end(self, event: Event) -> None:
            pass

    with lock, install_listener(WAITING, Ends()):
        yield


def lock_file(folder: Path) -> Path:
    (lock,) = (folder / "__pycache__").glob("*.lock")
    return lock


def test_what_another_process_compiles_is_awaited_and_loaded(folder: Path) -> None:
    loads(imported(folder))
    code = {path: path.read_bytes() for path in (folder / "__pycache__").glob("*.nb?")}
    for path in code:
        path.unlink()

    def leaves() -> None:
        for path, data in code.items():
            path.write_bytes(data)

    with another_process(folder, leaves):
        assert loads(imported(folder)) == 1


def test_if_the_other_process_is_killed_this_one_compiles(folder: Path) -> None:
    loads(imported(folder))
    for path in (folder / "__pycache__").glob("*.nb?"):
        path.unlink()
    with another_process(folder, lambda: None):
        assert loads(imported(folder)) == 0
    assert loads(imported(folder)) == 1


@pytest.mark.parametrize("source", [SOURCE, SOURCE.replace("2 * x", "x.missing")])
def test_the_lock_is_released_when_the_compilation_has_ended_or_failed(source: str, folder: Path) -> None:
    (folder / "module.py").write_text(source, encoding="utf-8")
    if source == SOURCE:
        loads(imported(folder))
    else:
        with pytest.raises(numba.TypingError):
            imported(folder)(21)
    with lock_file(folder).open("ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_without_a_lock_file_the_code_is_compiled_and_kept(folder: Path) -> None:
    imported(folder)._cache.index.with_suffix(".lock").mkdir(parents=True)
    assert loads(imported(folder)) == 0
    assert loads(imported(folder)) == 1


def test_the_code_of_an_installed_package_is_kept_in_the_users_cache(folder: Path) -> None:
    package = folder / "site-packages"
    package.mkdir()
    (folder / "module.py").rename(package / "module.py")
    assert loads(imported(package)) == 0
    assert loads(imported(package)) == 1
    assert not list(package.rglob("*.nb?"))
    assert imported(package)._cache.index.is_relative_to(folder / "user")


def test_every_compiled_function_that_is_kept_has_this_cache() -> None:
    kept, plain = set(), []
    for path in (p for layer in ("cell", "skills", "robots", "calibration") for p in (ROOT / layer).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if path.name != "compiled.py" and re.search(r"\bcached\(.*\)$|\bcached\(\)\(", text, flags=re.M):
            kept.add(".".join(("foldcell", *path.relative_to(ROOT).with_suffix("").parts)))
        plain += [path for _ in re.findall(r"cache=True", text)]
    assert plain == [] and kept == set(checks.COMPILED)


@pytest.fixture
def one_module(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Lets doctor find one compiled function, named like the cloth simulation's; returns its folder."""
    (folder / "module.py").rename(folder / "kernel.py")
    monkeypatch.setattr(checks, "COMPILED", ())
    spec = importlib.util.spec_from_file_location("kernel_of_a_test", folder / "kernel.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.twice(21) == 42
    return folder / "__pycache__"


def test_doctor_loads_what_is_there(one_module: Path) -> None:
    (check,) = checks._compile_cache()
    assert check.verdict is checks.Verdict.GOOD and check.found == f"{one_module}; all 1 compiled functions load"


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_doctor_names_a_damaged_entry(ending: str, one_module: Path) -> None:
    (entry,) = one_module.glob(f"*.{ending}")
    entry.write_bytes(b"")
    (check,) = checks._compile_cache()
    assert check.verdict is checks.Verdict.WARNING and "damaged" in check.found
    assert str(one_module / "kernel.twice") in check.found and "compiled again" in check.hint
    assert entry.read_bytes() == b""  # the checks change nothing


def test_doctor_names_a_folder_without_room(one_module: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "_write_problem", lambda _: "Read-only file system")
    (check,) = checks._compile_cache()
    assert check.verdict is checks.Verdict.WARNING and "NUMBA_CACHE_DIR" in check.hint
