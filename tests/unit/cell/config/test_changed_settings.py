"""Settings that differ from the shipped ones."""

from __future__ import annotations

from pathlib import Path

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.changed_settings import changed_settings, differing


def test_the_shipped_settings_differ_in_nothing() -> None:
    assert changed_settings(load_settings(), load_settings()) == ({}, {})


def test_only_keys_whose_values_differ_are_listed_with_both_values(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    same = load_settings().motion.velocity_scale
    path.write_text(
        f"table: {{x: [0.25, 0.9]}}\nmotion: {{tool_speed: 0.11, velocity_scale: {same}}}\nsurface: felt\n",
        encoding="utf-8",
    )
    shipped = load_settings()
    own, default = changed_settings(load_settings(path), shipped)
    assert own == {"table": {"x": [0.25, 0.9]}, "motion": {"tool_speed": 0.11}, "surface": "felt"}
    assert default == {
        "table": {"x": list(shipped.table_.x)}, "motion": {"tool_speed": shipped.motion.tool_speed},
        "surface": shipped.surface,
    }  # fmt: skip


def test_a_key_that_one_side_lacks_differs() -> None:
    assert differing({"a": {"b": None, "c": 1}}, {"a": {"c": 1}}) == {"a": {"b": None}}
    assert differing({"a": 1}, {"a": {"c": 1}}) == {"a": 1}
