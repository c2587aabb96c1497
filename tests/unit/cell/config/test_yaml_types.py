"""Every number and truth value of every kind of YAML file: another type in its place is refused, with its line."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from foldcell.cell.campaigns.hil.script import read_script
from foldcell.cell.config import yaml_file
from foldcell.cell.config.calibration_file import (
    calibration_text,
    load_camera_calibration,
    load_table_height,
    load_tactile_thresholds,
    table_text,
    tactile_text,
)
from foldcell.cell.config.cell_settings import default_settings_path, load_settings
from foldcell.cell.config.garments.garment_file import load_garment, shipped_garment_path
from foldcell.cell.config.yaml_file import parse_yaml, read_yaml
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.robots.errors import ConfigurationError

SCRIPT = """
about: everything that a script can say
garment: small_towel
seed: 1
attended: true
limit_s: 600
do:
  - when: {state: lifting, visit: 2, after_s: 1.5}
    fault: {kind: dropped_corner, side: left, grasp: 1}
  - fault: {kind: sudden_drop, fold: 1, duration_s: 3.0}
  - when: {time_s: 60}
    say: pause
expect: {end: folded, only_failures: false, folds: 2, within_s: 300, passed: true, parked: true}
"""


def garment() -> dict[str, Any]:
    """A garment file with every key that has a number."""
    data = yaml.safe_load(shipped_garment_path("medium_towel").read_text(encoding="utf-8"))
    for grasp in data["plan"][0]["variants"][0]["grasps"]:
        grasp["turn_deg"] = 0.0
    return dict(data)


FILES: Mapping[str, tuple[Callable[[], Any], Callable[[Path], object]]] = {
    "garment": (garment, load_garment),
    "settings": (lambda: yaml.safe_load(default_settings_path().read_text(encoding="utf-8")), load_settings),
    "script": (lambda: yaml.safe_load(SCRIPT), read_script),
    "camera": (
        lambda: yaml.safe_load(calibration_text(camera_calibration(load_settings()), -0.1)),
        load_camera_calibration,
    ),
    "table": (lambda: yaml.safe_load(table_text(-0.1)), load_table_height),
    "tactile": (
        lambda: yaml.safe_load(tactile_text({"contact_force": 0.5, "held_force": 0.4})),
        load_tactile_thresholds,
    ),
}


def places(data: Any, key: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Keys of all numbers and truth values."""
    inside = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for name, value in inside:
        yield from places(value, (*key, name))
    if isinstance(data, bool | int | float):
        yield key


def replaced(data: Any, key: tuple[Any, ...], value: Any) -> Any:
    data = copy.deepcopy(data)
    group = data
    for part in key[:-1]:
        group = group[part]
    group[key[-1]] = value
    return data


def value_at(data: Any, key: tuple[Any, ...]) -> Any:
    for part in key:
        data = data[part]
    return data


@pytest.mark.parametrize("kind", FILES)
def test_every_number_and_truth_value_refuses_other_types(kind: str, tmp_path: Path) -> None:
    """`layers: true` is not one layer, and `"1"` is not a number, wherever it stands."""
    make, load = FILES[kind]
    data, path = make(), tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    load(path)
    keys = list(places(data))
    assert len(keys) >= {"garment": 60, "settings": 45, "script": 10, "camera": 20}.get(kind, 2)
    accepted = []
    for key in keys:
        old = value_at(data, key)
        wrong = [0 if old is False else 1, str(old).lower()] if isinstance(old, bool) else [True, str(old), [old]]
        for value in wrong:
            written = replaced(data, key, value)
            if kind == "settings":  # a file of one's own needs only what differs
                written = {key[0]: written[key[0]]}
            path.write_text(yaml.safe_dump(written, sort_keys=False), encoding="utf-8")
            try:
                load(path)
                accepted.append((key, value))
            except ConfigurationError as e:
                assert f"{path}:" in e.what and repr(value) in e.what, (key, e.what)
    assert not accepted


@pytest.mark.parametrize("key", ["layers", "final_layers"])
@pytest.mark.parametrize("value", ["true", '"1"', "1.0", "1.5"])
def test_numbers_of_layers_are_whole_numbers(tmp_path: Path, key: str, value: str) -> None:
    path = tmp_path / "mine.yaml"
    text = shipped_garment_path("medium_towel").read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if line.startswith(f"{key}:"))
    path.write_text(text.replace(line, f"{key}: {value}"), encoding="utf-8")
    number = text.splitlines().index(line) + 1
    with pytest.raises(ConfigurationError, match=rf"mine\.yaml:{number}: {key} = "):
        load_garment(path)


def test_whole_numbers_may_stand_where_a_length_is_expected(tmp_path: Path) -> None:
    data = garment()
    data["poses"]["y"] = [0, 0]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    assert load_garment(path).poses.y == (0.0, 0.0)


@pytest.mark.parametrize("text", ["a: [1, 2\nb: 3", "a: 'x", "a:\n\tb: 1", "a: %x", "&a a: *b", "a: 1\n b: 2"])
def test_an_error_of_syntax_is_worded_by_the_parser_in_python(text: str) -> None:
    with pytest.raises(yaml.MarkedYAMLError) as known:
        yaml.safe_load(text)
    with pytest.raises(ConfigurationError, match=re.escape(str(known.value.problem))):
        parse_yaml(text, Path("x.yaml"))


def test_both_parsers_give_the_same_values_and_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    paths = [*Path(shipped_garment_path("jeans")).parent.glob("*.yaml"), default_settings_path()]
    fast = [read_yaml(path) for path in paths]
    assert len(fast) > 10 and yaml_file._FastLoader is not yaml_file._Loader
    monkeypatch.setattr(yaml_file, "_FastLoader", yaml_file._Loader)
    assert [read_yaml(path) for path in paths] == fast
