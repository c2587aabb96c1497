"""YAML texts that are small and stand for much."""

from __future__ import annotations


def aliases_of_aliases(kind: str = "list", levels: int = 4, count: int = 10) -> str:
    """A short text that stands for count ** (levels + 1) values: each line repeats the one before."""
    lines = []
    for k in range(levels + 1):
        values = [f"*a{k - 1}" if k else "1"] * count
        inside = ", ".join(f"k{i}: {v}" for i, v in enumerate(values)) if kind == "group" else ", ".join(values)
        lines.append(f"a{k}: &a{k} {{{inside}}}" if kind == "group" else f"a{k}: &a{k} [{inside}]")
    return "\n".join(lines) + "\n"
