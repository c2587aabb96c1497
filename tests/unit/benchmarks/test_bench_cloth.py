"""The cloth bench: its parts, the reuse of saved figures, and the places of strain and creases."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import benchmarks.cloth as bench
from benchmarks.cloth.results import page
from benchmarks.cloth.scenes import MATERIAL, TOWEL, frames_of, mirrored, shirt_folds, towel_half, towel_mesh
from benchmarks.cloth.strain import edge_strains, on_the_line
from foldcell.cell.commands.main import main
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.cloth.strain import TURN, reach, turns
from tests.optional_parts import MUJOCO


def test_finished_parts_are_reused_and_others_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, told, measured = tmp_path / "kept.json", [], []

    def made(self: bench.Part, quick: bool, tell: bench.Tell) -> dict[str, float]:
        measured.append(self.function)
        tell("half of it")
        if len(measured) == 2:
            raise KeyboardInterrupt
        return {self.function: float(len(measured))}

    monkeypatch.setattr(bench.Part, "measure", made)
    with pytest.raises(KeyboardInterrupt):
        bench.measure(told.append, peers=False, quick=True, only=["towel", "tilt"], keep=file)
    figures = bench.measure(told.append, peers=False, quick=True, only=["towel", "tilt"], keep=file)
    assert figures == {"speed:towel": 1.0, "physics:tilt": 3.0}
    assert measured == ["speed:towel", "physics:tilt", "physics:tilt"]
    assert told.count("      half of it") == 3, "a part reports its progress"
    # a full run does not take the figures of a quick one
    assert bench.measure(told.append, peers=False, quick=False, only=["towel"], keep=file)["speed:towel"] == 4.0
    with pytest.raises(ConfigurationError, match="no part"):
        bench.measure(told.append, peers=False, quick=True, only=["towels"])
    file.write_text(json.dumps([1]))
    with pytest.raises(ConfigurationError, match="holds no figures"):
        bench.measure(told.append, peers=False, quick=True, only=["towel"], keep=file)
    before = list(measured)
    with pytest.raises(ConfigurationError, match="cannot be written"):
        bench.measure(told.append, peers=False, quick=True, only=["towel"], keep=tmp_path / "no" / "such.json")
    assert measured == before, "nothing is measured if the figures cannot be saved"


def test_every_part_is_a_function_of_the_bench() -> None:
    import importlib

    for name, part in bench.PARTS.items():
        if part.needs is not None:
            assert part.needs == MUJOCO.name
            MUJOCO.require()
        module, function = part.function.split(":")
        assert callable(getattr(importlib.import_module(f"benchmarks.cloth.{module}"), function)), name


def test_bench_only_selects_parts_of_the_cloth_bench(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "cloth", "--only", "nothing"]) == 64
    assert main(["bench", "cloth", "--quick", "--only", "mesh", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert main(["bench", "cloth", "--quick", "--only", "substeps"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert "substeps_folds" in shown and sum(line.startswith("towel ") for line in shown) == 2
    assert figures["mesh_min_angle_deg"] > 20.0 and "towel_425_x_realtime" not in figures
    assert main(["bench", "motion", "--only", "mesh"]) == 64


def test_a_fold_frame_by_frame_equals_the_predicted_fold() -> None:
    mesh, material = towel_mesh(60)
    flat = mesh.lay_flat(material.thickness)
    *_, last = frames_of(mesh, flat, material, towel_half())
    assert last.tobytes() == predict_fold(mesh, flat, material, towel_half(), 0.3, 1.0).vertices.tobytes()
    # the moved half is 0.3 m from its target on average
    assert mirrored(mesh, material, flat) == pytest.approx(0.15, abs=0.005)


def strains(mesh: ClothMesh, x: Array, pinched: Array, lined: NDArray[np.bool_]) -> Array:
    return edge_strains(mesh, x, pinched, lined).away()


def test_strain_is_found_away_from_the_pinch_and_the_crease() -> None:
    mesh, _ = towel_mesh(425)
    x = mesh.lay_flat(MATERIAL.thickness)
    x[:, 0] *= 1.03
    none, smooth = np.zeros((0, 2)), np.zeros(len(x), bool)
    assert strains(mesh, x, none, smooth).max() == pytest.approx(0.03, abs=1e-6)
    x[:, 0] *= 0.96 / 1.03
    assert strains(mesh, x, none, smooth).min() == pytest.approx(-0.04, abs=1e-6)
    x = mesh.lay_flat(MATERIAL.thickness)
    pulled = int(np.argmin(np.linalg.norm(mesh.rest - [0.2, 0.1], axis=1)))
    x[pulled, 0] += 0.005
    assert np.abs(strains(mesh, x, none, smooth)).max() > 0.1
    assert np.abs(strains(mesh, x, mesh.rest[[pulled]], smooth)).max() < 1e-9
    # the towel's fold line is x = 0 on the table, so the crease is the cloth at x = 0
    flat = mesh.lay_flat(MATERIAL.thickness)
    shift = np.array([0.2, 0.0, 0.0])
    line = on_the_line(flat, towel_half(), 0.05)
    assert line.sum() == (np.abs(flat[:, 0]) < 0.05).sum() > 0
    assert np.abs(strains(mesh, x, none, line)).max() > 0.1
    assert np.abs(strains(mesh, x, none, on_the_line(flat + shift, towel_half(), 0.05))).max() > 0.1
    assert np.abs(strains(mesh, x, none, on_the_line(flat - shift, towel_half(), 0.05))).max() < 1e-9


def turned_over(mesh: ClothMesh, radius: float) -> Array:
    """The cloth beyond x = 0 turned back by 180 degrees around a cylinder along y, without strain. radius [m]."""
    s = mesh.rest[:, 0]
    angle = np.clip(s / radius, 0.0, np.pi)
    beyond = np.where(s < 0.0, s, np.maximum(s - np.pi * radius, 0.0) * -1.0)
    return np.column_stack([beyond + radius * np.sin(angle), mesh.rest[:, 1], radius * (1.0 - np.cos(angle))])


@pytest.mark.parametrize("edge", [0.010, 0.015, 0.020, 0.026])
@pytest.mark.parametrize("radius", [0.002, 0.02, 0.04])
def test_a_crease_has_the_same_width_on_any_mesh(edge: float, radius: float) -> None:
    """Cloth counts as near a crease if it turns by more than TURN within its reach. A limit on the angle of single
    hinges would depend on the mesh: an arc of 20 mm would be a crease on a mesh of 26 mm, but not on one of 10
    mm."""
    mesh = mesh_from_contour(TOWEL, edge)
    near = turns(mesh, turned_over(mesh, radius)) > TURN
    s = mesh.rest[:, 0]
    wide = reach(mesh) - radius * TURN
    outside = np.maximum(-s, s - np.pi * radius)  # distance from the arc along the cloth [m]
    assert near[outside < wide - edge].all() and not near[outside > wide + edge].any()


def test_bends_rounder_than_a_crease_are_measured() -> None:
    mesh = mesh_from_contour(TOWEL, 0.020)
    assert np.rad2deg(turns(mesh, turned_over(mesh, 0.15)).max()) == pytest.approx(
        np.rad2deg(2.0 * reach(mesh) / 0.15), abs=np.rad2deg(0.020 / 0.15)
    )


def test_a_crease_in_one_of_two_layers_counts_as_a_crease() -> None:
    """Only the upper of two layers is bent, and both layers at this place count."""
    mesh = mesh_from_contour(TOWEL, 0.020, layers=2)
    x = mesh.lay_flat(MATERIAL.thickness)
    flat = turns(mesh, x).copy()
    inner = (np.abs(mesh.rest) < [0.25, 0.15]).all(axis=1)
    upper = (mesh.layer == 1) & inner
    x[upper, 2] += np.maximum(0.0, 0.03 - np.abs(mesh.rest[upper, 0]))  # a ridge of 45 degrees on either side
    bent = turns(mesh, x)
    middle = (np.abs(mesh.rest) < [0.005, 0.1]).all(axis=1)
    assert flat[inner & (np.abs(mesh.rest) < [0.2, 0.1]).all(axis=1)].max() < 0.1
    assert (bent[middle] > TURN).all() and len(set(mesh.layer[middle])) == 2


def test_the_benchmark_shirt_is_folded_like_a_planned_shirt() -> None:
    mesh, folds = shirt_folds()
    assert 1250 < len(mesh.rest) < 1350 and mesh.layer.max() == 1
    # one hand folds each sleeve to the other side, and both hands fold the hem
    assert np.ptp(mesh.rest, axis=0) == pytest.approx([0.65, 1.20], abs=1e-6)
    assert [len(paths) for paths in folds] == [1, 1, 2]
    for paths in folds[:2]:
        (path,) = paths.values()
        assert path.position[0, 1] * path.position[-1, 1] < 0.0
    for path in folds[2].values():
        assert path.position[-1, 0] - path.position[0, 0] > 0.5


def test_the_results_page_marks_unmet_targets_and_omits_unmeasured_figures() -> None:
    hung = [{"mesh_mm": 20.0}, {"mesh_mm": 30.0}]
    text = page({
        "towel_425_x_realtime": 61.0, "shirt_end_crossings": 2, "same_bits_again": True,
        "hang_garment": [{"garment": "pants", "wanted_percent": 1.7, "hung": hung}],
    })  # fmt: skip
    assert "| towel, 425 vertices, in half | 61 x | at least 50 |" in text
    assert "at most 0: **not met**" in text and "| True | at least 1 |" in text
    assert "| pants | 1.7 | 30 |" in text
    assert "| MuJoCo" not in text, "no row for a peer that was not measured"
