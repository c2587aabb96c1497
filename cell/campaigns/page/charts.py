"""Draw charts as SVG: strips of dots, one dot per run, and success rates with their intervals."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from html import escape

from markupsafe import Markup

WIDTH, LABEL, ROW, AXIS, RIGHT = 760, 200, 26, 30, 20
TICKS = 5
LONGEST = 26
"""Number of characters for which a label has room."""


def strip_chart(groups: Mapping[str, Sequence[tuple[float, bool]]], unit: str, about: str) -> Markup | None:
    """Draw one row per group, with one mark per run (value, success): a dot for a success, a cross for a failure.
    A line marks the median.

    Returns None if there is no value. unit: unit on the axis; about: text for people who do not see the picture.
    """
    values = [value for dots in groups.values() for value, _ in dots]
    if not values:
        return None
    low, high, step = axis(min(values), max(values))
    rows = []
    for n, (name, dots) in enumerate(groups.items()):
        y = ROW * n + ROW / 2
        rows.append(_label(name, y))
        for k, (value, good) in enumerate(dots):
            spread = ((k * 0.618034) % 1.0 - 0.5) * 0.5 * ROW  # equal values stay apart and can be counted
            kind = "good" if good else "bad"
            shape = _circle(_x(value, low, high), y + spread) if good else _cross(_x(value, low, high), y + spread)
            rows.append(f'<g class="{kind}">{shape}<title>{escape(name)}: {value:.4g} {unit}</title></g>')
        if dots:
            at = _x(statistics.median(value for value, _ in dots), low, high)
            rows.append(f'<path class="median" d="M{at:.1f} {y - 11:.1f} v22"/>')
    return _svg(rows, len(groups), low, high, step, unit, about)


def rate_chart(rates: Mapping[str, tuple[float, float, float]], about: str) -> Markup | None:
    """Draw one row per group. rates: the success rate of each group, and the lower and upper end of its interval,
    each from 0 to 1."""
    if not rates:
        return None
    rows = []
    for n, (name, (rate, low, high)) in enumerate(rates.items()):
        y, at = ROW * n + ROW / 2, _x(100.0 * rate, 0.0, 100.0)
        left, right = _x(100.0 * low, 0.0, 100.0), _x(100.0 * high, 0.0, 100.0)
        rows.append(_label(name, y))
        rows.append(f'<path class="interval" d="M{left:.1f} {y:.1f} H{right:.1f} M{left:.1f} {y - 5:.1f} v10 '
                    f'M{right:.1f} {y - 5:.1f} v10"/><g class="rate">{_circle(at, y, 4.5)}</g>')  # fmt: skip
    return _svg(rows, len(rates), 0.0, 100.0, 20.0, "%", about)


def axis(low: float, high: float) -> tuple[float, float, float]:
    """Return the first tick, the last tick and the step of an axis with round ticks that contains low and high."""
    span = max(high - low, 1e-9, 0.02 * max(abs(low), abs(high)))
    power = 10.0 ** math.floor(math.log10(span / TICKS))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power * TICKS >= span)
    first, last = math.floor(low / step) * step, math.ceil(high / step) * step
    return first, max(last, first + step), step


def _svg(rows: list[str], count: int, low: float, high: float, step: float, unit: str, about: str) -> Markup:
    bottom = ROW * count + 4
    ticks = []
    for k in range(round((high - low) / step) + 1):
        value = low + k * step
        x = _x(value, low, high)
        label = f"{value:.4g} {unit}" if k == 0 else f"{value:.4g}"
        ticks.append(f'<path class="grid" d="M{x:.1f} 0 V{bottom}"/>')
        ticks.append(f'<text x="{x:.1f}" y="{bottom + 16}" text-anchor="middle">{label}</text>')
    height = bottom + AXIS
    return Markup(
        f'<svg class="chart" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{escape(about)}">'
        + "".join(ticks) + "".join(rows) + "</svg>"
    )  # fmt: skip


def _x(value: float, low: float, high: float) -> float:
    return LABEL + (value - low) / (high - low) * (WIDTH - LABEL - RIGHT)


def _label(name: str, y: float) -> str:
    """Return the label of a row. A longer name is shortened, and its title has the whole."""
    shown = name if len(name) <= LONGEST else name[: LONGEST - 1] + "…"
    whole = f"<title>{escape(name)}</title>" if shown != name else ""
    return f'<text x="{LABEL - 12}" y="{y + 4:.1f}" text-anchor="end">{whole}{escape(shown)}</text>'


def _circle(x: float, y: float, r: float = 3.5) -> str:
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r}"/>'


def _cross(x: float, y: float) -> str:
    return f'<path d="M{x - 3.5:.1f} {y - 3.5:.1f} l7 7 m0 -7 l-7 7"/>'
