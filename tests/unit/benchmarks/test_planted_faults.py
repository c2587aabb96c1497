"""Planted faults: what is changed in a source, what is drawn, and when a fault counts as caught."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import planted_faults
from benchmarks.planted_faults import PARTS, ROOT, covering_tests, drawn, faults, is_caught, main

SOURCE = '''"""A text with 3 words."""
from math import pi

__all__ = ["f", "g"]


def f(held: bool, é: float = 2.0) -> "1 + 1":
    if held and é < 3.0:
        print("é", end="")
    return max(é, 1) if held else not {1, 2}
'''


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("2.0", "(3.0)"),
        ("held and é < 3.0", "(held or é < 3.0)"),
        ("é < 3.0", "(é > 3.0)"),
        ('print("é", end="")', "pass"),
        ('print("é", end="")', "(print('é'))"),
        ("max", "(min)"),
        ("max(é, 1) if held else not {1, 2}", "(not {1, 2} if held else max(é, 1))"),
        ("not {1, 2}", "({1, 2})"),
        ("{1, 2}", "({2})"),
    ],
)
def test_one_place_is_changed_and_nothing_else(before: str, after: str) -> None:
    (fault,) = [f for f in faults(SOURCE, "f.py") if (f.before, f.after) == (before, after)]
    planted = fault.planted(SOURCE)
    assert planted.count(after) >= 1 and len(planted) == len(SOURCE) - len(before) + len(after)
    assert planted != SOURCE and ast.parse(planted)
    assert SOURCE.splitlines()[fault.line - 1].find(before.splitlines()[0]) >= 0


def test_texts_types_and_exported_names_are_not_changed() -> None:
    assert {f.line for f in faults(SOURCE, "f.py")} == {7, 8, 9, 10}
    assert not [f for f in faults(SOURCE, "f.py") if "1 + 1" in f.before]
    assert faults('x = "a" + f"{1}" + "b"\n', "f.py") == []


def test_the_same_seed_draws_the_same_faults_and_all_differ() -> None:
    parts = ["cell/control", "skills/scoring"]
    first = drawn(ROOT, 50, 1, parts)
    assert first == drawn(ROOT, 50, 1, parts) != drawn(ROOT, 50, 2, parts)
    assert len(set(first)) == 50 and {fault.file.rpartition("/")[0] for fault in first} >= {"skills/scoring"}


def test_each_part_and_its_tests_exist() -> None:
    assert all((ROOT / place).exists() for part, tests in PARTS.items() for place in (part, *tests))


def test_tests_that_name_the_faulty_module_come_first_and_can_be_the_only_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in {"test_a": "", "test_b": "import halves.half", "test_c": "import halves.other"}.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setattr(planted_faults, "PARTS", {"halves": (".",)})
    (half, *_), (third, *_) = (faults("x = 1", f"halves/{name}.py") for name in ("half", "third"))
    assert covering_tests(half, tmp_path, near=False) == ["test_b.py", "test_a.py", "test_c.py"]
    assert covering_tests(half, tmp_path, near=True) == ["test_b.py"]
    assert len(covering_tests(third, tmp_path, near=True)) == 3, "no test names it"


def test_a_fault_is_caught_if_a_test_fails_and_the_source_is_restored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = "def half(x):\n    return x / 2\n\n\ndef third(x):\n    return x / 3\n"
    (tmp_path / "halves").mkdir()
    (tmp_path / "halves" / "half.py").write_text(source)
    (tmp_path / "test_half.py").write_text(
        "from halves.half import half\n\n\ndef test():\n    assert half(4) == 2\n"
    )
    monkeypatch.setattr(planted_faults, "PARTS", {"halves": ("test_half.py",)})
    one, other = (next(f for f in faults(source, "halves/half.py") if f.before == b) for b in ("x / 2", "x / 3"))
    assert is_caught(one, tmp_path, False, 60.0) and not is_caught(other, tmp_path, False, 60.0)
    assert (tmp_path / "halves" / "half.py").read_text() == source
    monkeypatch.setattr(planted_faults, "ROOT", tmp_path)
    monkeypatch.setattr(planted_faults, "is_caught", lambda fault, root, near, timeout_s: fault == one)
    assert main(["--n", "4", "--only", "halves"]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "1 of 4 caught"
    assert sorted(line.split(" halves")[0].strip() for line in lines[:-1]) == ["NOT CAUGHT"] * 3 + ["caught"]


def test_a_planted_fault_is_in_the_module_that_the_tests_import(tmp_path: Path) -> None:
    root = planted_faults.copied(tmp_path)
    code = "import foldcell.robots.setpoint as planted; print(planted.__file__)"
    line = [sys.executable, "-c", code]
    done = subprocess.run(
        line, cwd=root, env={**os.environ, "PYTHONPATH": str(root)}, capture_output=True, text=True
    )
    assert Path(done.stdout.strip()).resolve() == (root / "robots" / "setpoint.py").resolve()
