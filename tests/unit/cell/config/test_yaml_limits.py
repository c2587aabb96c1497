"""Small files that stand for much, deep files and large files: refused at once, with file, line and what to do."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from foldcell.cell.campaigns.hil.script import read_script
from foldcell.cell.config.calibration_file import (
    load_camera_calibration,
    load_table_height,
    load_tactile_thresholds,
)
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.yaml_file import DEEPEST, LARGEST_FILE, MOST_VALUES, parse_yaml, read_yaml
from foldcell.robots.errors import ConfigurationError
from tests.builders.yaml_texts import aliases_of_aliases

READERS = {
    "settings": load_settings,
    "garment": load_garment,
    "script": read_script,
    "camera": load_camera_calibration,
    "table": load_table_height,
    "tactile": load_tactile_thresholds,
    "any": read_yaml,
}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
@pytest.mark.parametrize(("kind", "line"), [("list", 6), ("group", 5)])
def test_aliases_of_aliases_are_refused_by_every_reader(
    tmp_path: Path, read: Callable[[Path], object], kind: str, line: int
) -> None:
    """Five levels of ten stand for a hundred thousand values. The fifth line is more than any file needs, of
    groups the fourth, whose keys count too."""
    path = tmp_path / "mine.yaml"
    path.write_text(f"# mine\n{aliases_of_aliases(kind)}", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=rf"mine\.yaml:{line}: .*more than {MOST_VALUES} values") as error:
        read(path)
    assert "write the values out" in error.value.hint and error.value.values["path"] == str(path)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a: 1\nb: " + "[" * 1000, 2),
        ("a: 1\nb: " + "[" * 1000 + "]" * 1000, 2),
        ("a: 1\nc: " + "{b: " * 1000, 2),
        ("".join(f"{' ' * k}k:\n" for k in range(1000)), DEEPEST),
        ("a:\n" + "- " * 1000, 2),
        (
            "a: &a [1]\n" + "".join(f"b{k}: &b{k} [*{'a' if k == 0 else f'b{k - 1}'}]\n" for k in range(100)),
            DEEPEST - 1,
        ),
    ],
    ids=["open brackets", "brackets", "braces", "indentation", "dashes", "aliases"],
)
def test_deep_nesting_is_refused_with_its_line(text: str, line: int) -> None:
    with pytest.raises(ConfigurationError, match=rf"mine\.yaml:{line}: .*nested too deep") as error:
        parse_yaml(text, Path("mine.yaml"))
    assert error.value.hint


@pytest.mark.parametrize(
    "text", ["a: [" + "1, " * MOST_VALUES + "1]", "\n".join(f"k{i}: 1" for i in range(MOST_VALUES))]
)
def test_more_values_than_any_file_needs_are_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"mine\.yaml:\d+: .*more than {MOST_VALUES} values"):
        parse_yaml(text, Path("mine.yaml"))


def test_a_large_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n" + "#" * LARGEST_FILE)
    with pytest.raises(
        ConfigurationError, match=rf"mine\.yaml: the file has {LARGEST_FILE + 5} bytes.*{LARGEST_FILE}"
    ):
        read_yaml(path)


@pytest.mark.parametrize("text", ["a: &a [1, *a]", "a: &a {b: *a}", "a: &a\n  - b: {c: *a}"])
def test_an_alias_inside_of_what_it_repeats_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"mine\.yaml:\d: .*\*a stands inside of what it repeats"):
        parse_yaml(text, Path("mine.yaml"))


def test_a_few_aliases_repeat_their_values() -> None:
    document = parse_yaml("a: &a {x: [1, 2]}\nb: *a\nc: [*a, *a]\n", Path("mine.yaml"))
    assert document.data == {"a": {"x": [1, 2]}, "b": {"x": [1, 2]}, "c": [{"x": [1, 2]}] * 2}
    assert document.where(("b",)) == "mine.yaml:2" and document.where(("c", 1)) == "mine.yaml:1"


@pytest.mark.parametrize(
    ("value", "part"),
    [
        ("9" * 5000, "is not a value of the kind int"),
        ("!!int x", "is not a value of the kind int"),
        ("!!float x", "is not a value of the kind float"),
        ("!!bool maybe", "is not a value of the kind bool"),
        ("!!set {x}", "set"),
        ("!!timestamp 2020-99-99", "timestamp"),
        ("!!binary '%'", "binary"),
        ("!!omap [x: 1]", "omap"),
    ],
)
def test_values_of_a_wrong_or_unknown_kind_are_refused_with_their_line(value: str, part: str) -> None:
    with pytest.raises(ConfigurationError, match=r"mine\.yaml:2: ") as error:
        parse_yaml(f"a: 1\nb: {value}", Path("mine.yaml"))
    assert part in error.value.what and len(error.value.what) < 300


def test_no_module_reads_yaml_by_other_means() -> None:
    """The limits hold for every file because one module reads them all."""
    root = Path(__file__).parents[4]
    modules = [
        p for name in ("foldcell", "cell", "calibration", "skills", "robots") for p in (root / name).rglob("*.py")
    ]
    assert len(modules) > 300
    reading = {
        p.name
        for p in modules
        if re.search(r"yaml\.(\w+_)?(load|compose|parse|scan)|\b(C?Safe|Full|Unsafe|Base)?Loader\b", p.read_text())
    }
    assert reading == {"yaml_file.py"}
