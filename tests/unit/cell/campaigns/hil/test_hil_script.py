"""HIL script files: valid ones are read, invalid ones are refused with the reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from foldcell.cell.campaigns.hil.script import FaultSpec, Moment, read_script
from foldcell.cell.campaigns.hil.script_run import check_script
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.simulation import FaultKind
from foldcell.cell.states.transition_table import Event, State
from foldcell.robots.errors import ConfigurationError, FailureKind
from foldcell.robots.ports import Side

SHIPPED = sorted((Path(__file__).parents[4] / "hil").glob("*.yaml"))
GOOD: dict[str, Any] = {"about": "a test", "garment": "small_towel", "expect": {"end": "folded"}}


def script_file(folder: Path, **changes: Any) -> Path:
    path = folder / "script.yaml"
    path.write_text(yaml.safe_dump({**GOOD, **changes}), encoding="utf-8")
    return path


@pytest.mark.parametrize("path", SHIPPED, ids=[p.stem for p in SHIPPED])
def test_every_shipped_script_is_valid(path: Path) -> None:
    script = read_script(path)
    check_script(script, load_settings(), "sim")
    assert script.name == path.stem


def test_every_field_of_a_script_is_read(tmp_path: Path) -> None:
    script = read_script(script_file(
        tmp_path, seed=7, attended=True, cell={"optimiser": {"simulations": 5}},
        do=[
            {"when": {"state": "folding", "visit": 2, "after_s": 1.5}, "say": "pause"},
            {"when": {"time_s": 3}, "fault": {"kind": "dropped_corner", "side": "left", "size_m": 0.1}},
            {"stop": "the button"},
        ],
        expect={"end": ["folded", "not_folded"], "failures": ["slipped"], "through": ["paused"]},
    ))  # fmt: skip
    pause, drop, stop = script.do
    assert (pause.when.state, pause.when.visit, pause.when.after_s) == (State.FOLDING, 2, 1.5)
    assert pause.say is Event.PAUSE and stop.stop == "the button" and stop.when.time_s == 0.0
    fault = drop.fault.at(3.0)
    assert (fault.kind, fault.side, fault.at, fault.size) == (FaultKind.DROPPED_CORNER, Side.LEFT, 3.0, 0.1)
    assert script.expect.end == (State.FOLDED, State.NOT_FOLDED)
    assert script.expect.failures == (FailureKind.SLIPPED,) and script.needs_simulation
    own = check_script(script, load_settings(), "sim")
    assert own.optimiser.simulations == 5 and own.table == load_settings().table


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"expect": {}}, "expect.end"),
        ({"expect": {"end": "folding"}}, "folded, not_folded, stopped, fault"),
        ({"expect": {"end": "folded", "failures": ["bad_luck"]}}, "missed_grasp"),
        ({"expect": {"end": "folded", "fold": 2}}, "did you mean 'folds'"),
        ({"do": [{"when": {"state": "folding"}}]}, "one of fault, say, stop and tell"),
        ({"do": [{"say": "pause", "stop": "now"}]}, "one of fault, say, stop and tell"),
        ({"do": [{"say": "faster"}]}, "approve"),
        ({"do": [{"fault": {"kind": "droped_corner"}}]}, "did you mean 'dropped_corner'? allowed is one of"),
        ({"expect": {"end": "foldet"}}, "did you mean 'folded'?"),
        ({"cell": {"optimiser": {"method": "papper"}}}, "did you mean 'paper'?"),
        ({"do": [{"when": {"state": "folding", "time_s": 1.0}, "say": "pause"}]}, "either `time_s` or `state`"),
        ({"do": [{"when": {"time_s": 1.0, "visit": 2}, "say": "pause"}]}, "need `state`"),
        ({"do": [{"when": {"state": "dancing"}, "say": "pause"}]}, "folding"),
        ({"do": [{"when": {"state": "idle"}, "say": "pause"}]}, "folding"),
        ({"limit_s": 0}, "limit_s"),
        ({"do": [{"when": {"state": "folding", "after_s": -1}, "say": "pause"}]}, "after_s"),
        ({"do": [{"when": {"time_s": float("nan")}, "say": "pause"}]}, "time_s"),
        ({"do": [{"fault": {"kind": "camera_black", "side": "left"}}]}, "has no side"),
        ({"do": [{"fault": {"kind": "camera_black", "grasp": 1}}]}, "does not count grasps"),
        ({"do": [{"say": "approve"}]}, "attended: true"),
        ({"seed": -1}, "seed"),
        ({"path": "/etc"}, "unknown key 'path'"),
        ({"about": ""}, "about"),
    ],
)
def test_invalid_input_is_refused_with_its_reason(changes: dict[str, Any], said: str, tmp_path: Path) -> None:
    path = script_file(tmp_path, **changes)
    with pytest.raises(ConfigurationError) as error:
        check_script(read_script(path), load_settings(), "sim")
    assert said in f"{error.value.what} {error.value.hint}" and str(path) in error.value.what


@pytest.mark.parametrize("content", [b"", b"- a", b"about: [", b"\xff\xfe", b"about: x\nabout: y"])
def test_other_files_are_refused_as_scripts(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "script.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError):
        read_script(path)


def test_faults_are_injected_into_a_simulated_cell_only(tmp_path: Path) -> None:
    script = read_script(script_file(tmp_path, do=[{"fault": {"kind": "no_garment"}}]))
    with pytest.raises(ConfigurationError, match="only a simulated cell"):
        check_script(script, load_settings(), "ros")
    scored = read_script(script_file(tmp_path, expect={"end": "folded", "passed": True}))
    with pytest.raises(ConfigurationError, match="is scored"):
        check_script(scored, load_settings(), "ros")
    plain = read_script(script_file(tmp_path, do=None))
    assert plain.do == () and check_script(plain, load_settings(), "ros")


def test_errors_in_settings_and_garments_name_their_file_and_line(tmp_path: Path) -> None:
    path = script_file(tmp_path, cell={"optimiser": {"speed": 9}})
    line = path.read_text().splitlines().index("    speed: 9") + 1
    with pytest.raises(ConfigurationError) as error:
        check_script(read_script(path), load_settings(), "sim")
    assert f"{path}:{line}: unknown key" in error.value.what
    (tmp_path / "own.yaml").write_text("title: no garment\n")
    with pytest.raises(ConfigurationError, match=r"own\.yaml"):
        check_script(read_script(script_file(tmp_path, garment="./own.yaml")), load_settings(), "sim")


@pytest.mark.parametrize(("key", "value"), [("cell", {"optimiser": {"speed": 9}}), ("garment", "small_towle")])
def test_settings_and_garments_are_checked_before_anything_moves(key: str, value: Any, tmp_path: Path) -> None:
    script = read_script(script_file(tmp_path, **{key: value}))
    with pytest.raises(ConfigurationError):
        check_script(script, load_settings(), "sim")


def test_a_random_moment_is_drawn_evenly_over_the_stays_of_its_states() -> None:
    moment = Moment.model_validate({"during": {"lifting": 1.0, "folding": 3.0}, "visits": 2})
    drawn = [moment.drawn(seed, 0) for seed in range(4000)]
    assert all(m.at_latest and not m.during for m in drawn)
    for state, visit, span in [("lifting", 1, 1.0), ("lifting", 2, 1.0), ("folding", 1, 3.0), ("folding", 2, 3.0)]:
        delays = [m.after_s for m in drawn if m.state == state and m.visit == visit]
        assert len(delays) / len(drawn) == pytest.approx(span / 8.0, abs=0.04)
        assert min(delays) >= 0.0 and max(delays) <= span
        assert np.mean(delays) == pytest.approx(span / 2, rel=0.1)


def test_a_random_moment_depends_on_the_seed_and_the_action() -> None:
    moment = Moment.model_validate({"during": {"folding": 3.0}, "visits": 3})
    assert moment.drawn(5, 1) == moment.drawn(5, 1)
    assert len({str(moment.drawn(seed, index)) for seed in range(10) for index in range(3)}) > 25


def test_states_that_a_run_enters_once_are_drawn_for_their_only_visit() -> None:
    moment = Moment.model_validate({"during": {"looking": 0.3, "looking_after": 0.3}, "visits": 2})
    drawn = [moment.drawn(seed, 0) for seed in range(300)]
    assert {(m.state.value, m.visit) for m in drawn} == {
        ("looking", 1),
        ("looking_after", 1),
        ("looking_after", 2),
    }


@pytest.mark.parametrize(
    ("moment", "message"),
    [
        ({"during": {"folding": 1.0}, "state": "folding"}, "a moment is either"),
        ({"state": "folding", "visits": 2}, "`visits` needs `during`"),
        ({"time_s": 3.0, "at_latest": True}, "need `state`"),
        ({"during": {"dancing": 1.0}}, "folding"),
        ({"during": {"folding": -1.0}}, "greater than or equal to 0"),
    ],
)
def test_impossible_random_moments_are_refused(moment: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Moment.model_validate(moment)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"kind": "gripper_weak", "size_m": 0.3}, "use `size`"),
        ({"kind": "sudden_drop", "size_m": 0.3, "size": 0.3}, "not both"),
        ({"kind": "camera_black", "turn_deg": 10.0}, "has no angle"),
        ({"kind": "camera_late", "size": -1.0}, "above 0"),
    ],
)
def test_sizes_that_do_not_fit_their_kind_are_refused(fault: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FaultSpec.model_validate(fault)
