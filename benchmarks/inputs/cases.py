"""Strategies for random cases: a command line, damaged files, and surroundings."""

from __future__ import annotations

import argparse
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import yaml
from hypothesis import strategies as st

from benchmarks.inputs.samples import KINDS, ODD
from foldcell.cell.commands.main import build_parser
from foldcell.cell.config.garments.garment_file import list_garments


@dataclass(frozen=True)
class Damage:
    """A change of one sample. kind: of the sample; how: name of the change; seed: decides its place and value."""

    kind: str
    how: str
    seed: int

    def __call__(self, data: bytes) -> bytes:
        return DAMAGES[self.how](data, random.Random(self.seed))


@dataclass(frozen=True)
class Case:
    """One call of the program. words: of the command line; damages: changes of files; environment: variables that
    are set, or unset (None); stdin, stdout: what the streams are."""

    words: tuple[str, ...]
    damages: tuple[Damage, ...]
    environment: tuple[tuple[str, str | None], ...]
    stdin: str
    stdout: str


NUMBERS = (
    "0", "1", "2", "3", "7", "100", "-1", "-0", "+1", "1.5", "0.3", "0.04", "60", "nan", "inf", "-inf", "1e3",
    "1e400", "1_0", " 1", "0x10", "", "x", "10000", "65535", "65536", "2147483647", "2147483648", "9" * 30,
    "9" * 5000, "١٢", "²",
)  # fmt: skip
TEXTS = (
    "", " ", ".", "..", "/", "-", "--", "x", "a b", "'", '"', "a\nb", "\t", "Größe", "衣服", "\U0001f9e5",
    "\udce9", "a" * 300, "../../etc/passwd", "~", "$HOME", "%s%n", "{}", "a,b", ",", "near_left,near_right",
    "near_left,near_left", "/dev/null", "/dev/full", "/proc/self/mem", "http://localhost:9000", "tcp://127.0.0.1:1",
    "[::1]:80", "a/b", "1", "nul", "yes",
)  # fmt: skip
VALUES: tuple[object, ...] = (
    None, True, 0, -1, 1, 3, 10**30, 1.5, -0.2, float("nan"), float("inf"), 1e308, "", "x", "1", "0.3",
    "near_left", "my_towel.yaml", "é", "a" * 1000, "\u202e", [], [0, 0], [1.0, "a"], [[]], {}, {"a": 1}, {1: 2},
    [0.1, 0.2, 0.3],
)  # fmt: skip


def _places(value: object, to: tuple[object, ...] = ()) -> Iterator[tuple[object, ...]]:
    if to:
        yield to
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from _places(inner, (*to, key))


def _another_value(data: bytes, rng: random.Random) -> bytes:
    """Replace, remove or add a value anywhere in a YAML or JSON document."""
    try:
        document = yaml.safe_load(data)
    except (yaml.YAMLError, UnicodeDecodeError):
        return _flipped(data, rng)
    places = list(_places(document))
    if not places:
        return data
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        *path, last = rng.choice(places)
        inner = document
        try:
            for key in path:
                inner = inner[key]
            how = rng.randrange(4)
            if how == 0:
                del inner[last]
            elif how == 1 and isinstance(inner, dict):
                inner[rng.choice(("x", 1, "title", "seed", "\n"))] = inner[last]
            else:
                inner[last] = rng.choice(VALUES)
        except (KeyError, IndexError, TypeError):  # an earlier change has removed it
            continue
    return yaml.safe_dump(document, allow_unicode=rng.random() < 0.5).encode(errors="replace")


def _flipped(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data or b"x")
    for _ in range(rng.choice((1, 3, 30))):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    return bytes(changed)


def _inserted(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    text = rng.choice(
        ("\t", "\n\n", "{", "]", ":", "&a ", "*a", "!!python/object:os.system ", "\0", "\ufeff", "- ", "\x1b[2J")
    )
    return data[:at] + text.encode() + data[at:]


DAMAGES: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "value": _another_value,
    "value again": _another_value,
    "flipped": _flipped,
    "inserted": _inserted,
    "cut": lambda data, rng: data[: rng.randrange(len(data) + 1)],
    "twice": lambda data, rng: data + data,
    "empty": lambda data, rng: b"",
    "swapped": lambda data, rng: bytes(reversed(data)),
    "utf-16": lambda data, rng: data.decode("utf-8", "replace").encode("utf-16"),
}
FILES = tuple(kind for kind in KINDS if kind not in ("logs", "trials"))


def _leaves(
    parser: argparse.ArgumentParser, to: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], argparse.ArgumentParser]]:
    groups = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if not groups:
        yield to, parser
    for group in groups:
        for name, inner in group.choices.items():
            yield from _leaves(inner, (*to, name))


LEAVES = tuple(_leaves(build_parser()))
GARMENTS = (*list_garments(), "auto", "all", "medium_towl", "")
EXPECTED = {
    "image": ("picture", "jpeg"), "reference": ("picture",), "depth": ("depth",), "reference_depth": ("depth",),
    "cell": ("cell",), "scripts": ("script",), "file": ("campaign",), "key_points": ("points",),
    "resume": ("trials",), "logs": ("logs",), "first": ("trials",), "second": ("trials",), "keep": ("journal",),
    "faults": ("campaign",),
}  # fmt: skip
"""Name of an argument -> the kinds of sample that it expects."""


def _file(*kinds: str) -> st.SearchStrategy[str]:
    right = st.sampled_from([KINDS[kind] for kind in kinds or KINDS])
    wrong = st.sampled_from([*KINDS.values(), *ODD])
    return st.one_of(right, right, right, wrong, st.sampled_from(TEXTS))


def _value(action: argparse.Action, run: str) -> st.SearchStrategy[str]:
    """Return a strategy for the value of an argument: mostly of its own kind."""
    kind, name = getattr(action.type, "__name__", ""), action.dest
    if action.choices:
        right = st.sampled_from([str(choice) for choice in action.choices])
        return st.one_of(right, right, right, st.sampled_from(TEXTS))
    if name in ("garment", "garments", "like"):
        known = st.sampled_from(GARMENTS)
        return st.one_of(known, known, _file("garment"))
    if kind in ("Path", "folder"):
        if name in ("output", "export", "draw", "junit", "into"):
            new = st.sampled_from(
                ["new.yaml", "new.json", "new.png", "new.csv", "new", "folder", "folder/new.txt"]
            )
            return st.one_of(new, new, _file())
        return _file(*EXPECTED.get(name, ()))
    if kind in ("seed", "count", "port", "float", "_hours"):
        return st.sampled_from(NUMBERS)
    if name == "name":
        return st.one_of(st.sampled_from(["last", run, run[:9], f"logs/{run}"]), _file("logs"))
    return st.one_of(st.sampled_from(TEXTS), st.text(max_size=12).filter(lambda text: "\0" not in text))


ENVIRONMENT = {
    "FOLDCELL_LOGS": ("logs", "logs", "logs", "", "new logs", "empty", "dangling", "\udce9", "/proc/logs", None),
    "HOME": ("home", "no/such", "empty", None),
    "XDG_CACHE_HOME": ("", "empty", "relative", None),
    "XDG_DATA_HOME": ("", "empty", "relative", None),
    "ROS_MASTER_URI": (
        "http://localhost:1", "nonsense", "", "http://[", "http://localhost:99999", "http://a b:1",
        "http://\udce9:1", "http://a..b:1", None,
    ),
    "COLUMNS": ("0", "-3", "x", "20", None),
    "TERM": ("dumb", "", None),
    "LC_ALL": ("C", "nonsense", None),
    "NO_COLOR": ("1", None),
}  # fmt: skip


@st.composite
def cases(draw: st.DrawFn, run: str, leaf: int) -> Case:
    """Return a strategy for cases. run: id of a run in the samples' logs; leaf: index of the command in LEAVES."""
    name, parser = LEAVES[leaf]
    words = [*name]
    for action in parser._actions:
        if action.dest == "help":
            continue
        value = _value(action, run)
        if not action.option_strings:
            number = {"*": (0, 2), "?": (0, 1), "+": (1, 2)}.get(str(action.nargs), (1, 1))
            words += draw(st.lists(value, min_size=number[0], max_size=number[1]))
        elif draw(st.integers(0, 3)) == 0 or action.required:
            words += [action.option_strings[-1]] if action.nargs == 0 else [action.option_strings[-1], draw(value)]
    if draw(st.integers(0, 11)) == 0:
        words.insert(
            draw(st.integers(0, len(words))),
            draw(st.sampled_from(("--no-such", "-x", "--", "", "extra", "--json=1"))),
        )
    damage = st.builds(Damage, st.sampled_from(FILES), st.sampled_from(sorted(DAMAGES)), st.integers(0, 2**20))
    around = {key: draw(st.sampled_from(values)) for key, values in ENVIRONMENT.items()}
    return Case(
        tuple(words),
        tuple(draw(st.lists(damage, max_size=3))),
        tuple(around.items()),
        draw(st.sampled_from(("null", "null", "letters", "closed"))),
        draw(st.sampled_from(("file", "file", "file", "file", "full", "closed", "pipe"))),
    )
