"""`foldcell optimise` for a user's garment file with a new fold plan.

The exported tool poses are read back and compared with an independent evaluation of the curves.
"""

from __future__ import annotations

import csv
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from foldcell.cell.commands.main import main
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.fold_plan.crease_mesh import predictor_mesh
from foldcell.skills.fold_plan.folding import silhouette, target_vertices
from foldcell.skills.fold_plan.plan import plan_folds

SIDE = 0.36
SPEED = 0.30


def napkin() -> dict[str, Any]:
    """A square towel that is folded twice along its diagonals. No shipped garment has this plan."""
    a = SIDE / 2
    return {
        "title": "Napkin, folded to a triangle",
        "category": "towel",
        "layers": 1,
        "keypoints": {"near_right": [-a, -a], "far_right": [a, -a], "far_left": [a, a], "near_left": [-a, a]},
        "plan": [
            {
                "name": "triangle",
                "line": ["near_left", "far_right"],
                "variants": [
                    {
                        "name": "far_onto_near",
                        "moves": ["far_left"],
                        "grasps": [{"at": "far_left", "inset": [0.02, 0.0]}],
                    }
                ],
            },
            {
                "name": "smaller",
                "line": ["near_right", {"near_left": 0.5, "far_right": 0.5}],
                "variants": [
                    {
                        "name": "left_onto_right",
                        "moves": ["near_left"],
                        "grasps": [{"at": "near_left", "inset": [0.03, 0.0]}],
                    }
                ],
            },
        ],
        "max_tool_speed": SPEED,
        "poses": {"x": [0.58, 0.58], "y": [0.0, 0.0], "angle_deg": [0, 0]},
        "final_layers": 4,
    }


def write(folder: Path, data: dict[str, Any]) -> Path:
    path = folder / "napkin.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """The command's JSON output, and the folder with both exports."""
    folder = tmp_path_factory.mktemp("own")
    path = write(folder, napkin())
    import contextlib
    import io

    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        for suffix in ("csv", "json"):
            export = str(folder / f"poses.{suffix}")
            assert main(["optimise", str(path), "--method", "initial", "--export", export, "--json"]) == 0
    return json.loads(out.getvalue().splitlines()[-1]), folder


def test_a_user_plan_gets_steps_and_target_shapes(tmp_path: Path) -> None:
    """Compared with a hand calculation: the square's corners at (0.58 +- 0.18, +- 0.18), mirrored in the
    diagonals."""
    garment = load_garment(write(tmp_path, napkin()))
    state = garment.flat_state(*garment.poses.middle)
    first, second = plan_folds(state, garment).unwrap()
    assert [s.name for s in (first, second)] == ["triangle", "smaller"]
    centre, a = np.array([0.58, 0.0]), SIDE / 2
    ((side, grasp),) = first.grasps.items()
    inset = 0.02 / np.sqrt(2)
    np.testing.assert_allclose(grasp.point, centre + a - inset, atol=1e-9)
    np.testing.assert_allclose(first.targets[side][:2], centre - a + inset, atol=1e-9)
    triangle = silhouette(second.lines, state.contour)
    x, y = triangle.T
    area = 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))
    assert area == pytest.approx(SIDE**2 / 4, rel=1e-4)
    corners = {tuple(np.round(p - centre, 4) + 0.0) for p in triangle}
    assert {(0.0, 0.0), (-a, -a), (a, -a)} <= corners

    mesh = predictor_mesh(state, garment)
    target = target_vertices(mesh, second.lines, garment.material)
    assert np.all(target[:, 1] <= -np.abs(target[:, 0] - 0.58) + 1e-6), "all cloth is in the last triangle"
    assert target[:, 2].max() == pytest.approx(3.5 * garment.material.thickness), "four layers"


def test_a_new_plan_gets_trajectories_by_simulation(told: tuple[dict[str, Any], Path]) -> None:
    answer, _ = told
    assert answer["garment"] == "napkin" and answer["method"] == "initial"
    assert [s["name"] for s in answer["steps"]] == ["triangle", "smaller"]
    for step in answer["steps"]:
        assert step["failure"] is None and step["simulations"] == 1
        assert 0.0 < step["dissimilarity_m"] < 0.05 * SIDE * np.sqrt(2)
        assert len(step["control_points_m"]) == 1, "one corner is moved by one arm"


def de_casteljau(control: np.ndarray, u: float) -> np.ndarray:
    points = [np.array(p) for p in control]
    while len(points) > 1:
        points = [(1 - u) * a + u * b for a, b in pairwise(points)]
    return points[0]


def nearest(control: np.ndarray, point: np.ndarray) -> tuple[float, float]:
    """Parameter of the curve's nearest point and its distance [m], found by successively finer sampling."""
    low, high = 0.0, 1.0
    for _ in range(7):
        u = np.linspace(low, high, 21)
        away = [float(np.linalg.norm(de_casteljau(control, v) - point)) for v in u]
        k = int(np.argmin(away))
        low, high = u[max(0, k - 1)], u[min(20, k + 1)]
    return float(u[k]), away[k]


def test_the_exported_poses_follow_the_trajectory(told: tuple[dict[str, Any], Path]) -> None:
    answer, folder = told
    with (folder / "poses.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["fold", "arm", "t_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"], (
        "the header states the units"
    )
    garment = load_garment(folder / "napkin.yaml")
    plan = plan_folds(garment.flat_state(*garment.poses.middle), garment).unwrap()
    for step, planned in zip(answer["steps"], plan, strict=True):
        ((arm, control),) = step["control_points_m"].items()
        own = [r for r in rows if r["fold"] == step["name"] and r["arm"] == arm]
        t, *xyz = (np.array([float(r[k]) for r in own]) for k in ("t_s", "x_m", "y_m", "z_m"))
        position = np.stack(xyz, axis=1)
        assert t[0] == 0.0 and np.all(np.diff(t) > 0)
        speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / np.diff(t)
        assert speed.max() <= 1.05 * SPEED and max(speed[0], speed[-1]) < 0.05 * SPEED

        rising = t < t[-1] - step["duration_s"] - 1e-5
        lift, up, arc = step["lift_m"], position[rising], position[~rising].copy()
        assert np.allclose(up[:, :2], position[0, :2], atol=1e-6) and np.all(np.diff(up[:, 2]) > 0)
        assert arc[0] == pytest.approx(position[0] + (0, 0, lift), abs=1e-5), (
            "the tool moves straight up before the arc"
        )
        left = np.linspace(1, 0, len(arc))
        arc[:, 2] -= lift * left**2 * (3 - 2 * left)
        t, position = t[~rising], arc
        control = np.array(control)
        some = np.unique(np.linspace(0, len(t) - 1, 25).astype(int))
        on_curve = [nearest(control, position[i]) for i in some]
        assert max(away for _, away in on_curve) < 3e-6
        u = [parameter for parameter, _ in on_curve]
        assert u[0] < 1e-4 and u[-1] > 1 - 1e-4 and np.all(np.diff(u) > 0)
        assert np.allclose(position[0, :2], next(iter(planned.grasps.values())).point, atol=1e-6)
        assert np.allclose(position[-1], next(iter(planned.targets.values())), atol=1e-6)

        speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / np.diff(t)
        assert speed.max() <= 1.002 * SPEED

        q = np.array([[float(r[k]) for k in ("qx", "qy", "qz", "qw")] for r in own])
        assert np.allclose(np.linalg.norm(q, axis=1), 1.0, atol=3e-6)
        matrix = Rotation.from_quat(q).as_matrix()
        assert np.allclose(matrix[:, :, 2], [0, 0, -1], atol=1e-5), "the hand points down"
        across = matrix[:, :2, 0] @ planned.line.normal
        assert np.allclose(across, 0, atol=1e-5), "the held line lies along the fold line"


def test_exported_tools_keep_the_speed_limit_of_the_cell(tmp_path: Path) -> None:
    garment, out = write(tmp_path, napkin()), tmp_path / "poses.csv"
    (tmp_path / "cell.yaml").write_text("motion: {tool_speed: 0.12}\n")
    line = ["optimise", str(garment), "--step", "1", "--method", "initial", "--export", str(out)]
    assert main([*line, "--cell", str(tmp_path / "cell.yaml")]) == 0
    with out.open(newline="") as file:
        t, *xyz = np.array([[float(r[k]) for k in ("t_s", "x_m", "y_m", "z_m")] for r in csv.DictReader(file)]).T
    speed = np.linalg.norm(np.diff(xyz), axis=0) / np.diff(t)
    assert 0.10 < speed.max() < 0.125 < SPEED


def test_both_export_formats_hold_the_same_poses(told: tuple[dict[str, Any], Path]) -> None:
    _, folder = told
    value = json.loads((folder / "poses.json").read_text())
    assert value["garment"] == "napkin" and value["frame"] == "table" and value["schema"] == 1
    with (folder / "poses.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for fold, arms in value["folds"].items():
        for arm, numbers in arms.items():
            own = [[float(r[k]) for k in value["columns"]] for r in rows if (r["fold"], r["arm"]) == (fold, arm)]
            assert np.array_equal(own, numbers)


def moved_line(shift: float) -> list[dict[str, float]]:
    """A line parallel to x at `shift` times the square's side from its left edge."""
    return [{"near_left": 1 - shift, "near_right": shift}, {"far_left": 1 - shift, "far_right": shift}]


@pytest.mark.parametrize(
    ("step", "line", "words"),
    [
        (0, moved_line(1.5), ["plan.triangle.line", "misses it by 180 mm"]),
        (0, moved_line(0.98), ["plan.triangle.line", "cuts off 7 mm"]),
        (1, ["far_left", {"near_left": 0.6, "far_left": 1.0, "far_right": -0.6}], ["plan.smaller.line"]),
        (0, ["near_left", "near_left"], ["plan.triangle.line", "no fold line"]),
    ],
)
def test_a_line_that_misses_the_garment_is_refused_by_name(
    step: int, line: list[Any], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = napkin()
    data["plan"][step]["line"] = line
    path = write(tmp_path, data)
    export = tmp_path / "poses.csv"
    for command in (["optimise", str(path), "--method", "initial", "--export", str(export)],
                    ["garment", "check", str(path)]):  # fmt: skip
        assert main(command) == 64
        said = "".join(capsys.readouterr())
        assert all(word in said for word in ["napkin.yaml", *words]), said
        assert "Traceback" not in said
    assert not export.exists()
