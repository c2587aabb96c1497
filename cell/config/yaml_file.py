"""Read a user's YAML file into validated values.

The reader is stricter than YAML 1.1: a repeated key is an error, only `true` and `false` are truth values, and
`1e-3` is a number. Every error names file, line, key, value and the allowed values, and often suggests a
correction.

Every YAML file is read by this reader. Reading takes little time for any file, because size, depth and number of
values are limited. If an alias repeats a value, every repetition counts, because aliases of aliases can produce
billions of values from a short file.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn, TypeVar, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from foldcell.robots.errors import ConfigurationError

M = TypeVar("M", bound=BaseModel)
Key = tuple[str | int, ...]

LARGEST_FILE = 2**20
"""Maximum size of a file [bytes]. It is far above the size of any configuration of a cell."""
DEEPEST = 32
"""Maximum depth of nested lists and groups. A garment file has a depth of eight."""
MOST_VALUES = 20_000
"""Maximum number of keys and values, including those that aliases repeat. A garment file has about 300."""


@dataclass(frozen=True)
class Document:
    """A YAML mapping as read: its file, its data and the line number of every key."""

    path: Path
    data: Mapping[str, Any]
    lines: Mapping[Key, int]

    def where(self, key: Key) -> str:
        """Return the location of a key, as in `cell.yaml:12`. If the key is not in the file, the location of its
        nearest enclosing key is returned, or the path alone."""
        while key and key not in self.lines:
            key = key[:-1]
        return f"{self.path}:{self.lines[key]}" if key else str(self.path)


def read_yaml(path: Path, what: str = "configuration file") -> Document:
    """Read one YAML mapping from a file. Raises ConfigurationError if it is unreadable or malformed."""
    return parse_yaml(read_text(path, what), path, what)


def parse_yaml(text: str, path: Path, what: str = "configuration file") -> Document:
    """Parse one YAML mapping. path: file name for error messages. Raises ConfigurationError."""
    try:
        try:
            node, data = _loaded(_FastLoader(text))
        except yaml.YAMLError:
            node, data = _loaded(_Loader(text))
        lines: dict[Key, int] = {}
        _note_lines(node, (), lines)
    except yaml.YAMLError as e:
        raise _syntax_error(path, what, e) from e
    if not isinstance(data, dict):
        raise ConfigurationError(
            f"{path}: a {what} is a list of 'key: value' lines; this file contains {shown(data)}", path=str(path)
        )
    return Document(path, data, lines)


def validated(
    document: Document,
    model: type[M],
    data: Mapping[str, Any] | None = None,
    renamed: Mapping[str, str] = MappingProxyType({}),
) -> M:
    """Validate `data` (default: the document's data) as a `model`.

    renamed: former key with its groups, as in `motion.state_age` -> present name of its last part. Raises a
    ConfigurationError that lists every fault.
    """
    try:
        return model.model_validate(document.data if data is None else data)
    except ValidationError as e:
        _raise_configuration(document, model, e, renamed)


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` overridden by `over`. Mappings are merged recursively; lists and scalar values are
    replaced."""
    merged = dict(base)
    for key, value in over.items():
        old = merged.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(old, value) if both else value  # type: ignore[arg-type]
    return merged


# reading


class _TooLarge(yaml.MarkedYAMLError):
    """The file exceeds DEEPEST or MOST_VALUES. note: advice to the user."""


@dataclass(frozen=True)
class _Extent:
    """Size of a node: the number of its values, including those that aliases repeat, and their depth of
    nesting."""

    values: int
    depth: int


def _children(node: yaml.Node | None) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [child for pair in node.value for child in pair]
    return list(node.value) if isinstance(node, yaml.SequenceNode) else []


class _Strict(yaml.composer.Composer, yaml.constructor.SafeConstructor, yaml.resolver.Resolver):
    """Loads YAML 1.2's core schema and requires unique keys. In YAML 1.1, `no`, `on`, `1:30` and dates would be
    read as other types."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012
    yaml_constructors = {  # noqa: RUF012
        tag: yaml.SafeLoader.yaml_constructors[tag]
        for tag in (
            None,
            *(f"tag:yaml.org,2002:{name}" for name in ("map", "seq", "str", "bool", "null", "float")),
        )
    }

    def __init__(self) -> None:
        yaml.composer.Composer.__init__(self)
        yaml.constructor.SafeConstructor.__init__(self)
        yaml.resolver.Resolver.__init__(self)
        self._depth = 0
        self._values = 0
        self._complete: dict[int, _Extent] = {}
        """Extent of each complete node, by the node's id."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[attr-defined]
        mark = event.start_mark
        if isinstance(event, yaml.AliasEvent):
            node = super().compose_node(parent, index)
            extent = self._complete.get(id(node))
            if extent is None:
                what = f"the alias *{event.anchor} stands inside of what it repeats"
                raise _TooLarge(problem=what, problem_mark=mark, note="write the values out")
            self._check_depth(extent.depth, mark)
            self._count(extent.values, mark)
            return node
        self._check_depth(1, mark)
        self._count(1, mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        inside = [self._complete[id(child)] for child in _children(node)]
        self._complete[id(node)] = _Extent(
            1 + sum(extent.values for extent in inside), 1 + max((extent.depth for extent in inside), default=0)
        )
        return node

    def _check_depth(self, depth: int, mark: yaml.Mark) -> None:
        if self._depth + depth > DEEPEST:
            raise _TooLarge(
                problem=f"nested too deep: more than {DEEPEST} lists and groups inside each other",
                problem_mark=mark,
                note="close the brackets, or correct the indentation",
            )

    def _count(self, values: int, mark: yaml.Mark) -> None:
        self._values += values
        if self._values > MOST_VALUES:
            raise _TooLarge(
                problem=f"more than {MOST_VALUES} values, where a value that an alias repeats counts each time",
                problem_mark=mark,
                note="write the values out instead of aliases of aliases, and keep only what the file needs",
            )

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Construct a value. An error in a number or a truth value gets the line of the value, and so does a text
        that cannot be written as UTF-8 (the escape `"\\uDCE9"`)."""
        try:
            if isinstance(node, yaml.ScalarNode):
                node.value.encode()
            return super().construct_object(node, deep)
        except (ValueError, OverflowError, KeyError) as e:
            raise yaml.constructor.ConstructorError(
                None,
                None,
                f"{shown(node.value)} is not a value of the kind {node.tag.rpartition(':')[2]}",
                node.start_mark,
            ) from e

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
                    None,
                    None,
                    f"the key '{key}' is repeated; its first use is in line {seen[key]}",
                    key_node.start_mark,
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
        _Strict.yaml_implicit_resolvers.setdefault("" if _c == "\0" else _c, []).append(
            (f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"))
        )
# `010` is ten. The constructor of YAML 1.1 would read it as octal eight.
_Strict.add_constructor(
    "tag:yaml.org,2002:int",
    lambda _, node: int(node.value, 16 if node.value.lower().startswith("0x") else 10),
)


class _Loader(_Strict, yaml.SafeLoader):
    """Parses in Python."""

    def __init__(self, text: str) -> None:
        yaml.SafeLoader.__init__(self, text)
        _Strict.__init__(self)


_Parser: Any = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader


class _FastLoader(_Strict, _Parser):
    """Parses with libyaml, which is faster, but whose messages say less about the cause of an error."""

    def __init__(self, text: str) -> None:
        _Parser.__init__(self, text)
        _Strict.__init__(self)


def _loaded(loader: Any) -> tuple[yaml.Node | None, Any]:
    """Return the document's node, None for an empty one, and its value."""
    try:
        node = loader.get_single_node()
        return node, loader.construct_document(node) if node is not None else {}
    finally:
        loader.dispose()


def read_text(path: Path, what: str) -> str:
    try:
        if path.is_dir():
            raise ConfigurationError(f"{path}: this is a folder; a {what} is expected", path=str(path))
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise ConfigurationError(
                f"{path}: the file has {size} bytes; a {what} has at most {LARGEST_FILE}",
                "check that this is the right file",
                path=str(path),
            )
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
        if len(data) > LARGEST_FILE:  # a device without an end states no size
            raise ConfigurationError(
                f"{path}: has no end; a {what} is expected", "check that this is the right file", path=str(path)
            )
        return data.decode("utf-8")
    except FileNotFoundError as e:
        raise ConfigurationError(f"{path}: there is no such {what}", _similar_file(path), path=str(path)) from e
    except UnicodeDecodeError as e:
        raise ConfigurationError(
            f"{path}: the file is not UTF-8 text, so it is not a {what}", path=str(path)
        ) from e
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
    hint = error.note or "" if isinstance(error, _TooLarge) else ""
    return ConfigurationError(f"{where}: not a valid {what}: {problem}", hint, path=str(path))


def _note_lines(node: yaml.Node | None, key: Key, lines: dict[Key, int]) -> None:
    """Record the line number of every key. The loader has already limited the size of the document."""
    if isinstance(node, yaml.MappingNode):
        for k, v in node.value:
            lines[(*key, k.value)] = k.start_mark.line + 1
            _note_lines(v, (*key, k.value), lines)
    elif isinstance(node, yaml.SequenceNode):
        for i, v in enumerate(node.value):
            lines[(*key, i)] = v.start_mark.line + 1
            _note_lines(v, (*key, i), lines)


# error messages


def _raise_configuration(
    document: Document, model: type[BaseModel], error: ValidationError, renamed: Mapping[str, str]
) -> NoReturn:
    faults = error.errors(include_url=False)
    lines: list[str] = []
    hints: dict[str, list[str]] = {}
    for fault in faults:
        line, hint = _explain(document, model, fault, renamed)
        lines.append(line)
        if hint:
            hints.setdefault(hint, []).append(dotted(_key(fault)))
    hint_lines = [hint if len(faults) == 1 else f"{', '.join(keys)}: {hint}" for hint, keys in hints.items()]
    first = faults[0]
    raise ConfigurationError(
        "\n".join(lines),
        "\n  ".join(hint_lines),
        path=str(document.path),
        key=dotted(_key(first)),
        value=shown(first["input"]),
    ) from None


def _explain(
    document: Document, model: type[BaseModel], fault: ErrorDetails, renamed: Mapping[str, str]
) -> tuple[str, str]:
    """Return (message, hint) for one fault that pydantic reports."""
    loc = _key(fault)
    where, key, value, kind = document.where(loc), dotted(loc), fault["input"], fault["type"]
    owner, field = _field(model, loc)
    if kind == "extra_forbidden" and key in renamed:
        return f"{where}: unknown key '{key}'", f"it was renamed to '{renamed[key]}'"
    if kind == "extra_forbidden":
        return f"{where}: unknown key '{key}'", _known_keys(owner, str(loc[-1]))
    if kind == "missing" and isinstance(loc[-1], int):
        return f"{where}: {dotted(loc[:-1])} = {shown(value)}: has too few entries", _about(field)
    if kind == "missing":
        return f"{where}: the key '{key}' is missing", _about(field)
    if kind in {"model_type", "model_attributes_type", "dict_type"}:
        known = ", ".join(_names(owner)) if owner else ""
        return f"{where}: {key} = {shown(value)}: a group of keys is expected", f"keys of '{key}': {known}"
    if kind == "rule":
        return f"{where}: {key}: {_message(fault)}", ""
    if kind == "value_error" and not _allowed(field):  # the message of a rule over several keys names these keys
        return f"{where}: {_message(fault)}", ""
    choices = [choice for choice in (get_args(field.annotation) if field else ()) if isinstance(choice, str)]
    allowed = did_you_mean(value, choices) + (_allowed(field) or _message(fault))
    hint = _unit_hint(field, value) or _number_hint(value) or _about(field)
    return f"{where}: {key} = {shown(value)}: {allowed}", hint


def dotted(loc: Sequence[str | int]) -> str:
    """Format a key as people write it, as in `plan[0].line`."""
    text = ""
    for part in loc:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def shown(value: Any) -> str:
    """Format a value for a message, shortened to 60 characters."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def rule_broken(text: str, *key: str | int) -> PydanticCustomError:
    """Make the error of a rule that concerns several keys. key: where the rule is broken, from the group on whose
    validator raises it."""
    return PydanticCustomError("rule", "{text}", {"text": text, "key": key})


def _key(fault: ErrorDetails) -> Key:
    loc = (*fault["loc"], *fault.get("ctx", {}).get("key", ()))
    return tuple(part for part in loc if part != "[key]")  # pydantic adds "[key]" to an error in a name


def _message(fault: ErrorDetails) -> str:
    text = fault["msg"].removeprefix("Value error, ")
    return text[:1].lower() + text[1:]


def _field(model: type[BaseModel], loc: Key) -> tuple[type[BaseModel] | None, FieldInfo | None]:
    """Return the model that owns the last named key of `loc`, and the field of that key. If `loc` names a group,
    the returned model is that group."""
    owner: type[BaseModel] | None = model
    field: FieldInfo | None = None
    for part in loc:
        if isinstance(part, int):
            continue
        found = _find(owner, part) if owner else None
        if found is None:  # a name that the file chooses has the meaning of its table
            return owner, field if field and get_origin(field.annotation) is dict else None
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


def did_you_mean(value: Any, known: Sequence[str]) -> str:
    """Return a question that names the known word that is nearest to a value; empty if none is near."""
    near = difflib.get_close_matches(str(value), known, 1, cutoff=0.6)
    return f"did you mean '{near[0]}'? " if near else ""


def _known_keys(owner: type[BaseModel] | None, name: str) -> str:
    known = _names(owner) if owner else []
    return did_you_mean(name, known) + (f"known here: {', '.join(known)}" if known else "")


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
        return f"{shape} {low:g}{unit}" if low == high else f"{shape} {low:g} to {high:g}{unit}"
    if field and field.annotation is bool:
        return "allowed is true or false"
    choices = get_args(field.annotation) if field else ()
    if choices and all(isinstance(c, str) for c in choices):
        return "allowed is one of " + ", ".join(choices)
    return ""


def _about(field: FieldInfo | None) -> str:
    return field.description or "" if field else ""


def _unit_hint(field: FieldInfo | None, value: Any) -> str:
    """Return a hint for a number that would be in range in another unit, or an empty text."""
    numbers = value if isinstance(value, list) else [value]
    if not numbers or any(isinstance(n, bool) or not isinstance(n, int | float) for n in numbers):
        return ""
    low, high = _bounds(field)
    if low is None or high is None:
        return ""

    def fits(scale: float) -> bool:
        return any(not low <= n <= high for n in numbers) and all(low <= n * scale <= high for n in numbers)

    unit = str(_extra(field).get("unit", ""))
    units = {
        "m": (("centimetres", 0.01), ("millimetres", 0.001)),
        "rad": (("degrees", 0.017453292519943295),),
        "s": (("milliseconds", 0.001),),
        "m/s": (("millimetres per second", 0.001),),
    }.get(unit, ())
    # A length of 100 or more is taken for millimetres, even where centimetres would be in range.
    if unit == "m" and max(abs(n) for n in numbers) >= 100:
        units = (("millimetres", 0.001), ("centimetres", 0.01))
    for name, scale in units:
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
        return "give a plain number, without a unit: metres, radians (degrees if the key ends in _deg), seconds"
    return ""
