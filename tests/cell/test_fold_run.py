"""A whole run of the simulated cell: effects, set-points, files, and reproducibility."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.trajectory_library.library_file import load_library
from foldcell.cell.executive.machine import Executive
from foldcell.cell.journal.journal import Entry
from foldcell.cell.record.run_record import NOTHING_LOST, read_record, record_of
from foldcell.cell.states.transition_table import TERMINAL, Effect, Event, State
from foldcell.cell.support.process.lock import is_held
from foldcell.robots.baxter.robot import load_model
from foldcell.skills.motion.validation.collision import CollisionChecker
from tests.runs import LastCommand

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

NEAR_THE_TABLE = frozenset({Effect.GRASP, Effect.LIFT, Effect.FOLD, Effect.RELEASE, Effect.RETREAT, Effect.CLEAR})
"""Effects in which the fingertips may touch the table."""


# the end of the run


def test_the_towel_ends_folded_with_exit_code_0(seen: Any) -> None:
    result = seen.result
    assert (result.result, result.state, result.exit_code) == ("folded", "folded", 0), result.failure
    assert all(step.done for step in result.steps)
    assert result.failure is None


def test_the_score_is_marked_as_simulated(seen: Any) -> None:
    score = seen.result.score
    assert seen.result.simulated and score.simulated
    assert score.passed is (not score.failed)
    assert 0.5 < score.iou <= 1.0


def test_the_observed_height_grows_with_each_fold_and_agrees_with_the_score(seen: Any) -> None:
    steps = seen.result.steps
    assert all(step.done for step in steps)
    assert 0.004 < steps[0].observed_height_m < steps[1].observed_height_m
    assert steps[-1].observed_height_m == pytest.approx(seen.result.score.height_m, abs=0.007)


def test_the_hands_hold_each_layer_once_and_no_pleat(seen: Any) -> None:
    """The first fold shows how thick a layer is; in the second, two lie on each other."""
    grasps = [e.payload["held"] for e in seen.entries if e.kind == "result" and e.name == "grasp"]
    first, second = ([hand["opening_m"] for hand in held.values()] for held in grasps)
    assert second == pytest.approx([2.0 * np.mean(first)] * 2, rel=0.1)


def test_the_json_result_has_all_documented_keys(seen: Any) -> None:
    figures = json.loads(json.dumps(seen.result.as_json(), allow_nan=False))
    for key in ("garment", "seed", "driver", "result", "score", "steps", "robot_time_s", "wall_time_s",
                "stage_times_s", "run_dir"):  # fmt: skip
        assert key in figures
    for step in figures["steps"]:
        if not step["done"]:
            assert not step["accepted"], "an accepted fold counts as done"
            continue
        # a fold before the last may count as done without being accepted
        assert step["accepted"] in {True, False}
        assert step["source"] in {"library", "optimised"}
        assert 0.5 < step["aligned_iou"] <= 1.0 and 0.5 < step["observed_iou"] <= 1.0
        assert step["attempts"] >= 1 and isinstance(step["recoveries"], list)
    assert {"passed", "iou", "correspondence_m", "edges_m", "drift_m", "height_m"} <= figures["score"].keys()


# the journal


def test_the_journal_has_no_gaps_and_its_times_never_decrease(seen: Any) -> None:
    assert [e.sequence for e in seen.entries] == list(range(1, len(seen.entries) + 1))
    for clock in ("cell_time", "wall_time"):
        times = [getattr(e, clock) for e in seen.entries]
        assert all(a <= b for a, b in pairwise(times))


def test_every_effect_has_an_intent_followed_by_its_result(seen: Any) -> None:
    open_intent: Entry | None = None
    for entry in seen.entries:
        if entry.kind == "intent":
            assert open_intent is None, "no effect begins before the previous one has ended"
            open_intent = entry
        elif entry.kind == "result":
            assert open_intent is not None and entry.answers == open_intent.sequence
            assert (entry.name, entry.state) == (open_intent.name, open_intent.state)
            open_intent = None
    assert open_intent is None
    quiet = {Effect.NOTHING, Effect.WAIT, Effect.CHOOSE_RECOVERY, Effect.NEXT_STEP}
    noted = [e.name for e in seen.entries if e.kind == "intent"]
    assert noted == [e.value for e, _ in seen.onlooker.performed if e not in quiet]


def test_the_state_machine_reaches_the_same_end_from_the_journal_alone(seen: Any) -> None:
    """The journal's events drive the machine through the same effects to the same end."""
    machine = Executive()
    for entry in seen.entries:
        if entry.kind == "event":
            step = machine.handle(Event(entry.name))
            assert (step.target.value, step.source.value) == (entry.state, entry.payload["from"])
        elif entry.kind == "intent":
            assert (entry.state, entry.name) == (step.target.value, step.effect.value)
        else:
            assert entry.payload["event"] in {e.value for e in machine.allowed()}
    assert machine.state in TERMINAL and machine.state.value == seen.result.state


def test_the_summary_in_the_journal_equals_the_result(seen: Any) -> None:
    kept = json.loads((seen.folder / "result.json").read_text(encoding="utf-8"))
    summary = {k: v for k, v in seen.record.summary.items() if k != "schema"}
    assert kept == summary == json.loads(json.dumps(seen.result.as_json()))
    assert read_record(seen.folder) == record_of(summary) == seen.result
    assert (seen.record.status, seen.record.result) == (seen.result.result, seen.result.result)
    assert seen.record.settings_hash == seen.request.settings.fingerprint()
    assert seen.record.versions["foldcell"]


# time


def test_robot_time_is_the_cell_time_between_first_and_last_entry(seen: Any) -> None:
    result, entries = seen.result, seen.entries
    assert result.robot_time_s == pytest.approx(entries[-1].cell_time - entries[0].cell_time, abs=1e-6)
    assert sum(result.stage_times_s.values()) == pytest.approx(result.robot_time_s, abs=0.1)
    assert set(result.stage_times_s) <= {s.value for s in State}


def test_wall_time_covers_the_run(seen: Any) -> None:
    within = seen.entries[-1].wall_time - seen.entries[0].wall_time
    assert within <= seen.result.wall_time_s <= seen.record.ended - seen.record.started + 5.0


def test_computing_takes_the_declared_cell_time_per_simulation(seen: Any) -> None:
    costs = seen.request.settings.computing
    spans = {e.sequence: e for e in seen.entries if e.kind == "intent"}
    charged = [
        (e.payload["simulations"], e.cell_time - spans[e.answers].cell_time)
        for e in seen.entries
        if e.kind == "result" and e.name == "choose_trajectory"
    ]
    assert charged
    for simulations, seconds in charged:
        assert seconds == pytest.approx(simulations * costs.simulation_s, abs=1e-6)


# the set-points


def test_every_set_point_is_within_the_joint_limits(seen: Any) -> None:
    limits = load_model().limits("planning", seen.request.settings.motion.velocity_scale)
    sent = seen.onlooker.set_points
    t, q = np.array([s.t for s in sent]), np.array([s.q for s in sent])
    assert len(t) > 1000 and np.isfinite(q).all()
    assert not any(s.sent.clipped for s in sent), "the driver clips no set-point"
    assert (q >= limits.lower).all() and (q <= limits.upper).all()
    dt, dq = np.diff(t), np.diff(q, axis=0)
    speed = np.abs(dq) / np.where(dt > 1e-6, dt, np.inf)[:, None]
    assert (speed <= 1.01 * limits.velocity).all()
    assert (np.abs(np.array([s.qd for s in sent])) <= 1.01 * limits.velocity).all()
    assert np.abs(dq).max() < 0.05, "a set-point jumps"


def test_planned_motions_keep_the_acceleration_limits(seen: Any) -> None:
    """Approach and fold are each one planned motion, so second differences of the set-points are accelerations."""
    limits = load_model().limits("planning", 1.0)
    for effect in (Effect.APPROACH, Effect.FOLD):
        sent = [s for s in seen.onlooker.set_points if s.effect is effect]
        t, q = np.array([s.t for s in sent]), np.array([s.q for s in sent])
        whole = np.flatnonzero(np.abs(np.diff(t, n=2)) < 1e-6)
        whole = whole[np.diff(t)[whole] < 0.011]
        assert len(whole) > 200
        acceleration = np.abs(np.diff(q, n=2, axis=0)[whole]) / 1e-4
        assert (acceleration <= 1.05 * limits.acceleration).all()


def test_moving_arms_are_commanded_at_least_every_50_ms(seen: Any) -> None:
    """A command expires after 0.2 s. Within one effect none may expire."""
    for a, b in pairwise(seen.onlooker.set_points):
        if a.effect is b.effect and np.abs(a.qd).max() > 1e-3:
            assert b.t - a.t < 0.05


def test_no_set_point_is_in_collision(seen: Any) -> None:
    table = seen.request.settings.table
    checker = CollisionChecker(load_model(), table, body_margin=0.005, table_margin=0.010, fingertip_margin=0.010)
    for s in seen.onlooker.set_points[::5]:
        contact = checker.contact(s.q, allow_fingertips=s.effect in NEAR_THE_TABLE)
        assert contact is None, f"{contact} at {s.t:.2f} s in {s.effect}"


def test_the_run_ends_with_parked_arms_and_open_hands(seen: Any) -> None:
    assert np.abs(seen.onlooker.last_q - load_model().q_park).max() < 0.02
    assert min(seen.onlooker.openings) > 0.015


# the files of the run


def test_the_run_folder_is_complete(seen: Any) -> None:
    names = {p.name for p in seen.folder.iterdir()}
    assert {"cell.yaml", "report.html", "result.json", "run.rrd"} <= names
    assert not any(name.startswith(".") or name.endswith(".part") for name in names), (
        "no partly written file remains"
    )
    assert all(p.stat().st_size > 0 for p in seen.folder.iterdir())
    assert (seen.folder / "cell.yaml").read_text(encoding="utf-8") == seen.request.settings.as_yaml()
    logs = {p.name for p in seen.request.logs.iterdir()} - {"journal.db-shm", "journal.db-wal"}
    assert logs == {"cell.lock", "journal.db", "library.json", seen.record.id}
    assert not is_held(seen.request.logs / "cell.lock")


def test_the_recording_holds_every_series_and_every_transition(seen: Any) -> None:
    import rerun.chunk

    assert seen.result.recording == NOTHING_LOST
    rows: dict[str, int] = {}
    for chunk in rerun.chunk.RrdReader(str(seen.folder / "run.rrd")).stream():
        rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.to_record_batch().num_rows
    names = " ".join(rows)
    parts = [
        *("/camera/picture", "/camera/depth", "/camera/mask", "/perceived/keypoints", "/perception/overlay"),
        *("/joints/", "/grip/", "/opening/", "/plan/fold_line", "/arcs/planned", "/predicted", "/observed"),
        *("/truth", "/log"),
    ]
    for part in parts:
        assert part in names, f"nothing of '{part}' in {names}"
    transitions = sum(1 for e in seen.entries if e.kind == "event")
    assert max(n for path, n in rows.items() if "state" in path) >= transitions


class Loads(HTMLParser):
    """Collects the resources that a browser would load for a page."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.pictures = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.pictures += tag in {"img", "svg"}
        wanted = [named.get("src"), named.get("srcset"), named.get("poster"), named.get("data")]
        wanted.append(named.get("href") if tag in {"link", "use", "image", "base"} else None)
        self.fetched += [w for w in wanted if w and not w.startswith(("data:", "#"))]


def test_the_report_loads_no_external_resources(seen: Any) -> None:
    text = (seen.folder / "report.html").read_text(encoding="utf-8")
    page = Loads()
    page.feed(text)
    styled = [u for u in re.findall(r"url\(\s*['\"]?([^'\")]+)", text) if not u.startswith(("data:", "#"))]
    assert page.fetched + styled + re.findall(r"@import[^;]+", text) == []
    assert page.pictures >= 6, "three key frames of each fold"


def test_the_report_names_every_step_and_the_robot_time(seen: Any) -> None:
    text = re.sub(r"<[^>]+>", " ", (seen.folder / "report.html").read_text(encoding="utf-8"))
    assert "simulated" in text
    for step in seen.result.steps:
        assert step.name in text.lower()
    assert f"{seen.result.robot_time_s:.1f}" in text


def test_optimised_trajectories_are_saved_in_the_user_library(seen: Any) -> None:
    loaded = load_library(seen.request.logs)
    assert [r for path, r in loaded.refused if path.parent == seen.request.logs] == []
    kept = json.loads((seen.request.logs / "library.json").read_text(encoding="utf-8"))
    assert {entry["step"] for entry in kept["entries"]} == {
        seen.result.steps[e.payload["step"]].name
        for e in seen.entries
        if e.kind == "intent" and e.name == "choose_trajectory"
    }
    assert {s.source for s in seen.result.steps if s.done} == {"optimised"}


# reproducibility


def test_the_same_seed_gives_the_same_journal_without_recording_and_scorer(seen: Any, unseen: Any) -> None:
    """A run is a function of its seed. Recording and scoring change nothing, up to the second fold."""
    second = [i for i, e in enumerate(unseen.entries) if (e.kind, e.name) == ("intent", "approach")][1]
    assert list(told(unseen.entries[:second])) == list(told(seen.entries[:second]))


def test_the_same_seed_sends_the_same_set_points_bit_for_bit(seen: Any, unseen: Any) -> None:
    b = first_fold(unseen)
    a = seen.onlooker.set_points[: len(b)]
    assert len(b) > 1000 and [s.t for s in a] == [s.t for s in b]
    assert all(np.array_equal(x.q, y.q) and np.array_equal(x.qd, y.qd) for x, y in zip(a, b, strict=True))


def test_the_same_seed_gives_the_same_pictures_bit_for_bit(seen: Any, unseen: Any) -> None:
    inspected = 1 + [effect for effect, _ in unseen.onlooker.performed].index(Effect.INSPECT)
    frames = [
        [r.context.sight.frame for r in run.onlooker.results[:inspected] if r.context.sight.frame is not None]
        for run in (seen, unseen)
    ]
    assert len(frames[0]) > 3
    for a, b in zip(*frames, strict=True):
        assert np.array_equal(a.rgb, b.rgb)
        assert np.array_equal(a.depth, b.depth, equal_nan=True)


def test_a_run_without_recording_leaves_no_score_and_no_recording(unseen: Any) -> None:
    assert unseen.result.score is None
    left = {p.name for p in unseen.folder.iterdir()}
    assert {"cell.yaml", "request.json", "result.json"} <= left
    assert not left & {"run.rrd", "report.html", "run.transcript"}


def first_fold(run: Any) -> list[LastCommand]:
    """The set-points up to the end of the first fold's retreat; then the run without recording is ended."""
    retreats = [i for i, s in enumerate(run.onlooker.set_points) if s.effect is Effect.RETREAT]
    return run.onlooker.set_points[: retreats[-1] + 1]


def told(entries: tuple[Entry, ...]) -> Iterator[tuple[Any, ...]]:
    """The journal's entries, without wall-clock times."""
    for e in entries:
        yield e.sequence, e.cell_time, e.state, e.kind, e.name, e.answers, _timeless(e.payload)


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _timeless(v) for k, v in value.items() if k != "wall"}
    return value
