"""The simulated cell through its ports."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.hardware.contract.clauses import CLAUSES, check_driver
from foldcell.cell.hardware.contract.opening import opened_rig
from foldcell.cell.simulation import Fault, FaultKind, SimulationSettings, open_simulated_cell
from foldcell.cell.simulation.garment.garment import WorldGarment
from foldcell.cell.simulation.noise import load_noise
from foldcell.cell.simulation.world import World
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.transcript.port_recorder import PortRecorder
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.depth_averaging import EVERY_S, EXPOSURES
from foldcell.robots.errors import ConfigurationError, DriverError
from foldcell.robots.ports import Side
from foldcell.skills.vocabulary import tool_rotation
from tests.simulated_bench import BLIND, DT, QUIET, Bench, corner


@pytest.fixture
def opened(open_bench: Any) -> Any:
    return lambda settings=BLIND, seed=1: open_bench(settings, seed)


# no access to the ground truth ------------------------------------------------------------------------


def reachable(root: object) -> Iterator[object]:
    """Every object that attributes, items and bound methods lead to. Paths and threads are left out, because they
    lead to all of Python."""
    plain = (str, int, float, bool, type, type(None), Path, threading.Thread)
    seen: set[int] = set()
    waiting = [root]
    while waiting:
        value = waiting.pop()
        if id(value) in seen or isinstance(value, plain):
            continue
        seen.add(id(value))
        yield value
        if isinstance(value, dict):
            waiting += list(value.values())
        elif isinstance(value, (list, tuple, set, frozenset)):
            waiting += list(value)
        elif not isinstance(value, np.ndarray):
            names = [n for n in dir(value) if not n.startswith("__")]
            waiting += [getattr(value, n) for n in names]
            waiting += [getattr(value, "__self__", None), getattr(value, "__closure__", None)]


@pytest.mark.parametrize("taken_down", [False, True])
def test_no_attribute_of_the_ports_leads_to_the_world(opened: Any, taken_down: bool, tmp_path: Path) -> None:
    """This holds for plain ports and for those of a recorded run."""
    bench, port_recorder = opened(), PortRecorder(tmp_path if taken_down else None)
    heard, _ = port_recorder.between(bench.ports, CommandQueue())
    heard.attendant.lay_garment()
    garment = bench.truth().garment
    assert garment is not None
    found = list(reachable(heard))
    assert port_recorder.close() is None
    assert len(found) > 30  # the search visits many objects
    for value in found:
        assert not isinstance(value, World)
        assert not type(value).__module__.startswith(("foldcell.cell.simulation.world", "foldcell.skills.cloth"))
        if isinstance(value, np.ndarray):
            assert value.shape[:1] != garment.vertices.shape[:1]
    world = World.__new__(World)
    world.ports = bench.ports  # type: ignore[attr-defined]
    assert any(v is world for v in reachable({"a": [world]}))  # the search would find a world


# the clock ------------------------------------------------------------------------------------------


def test_time_passes_only_while_sleeping(opened: Any) -> None:
    ports = opened().ports
    for _ in range(3):
        ports.arms.state()
        ports.tactile[Side.LEFT].reading()
    assert ports.clock.now() == 0.0
    ports.clock.sleep_until(0.5)
    assert ports.clock.now() == 0.5
    ports.clock.sleep_until(0.2)  # a time in the past
    assert ports.clock.now() == 0.5
    assert ports.arms.state().stamp == pytest.approx(0.5, abs=1 / 240)


def test_real_time_follows_the_wall_clock(opened: Any) -> None:
    ports = opened(SimulationSettings(garment="small_towel", render=False, realtime=True)).ports
    start = time.monotonic()
    ports.clock.sleep_until(0.4)
    assert time.monotonic() - start > 0.3


def play(settings: SimulationSettings, seed: int, looking: bool = False) -> tuple[bytes, ...]:
    """Make calls of every kind. Returns the ports' answers."""
    bench = Bench(settings, seed)
    ports, out = bench.ports, []
    try:
        bench.ready()
        ports.attendant.lay_garment()
        bench.move(bench.q + 0.1, 1.0)
        for k in range(3):
            if looking:
                bench.truth()
            ports.grippers[Side.LEFT].command(0.01 * k, 5.0)
            bench.hold(0.1)
            state = ports.arms.state()
            out += [state.q.tobytes(), state.effort.tobytes(), ports.tactile[Side.RIGHT].reading().cells.tobytes()]
        if settings.render:
            frame = ports.camera.capture()
            out += [frame.rgb.tobytes(), frame.depth.tobytes()]
        garment = bench.truth().garment
        assert garment is not None
        return (*out, garment.vertices.tobytes())
    finally:
        bench.close()


def test_a_run_is_a_function_of_its_seed_bit_for_bit() -> None:
    seeing = SimulationSettings(garment="small_towel")
    first = play(seeing, 3)
    assert first == play(seeing, 3, looking=True)  # reading the ground truth changes nothing
    assert all(a != b for a, b in zip(first, play(seeing, 4), strict=True))


def test_a_still_picture_takes_the_time_of_its_exposures_and_a_glimpse_none(opened: Any) -> None:
    """A glimpse is taken between two set-points, so cell time must not pass meanwhile."""
    ports = opened(SimulationSettings(garment="small_towel")).ports
    began = ports.clock.now()
    glimpse = ports.camera.glimpse()
    assert ports.clock.now() == began and glimpse.stamp == began
    still = ports.camera.capture()
    assert ports.clock.now() - began == pytest.approx(EXPOSURES * EVERY_S, abs=1e-6) and still.stamp > began
    table = (slice(300, 400), slice(250, 400))
    one, mean = (np.nanstd(np.diff(frame.depth[table], axis=0)) for frame in (glimpse, still))
    assert mean < 0.75 * one


# the arms -------------------------------------------------------------------------------------------


def test_arms_follow_within_their_error(opened: Any) -> None:
    bench = opened().ready()
    bench.move(bench.q + 0.3, 2.0)
    bench.hold(0.5)
    state = bench.ports.arms.state()
    assert np.abs(state.q - bench.q).max() < 0.01


def test_encoder_readings_exclude_the_joint_bias(opened: Any) -> None:
    bench = opened()
    T = bench.truth().tools[Side.LEFT]
    from foldcell.skills.motion.kinematics.ik import tool_pose

    believed = tool_pose(load_model().chains[Side.LEFT], bench.ports.arms.state().q[:7])[:3, 3]
    believed = believed - (0.0, 0.0, bench.height)
    assert 2e-4 < np.linalg.norm(T - believed) < 0.01


@pytest.mark.parametrize("robot", ["baxter", "ur5_pair"])
def test_the_simulated_driver_keeps_the_contract_of_the_ports(robot: str) -> None:
    settings = load_settings().model_copy(update={"robot": robot})
    results = list(check_driver(lambda: opened_rig("sim", settings)))
    assert len(results) == len(CLAUSES)
    assert [(r.of.name, r.reason) for r in results if not r.passed] == []


def test_a_stop_brakes_at_a_bounded_rate(opened: Any) -> None:
    bench = opened(QUIET).ready()
    ports = bench.ports
    speed = np.zeros(14)
    speed[0] = 0.6
    for _ in range(50):
        bench.q = bench.q + speed * DT
        bench.wait(DT)
        ports.arms.command(bench.q, speed)
    ports.stop.trigger("test")
    speeds = []
    for _ in range(60):
        bench.wait(1 / 240)
        speeds.append(ports.arms.state().qd[0])
    assert max(speeds[:3]) > 0.3  # the arm does not halt abruptly
    assert abs(speeds[-1]) < 0.02  # braking from 0.6 rad/s at 6 rad/s2 takes 0.1 s


# the garment ----------------------------------------------------------------------------------------


def test_the_table_is_empty_until_the_attendant_lays_the_garment(opened: Any) -> None:
    bench = opened()
    assert bench.truth().garment is None
    bench.ports.attendant.lay_garment()
    assert bench.ports.clock.now() == pytest.approx(5.0)
    garment = bench.truth().garment
    assert garment is not None
    assert garment.vertices[:, 2].max() < 0.01
    assert np.abs(garment.vertices[:, :2] - garment.material).max() < 0.005
    assert set(garment.keypoints) == {"near_right", "far_right", "far_left", "near_left"}


def test_the_fault_no_garment_leaves_the_table_empty(opened: Any) -> None:
    bench = opened()
    bench.cell.faults.add(Fault(FaultKind.NO_GARMENT))
    bench.ports.attendant.lay_garment()
    assert bench.truth().garment is None
    bench.ports.attendant.lay_garment()
    assert bench.truth().garment is not None


def test_a_corner_can_be_pinched_lifted_and_released(opened: Any) -> None:
    bench = opened(seed=2).ready()
    ports = bench.ports
    ports.attendant.lay_garment()
    point = corner(bench)
    bench.pinch(Side.LEFT, point)
    garment = bench.truth().garment
    assert garment is not None and bench.truth().held[Side.LEFT]
    state = ports.grippers[Side.LEFT].state()
    assert state.opening == pytest.approx(garment.thickness, abs=1e-3)
    assert ports.tactile[Side.LEFT].reading().grip == pytest.approx(12.0, rel=0.15)
    tip = ports.tactile[Side.LEFT].reading().tip
    bench.move(bench.above(Side.LEFT, point, 0.12, np.pi / 2), 1.5)
    lifted = bench.truth().garment
    assert lifted is not None and lifted.vertices[:, 2].max() > 0.10
    assert ports.tactile[Side.LEFT].reading().tip.max() < tip.max()  # the cloth is lifted off the table
    ports.grippers[Side.LEFT].command(0.03, 12.0)
    bench.hold(1.2)
    fallen = bench.truth()
    assert not fallen.held[Side.LEFT]
    assert fallen.garment is not None and fallen.garment.vertices[:, 2].max() < 0.06


def test_tips_pressed_too_high_hold_nothing(opened: Any) -> None:
    bench = opened(seed=2).ready()
    bench.ports.attendant.lay_garment()
    bench.pinch(Side.LEFT, corner(bench), height=0.015)
    assert not bench.truth().held[Side.LEFT]
    assert bench.ports.grippers[Side.LEFT].state().opening < 1e-3
    assert bench.ports.tactile[Side.LEFT].reading().grip < 0.3


def test_the_fault_missed_grasp_affects_one_grasp(opened: Any) -> None:
    bench = opened(seed=2).ready()
    ports = bench.ports
    bench.cell.faults.add(Fault(FaultKind.MISSED_GRASP, side=Side.LEFT, grasp=1))
    ports.attendant.lay_garment()
    bench.pinch(Side.LEFT, corner(bench))
    assert not bench.truth().held[Side.LEFT]
    bench.pinch(Side.LEFT, corner(bench))
    assert bench.truth().held[Side.LEFT]
    assert [fault.kind for _, fault in bench.truth().faults] == [FaultKind.MISSED_GRASP]


def test_the_pads_sense_a_dropped_corner(opened: Any) -> None:
    bench = opened(seed=2).ready()
    ports = bench.ports
    bench.cell.faults.add(Fault(FaultKind.DROPPED_CORNER, side=Side.LEFT, size=0.05))
    ports.attendant.lay_garment()
    point = corner(bench)
    bench.pinch(Side.LEFT, point)
    assert bench.truth().held[Side.LEFT]
    bench.move(bench.above(Side.LEFT, point, 0.12, np.pi / 2), 1.5)
    bench.hold(0.3)
    assert not bench.truth().held[Side.LEFT]
    assert ports.grippers[Side.LEFT].state().opening < 1e-3
    assert ports.tactile[Side.LEFT].reading().grip < 0.5


def test_a_careless_hand_pushes_the_hanging_garment() -> None:
    """One hand holds a corner up. A finger that sweeps through the hanging cloth takes it along."""
    garment = WorldGarment(
        load_garment("small_towel", "bare_table"), load_noise().garment, np.random.default_rng(0), ideal=True
    )
    garment.lay()
    inwards = garment.flat.mean(axis=0) - garment.keypoints["far_left"]
    inwards /= np.linalg.norm(inwards)
    low = np.append(garment.keypoints["far_left"] + 0.02 * inwards, 0.0)
    rotation = np.tile(tool_rotation(np.array(0.0), np.array(0.0), np.array(0.0)), (2, 2, 1, 1))
    assert garment.grip(0, low, rotation[0, 0], 0.03, 15.0).held_points > 0

    def frame(z0: float, z1: float, finger: tuple[Any, Any] | None = None) -> None:
        hands = np.tile(low, (2, 2, 1))
        hands[:, 0, 2] = z0, z1
        hands[:, 1] += (0.0, 0.0, 1.0)
        if finger is None:
            garment.frame(hands, rotation, None)
            return
        foot = np.array([[np.append(p, 0.06)] for p in finger])
        garment.frame(hands, rotation, (foot, foot + np.array([0.0, 0.0, 0.12]), np.array([0.01])))

    heights = 0.15 * (1 - np.cos(np.linspace(0.0, np.pi, 121))) / 2
    for z0, z1 in itertools.pairwise(heights):
        frame(z0, z1)
    for _ in range(90):
        frame(0.15, 0.15)
    hanging = garment.positions
    x = hanging[(hanging[:, 2] > 0.07) & (hanging[:, 2] < 0.12), :2].mean(axis=0)
    across = np.array([-inwards[1], inwards[0]])
    way = [x + s * across for s in np.linspace(-0.14, 0.04, 91)]
    for p0, p1 in itertools.pairwise(way):
        frame(0.15, 0.15, (p0, p1))
    moved = np.linalg.norm(garment.positions - hanging, axis=1)
    assert moved.max() > 0.02


def test_a_world_continues_from_its_checkpoint(opened: Any) -> None:
    bench = opened(QUIET, seed=5).ready()
    bench.ports.attendant.lay_garment()
    bench.pinch(Side.LEFT, corner(bench))
    saved = bench.cell.checkpoint.save()
    before, q = bench.truth(), bench.ports.arms.state().q
    other = opened(QUIET, seed=5)
    other.cell.checkpoint.restore(saved)
    after = other.truth()
    assert before.garment is not None and after.garment is not None
    np.testing.assert_array_equal(after.garment.vertices, before.garment.vertices)
    assert other.ports.clock.now() == bench.ports.clock.now()
    np.testing.assert_allclose(other.ports.arms.state().q, q, atol=1e-6)
    assert after.held == before.held and after.held[Side.LEFT]
    with pytest.raises(DriverError):  # nothing re-arms by itself
        other.ports.arms.command(q, np.zeros(14))
    other.wait(0.5)
    assert other.truth().held[Side.LEFT]


# bad input ------------------------------------------------------------------------------------------


def test_impossible_simulation_settings_are_refused() -> None:
    with pytest.raises(ConfigurationError):
        SimulationSettings(world="clay")
    with (
        pytest.raises(ConfigurationError),
        open_simulated_cell(SimulationSettings(garment="nobodys_towel", render=False), 1),
    ):
        pass


def test_a_closed_cell_refuses_calls_and_can_be_closed_again(opened: Any) -> None:
    bench = opened()
    bench.close()
    bench.close()
    with pytest.raises(DriverError):
        bench.ports.clock.now()
