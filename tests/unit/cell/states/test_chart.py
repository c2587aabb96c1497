"""The state chart agrees with the transition table."""

import re
from html import unescape
from pathlib import Path

import pytest

from benchmarks.state_chart import draw_chart
from foldcell.cell.states.state_chart import CHART, marked_chart
from foldcell.cell.states.transition_table import TRANSITIONS, Event, State

AGAIN = "the table has changed: draw it again: python -m benchmarks.state_chart, then benchmarks.reference"


def drawn_rows() -> set[tuple[str, str, str]]:
    """(state, event, target) of every arrow in the shipped picture."""
    arrows = re.findall(r'class="edge">\s*<title>(.*?)</title>(.*?)</g>', CHART.read_text(), re.S)
    return {
        (*unescape(ends).split("->"), event.strip().replace(" ", "_"))
        for ends, body in arrows
        for label in re.findall(r"<text[^>]*>(.*?)</text>", body)
        for event in label.split("|")
    }


def test_every_transition_except_failures_is_an_arrow_of_the_chart() -> None:
    rows = {(r.state.value, r.target.value, r.event.value) for r in TRANSITIONS if r.event is not Event.FAILED}
    assert drawn_rows() == rows, AGAIN


def test_every_state_is_in_the_chart() -> None:
    assert set(re.findall(r'id="state-(\w+)"', CHART.read_text())) == {s.value for s in State}, AGAIN


def test_chart_colours_group_states_by_their_failure_target() -> None:
    """States have the same colour exactly if their failures lead to the same state."""
    colour = dict(re.findall(r'id="state-(\w+)".*?<path fill="(#\w+)" stroke="#', CHART.read_text(), re.S))
    failing = {r.state.value: r.target for r in TRANSITIONS if r.event is Event.FAILED}
    led = {state: failing[state] for state in failing if failing[state] is not State.FAULT}
    for state, target in led.items():
        alike = {other for other, ground in colour.items() if ground == colour[state]}
        assert alike == {other for other, to in led.items() if to is target}, AGAIN


@pytest.mark.parametrize("present", list(State))
def test_the_marked_chart_shows_the_present_state_and_the_passed_states(present: State) -> None:
    marked = dict(re.findall(r'id="state-(\w+)" class="([^"]*)"', marked_chart(present, [State.IDLE, present])))
    assert {name for name, look in marked.items() if "present" in look} == {present.value}
    passed = {name for name, look in marked.items() if "passed" in look}
    assert passed == ({"idle"} if present is not State.IDLE else set())


def test_without_graphviz_the_chart_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SystemExit, match="install Graphviz"):
        draw_chart()
