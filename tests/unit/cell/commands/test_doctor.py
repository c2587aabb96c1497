"""`foldcell doctor` finds faults, gives a hint for each, and never crashes."""

import json
from dataclasses import replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from foldcell.cell.commands.installation import checks as doctor
from foldcell.cell.commands.installation.checks import Check, Verdict, examine, pinned_versions, required_packages
from foldcell.cell.commands.main import main
from foldcell.cell.journal.journal import Journal
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.registry import find_robot
from foldcell.robots.robot import Robot


def by_name(checks: list[Check]) -> dict[str, Check]:
    return {c.name: c for c in checks}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Loading every compiled module takes seconds: one test does it."""
    if "native" not in request.node.name:
        monkeypatch.setattr(doctor, "NATIVE", (("json",),))


def test_all_checks_pass_on_this_machine(tmp_path: Path) -> None:
    checks = examine(tmp_path)
    assert [c for c in checks if c.verdict is Verdict.BAD] == []
    names = by_name(checks)
    for name in (
        "python",
        "numpy",
        "pin",
        "Baxter model",
        "compile cache",
        "logs",
        "disk",
        "memory",
        "viewer",
        "garments",
    ):
        assert name in names


def native_modules() -> list[Check]:
    return list(doctor._native_modules([doctor._loading(*group) for group in doctor.NATIVE]))


def test_native_modules_load() -> None:
    (check,) = native_modules()
    assert check.verdict is Verdict.GOOD and check.found == "all 10 load"


def test_native_module_that_does_not_load(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "NATIVE", (("json", "no_such_module", "csv"), ("math",)))
    (check,) = native_modules()
    assert (
        check.verdict is Verdict.BAD and check.name == "import no_such_module" and "no_such_module" in check.found
    )


def test_native_module_that_crashes_its_process(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "crashing.py").write_text("import os; os.abort()")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(doctor, "NATIVE", (("json", "crashing"),))
    (check,) = native_modules()
    assert (check.name, check.found) == ("import crashing", "crashed (-6)")


def test_versions_that_differ_from_the_pinned_ones_are_reported() -> None:
    version = metadata.version("numpy")
    assert doctor._package("numpy", version).verdict is Verdict.GOOD
    other = doctor._package("numpy", "1.0.0")
    assert other.verdict is Verdict.WARNING and "1.0.0" in other.hint
    missing = doctor._package("surely-not-installed", "2.0")
    assert missing.verdict is Verdict.BAD and "surely-not-installed==2.0" in missing.hint


def test_constraints_are_read() -> None:
    text = "Jinja2==3.1.6 \\\n    --hash=sha256:0a \\\n    --hash=sha256:0b\ntyping_extensions==4.0 \\\n"
    assert pinned_versions(text) == {"jinja2": "3.1.6", "typing-extensions": "4.0"}


def test_developer_packages_are_not_required_of_users() -> None:
    packages = required_packages()
    assert "numpy" in packages and "rerun-sdk" in packages
    assert "pytest" not in packages


def test_read_only_logs_are_bad(lockable: Any) -> None:
    with lockable.read_only():
        (check,) = doctor._logs(lockable.folder / "logs")
    assert check.verdict is Verdict.BAD and "--logs DIR" in check.hint


def test_a_broken_journal_is_bad(tmp_path: Path) -> None:
    (tmp_path / "journal.db").write_bytes(b"x" * 5000)
    checks = [c for c in examine(tmp_path) if c.verdict is Verdict.BAD]
    assert len(checks) == 1 and "journal.db" in checks[0].found + checks[0].hint


def test_every_damaged_page_of_the_journal_is_reported_with_its_file(tmp_path: Path) -> None:
    journal_file = tmp_path / "journal.db"
    with Journal.open(journal_file) as journal:
        for seed in range(300):
            journal.begin_run(garment="towel", seed=seed, driver="sim")
    content, page = journal_file.read_bytes(), 4096
    for start in range(page, len(content), page):
        journal_file.write_bytes(content[:start] + b"\0" * 64 + content[start + 64 :])
        (bad,) = [c for c in doctor._safely(partial(doctor._logs, tmp_path)) if c.verdict is Verdict.BAD]
        assert str(journal_file) in bad.found + bad.hint and "keep a copy" in bad.hint


def test_a_crashing_check_is_bad_and_the_others_continue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> list[Check]:
        raise ConfigurationError("the model is gone", "install it")

    def found(name: str) -> Robot:
        robot = find_robot(name)
        return replace(robot, load_model=broken) if name == "baxter" else robot

    monkeypatch.setattr(doctor, "find_robot", found)
    checks = examine(tmp_path)
    (bad,) = [c for c in checks if c.verdict is Verdict.BAD]
    assert "the model is gone" in bad.found and bad.hint == "install it"
    assert "viewer" in by_name(checks)


def test_the_command_exits_with_the_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["doctor", "--logs", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["good"] is True
    monkeypatch.setattr(doctor, "required_packages", lambda: ["surely-not-installed"])
    assert main(["doctor", "--logs", str(tmp_path)]) == 3
    text = capsys.readouterr().out
    assert "BAD" in text and "surely-not-installed" in text and "cannot run here" in text


def test_the_doctor_changes_nothing(tmp_path: Path) -> None:
    examine(tmp_path / "logs")
    assert list(tmp_path.iterdir()) == []
