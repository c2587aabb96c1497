"""Requirements on every RobotModel, tested with Baxter and with very different robots: kinematics, inverse
kinematics, timing, collision, and planning a whole fold."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.motion.peers import clearance, jacobian
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, Side
from foldcell.robots.ur5_pair.robot import ROBOT as UR5_PAIR
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.moves.fold import plan_hands_motion
from foldcell.skills.motion.timing.timing import free_motion, peaks, time_path
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.motion.validation.trajectory_check import check_trajectory
from foldcell.skills.vocabulary import GraspId, Table, ToolPath
from tests.builders.stops import stop_profile
from tests.panda_arms import load_pandas
from tests.tool_paths import path_deviation

TABLE = Table(-0.10, (0.20, 1.10), (-0.75, 0.75))


@pytest.fixture(
    scope="module", params=[load_model, load_pandas, UR5_PAIR.load_model], ids=["baxter", "pandas", "ur5_pair"]
)
def model(request: pytest.FixtureRequest) -> RobotModel:
    return request.param()


@pytest.fixture(scope="module")
def checker(model: RobotModel) -> CollisionChecker:
    return CollisionChecker(model, TABLE)


def drawn(model: RobotModel, rng: np.random.Generator) -> Array:
    return rng.uniform(model.planning.lower, model.planning.upper)


def test_joint_vectors_have_the_left_arm_first(model: RobotModel) -> None:
    assert len(model.joint_names) == len(set(model.joint_index.tolist())) == len(model.q_park)
    for side in Side:
        assert all(name.startswith(str(side)) for name in model.joint_names[model.arm(side)])
        moved = np.array(model.q_park)
        moved[model.arm(side)] += 0.1
        assert not np.allclose(model.tool_pose(side, moved), model.tool_pose(side, model.q_park))
        assert np.array_equal(model.tool_pose(side.other, moved), model.tool_pose(side.other, model.q_park))


def test_commissioning_planning_and_protective_limits_are_nested(model: RobotModel) -> None:
    for slow, fast in ((model.commissioning, model.planning), (model.planning, model.protective)):
        for name in ("velocity", "acceleration", "jerk"):
            assert np.all(getattr(slow, name) <= getattr(fast, name))
        assert np.all(slow.lower >= fast.lower) and np.all(slow.upper <= fast.upper)
    assert np.all(model.q_park >= model.planning.lower) and np.all(model.q_park <= model.planning.upper)


def test_kinematics_equal_pinocchio(model: RobotModel) -> None:
    rng, pm = np.random.default_rng(1), model.pin_model
    data = pm.createData()
    for _ in range(30):
        q = drawn(model, rng)
        for side in Side:
            arm, frame = q[model.arm(side)], pm.getFrameId(model.tool_frame[side])
            assert np.abs(ik.tool_pose(model.chains[side], arm) - model.tool_pose(side, q)).max() < 1e-12
            J = pin.computeFrameJacobian(
                pm, data, model.configuration(q), frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
            columns = [pm.joints[pm.getJointId(n)].idx_v for n in model.joint_names[model.arm(side)]]
            assert np.abs(jacobian(model.chains[side], arm) - J[:, columns]).max() < 1e-12


def test_inverse_kinematics_reaches_the_poses_of_random_joints(model: RobotModel) -> None:
    """At least 99.9 % must be reached, so none of 200 may fail."""
    rng = np.random.default_rng(2)
    starts = np.array([drawn(model, rng) for _ in range(60)])
    for k in range(200):
        side = tuple(Side)[k % 2]
        cut = model.arm(side)
        T = model.tool_pose(side, drawn(model, rng))
        found = ik.solve_seeds(model, side, T, np.ascontiguousarray(starts[:, cut]))
        assert len(found) > 0
        for q in found:
            assert np.abs(ik.tool_pose(model.chains[side], q) - T).max() < 1e-7
            assert np.all(q >= model.planning.lower[cut]) and np.all(q <= model.planning.upper[cut])


def test_motions_keep_the_limits_of_the_model(model: RobotModel) -> None:
    rng = np.random.default_rng(3)
    for _ in range(4):
        a, b, c = (drawn(model, rng) for _ in range(3))
        u = np.linspace(0.0, 1.0, 80)[:, None]
        bow = (1 - u) ** 2 * a + 2 * u * (1 - u) * c + u**2 * b
        for motion in (free_motion(a, b, model.planning), time_path(bow, model.planning)):
            assert peaks(motion, model.planning).worst <= 1.0 + 1e-6
            assert motion.q[0] == pytest.approx(a, abs=1e-9) and motion.q[-1] == pytest.approx(b, abs=1e-9)
            stop = stop_profile(motion, 0.4 * motion.duration, model.protective)
            assert stop.duration <= 0.6 + 1e-9 and peaks(stop, model.protective).worst <= 1.0 + 1e-6


def test_parked_arms_are_free_and_crossed_ones_are_not(model: RobotModel, checker: CollisionChecker) -> None:
    assert checker.contact(model.q_park) is None
    plain = CollisionChecker(model, TABLE, body_margin=0.0, table_margin=0.0, fingertip_margin=0.0)
    rng = np.random.default_rng(4)
    met: set[str] = set()
    for _ in range(150):
        q = drawn(model, rng)
        assert plain.in_collision(q) == (clearance(plain, q) <= 1e-6)
        contact = checker.contact(q)
        if contact is not None:
            met.add("table" if contact.second == "table" else "robot")
    assert met == {"table", "robot"}


def test_a_planned_fold_passes_the_execution_check(model: RobotModel, checker: CollisionChecker) -> None:
    """The fold lays the far edge of a small towel onto its near edge."""
    t = np.linspace(0.0, 3.0, 301)
    u = t / 3.0
    share = u**3 * (10 - 15 * u + 6 * u**2)
    paths = {}
    for i, y in ((GraspId.LEFT, 0.19), (GraspId.RIGHT, -0.19)):
        x, z = 0.55 + 0.14 * np.cos(np.pi * share), 0.10 * np.sin(np.pi * share) + 0.01 * share
        zero = np.zeros(len(t))
        paths[i] = ToolPath(t, np.stack([x, np.full(len(t), y), z], axis=1), zero + np.pi / 2, zero, zero)
    motion = plan_hands_motion(model, checker, TABLE, paths, model.q_park).unwrap()
    for part, fingers in (
        (motion.approach, False), (motion.fold, True), (motion.retreat, True), (motion.park, False)
    ):  # fmt: skip
        assert check_trajectory(model, checker, part, part.q[0], model.planning, allow_fingertips=fingers).ok
    intended = {side: paths[p.path] for side, p in motion.postures.items()}
    assert path_deviation(model, TABLE, motion.fold, intended) < 2e-4
