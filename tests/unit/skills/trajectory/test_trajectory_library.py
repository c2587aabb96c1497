"""The trajectory library stores, scales and verifies its entries."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.trajectory_library.library_file import entry_of
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.trajectory.arcs.bezier import arc_controls
from foldcell.skills.trajectory.arcs.frame import FoldFrame, frames_of
from foldcell.skills.trajectory.arcs.paths import fold_duration
from foldcell.skills.trajectory.trajectory_library import (
    SCHEMA,
    Library,
    LibraryEntry,
    _digest,
    from_json,
    lookup,
    to_json,
    trajectory_from,
)
from foldcell.skills.vocabulary import FoldStep, GraspId, GraspTrajectory

TOWEL = load_garment("medium_towel")
HALF, QUARTER = plan_folds(TOWEL.flat_state(0.58, 0.0), TOWEL).unwrap()


def trajectory(step: FoldStep) -> GraspTrajectory:
    frames = frames_of(step, TOWEL.material.thickness)
    controls = {s: arc_controls(f.start, f.end, 0.5, 0.1) for s, f in frames.items()}
    return GraspTrajectory(controls, fold_duration(controls, 0.35), "optimised", 5.6, 0.005, 25)


def entry(step: FoldStep = HALF, **change: object) -> LibraryEntry:
    made = replace(entry_of(TOWEL, step, trajectory(step), "default", 0.012), max_tool_speed=0.35)
    return replace(made, **change)  # type: ignore[arg-type]


points = st.tuples(st.floats(0.3, 0.9), st.floats(-0.4, 0.4), st.floats(0, 0.01)).map(np.array)


@given(points, points, st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_denormalising_restores_the_arc_and_keeps_its_shape(start: np.ndarray, end: np.ndarray, seed: int) -> None:
    if np.linalg.norm((end - start)[:2]) < 0.05:
        return
    frame = FoldFrame(start, end)
    control = np.vstack([start, np.random.default_rng(seed).uniform(0, 0.5, (2, 3)), end])
    inner = frame.normalise(control)
    assert np.allclose(frame.denormalise(inner), control, atol=1e-12)
    assert np.allclose(frame.axes @ frame.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.norm(inner[1] - inner[0]) == pytest.approx(
        np.linalg.norm(control[2] - control[1]) / np.linalg.norm(end - start)
    )


def test_an_entry_returns_its_own_trajectory() -> None:
    found = trajectory_from(entry(), HALF, TOWEL.material.thickness)
    assert found is not None and found.source == "library" and found.simulations == 0
    for i, control in trajectory(HALF).control_points.items():
        assert np.allclose(found.control_points[i], control, atol=1e-12)
    assert found.duration == pytest.approx(trajectory(HALF).duration)


def test_a_library_entry_scales_and_turns_with_the_fold() -> None:
    pose = (0.62, -0.05, 0.3, 1.25)
    step = plan_folds(TOWEL.flat_state(*pose), TOWEL).unwrap()[0]
    found = trajectory_from(entry(), step, TOWEL.material.thickness)
    assert found is not None
    own = trajectory(HALF).control_points[GraspId.LEFT]
    ratio = np.ptp(found.control_points[GraspId.LEFT][:, 2]) / np.ptp(own[:, 2])
    distances = [np.linalg.norm(s.targets[GraspId.LEFT][:2] - s.grasps[GraspId.LEFT].point) for s in (step, HALF)]
    assert ratio == pytest.approx(distances[0] / distances[1], rel=0.01)
    assert np.allclose(found.control_points[GraspId.LEFT][0, :2], step.grasps[GraspId.LEFT].point)
    assert np.allclose(found.control_points[GraspId.LEFT][-1], step.targets[GraspId.LEFT])


def test_a_single_arm_arc_is_mirrored_for_the_other_arm() -> None:
    one = entry(inner={GraspId.LEFT: np.array([[0.3, 0.1, 0.4], [0.7, 0.05, 0.4]])})
    right = replace(
        HALF,
        grasps={GraspId.RIGHT: HALF.grasps[GraspId.RIGHT]},
        targets={GraspId.RIGHT: HALF.targets[GraspId.RIGHT]},
    )
    found = trajectory_from(one, right, TOWEL.material.thickness)
    assert found is not None
    frame = frames_of(right, TOWEL.material.thickness)[GraspId.RIGHT]
    assert np.allclose(frame.normalise(found.control_points[GraspId.RIGHT]), [[0.3, -0.1, 0.4], [0.7, -0.05, 0.4]])
    assert trajectory_from(one, HALF, TOWEL.material.thickness) is None, "one arc is not used for two arms"


def test_the_lookup_takes_the_nearest_entry_within_limits() -> None:
    small, large = entry(size_m=(0.36, 0.54)), entry(size_m=(0.46, 0.69), garment="big")
    other = entry(QUARTER)
    library = Library((small, large, other))

    def find(size=(0.40, 0.60), material=TOWEL.material, step="half", category="towel"):  # type: ignore[no-untyped-def]
        return lookup(library, category, step, material, size)

    assert find() is small
    assert find(size=(0.45, 0.68)) is large
    assert find(step="quarter") is other
    assert find(size=(0.20, 0.30)) is None
    assert find(material=TOWEL.material.with_friction(2 * TOWEL.material.friction_static)) is None
    assert find(material=TOWEL.material.with_friction(1.2 * TOWEL.material.friction_static)) is small
    assert find(category="pants") is None and find(step="sleeve") is None


def test_a_more_similar_fabric_is_preferred_at_equal_size() -> None:
    stiff = entry(material=replace(TOWEL.material, bending_length=1.5 * TOWEL.material.bending_length))
    library = Library((stiff, entry()))
    assert lookup(library, "towel", "half", TOWEL.material, TOWEL.size_m) is library.entries[1]
    assert lookup(library, "towel", "half", stiff.material, TOWEL.size_m) is stiff


def test_a_library_reads_back_from_its_text() -> None:
    library = Library((entry(), entry(QUARTER)))
    back, refused = from_json(to_json(library))
    assert not refused
    assert to_json(back) == to_json(library)
    for a, b in zip(library.entries, back.entries, strict=True):
        assert a.material == b.material and a.size_m == b.size_m and set(a.inner) == set(b.inner)
        assert all(np.array_equal(a.inner[s], b.inner[s]) for s in a.inner)


def test_a_new_entry_replaces_only_its_predecessor() -> None:
    library = Library((entry(), entry(QUARTER))).with_entry(entry(dissimilarity=0.001))
    assert len(library.entries) == 2
    assert lookup(library, "towel", "half", TOWEL.material, TOWEL.size_m).dissimilarity == 0.001  # type: ignore[union-attr]


def _resigned(change: dict[str, object]) -> str:
    """An altered entry whose hash matches."""
    data = json.loads(to_json(Library((entry(),))))
    row = {k: v for k, v in data["entries"][0].items() if k != "sha256"} | change
    data["entries"] = [{"sha256": _digest(row), **row}]
    return json.dumps(data)


NONSENSE = [
    {"inner": {"left": [[1, 2], [3, 4]]}},
    {"inner": {"left": [[50.0, 0, 1], [1, 0, 1]]}},
    {"inner": {"left": [[float("nan"), 0, 1], [1, 0, 1]]}},
    {"inner": {"middle": [[0.3, 0, 0.3], [0.6, 0, 0.3]]}},
    {"inner": {}},
    {"edge_length": -1.0},
    {"edge_length": True},
    {"max_tool_speed": True},
    {"size_m": ["a", "b"]},
    {"material": {"areal_mass": 0.3}},
    {"dissimilarity": "small"},
    {"dissimilarity_initial": "large"},
    {"dissimilarity_initial": float("nan")},
    {"surprise": 1},
]


@pytest.mark.parametrize("change", NONSENSE, ids=str)
def test_invalid_entries_are_refused_even_with_a_right_hash(change: dict[str, object]) -> None:
    library, refused = from_json(_resigned(change))
    assert library.entries == () and len(refused) == 1 and refused[0].index == 0
    assert len(refused[0].reason) > 10


def test_an_edited_entry_is_refused_and_other_entries_are_kept() -> None:
    text = to_json(Library((entry(), entry(QUARTER)))).replace('"simulations": 25', '"simulations": 24', 1)
    library, refused = from_json(text)
    assert [e.step for e in library.entries] == ["quarter"]
    assert [r.index for r in refused] == [0] and "hash" in refused[0].reason


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "[" * 100_000,
        '{"entries": []}',
        '{"schema": "other/9", "entries": []}',
        f'{{"schema": "{SCHEMA}"}}',
    ],
)
def test_a_foreign_file_is_refused_with_its_reason(text: str) -> None:
    library, refused = from_json(text)
    assert library.entries == () and refused[0].index == -1 and refused[0].reason


def test_rows_of_the_wrong_kind_are_refused_one_by_one() -> None:
    library, refused = from_json(json.dumps({"schema": SCHEMA, "entries": [1, None, "x", [], {}]}))
    assert library.entries == () and [r.index for r in refused] == [0, 1, 2, 3, 4]
