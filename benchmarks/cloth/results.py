"""The page of the cloth's results, from the figures of a run.

foldcell bench cloth --peers --json > figures.json
python -m benchmarks.cloth.results figures.json > docs/results/cloth.md
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.figures_file import command, read_figures
from benchmarks.results_page import Row, plain, table, table_of_rows
from robots.errors import ConfigurationError

__all__ = ["main", "page"]


SECTIONS: Mapping[str, Sequence[Row]] = {
    "Speed (simulated seconds over CPU seconds of one thread, the best of three)": (
        Row("towel, 425 vertices, in half", "towel_425_x_realtime", 50, True, "x"),
        Row("the same folded once more", "towel_425_second_fold_x_realtime", unit="x"),
        Row("towel, 5200 vertices", "towel_5200_x_realtime", 4, True, "x"),
        Row("two-layer shirt, about 1300 vertices: sleeves", "shirt_1307_sleeve_x_realtime", 20, True, "x"),
        Row("its hem, over both sleeves", "shirt_1307_hem_x_realtime", 12, True, "x"),
        Row("the shirt's sleeves together with its sides", "sides_x_realtime", unit="x"),
        Row("its hem after that", "sides_hem_x_realtime", unit="x"),
        Row("at rest", "shirt_1307_rest_x_realtime", 40, True, "x"),
        Row("two simulations in two threads (wall time)", "two_threads_x_throughput", 1.8, True, "x"),
        Row("cost over vertices, exponent", "cost_exponent"),
        Row("sizes to 20 000 vertices at which the cloth is lost", "cost_sizes_lost", 0),
        Row("a new process to its first fold (wall time)", "first_fold_in_a_new_process_s", unit="s"),
    ),
    "Self-contact": tuple(
        row
        for name, title in (
            ("shirt", "shirt"), ("shirting", "shirt with the stretch of the paper's"), ("pants", "pants"),
            ("sides", "shirt, sleeves together with sides"), ("variants", "variants"),
            ("shipped", "shipped garments"),
        )
        for row in (
            Row(f"{title}: edge-triangle crossings at the end", f"{name}_end_crossings", 0),
            Row(f"{title}: most at any frame", f"{name}_max_crossings", 5),
            Row(f"{title}: motion in 0.1 s, 1 s after the release", f"{name}_residual_mm_max", 0.5, unit="mm"),
            Row(f"{title}: strain away from pinch and crease", f"{name}_strain_percent_max", 5, unit="%"),
            Row(f"{title}: of it tension", f"{name}_tension_percent_max", 5, unit="%"),
            Row(f"{title}: edges strained by more than 5 %", f"{name}_edges_over_5_percent"),
            Row(f"{title}: of so many looked at", f"{name}_edges_looked_at"),
        )
    ),
    "Self-contact, shirt and shipped garments from six starts that differ by 1e-6 m": (
        Row("folds", "starts_folds"),
        Row("that end with crossings", "starts_end_crossed"),
        Row("with more than 5 crossings at a frame", "starts_crossed_over_5"),
        Row("that still move by more than 0.5 mm in 0.1 s, 1 s after the release", "starts_not_at_rest"),
    ),
    "Laboratory tests": (
        Row("tilted table: creep in 1 s at 0.98 of the critical slope", "tilt_creep_mm_max", 0.05, unit="mm"),
        Row("tilted table: way at 1.02, 1.1, 1.5", "tilt_slide_error_rel_max", 0.02),
        Row("a layer on a layer: creep", "tilt_layers_creep_mm_max", 0.05, unit="mm"),
        Row("a layer on a layer: way", "tilt_layers_slide_error_rel_max", 0.02),
        Row("hung strips, meshes of 15 to 30 mm", "hang_strip_error_pp_max", 0.1, unit="pp"),
        Row("hung garments, on the mesh that they are calibrated on", "hang_garment_error_pp_max", 0.1, unit="pp"),
        Row("the same with the predictor's substeps", "hang_garment_predictors_substeps_error_pp_max", unit="pp"),
        Row("one fabric on meshes of 15 to 30 mm", "hang_garment_mesh_spread_pp_max", unit="pp"),
        Row("bending length by the cantilever", "bending_error_rel_max", 0.05),
        Row("friction test of the paper's garments", "friction_calibration_error_rel_max", 0.02),
        Row("momentum lost in the void", "momentum_lost_rel"),
        Row("kinetic energy won in the void", "kinetic_energy_won_rel_max", 0),
        Row("a sheet at rest, in 10 s", "sheet_at_rest_moves_mm_in_10_s", unit="mm"),
        Row("the held line strays from the pads", "pinch_strays_mm_max", unit="mm"),
        Row("weight that a hand feels", "pinch_weight_error_rel"),
        Row("force at which the pads lose the cloth", "pinch_breakaway_error_rel"),
    ),
    "Mesh (all shipped garments, 15 to 30 mm)": (
        Row("smallest angle", "mesh_min_angle_deg", unit="degrees"),
        Row("shortest edge over the one asked for", "mesh_shortest_edge_rel"),
        Row("longest edge over the one asked for", "mesh_longest_edge_rel"),
    ),
    "Determinism and smoothness": (
        Row("the same bits on rerun", "same_bits_again", 1, True),
        Row("in another process", "same_bits_in_another_process", 1, True),
        Row("in two threads at once", "same_bits_in_two_threads_at_once", 1, True),
        Row("1e-6 m grows to (towel, mean)", "towel_1e-6_m_grows_to_mm_mean", unit="mm"),
        Row("1e-6 m grows to (two sleeves, mean)", "shirt_two_sleeves_1e-6_m_grows_to_mm_mean", unit="mm"),
        Row("spread of the cost, towel", "towel_cost_spread_mm", unit="mm"),
        Row("spread of the cost, shirt", "shirt_two_sleeves_cost_spread_mm", unit="mm"),
        Row("roughness of the cost over the arc's height", "towel_cost_roughness_mm", unit="mm"),
    ),
    "Independent engines": (
        Row("MuJoCo: towel", "mujoco_towel_x_realtime", unit="x"),
        Row("our speed over MuJoCo's", "towel_425_speed_over_mujoco", unit="x"),
        Row("PyBullet: towel", "pybullet_towel_x_realtime", unit="x"),
        Row("our speed over PyBullet's", "towel_425_speed_over_pybullet", unit="x"),
        Row("MuJoCo: tilt, creep", "mujoco_tilt_creep_mm_max", unit="mm"),
        Row("MuJoCo: tilt, way", "mujoco_tilt_slide_error_rel_max"),
        Row("MuJoCo: hung strips", "mujoco_hang_error_pp_max", unit="pp"),
        Row("MuJoCo: its last refinement changes the fold by", "mujoco_refinement_last_change_mm", unit="mm"),
        Row("towel fold: ours against MuJoCo's, mean", "mujoco_towel_shape_difference_mm_mean", unit="mm"),
        Row("optimised towel fold: error in our simulation", "optimised_towel_error_mm", unit="mm"),
        Row("optimised towel fold: error in MuJoCo", "mujoco_optimised_towel_error_mm", unit="mm"),
        Row("the difference", "mujoco_final_error_difference_mm", unit="mm"),
    ),
}  # fmt: skip


def page(figures: Mapping[str, Any]) -> str:
    """Markdown: one table a section, of the figures that were measured."""
    machine = figures.get("machine") or {}
    head = [
        "# Results: cloth",
        "",
        "Everything here is simulated. Generated by `python -m benchmarks.cloth.results` from",
        "`foldcell bench cloth --peers --json`"
        + (f" on {machine['cpu']}, {machine['cores']} cores." if "cpu" in machine else "."),
    ]
    head.append(
        "Strain (edges longer or shorter than at rest) is taken 40 mm and two edges away from pinches and "
        "creases: fold lines, and wherever cloth turns by more than 45 degrees within that reach; edges are "
        "counted at the end of every fold."
    )
    if figures.get("remark"):
        head.append(str(figures["remark"]))
    if figures.get("quick"):
        head.append("**A quick run: it shows that the bench works, not how good the figures are.**")
    parts = ["\n".join(head)]
    parts += filter(None, (table_of_rows(title, rows, figures) for title, rows in SECTIONS.items()))
    for key, title in LISTS.items():
        rows = figures.get(key)
        if rows:
            flat = [r | inner for r in rows for inner in r.get("hung", [{}])]
            names = [k for k in flat[0] if not isinstance(flat[0][k], list)]
            parts.append(table(title, names, [[plain(r.get(k)) for k in names] for r in flat]))
    return "\n\n".join(parts) + "\n"


LISTS = {
    "substeps_folds": "Substeps of a frame: speed, and how far a fold ends from that with 48",
    "variants": "Folds with other friction, thickness and speed",
    "variants_by_turn": "Their strain by what is called a crease: cloth that turns by more within reach",
    "shipped": "The shipped garments",
    "starts": "Each of these, from six starts that differ by 1e-6 m",
    "hang_garment": "Hung garments of the paper's table",
    "mujoco_refinement": "MuJoCo's own refinement",
    "mujoco_folds": "The towel fold by both, over friction",
    "pybullet_folds": "PyBullet's soft body on the same fold",
}


def main(arguments: Sequence[str], tell: Callable[[str], Any] = sys.stdout.write) -> int:
    if len(arguments) != 1:
        raise ConfigurationError(
            "one file of figures is expected", "python -m benchmarks.cloth.results figures.json"
        )
    figures = read_figures(Path(arguments[0]), "cloth")
    known = {row.key for rows in SECTIONS.values() for row in rows} | set(LISTS)
    if known.isdisjoint(figures):
        raise ConfigurationError(
            f"{arguments[0]} holds no figures of the cloth", "give the output of: foldcell bench cloth --json"
        )
    tell(page(figures))
    return 0


if __name__ == "__main__":
    sys.exit(command(main))
