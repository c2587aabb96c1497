"""The functions of `foldcell` convert their arguments to plain values or refuse them before anything begins, and
compute with their own numeric state."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import foldcell
from foldcell import folding
from foldcell.arguments import flag, number, path, text, whole
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.support.files.paths import journal_path

LATIN = "sh\udce9et.png"  # the file name b"sh\xe9et.png"


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[FoldRequest]]:
    """The requests that `fold` makes; no run is performed."""
    taken: list[FoldRequest] = []
    monkeypatch.setattr(folding, "fold_once", taken.append)
    yield taken


@pytest.mark.parametrize("seed", [np.int64(3), np.uint8(3), np.float32(3), np.array(3), 3.0, 3])
def test_a_seed_of_any_whole_number_is_an_int(seed: Any, requests: list[FoldRequest], tmp_path: Path) -> None:
    foldcell.fold("small_towel", seed=seed, logs=tmp_path)
    assert type(requests[0].seed) is int and requests[0].seed == 3


@pytest.mark.parametrize("seed", [1.5, "1", True, None, float("nan"), float("inf"), 1j, np.array([1]), 10**400])
def test_other_seeds_are_refused_before_the_run(seed: Any, requests: list[FoldRequest], tmp_path: Path) -> None:
    with pytest.raises(foldcell.ConfigurationError, match="seed"):
        foldcell.fold("small_towel", seed=seed, logs=tmp_path / "logs")
    assert not requests and not (tmp_path / "logs").exists()


def test_a_request_holds_plain_values_only(requests: list[FoldRequest], tmp_path: Path) -> None:
    given = {"optimiser": {"simulations": np.int64(7), "use_library": np.bool_(False)}}
    given["table"] = {"x": np.array([0.35, 1.05]), "height": np.float32(-0.125)}
    foldcell.fold(
        np.str_("small_towel"), seed=np.int8(1), driver=np.str_("sim"), settings=given, logs=tmp_path,
        approve=np.bool_(False), record=np.bool_(False), quiet=np.bool_(True),
    )  # fmt: skip
    (request,) = requests
    for name in ("garment", "seed", "driver", "approve", "record", "quiet"):
        value = getattr(request, name)
        assert type(value) in (str, int, bool), name
        json.dumps(value)
    same = {"optimiser": {"simulations": 7, "use_library": False}}
    same["table"] = {"x": [0.35, 1.05], "height": -0.125}
    foldcell.fold("small_towel", settings=same, logs=tmp_path)
    assert request.settings.as_yaml() == requests[1].settings.as_yaml()


@pytest.mark.parametrize(
    ("function", "arguments", "words"),
    [
        ("fold", {"garment": 3}, "garment: 3 is no path"),
        ("fold", {"garment": LATIN}, r"garment: the name 'sh\\udce9et.png' is no UTF-8"),
        ("fold", {"garment": "small_towel", "logs": LATIN}, "logs: the name"),
        ("fold", {"garment": "small_towel", "logs": ""}, "logs: '' is no path"),
        ("fold", {"garment": "small_towel", "logs": b"logs"}, "logs: b'logs' is no path"),
        ("fold", {"garment": "small_towel", "driver": None}, "driver: None is no text"),
        ("fold", {"garment": "small_towel", "record": "no"}, "record: 'no' is neither True nor False"),
        ("fold", {"garment": "small_towel", "settings": 5}, "settings: 5 is no path"),
        ("optimise", {"garment": "small_towel", "step": 1.5}, "step: 1.5 is no whole number"),
        ("optimise", {"garment": "small_towel", "budget": "9"}, "budget: '9' is no whole number"),
        ("optimise", {"garment": "small_towel", "method": 1}, "method: 1 is no text"),
        ("optimise", {"garment": None}, "garment: None is no path"),
        ("export", {"folds": [], "file": 1}, "file: 1 is no path"),
        ("export", {"folds": 1, "file": "a.csv"}, "folds: is no sequence of optimised folds"),
        ("export", {"folds": [None], "file": "a.csv"}, "folds: is no sequence of optimised folds"),
        ("load_run", {"run": 7}, "run: 7 is no path"),
        ("load_run", {"run": "last", "logs": 7}, "logs: 7 is no path"),
        ("load_run", {"run": "a\0b"}, r"run: the name 'a\\0b'"),
        ("perceive", {"rgb": LATIN}, "rgb: the name"),
        ("perceive", {"rgb": [[1]]}, "rgb: is a list"),
        ("perceive", {"rgb": None}, "rgb: is a NoneType"),
        ("perceive", {"rgb": np.zeros((0, 9, 3), np.uint8), "unit": "px"}, "rgb: holds uint8 of shape"),
        ("perceive", {"rgb": np.ma.masked_equal(np.zeros((9, 9, 3), np.uint8), 0)}, "rgb: is a MaskedArray"),
        ("perceive", {"rgb": np.zeros((480, 640, 3), np.uint8), "depth": [1.0]}, "depth: is a list"),
        ("perceive", {"rgb": np.zeros((480, 640, 3), np.uint8), "unit": 1}, "unit: 1 is no text"),
        ("perceive", {"rgb": np.zeros((480, 640, 3), np.uint8), "garment": 1}, "garment: 1 is no path"),
        ("new_garment", {"seen": None, "file": "a.yaml", "like": "jeans"}, "seen: is a NoneType"),
    ],
)
def test_arguments_of_a_wrong_kind_are_refused_by_name(
    function: str, arguments: dict[str, Any], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(foldcell.ConfigurationError, match=words) as error:
        getattr(foldcell, function)(**arguments)
    error.value.what.encode()  # the message itself can be written
    assert not journal_path(tmp_path).exists()


def seen_towel() -> foldcell.PerceivedGarment:
    corners = {"near_left": (0, 9), "near_right": (9, 9), "far_right": (9, 0), "far_left": (0, 0)}
    points = {name: np.array(p, float) for name, p in corners.items()}
    return foldcell.PerceivedGarment("small_towel", "towel", 0.9, (), "px", points, np.empty((0, 2)), None)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"length": "0.4", "between": ("near_left", "near_right")}, "length: '0.4' is no finite number"),
        ({"length": np.nan, "between": ("near_left", "near_right")}, "length: nan is no finite number"),
        ({"length": 0.4, "between": ("near_left", "near_right", "near_left")}, "between"),
        ({"length": 0.4, "between": (["near_left"], "near_right")}, "between"),
        ({"length": 0.4, "between": 4}, "between"),
        ({"length": 0.4, "between": ("near_left", "near_right"), "title": 5}, "title: 5 is no text"),
    ],
)
def test_new_garment_refuses_wrong_arguments(arguments: dict[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(foldcell.ConfigurationError, match=words):
        foldcell.new_garment(seen_towel(), tmp_path / "own.yaml", like="small_towel", **arguments)
    assert not list(tmp_path.iterdir())


def test_new_garment_accepts_numpys_scalars(tmp_path: Path) -> None:
    pairs = np.array(["near_left", "near_right"])
    one = foldcell.new_garment(
        seen_towel(), tmp_path / "own.yaml", like=np.str_("small_towel"), length=np.float64(0.4), between=pairs
    )
    text_with_scalars = one.read_text(encoding="utf-8")
    one.unlink()
    foldcell.new_garment(seen_towel(), one, like="small_towel", length=0.4, between=("near_left", "near_right"))
    assert one.read_text(encoding="utf-8") == text_with_scalars


def test_the_converters_return_plain_values(tmp_path: Path) -> None:
    assert type(whole(np.float64(2.0), "n")) is int and type(number(np.float32(0.5), "x")) is float
    assert type(flag(np.bool_(True), "f")) is bool and type(text(np.str_("a"), "t")) is str
    assert path(np.str_("a"), "p") == Path("a") and path(tmp_path, "p") == tmp_path


def test_loaded_settings_are_accepted(requests: list[FoldRequest], tmp_path: Path) -> None:
    settings = load_settings()
    foldcell.fold("small_towel", settings=settings, logs=tmp_path)
    assert requests[0].settings is settings


def test_every_public_function_has_its_own_numeric_state() -> None:
    functions = [getattr(foldcell, name) for name in foldcell.__all__ if name.islower()]
    methods = [value for name, value in vars(foldcell.Run).items() if inspect.isfunction(value) and name[0] != "_"]
    assert [f.__name__ for f in functions + methods if not hasattr(f, "__wrapped__")] == []


def test_the_callers_numeric_state_does_not_reach_a_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An underflow while grasping would otherwise end the run as a fault."""
    monkeypatch.setattr(folding, "fold_once", lambda request: (np.geterr(), np.exp(np.float64(-750.0))))
    default = {"divide": "warn", "over": "warn", "under": "ignore", "invalid": "warn"}
    with np.errstate(all="raise"):
        assert foldcell.fold("small_towel", logs=tmp_path) == (default, 0.0)
        assert set(np.geterr().values()) == {"raise"}
    with np.errstate(all="raise"), pytest.raises(foldcell.ConfigurationError):
        foldcell.fold("sock", logs=tmp_path)


@pytest.mark.long
def test_perceive_gives_the_same_result_in_any_numeric_state() -> None:
    picture = np.random.default_rng(0).normal(170, 2, (480, 640, 3)).clip(0, 255).astype(np.uint8)
    picture[120:345, 180:480] = (150, 90, 60)
    usual = foldcell.perceive(picture, unit="px")
    with np.errstate(all="raise"):
        strict = foldcell.perceive(picture, unit="px")
    assert usual.failure is None and strict.confidence == usual.confidence
    assert np.array_equal(strict.contour, usual.contour)
