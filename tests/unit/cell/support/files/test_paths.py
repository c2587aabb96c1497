"""The logs folder. Unusable folders are reported before anything moves."""

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from foldcell.cell.support.files import paths
from foldcell.cell.support.files.paths import logs_directory, logs_of_run, prepare_logs, repository_root
from foldcell.robots.errors import StorageError


def test_the_option_wins_over_the_environment(tmp_path: Path) -> None:
    environment = {"FOLDCELL_LOGS": str(tmp_path / "environment")}
    assert logs_directory(tmp_path / "option", environment) == tmp_path / "option"
    assert logs_directory(None, environment) == tmp_path / "environment"


def test_a_checkout_keeps_its_logs_in_its_own_folder() -> None:
    root = repository_root()
    assert root is not None and (root / "cell" / "support" / "files" / "paths.py").is_file()
    assert logs_directory(None, {}) == root / "logs"


def test_an_installed_package_uses_the_users_data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed = tmp_path / "site-packages" / "foldcell" / "cell" / "support" / "files" / "paths.py"
    monkeypatch.setattr(paths, "__file__", str(installed))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    assert repository_root() is None
    assert logs_directory(None, {}) == tmp_path / "data" / "foldcell" / "logs"


def test_an_empty_environment_variable_is_ignored() -> None:
    assert logs_directory(None, {"FOLDCELL_LOGS": ""}) == logs_directory(None, {})


def test_a_relative_logs_option_is_relative_to_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert logs_directory(Path("mine"), {}) == tmp_path / "mine"


def test_a_folder_of_a_run_names_its_logs_unless_the_option_names_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there, run = tmp_path / "here", tmp_path / "there", "2026-01-01"
    monkeypatch.setenv("FOLDCELL_LOGS", str(there))
    (here / run).mkdir(parents=True)
    monkeypatch.chdir(here)
    for name in (run, here / run, f"./{run}"):
        assert logs_of_run(name) == there, "without a journal it is no run"
    (here / "journal.db").touch()
    for name in (run, here / run, f"./{run}"):
        assert logs_of_run(name) == here
        assert logs_of_run(name, there) == there
    assert logs_of_run("last") == there


def test_preparing_the_logs_makes_an_empty_folder(tmp_path: Path) -> None:
    logs = prepare_logs(tmp_path / "a" / "b", least_free=0)
    assert logs.is_dir() and list(logs.iterdir()) == []


def test_a_file_in_place_of_the_logs_folder_is_a_storage_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for logs in (tmp_path / "file", tmp_path / "file" / "logs"):
        with pytest.raises(StorageError, match="cannot be written"):
            prepare_logs(logs)
    assert (tmp_path / "file").read_text() == "mine"


def test_a_read_only_folder_is_a_storage_error(lockable: Any) -> None:
    with lockable.read_only():
        for logs in (lockable.folder, lockable.folder / "new"):
            with pytest.raises(StorageError, match="--logs DIR"):
                prepare_logs(logs)
    assert list(lockable.folder.iterdir()) == []


def test_a_folder_without_space_is_left_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file system is full or read-only."""
    for number in (errno.EROFS, errno.ENOSPC):

        def refuse(*_: object, _number: int = number, **__: object) -> None:
            raise OSError(_number, os.strerror(_number))

        monkeypatch.setattr(paths.tempfile, "NamedTemporaryFile", refuse)
        with pytest.raises(StorageError, match=os.strerror(number)):
            prepare_logs(tmp_path / "a" / "b")
        assert list(tmp_path.iterdir()) == []


def test_too_little_space_is_reported_before_the_run(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="MiB left"):
        prepare_logs(tmp_path / "new", least_free=2**60)
    assert not (tmp_path / "new").exists()
