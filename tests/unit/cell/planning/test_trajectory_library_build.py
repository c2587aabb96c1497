"""Building a library: the same result on any executor and after an interruption, with progress."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from foldcell.cell.commands.main import main
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.trajectory_library.library_file import put_garments, user_library_path, write_library
from foldcell.cell.planning.trajectory_library_build import BuildProgress, BuiltStep, build_library
from foldcell.cell.planning.unfinished_build import UnfinishedBuild
from foldcell.robots.errors import CellError, FailureKind
from foldcell.skills.cloth.pinch import PadGeometry
from foldcell.skills.fold_plan.crease_mesh import predictor_mesh
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.trajectory_library import Library, LibraryEntry, from_json, to_json
from foldcell.skills.vocabulary import GraspId

TOWEL, SMALL = load_garment("medium_towel"), load_garment("small_towel")
BOTH = [TOWEL, SMALL]
METHOD, BUDGET = "two_parameter", 14


@dataclass(frozen=True)
class Bowl:
    """A stand-in simulation with one best height of the arc. Its result also depends on the initial positions."""

    sleep_s: float = 0.0

    def __call__(self, mesh, positions, material, paths, /):  # type: ignore[no-untyped-def]
        time.sleep(self.sleep_s)
        target = _target(tuple(next(iter(paths.values())).position[0, :2]))
        top = np.mean([p.position[:, 2].max() for p in paths.values()])
        way = np.mean([p.position[len(p.t) // 3] for p in paths.values()])
        miss = (
            0.002
            + 0.3 * (top - 0.11) ** 2
            + 0.05 * (way - 0.3) ** 2
            + 1e-3 * np.abs(np.sin(1e9 * positions)).mean()
        )
        return target + np.array([0.0, 0.0, miss])


@cache
def _target(start: tuple[float, float]) -> np.ndarray:
    """The ideal shape of the step that has a grasp at this point."""
    for garment in (TOWEL, SMALL):
        state = garment.flat_state(*garment.poses.middle)
        mesh = predictor_mesh(state, garment)
        for step in plan_folds(state, garment).unwrap():
            if any(np.allclose(g.point, start) for g in step.grasps.values()):
                return target_vertices(mesh, step.lines, garment.material)
    raise AssertionError(start)


def built(executor: Executor | None = None, at_once: int = 1, **more) -> Library:  # type: ignore[no-untyped-def]
    with ThreadPoolExecutor(1) as serial:
        return build_library(
            [TOWEL, SMALL],
            METHOD,
            predict=Bowl(),
            budget=BUDGET,
            executor=executor or serial,
            at_once=at_once,
            **more,
        )


@pytest.fixture(scope="module")
def serial() -> Library:
    return built()


def test_every_step_has_an_entry_with_its_provenance(serial: Library) -> None:
    assert [(e.garment, e.step) for e in serial.entries] == [
        (g.name, s.name) for g in (TOWEL, SMALL) for s in g.plan
    ]
    for entry, garment in zip(serial.entries, (TOWEL, TOWEL, SMALL, SMALL), strict=True):
        assert entry.material == garment.material and entry.size_m == garment.size_m
        assert entry.edge_length == garment.mesh_edge_m and entry.max_tool_speed == garment.max_tool_speed
        assert 0.0 < entry.dissimilarity <= entry.dissimilarity_initial + 1e-3
        # more simulations than the initial probes
        assert entry.method == METHOD and 4 < entry.simulations <= BUDGET and entry.version
        assert set(entry.inner) == {GraspId.LEFT, GraspId.RIGHT}


def test_threads_build_the_same_bit_for_bit(serial: Library) -> None:
    with ThreadPoolExecutor(5) as pool:
        assert to_json(built(pool, at_once=2)) == to_json(serial)


def test_processes_build_the_same_bit_for_bit(serial: Library) -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        assert to_json(built(pool, at_once=2)) == to_json(serial)


def test_progress_counts_every_simulation_and_never_goes_back() -> None:
    seen: list[BuildProgress] = []
    reported: list[BuiltStep] = []
    with ThreadPoolExecutor(3) as pool:
        built(pool, at_once=2, progress=seen.append, report=reported.append)
    assert [p.done for p in seen] == list(range(1, len(seen) + 1))
    assert seen[0].total == 4 * BUDGET and seen[-1].total >= seen[-1].done
    assert len(seen) == sum(b.entry.simulations for b in reported if b.entry)
    assert {(p.garment, p.step) for p in seen} == {(b.garment, b.step) for b in reported}
    assert len(reported) == 4 and not any(b.kept for b in reported)
    for one in reported:
        told = [p.dissimilarity for p in seen if (p.garment, p.step) == (one.garment, one.step)]
        assert one.entry is not None and told[-1] == one.entry.dissimilarity


def test_a_resumed_build_makes_the_same_library_after_an_interruption(tmp_path: Path, serial: Library) -> None:
    unfinished = UnfinishedBuild(tmp_path / "library.json", BOTH)

    def interrupt(step: BuiltStep) -> None:
        assert step.entry is not None
        unfinished.keep(step.entry)
        if len(unfinished.library.entries) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        built(report=interrupt)
    assert not (tmp_path / "library.json").exists()
    again = UnfinishedBuild(tmp_path / "library.json", BOTH)
    seen: list[BuildProgress] = []
    reported: list[BuiltStep] = []
    library = built(finished=again.library, progress=seen.append, report=reported.append)
    assert to_json(library) == to_json(serial)
    assert [b.kept for b in reported] == [True, True, True, False]
    assert seen[0].total == BUDGET and len(seen) == serial.entries[-1].simulations
    again.end()
    assert list(tmp_path.iterdir()) == []


def test_a_resumed_build_makes_the_same_library_after_a_kill(tmp_path: Path, serial: Library) -> None:
    """The process gets SIGKILL at a random moment after the first entry."""
    code = (
        "from pathlib import Path; from foldcell.cell.planning.unfinished_build import UnfinishedBuild\n"
        "from foldcell.cell.planning.trajectory_library_build import *\n"
        "from test_trajectory_library_build import *\n"
        f"part = UnfinishedBuild(Path({str(tmp_path / 'library.json')!r}), BOTH)\n"
        "build_library([TOWEL, SMALL], METHOD, Bowl(0.02), lambda b: part.keep(b.entry), budget=BUDGET,"
        " executor=ThreadPoolExecutor(1))\n"
    )
    folder = str(Path(__file__).parent)
    paths = os.pathsep.join([str(Path(__file__).parents[4]), folder, os.environ.get("PYTHONPATH", "")])
    victim = subprocess.Popen([sys.executable, "-c", code], cwd=folder, env={**os.environ, "PYTHONPATH": paths})
    part = tmp_path / "library.json.part"
    try:
        until = time.monotonic() + 120
        while not part.exists():
            assert victim.poll() is None and time.monotonic() < until
            time.sleep(0.02)
    finally:
        victim.send_signal(signal.SIGKILL)
        victim.wait()
    finished = UnfinishedBuild(tmp_path / "library.json", BOTH).library
    assert 1 <= len(finished.entries) < 4
    assert to_json(built(finished=finished)) == to_json(serial)


def test_a_resumed_build_uses_only_its_own_entries(serial: Library) -> None:
    half, quarter = serial.entries[:2]
    foreign = Library((
        replace(half, method="paper"),
        replace(half, version="0"),
        replace(half, material=replace(half.material, areal_mass=9.0)),
        replace(quarter, size_m=(1.0, 1.0)),
        replace(quarter, max_tool_speed=0.1),
    ))  # fmt: skip
    reported: list[BuiltStep] = []
    assert to_json(built(finished=foreign, report=reported.append)) == to_json(serial)
    assert not any(b.kept for b in reported)


def test_a_damaged_entry_of_an_unfinished_build_counts_as_not_built(tmp_path: Path, serial: Library) -> None:
    part = UnfinishedBuild(tmp_path / "library.json", BOTH)
    for entry in serial.entries[:2]:
        part.keep(entry)
    text = part.path.read_text()
    part.path.write_text(text.replace('"method": "two_parameter"', '"method": "paper"', 1))
    assert len(UnfinishedBuild(tmp_path / "library.json", BOTH).library.entries) == 1
    part.path.write_text(text[: len(text) // 2])
    assert UnfinishedBuild(tmp_path / "library.json", BOTH).library.entries == ()


def test_a_build_keeps_unfinished_entries_of_other_garments(tmp_path: Path, serial: Library) -> None:
    cut_short, other = UnfinishedBuild(tmp_path / "library.json", [TOWEL]), serial.entries[2]
    cut_short.keep(serial.entries[0])
    beside = UnfinishedBuild(tmp_path / "library.json", [SMALL])
    assert beside.library.entries == ()
    beside.keep(other)
    cut_short.keep(serial.entries[1])  # both builds are running
    (again,) = UnfinishedBuild(tmp_path / "library.json", [SMALL]).library.entries
    assert again.garment == "small_towel"
    beside.end()
    left = UnfinishedBuild(tmp_path / "library.json", BOTH).library.entries
    assert {(e.garment, e.step) for e in left} == {("medium_towel", "half"), ("medium_towel", "quarter")}


def test_two_concurrent_builds_lose_no_entry(tmp_path: Path, serial: Library) -> None:
    begin = threading.Barrier(2)

    def build(garment: Garment, entry: LibraryEntry) -> None:
        part = UnfinishedBuild(tmp_path / "library.json", [garment])
        for k in range(20):
            begin.wait()
            part.keep(replace(entry, step=f"step{k}"))

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(build, BOTH, serial.entries[1:3]))
    assert len(UnfinishedBuild(tmp_path / "library.json", BOTH).library.entries) == 40


def test_a_build_creates_its_output_folder(tmp_path: Path, serial: Library) -> None:
    """For example `foldcell library build --output arcs/library.json`."""
    UnfinishedBuild(tmp_path / "arcs" / "library.json", [TOWEL]).keep(serial.entries[0])
    assert len(UnfinishedBuild(tmp_path / "arcs" / "library.json", [TOWEL]).library.entries) == 1


def test_a_garment_with_a_changed_plan_is_built_again(tmp_path: Path, serial: Library) -> None:
    part = UnfinishedBuild(tmp_path / "library.json", [TOWEL])
    for entry in serial.entries[:2]:
        part.keep(entry)
    first = [(step, step.variants[0]) for step in TOWEL.plan]
    one_hand = tuple(replace(s, variants=(replace(v, grasps=v.grasps[:1]),)) for s, v in first)
    towel = replace(TOWEL, plan=one_hand)
    assert UnfinishedBuild(tmp_path / "library.json", [towel]).library.entries == ()
    assert len(UnfinishedBuild(tmp_path / "library.json", [TOWEL]).library.entries) == 2


def test_a_failed_step_ends_its_garment_and_other_garments_are_built() -> None:
    def fails(mesh, positions, material, paths, /):  # type: ignore[no-untyped-def]
        if material == TOWEL.material:
            raise CellError("no")
        return Bowl()(mesh, positions, material, paths)

    reported: list[BuiltStep] = []
    seen: list[BuildProgress] = []
    with ThreadPoolExecutor(1) as pool:
        library = build_library(
            [TOWEL, SMALL], "initial", fails, report=reported.append, progress=seen.append, executor=pool
        )
    assert [(b.step, b.entry is None) for b in reported] == [("half", True), ("half", False), ("quarter", False)]
    assert reported[0].failure is not None and reported[0].failure.kind is FailureKind.OPTIMISER_FAILED
    assert [e.garment for e in library.entries] == ["small_towel", "small_towel"]
    assert seen[-1].done == seen[-1].total == 3


def test_an_exception_in_the_report_callback_ends_all_searches() -> None:
    calls = []

    def count(mesh, positions, material, paths, /):  # type: ignore[no-untyped-def]
        calls.append(threading.get_ident())
        return Bowl(0.005)(mesh, positions, material, paths)

    def full(step: BuiltStep) -> None:
        raise OSError(28, "No space left on device")

    with ThreadPoolExecutor(2) as pool, pytest.raises(OSError, match="No space"):
        build_library([TOWEL, SMALL], METHOD, predict=count, budget=BUDGET, report=full, executor=pool, at_once=2)
    assert len(calls) <= 3 * BUDGET, "the search for the other garment ends early"


def test_a_built_library_replaces_only_its_own_entries(tmp_path: Path, serial: Library) -> None:
    path = tmp_path / "library.json"
    stale = tuple(replace(e, simulations=3) for e in serial.entries)
    other = replace(serial.entries[0], garment="curtain")
    write_library(path, Library((other, *stale)))
    put_garments(path, Library(serial.entries[:2]), ["medium_towel"])
    library, refused = from_json(path.read_text())
    assert not refused
    assert [(e.garment, e.simulations) for e in library.entries] == [
        *(("medium_towel", e.simulations) for e in serial.entries[:2]), ("curtain", other.simulations),
        ("small_towel", 3), ("small_towel", 3),
    ]  # fmt: skip


def test_the_build_command_writes_the_library_and_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], serial: Library
) -> None:
    monkeypatch.setattr("foldcell.cell.campaigns.executors.worker_pool", ThreadPoolExecutor)
    monkeypatch.setattr("foldcell.cell.commands.library.build.ClothPredictor", lambda pads: Bowl())
    line = ["library", "build", "small_towel", "--method", "two_parameter", "--workers", "2",
            "--logs", str(tmp_path)]  # fmt: skip
    assert main([*line, "--json"]) == 0
    said = capsys.readouterr()
    answer = json.loads(said.out.splitlines()[-1])
    assert [e["step"] for e in answer["entries"]] == ["half", "quarter"] and answer["failed"] == []
    assert "small_towel half: D " in said.err and "\x1b" not in said.err
    path = user_library_path(tmp_path)
    first = path.read_text()
    assert len(from_json(first)[0].entries) == 2
    assert [p.name for p in tmp_path.glob("library.json*")] == ["library.json"]

    part = UnfinishedBuild(path, [SMALL])
    part.keep(from_json(first)[0].entries[0])
    assert main(line) == 0
    out = capsys.readouterr().out
    assert "continues from the 1 folds" in out and "half" in out.split("kept")[0]
    assert path.read_text() == first and not part.path.exists()


def test_a_build_uses_the_settings_of_its_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arcs are evaluated with its pads, together with the lift before them, at its folding speed."""
    lifts, widths = [], []

    class Watching(Bowl):
        def __call__(self, mesh, positions, material, paths, /):  # type: ignore[no-untyped-def]
            path = next(iter(paths.values())).position
            straight = np.all(path[:, :2] == path[0, :2], axis=1)
            lifts.append(path[straight, 2].max() - path[0, 2])
            return super().__call__(mesh, positions, material, paths)

    monkeypatch.setattr("foldcell.cell.campaigns.executors.worker_pool", ThreadPoolExecutor)

    def predictor(pads: PadGeometry) -> Watching:
        widths.append(pads.width)
        return Watching()

    monkeypatch.setattr("foldcell.cell.commands.library.build.ClothPredictor", predictor)
    (tmp_path / "cell.yaml").write_text(
        "grasp: {lift_height: 0.05}\nmotion: {tool_speed: 0.2}\ngripper: {pad_width: 0.03}\n"
    )
    line = ["library", "build", "small_towel", "--method", "initial", "--cell", str(tmp_path / "cell.yaml")]
    assert main([*line, "--workers", "1", "--logs", str(tmp_path)]) == 0
    assert lifts == pytest.approx([0.05] * len(lifts)) and widths == [0.03]
    entries = from_json(user_library_path(tmp_path).read_text())[0].entries
    assert [e.max_tool_speed for e in entries] == [0.2, 0.2]
