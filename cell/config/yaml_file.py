"""Reading a YAML file of the user's into validated values, with errors that a person can act on.

Strict where YAML is lax: a key given twice is an error, only `true` and `false` are truth values, and
`1e-3` is a number. Every error names file and line, key, value, what is allowed, and often what was meant.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from robots.errors import ConfigurationError

__all__ = ["Document", "Key", "merge", "parse_yaml", "read_yaml", "validated"]

M = TypeVar("M", bound=BaseModel)
Key = tuple[str | int, ...]

LARGEST_FILE = 4 * 2**20
"""Bytes. No configuration of a cell is longer; what is longer is another kind of file."""


@dataclass(frozen=True)
class Document:
    """A YAML mapping as read: where it came from, its data, and the line of every key."""

    path: Path
    data: Mapping[str, Any]
    lines: Mapping[Key, int]

    def where(self, key: Key) -> str:
        """`cell.yaml:12`, or the path alone for a key that the file does not have."""
        while key and key not in self.lines:
            key = key[:-1]
        return f"{self.path}:{self.lines[key]}" if key else str(self.path)


def read_yaml(path: Path, what: str = "configuration file") -> Document:
    """Read one YAML mapping. Raises ConfigurationError for whatever is wrong with the file."""
    return parse_yaml(_read_text(path, what), path, what)


def parse_yaml(text: str, path: Path, what: str = "configuration file") -> Document:
    """One YAML mapping, from its text. path: where it stands, or what to call it. Raises ConfigurationError."""
    try:
        loader = _StrictLoader(text)
        try:
            node = loader.get_single_node()
            data = loader.construct_document(node) if node is not None else {}
        finally:
            loader.dispose()
        lines: dict[Key, int] = {}
        _note_lines(node, (), lines)
    except yaml.YAMLError as e:
        raise _syntax_error(path, what, e) from e
    except RecursionError as e:
        raise ConfigurationError(f"{path}: the {what} is nested too deep", path=str(path)) from e
    except (ValueError, OverflowError) as e:  # what only looks like a date or a number
        raise ConfigurationError(f"{path}: not a valid {what}: {e}", path=str(path)) from e
    if not isinstance(data, dict):
        raise ConfigurationError(
            f"{path}: a {what} is a list of 'key: value' lines, this holds {_shown(data)}", path=str(path)
        )
    return Document(path, data, lines)


def validated(document: Document, model: type[M], data: Mapping[str, Any] | None = None) -> M:
    """`data` (the document's own unless given) as a `model`. Raises ConfigurationError with every fault."""
    try:
        return model.model_validate(document.data if data is None else data)
    except ValidationError as e:
        _raise_configuration(document, model, e)


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with what `over` says instead, mapping by mapping; lists and values are replaced whole."""
    merged = dict(base)
    for key, value in over.items():
        old = merged.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(old, value) if both else value  # type: ignore[arg-type]
    return merged


# reading


class _StrictLoader(yaml.SafeLoader):
    """YAML 1.2's core schema instead of 1.1's surprises (`no`, `on`, `1:30`, dates), and unique keys."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: dict[Any, int] = {}
        for key_node, _ in node.value:
            line = key_node.start_mark.line + 1
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            if key is None:
                raise yaml.constructor.ConstructorError(
                    None, None, "a key has to be a plain word", key_node.start_mark
                )
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key '{key}' stands twice, first in line {seen[key]}", key_node.start_mark
                )
            seen[key] = line
        return super().construct_mapping(node, deep)


for _tag, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("null", r"~|null|Null|NULL|", "~nN\0"),
    ("int", r"[-+]?[0-9]+|0x[0-9a-fA-F]+", "-+0123456789"),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+.0123456789",
    ),
):
    for _c in _first:
        _StrictLoader.yaml_implicit_resolvers.setdefault("" if _c == "\0" else _c, []).append(
            (f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"))
        )
# `010` is ten to a person; YAML 1.1's constructor would read it as eight.
_StrictLoader.add_constructor(
    "tag:yaml.org,2002:int",
    lambda _, node: int(node.value, 16 if node.value.lower().startswith("0x") else 10),
)


def _read_text(path: Path, what: str) -> str:
    try:
        if path.is_dir():
            raise ConfigurationError(f"{path}: a {what} is expected, this is a folder", path=str(path))
        if path.stat().st_size > LARGEST_FILE:
            raise ConfigurationError(f"{path}: too long for a {what}", path=str(path))
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as e:
        raise ConfigurationError(f"{path}: there is no such {what}", _similar_file(path), path=str(path)) from e
    except UnicodeDecodeError as e:
        raise ConfigurationError(f"{path}: not a text file (UTF-8), so not a {what}", path=str(path)) from e
    except OSError as e:
        raise ConfigurationError(
            f"{path}: cannot read the {what}: {e.strerror}", "check the path and its permissions", path=str(path)
        ) from e


def _similar_file(path: Path) -> str:
    try:
        near = difflib.get_close_matches(path.name, [p.name for p in path.parent.iterdir()], 1)
    except OSError:
        return f"the folder {path.parent} does not exist"
    return f"did you mean {path.parent / near[0]}?" if near else "check the path"


def _syntax_error(path: Path, what: str, error: yaml.YAMLError) -> ConfigurationError:
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    where = f"{path}:{mark.line + 1}" if mark else str(path)
    return ConfigurationError(f"{where}: not a valid {what}: {problem}", path=str(path))


def _note_lines(node: yaml.Node | None, key: Key, lines: dict[Key, int], depth: int = 0) -> None:
    """Line numbers by key path. Aliases are followed a few levels only: a circle would never end."""
    if node is None or depth > 32:
        return
    if isinstance(node, yaml.MappingNode):
        for k, v in node.value:
            lines[(*key, k.value)] = k.start_mark.line + 1
            _note_lines(v, (*key, k.value), lines, depth + 1)
    elif isinstance(node, yaml.SequenceNode):
        for i, v in enumerate(node.value):
            lines[(*key, i)] = v.start_mark.line + 1
            _note_lines(v, (*key, i), lines, depth + 1)


# saying what is wrong


def _raise_configuration(document: Document, model: type[BaseModel], error: ValidationError) -> NoReturn:
    faults = error.errors(include_url=False)
    lines: list[str] = []
    hints: dict[str, list[str]] = {}
    for fault in faults:
        line, hint = _explain(document, model, fault)
        lines.append(line)
        if hint:
            hints.setdefault(hint, []).append(_dotted(fault["loc"]))
    said = [hint if len(faults) == 1 else f"{', '.join(keys)}: {hint}" for hint, keys in hints.items()]
    first = faults[0]
    raise ConfigurationError(
        "\n".join(lines),
        "\n  ".join(said),
        path=str(document.path),
        key=_dotted(first["loc"]),
        value=_shown(first["input"]),
    ) from None


def _explain(document: Document, model: type[BaseModel], fault: ErrorDetails) -> tuple[str, str]:
    """(what is wrong, hint) of one of pydantic's faults."""
    loc: Key = fault["loc"]
    where, key, value, kind = document.where(loc), _dotted(loc), fault["input"], fault["type"]
    owner, field = _field(model, loc)
    if kind == "extra_forbidden":
        return f"{where}: unknown key '{key}'", _known_keys(owner, str(loc[-1]))
    if kind == "missing" and isinstance(loc[-1], int):
        return f"{where}: {_dotted(loc[:-1])} = {_shown(value)}: has too few entries", _about(field)
    if kind == "missing":
        return f"{where}: the key '{key}' is missing", _about(field)
    if kind in {"model_type", "model_attributes_type", "dict_type"}:
        known = ", ".join(_names(owner)) if owner else ""
        return f"{where}: {key} = {_shown(value)}: a group of keys is expected", f"keys of '{key}': {known}"
    if kind == "value_error" and not _allowed(field):  # a rule over several keys says itself which
        return f"{where}: {_message(fault)}", ""
    allowed = _allowed(field) or _message(fault)
    hint = _unit_hint(field, value) or _number_hint(value) or _about(field)
    return f"{where}: {key} = {_shown(value)}: {allowed}", hint


def _dotted(loc: Sequence[str | int]) -> str:
    text = ""
    for part in loc:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _message(fault: ErrorDetails) -> str:
    text = fault["msg"].removeprefix("Value error, ")
    return text[:1].lower() + text[1:]


def _field(model: type[BaseModel], loc: Key) -> tuple[type[BaseModel] | None, FieldInfo | None]:
    """The model that owns the last named key of `loc` (or that `loc` names itself), and that key's field."""
    owner: type[BaseModel] | None = model
    field: FieldInfo | None = None
    for part in loc:
        if isinstance(part, int):
            continue
        found = _find(owner, part) if owner else None
        if found is None:
            return owner, None
        field = found
        owner = _inner_model(found.annotation) or owner
    return owner, field


def _find(owner: type[BaseModel], name: str) -> FieldInfo | None:
    for key, field in owner.model_fields.items():
        if name in (key, field.alias):
            return field
    return None


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in get_args(annotation):
        if found := _inner_model(inner):
            return found
    return None


def _names(owner: type[BaseModel]) -> list[str]:
    return [field.alias or name for name, field in owner.model_fields.items()]


def _known_keys(owner: type[BaseModel] | None, name: str) -> str:
    known = _names(owner) if owner else []
    near = difflib.get_close_matches(name, known, 1, cutoff=0.6)
    return (f"did you mean '{near[0]}'? " if near else "") + (f"known here: {', '.join(known)}" if known else "")


def _extra(field: FieldInfo | None) -> Mapping[str, Any]:
    extra = field.json_schema_extra if field else None
    return extra if isinstance(extra, dict) else {}


def _bounds(field: FieldInfo | None) -> tuple[float | None, float | None]:
    extra = _extra(field)
    if "range" in extra:
        low, high = extra["range"]
        return low, high
    low = high = None
    for rule in field.metadata if field else ():
        low, high = getattr(rule, "ge", low), getattr(rule, "le", high)
    return low, high


def _allowed(field: FieldInfo | None) -> str:
    low, high = _bounds(field)
    unit = str(_extra(field).get("unit", ""))
    unit = f" {unit}" if unit else ""
    if low is not None and high is not None:
        shape = _extra(field).get("shape", "allowed is")
        return f"{shape} {low:g} to {high:g}{unit}"
    if field and field.annotation is bool:
        return "allowed is true or false"
    choices = get_args(field.annotation) if field else ()
    if choices and all(isinstance(c, str) for c in choices):
        return "allowed is one of " + ", ".join(choices)
    return ""


def _about(field: FieldInfo | None) -> str:
    return field.description or "" if field else ""


def _unit_hint(field: FieldInfo | None, value: Any) -> str:
    """What was probably meant when a number is off by exactly a unit."""
    numbers = value if isinstance(value, list) else [value]
    if not numbers or any(isinstance(n, bool) or not isinstance(n, int | float) for n in numbers):
        return ""
    low, high = _bounds(field)
    if low is None or high is None:
        return ""

    def fits(scale: float) -> bool:
        return any(not low <= n <= high for n in numbers) and all(low <= n * scale <= high for n in numbers)

    unit = str(_extra(field).get("unit", ""))
    meant = {
        "m": (("centimetres", 0.01), ("millimetres", 0.001)),
        "rad": (("degrees", 0.017453292519943295),),
        "s": (("milliseconds", 0.001),),
        "m/s": (("millimetres per second", 0.001),),
    }.get(unit, ())
    # A length of several hundreds is millimetres even where centimetres would fit as well.
    if unit == "m" and max(abs(n) for n in numbers) >= 100:
        meant = (("millimetres", 0.001), ("centimetres", 0.01))
    for name, scale in meant:
        if fits(scale):
            suggestion = ", ".join(f"{n * scale:.4g}" for n in numbers)
            suggestion = f"[{suggestion}]" if isinstance(value, list) else suggestion
            about = _about(field)
            base = f"looks like {name}; in {unit} it is {suggestion}"
            return f"{base} ({about})" if about else base
    if unit == "m" and any(abs(n) >= 10 for n in numbers):
        about = _about(field)
        base = f"looks like millimetres: lengths are in metres, {numbers[0]:g} mm is {numbers[0] * 0.001:.4g}"
        return f"{base} ({about})" if about else base
    return ""


def _number_hint(value: Any) -> str:
    if isinstance(value, str) and re.match(r"^\s*[-+]?[0-9.]+\s*(mm|cm|m|deg|rad|s|N)\s*$", value):
        return "give the plain number, without a unit: metres, radians (degrees in a key ending in _deg), seconds"
    return ""
