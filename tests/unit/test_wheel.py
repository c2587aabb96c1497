"""The wheel of this tree: what it holds, and what it does in an environment outside the repository."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from benchmarks.release import (
    PACKAGES,
    build_packages,
    changelog_problems,
    copy_tree,
    tag_problems,
    try_wheel,
    wheel_problems,
)
from foldcell.cell.journal.journal import Journal
from tests.builders.records import run_record
from tests.optional_parts import BUILD, GIT


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the repository without its history, and so without tags."""
    GIT.require()
    folder = tmp_path_factory.mktemp("tree")
    copy_tree(folder)
    return folder


@pytest.fixture(scope="module")
def wheel(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    BUILD.require()
    out = tmp_path_factory.mktemp("dist")
    assert build_packages(tree, out, "--no-isolation") == []
    (found,) = out.glob("*.whl")
    return found


def test_the_wheel_holds_the_packages_and_nothing_else(wheel: Path, tree: Path) -> None:
    assert wheel_problems(wheel, tree) == []


def test_a_wheel_of_a_wrong_content_is_refused(tmp_path: Path) -> None:
    (tmp_path / "foldcell").mkdir()
    for package in PACKAGES:
        (tmp_path / package).mkdir()
        (tmp_path / package / "page.html").write_text("a page")
    with zipfile.ZipFile(tmp_path / "a.whl", "w") as archive:
        for package in PACKAGES[1:]:
            archive.writestr(f"foldcell/{package}/page.html", "a page")
        archive.writestr("benchmarks/start.py", "")
        archive.writestr("foldcell-0.1.dist-info/licenses/LICENSE", "")
    assert wheel_problems(tmp_path / "a.whl", tmp_path) == [
        f"foldcell/{PACKAGES[0]}/page.html is missing",
        "benchmarks/start.py is too much",
        "licenses/NOTICE is missing",
    ]


def test_the_installed_wheel_works_outside_the_repository_and_leaves_nothing(wheel: Path, tmp_path: Path) -> None:
    logs = tmp_path / "home" / ".local" / "share" / "foldcell" / "logs"
    logs.mkdir(parents=True)
    with Journal.open(logs / "journal.db") as journal:
        run = journal.begin_run(garment="medium_towel", seed=1, driver="sim")
        run.result(run.intent(0.0, "looking", "look"), 0.5, {"event": "done"})
        run.end("folded", run_record(run_dir=str(run.directory)).as_json())
    assert try_wheel(wheel, tmp_path, shared=Path(np.__file__).parents[1]) == []


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        ("# Changelog\n\n## 0.1.0 (2026-11-28)\n", False),
        ("# Changelog\n\n## 0.1.0 (unreleased)\n", True),
        ("# Changelog\n\n## Unreleased\n\n## 0.1.0 (2026-11-28)\n", True),
        ("# Changelog\n", True),
    ],
)
def test_a_release_needs_its_section_of_the_changelog_with_a_date(text: str, refused: bool) -> None:
    assert bool(changelog_problems(text, "0.1.0")) == refused


def test_a_release_needs_the_tag_of_its_version() -> None:
    assert tag_problems(["v0.1.0"], "0.1.0") == []
    assert "v0.1.0 is due" in tag_problems(["v0.2.0", "0.1.0"], "0.1.0")[0]
