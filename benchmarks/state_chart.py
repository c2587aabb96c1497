"""Draws the state chart with the `transitions` library into cell/states: `python -m benchmarks.state_chart`.

The report and the operator's page show it. `python -m benchmarks.reference` copies it into docs/pictures.

The chart leaves out the rows that apply to every working state (stop, crash, abort, pause, lost journal). The
colour of a state shows which state follows its failure. A legend below the chart explains both.
"""

from __future__ import annotations

import re
import sys
from importlib import import_module
from typing import Any

from transitions.extensions import GraphMachine

from foldcell.cell.states.state_chart import CHART
from foldcell.cell.states.transition_table import TERMINAL, TRANSITIONS, Event, State

ON_FAILURE = {
    State.RECOVERING: ("#2f6fd0", "#eaf1fb"),
    State.LAYING_BACK: ("#7d3c98", "#f4ecf7"),
    State.CLEARING: ("#c0392b", "#fbeceb"),
    State.CLEARING_AGAIN: ("#c0392b", "#f5d5d0"),
    State.MAKING_SAFE: ("#96600b", "#fdf2dc"),
}
"""State -> border and fill colour. The chart draws every state whose failure leads to the key in these colours."""
LEGEND = (
    "On a failure: blue goes to recovering, purple to laying back, red to clearing, dark red to clearing again, "
    "amber to making safe.\\l"
    "Everywhere: stop ends in stopped, abort in giving up, a crash in making safe, a lost journal in fault.\\l"
    "Between two effects a run may be paused; resume enters the state anew.\\l"
)


NODE = {
    "style": "rounded,filled", "shape": "rectangle", "peripheries": "1",
    "color": "#7b8492", "fillcolor": "#f6f7f9",
    "fontname": "sans-serif", "fontsize": "14", "height": "0.3", "margin": "0.12,0.05",
}  # fmt: skip
EDGE = {"color": "#7b8492", "fontname": "sans-serif", "fontsize": "11", "arrowsize": "0.7"}
LOOKS = {
    "default": NODE,
    "active": NODE,
    "end": {**NODE, "color": "#1c2026", "peripheries": "2"},
    **{state.value: {**NODE, "color": border, "fillcolor": fill} for state, (border, fill) in ON_FAILURE.items()},
}


class _Chart(GraphMachine):
    machine_attributes: dict[str, str] = {  # noqa: RUF012 (as the library declares it)
        **GraphMachine.machine_attributes,
        "rankdir": "TB", "fontname": "sans-serif", "fontsize": "13", "labelloc": "b", "labeljust": "l",
        "nodesep": "0.28", "ranksep": "0.32", "bgcolor": "transparent",
    }  # fmt: skip
    style_attributes: dict[str, Any] = {  # noqa: RUF012
        "node": LOOKS,
        "edge": {"default": EDGE},
        "graph": {"default": {}},
    }


def draw_chart() -> str:
    """Return the transition table as SVG. In it, the group of each state has the id `state-NAME`.

    Ends the program with a hint if Graphviz is missing.
    """
    rows = [row for row in TRANSITIONS if row.event is not Event.FAILED]
    chart = _Chart(
        states=[s.value for s in State], initial=State.IDLE.value, auto_transitions=False,
        graph_engine="graphviz", title=LEGEND,
    )  # fmt: skip
    for row in rows:
        chart.add_transition(row.event.value, row.state.value, row.target.value)
    on_failure = {row.state: row.target for row in TRANSITIONS if row.event is Event.FAILED}
    graph = chart.model_graphs[id(chart)]
    for state in State:
        after_failure = on_failure.get(state)
        style = after_failure.value if after_failure in ON_FAILURE else "default"
        graph.set_node_style(state.value, "end" if state in TERMINAL else style)
    try:
        import_module("graphviz")  # without it, `transitions` draws with another program
        svg: str = chart.get_graph().pipe(format="svg", encoding="utf-8")
    except (ImportError, OSError, RuntimeError) as e:  # graphviz raises a RuntimeError without `dot`
        sys.exit(f"the chart cannot be drawn: {e}; install Graphviz (`dot`) and the extra `docs`")
    return _for_pages(svg)


def _for_pages(svg: str) -> str:
    """Return the SVG with an id for each state, with spaces instead of underscores in labels, and without a fixed
    size."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(
        r'<g id="[^"]*" class="node">\s*<title>(\w+)</title>',
        r'<g id="state-\1" class="state"><title>\1</title>',
        svg,
    )
    svg = re.sub(r'<svg width="[^"]*" height="[^"]*"', '<svg class="states"', svg)
    svg = re.sub(r"<!--.*?-->\n", "", svg, flags=re.S)
    svg = re.sub(r"<title>[^<]*\\l[^<]*</title>\n", "", svg)  # remove the title that repeats the legend
    return re.sub(r"(<text[^>]*>)([^<]*)(</text>)", lambda m: m[1] + m[2].replace("_", " ") + m[3], svg)


if __name__ == "__main__":
    CHART.write_text(draw_chart(), encoding="utf-8")
    print(CHART)
