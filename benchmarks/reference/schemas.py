"""The pages of files: cell.yaml, garment files, scripts, campaigns and the result of a run, from their types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml
from pydantic import TypeAdapter

from benchmarks.reference.markdown import cell, table
from foldcell.cell.campaigns.hil.script import Script
from foldcell.cell.campaigns.trials.campaign import CampaignFile
from foldcell.cell.config.cell_settings import CellSettings, default_settings_path
from foldcell.cell.config.garments.garment_file import AVERAGE, _GarmentFile
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.states.commands import OPERATOR_EVENTS

Schema = Mapping[str, Any]
PART = "PART"
"""Stands for the word before the name of a part in the anchor of its heading."""


def pages() -> dict[str, str]:
    """Return the pages: file name -> Markdown."""
    defaults = yaml.safe_load(default_settings_path().read_text(encoding="utf-8"))
    settings = CellSettings.model_json_schema()
    groups = settings["$defs"]
    for name, value in defaults.items():
        group = settings["properties"][name].get("$ref", "").rpartition("/")[2]
        for key, default in value.items() if group else ():
            groups[group]["properties"][key]["default"] = default
        if not group:
            settings["properties"][name]["default"] = value
    average = ", ".join(f"{key} {value:g}" for key, value in AVERAGE.items())
    return {
        "settings.md": _page(
            "Settings: `cell.yaml`",
            "Your file needs only the keys that differ from the shipped ones, `cell/config/cell.yaml`:"
            " `foldcell fold small_towel --cell mine.yaml`. Lengths are in metres, angles in radians unless a key"
            " ends in `_deg`, times in seconds, forces in newtons. An unknown key is an error.",
            settings,
            "group",
        ),
        "garment_file.md": _page(
            "The garment file",
            "One YAML file makes a garment; no code is needed. `foldcell garment new ...` makes one from a"
            " photograph, `foldcell garment check FILE` checks and predicts it. Lengths are in metres, angles in"
            f" degrees. A fabric of which nothing is stated has: {average}.",
            _GarmentFile.model_json_schema(),
            "part",
        ),
        "script.md": _page(
            "Scripts and their words",
            "What a script of `foldcell hil SCRIPT...` may say ([how to write one](../do/scripts.md)).",
            _spoken(Script.model_json_schema()),
            "part",
        ),
        "campaign.md": _page(
            "The campaign file",
            "What a file for `foldcell trials FILE` may say ([campaigns](../do/campaigns.md)). Its actions are"
            " those of [scripts](script.md).",
            _without(CampaignFile.model_json_schema(), Script.model_json_schema()),
            "part",
        ),
        "result.md": _page(
            "The result of a run",
            "What `foldcell fold small_towel --json` prints as its last line, `result.json` in the run's folder"
            " has, and `foldcell.fold` returns. A figure that was not measured is null.",
            TypeAdapter(RunRecord).json_schema(mode="serialization"),
            "part",
        ),
    }


def _spoken(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a script, with the events that an operator can say."""
    said = {"Event": {"enum": sorted(OPERATOR_EVENTS)}}
    return schema | {"$defs": schema["$defs"] | said}


def _without(schema: dict[str, Any], other: Schema) -> dict[str, Any]:
    """Return the schema without the parts that the other one has."""
    return schema | {"$defs": {name: part for name, part in schema["$defs"].items() if name not in other["$defs"]}}


def _page(title: str, about: str, schema: Schema, word: str) -> str:
    """Write the page of a type."""
    parts = {_plain(name): part for name, part in schema.get("$defs", {}).items()}
    lines = [f"# {title}", "", about, *_part(schema, top=True)]
    for name, part in parts.items():
        lines += ["", f"## {word.capitalize()} {name}", *_part(part)]
    made = "`python -m benchmarks.reference` writes this page from the program."
    text = "\n".join([*lines, "", made, ""])
    for name in parts:
        text = text.replace(f"(#{PART}-{_anchor(name)})", f"(#{word}-{_anchor(name)})")
    return text.replace(f"(#{PART}-", "(script.md#part-")  # what is explained there is not explained again


def _part(part: Schema, top: bool = False) -> list[str]:
    about = [] if top else _prose(part.get("description", ""))
    if "enum" in part:
        return ["", ", ".join(f"`{value}`" for value in part["enum"]) + "."]
    rows = [
        (f"`{key}`", _kind(value), _default(value), cell(_about(value)))
        for key, value in part.get("properties", {}).items()
    ]
    heads = ["key", "value", "default", "meaning"]
    if not any(row[3] for row in rows):
        heads, rows = heads[:3], [row[:3] for row in rows]  # type: ignore[misc]
    return [*about, "", *table(heads, rows)]


def _prose(text: str) -> list[str]:
    return [line for paragraph in text.split("\n\n") for line in ("", " ".join(paragraph.split()))] if text else []


def _about(value: Schema) -> str:
    unit = value.get("unit", "")
    return value.get("description", "") + (f" [{unit}]" if unit else "")


def _default(value: Schema) -> str:
    if "default" not in value or "$ref" in value:
        return ""
    default = value["default"]
    text = yaml.safe_dump(default, default_flow_style=True, width=1000).strip().removesuffix("\n...").strip()
    return f"`{text}`"


def _kind(value: Schema) -> str:
    """Return the type of a value in words."""
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(_kind(one) for one in value["anyOf"]))
    if "$ref" in value:
        name = _plain(value["$ref"].rpartition("/")[2])
        return f"[{name}](#{PART}-{_anchor(name)})"
    if "enum" in value or "const" in value:
        return ", ".join(f"`{one}`" for one in value.get("enum", [value.get("const")]))
    kind = value.get("type", "any")
    if kind == "array":
        items = value.get("prefixItems") or [value.get("items", {})]
        each = " and ".join(dict.fromkeys(_kind(one) for one in items))
        return f"{len(items)} x {each}" if "prefixItems" in value else f"list of {each}"
    if kind == "object":
        inner = value.get("additionalProperties")
        return f"name: {_kind(inner)}" if isinstance(inner, dict) else "keys and values"
    low, high = value.get("minimum", value.get("exclusiveMinimum")), value.get("maximum")
    words = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}
    span = "" if low is None else f" from {low}" if high is None else f" {low} to {high}"
    return words.get(kind, kind) + span.replace(".0 ", " ").removesuffix(".0")


def _anchor(name: str) -> str:
    return name.replace(" ", "-")


def _plain(name: str) -> str:
    """Return the name of a type as words."""
    name = name.strip("_").removesuffix("Config").removesuffix("File").removesuffix("Spec")
    return "".join(f" {c.lower()}" if c.isupper() else c for c in name).strip().replace("  ", " ")
