"""Writes the results page of the cloth from the figures of a run.

foldcell bench cloth --peers --json > figures.json
python -m benchmarks.cloth.results figures.json > docs/results/cloth.md
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from benchmarks.figures_file import command, read_figures
from benchmarks.results_page import Row, plain, table, table_of_rows
from foldcell.robots.errors import ConfigurationError

SPEED = "Speed (simulated seconds per CPU second of one thread)"
SECTIONS: Mapping[str, Sequence[Row]] = {
    SPEED: (
        Row("towel, 425 vertices, in half", "towel_425_x_realtime", 50, True, "x"),
        Row("towel, 425 vertices, second fold", "towel_425_second_fold_x_realtime", unit="x"),
        Row("towel, 5200 vertices", "towel_5200_x_realtime", 4, True, "x"),
        Row("two-layer shirt, about 1300 vertices: sleeves", "shirt_1307_sleeve_x_realtime", 20, True, "x"),
        Row("shirt: hem over both sleeves", "shirt_1307_hem_x_realtime", 12, True, "x"),
        Row("shirt: sleeves together with sides", "sides_x_realtime", unit="x"),
        Row("shirt: hem after the sides", "sides_hem_x_realtime", unit="x"),
        Row("shirt: at rest", "shirt_1307_rest_x_realtime", 40, True, "x"),
        Row("throughput of two threads over one (wall time)", "two_threads_x_throughput", 1.8, True, "x"),
        Row("cost over number of vertices: exponent", "cost_exponent"),
        Row("sizes up to 20 000 vertices at which the simulation diverges", "cost_sizes_lost", 0),
        Row("first fold in a new process (wall time)", "first_fold_in_a_new_process_s", unit="s"),
    ),
    "Self-contact of shirt and shipped garments from six starts that differ by 1e-6 m": (
        Row("folds", "starts_folds"),
        Row("folds that end with crossings", "starts_end_crossed"),
        Row("folds with more than 5 crossings in a frame", "starts_crossed_over_5"),
        Row("folds not at rest (motion of more than 0.5 mm)", "starts_not_at_rest"),
    ),
    "Laboratory tests": (
        Row("tilted table: creep in 1 s at 0.98 of the critical slope", "tilt_creep_mm_max", 0.05, unit="mm"),
        Row("tilted table: relative error of the slide at 1.02, 1.1, 1.5", "tilt_slide_error_rel_max", 0.02),
        Row("layer on layer: creep", "tilt_layers_creep_mm_max", 0.05, unit="mm"),
        Row("layer on layer: relative error of the slide", "tilt_layers_slide_error_rel_max", 0.02),
        Row("hung strips, meshes of 15 to 30 mm: error", "hang_strip_error_pp_max", 0.1, unit="pp"),
        Row("hung garments on the mesh of their calibration: error", "hang_garment_error_pp_max", 0.1, unit="pp"),
        Row("hung garments in the predictor: error", "hang_garment_predictors_substeps_error_pp_max", unit="pp"),
        Row("hung garments, one fabric on 15 to 30 mm: error", "hang_garment_mesh_spread_pp_max", unit="pp"),
        Row("cantilever: relative error of the bending length", "bending_error_rel_max", 0.05),
        Row("friction of the paper's garments: relative error", "friction_calibration_error_rel_max", 0.02),
        Row("free space: relative loss of momentum", "momentum_lost_rel"),
        Row("free space: relative gain of kinetic energy", "kinetic_energy_won_rel_max", 0),
        Row("resting sheet: motion in 10 s", "sheet_at_rest_moves_mm_in_10_s", unit="mm"),
        Row("pinch: distance by which the pinched cloth leaves the pads", "pinch_strays_mm_max", unit="mm"),
        Row("pinch: relative error of the measured weight of hung cloth", "pinch_weight_error_rel"),
        Row("pinch: relative error of the force at slip", "pinch_breakaway_error_rel"),
    ),
    "Mesh (all shipped garments, 15 to 30 mm)": (
        Row("smallest angle", "mesh_min_angle_deg", unit="degrees"),
        Row("shortest edge over requested length", "mesh_shortest_edge_rel"),
        Row("longest edge over requested length", "mesh_longest_edge_rel"),
    ),
    "Determinism": (
        Row("same bits when run again", "same_bits_again", 1, True),
        Row("same bits in another process", "same_bits_in_another_process", 1, True),
        Row("same bits in two concurrent threads", "same_bits_in_two_threads_at_once", 1, True),
    ),
    "Independent engines": (
        Row("MuJoCo: speed of the towel fold", "mujoco_towel_x_realtime", unit="x"),
        Row("foldcell's speed over MuJoCo's", "towel_425_speed_over_mujoco", unit="x"),
        Row("MuJoCo: creep on the tilted table", "mujoco_tilt_creep_mm_max", unit="mm"),
        Row("MuJoCo: relative error of the slide", "mujoco_tilt_slide_error_rel_max"),
        Row("MuJoCo: error of hung strips", "mujoco_hang_error_pp_max", unit="pp"),
        Row("MuJoCo: change by the last refinement", "mujoco_refinement_last_change_mm", unit="mm"),
        Row("towel fold: mean distance foldcell to MuJoCo", "mujoco_towel_shape_difference_mm_mean", unit="mm"),
        Row("optimised towel fold: error in foldcell", "optimised_towel_error_mm", unit="mm"),
        Row("optimised towel fold: error in MuJoCo", "mujoco_optimised_towel_error_mm", unit="mm"),
        Row("optimised towel fold: difference", "mujoco_final_error_difference_mm", unit="mm"),
    ),
}  # fmt: skip

CONTACT = "Self-contact"
SCENES = {
    "shirt": "shirt",
    "sides": "shirt, sleeves together with sides",
    "variants": "variants",
}
CONTACT_FIGURES = (
    Row("crossings at the end", "end_crossings", 0),
    Row("most crossings in a frame", "max_crossings", 5),
    Row("motion, mm", "residual_mm_max", 0.5),
    Row("strain, %", "strain_percent_max", 5),
    Row("tensile strain, %", "tension_percent_max", 5),
    Row("edges over 5 %", "edges_over_5_percent"),
    Row("edges examined", "edges_looked_at"),
)  # fmt: skip
"""Columns of the table on self-contact. The full key of a figure is the scene's name, `_` and this key."""


def page(figures: Mapping[str, Any]) -> str:
    """Write the page as Markdown, with one table per section. Figures that were not measured are left out."""
    machine = figures.get("machine") or {}
    on_machine = f" on {machine['cpu']}, {machine['cores']} cores." if "cpu" in machine else "."
    head = [
        "# Results: cloth",
        "",
        "All figures are simulated. The page is generated by `python -m benchmarks.cloth.results` from",
        "`foldcell bench cloth --peers --json`" + on_machine,
        "",
        "- **Crossings** are edges that pass through triangles. **Bar**: the required value of a figure.",
        "- **Speed**: the best of three measurements in a run of the bench (one for MuJoCo).",
        "- **Motion** is the largest motion of a vertex in 0.1 s, one second after the release.",
        "- **Strain** is the elongation or compression of an edge at the end of every fold. Edges within 40 mm or",
        "  two edges of a pinch or a crease are left out. A crease is a fold line, or cloth that turns by more",
        "  than 45 degrees within that distance"
        " ([other angles](#strain-of-the-variants-with-other-definitions-of-a-crease)).",
    ]
    if figures.get("remark"):
        head += ["", str(figures["remark"]).strip()]
    if figures.get("quick"):
        head += ["", "**A quick run: it shows that the bench works, not how good the figures are.**"]
    parts: list[str | None] = ["\n".join(head)]
    for title, rows in SECTIONS.items():
        parts.append(table_of_rows(title, rows, figures))
        if title == SPEED:
            parts.append(_contact(figures))
    for key, title in LISTS.items():
        found = figures.get(key)
        if found:
            flat = [r | inner for r in found for inner in r.get("hung", [{}])]
            names = [k for k in flat[0] if not isinstance(flat[0][k], list)]
            cells = [[plain(r.get(k)) for k in names] for r in flat]
            parts.append(table(title, [_heading(name) for name in names], cells))
    return "\n\n".join(part for part in parts if part) + "\n"


def _contact(figures: Mapping[str, Any]) -> str | None:
    """Write the table on self-contact, one line per scene; None if no scene was measured."""
    bars = ["" if row.bar is None else f" (at most {row.bar:g})" for row in CONTACT_FIGURES]
    lines = []
    for name, title in SCENES.items():
        found = [replace(row, key=f"{name}_{row.key}").cells(figures) for row in CONTACT_FIGURES]
        if any(found):
            lines.append([title, *(_with_verdict(cells) for cells in found)])
    names = ["scene", *(row.about + bar for row, bar in zip(CONTACT_FIGURES, bars, strict=True))]
    return table(CONTACT, names, lines) if lines else None


def _with_verdict(cells: tuple[str, str, str] | None) -> str:
    """Return a measured figure as text, with its required value only if it is not met."""
    if cells is None:
        return "-"
    _, shown, verdict = cells
    return f"{shown} ({verdict})" if "not met" in verdict else shown


def _heading(key: str) -> str:
    """Return the column heading of a figure in a list. If an unknown key ends in a number, this is the number of
    substeps."""
    name, _, count = key.rpartition("_")
    if key not in HEADINGS and count.isdigit():
        return f"{HEADINGS.get(name, name)}, {count} substeps"
    return HEADINGS.get(key, key)


LISTS = {
    "substeps_folds": "Substeps per frame: speed, and mean distance from the result with 48 substeps",
    "variants": "Variants: folds with other friction, thickness and speed",
    "variants_by_turn": "Strain of the variants with other definitions of a crease",
    "starts": "Shirt and shipped garments from six starts that differ by 1e-6 m",
    "hang_garment": "Hung garments of the paper's table",
    "mujoco_refinement": "MuJoCo: refinement of the time step",
    "mujoco_folds": "Towel fold in foldcell and in MuJoCo, over friction",
}
HEADINGS = {
    "chosen": "substeps chosen", "x_realtime": "x real time", "off_mm": "distance mm",
    "thickness_mm": "thickness mm",
    "end": "crossings at the end", "most": "most crossings in a frame", "residual_mm": "motion mm",
    "strain_percent": "strain %", "tension_percent": "tensile strain %", "edges_over_5_percent": "edges over 5 %",
    "edges_looked_at": "edges examined", "turn_degrees": "a crease turns by more than, degrees",
    "end_crossed": "end with crossings", "crossed_over_5": "over 5 crossings in a frame",
    "not_at_rest": "not at rest", "residual_mm_median": "motion mm, median",
    "residual_mm_max": "motion mm, largest",
    "strain_percent_max": "largest strain %", "tension_percent_max": "largest tensile strain %",
    "wanted_percent": "stretch in the paper %", "mesh_mm": "mesh mm", "hang_drop_m": "length of the equal strip m",
    "calibrated_percent": "stretch after calibration %",
    "predictors_substeps_percent": "with the predictor's substeps %",
    "nominal_fabric_percent": "with the fabric of the first mesh %",
    "spread_of_starts_percent": "spread over starts %", "steps_a_frame": "steps per frame",
    "contact_time_ms": "contact time ms", "change_mm": "change mm", "error_mm": "error mm",
    "difference_mm": "mean distance mm", "mujoco_error_mm": "error in MuJoCo mm", "drift_mm": "drift mm",
    "mujoco_drift_mm": "drift in MuJoCo mm",
}  # fmt: skip


def main(arguments: Sequence[str], tell: Callable[[str], Any] = sys.stdout.write) -> int:
    figures = read_figures(arguments, "cloth", "benchmarks.cloth.results")
    known = {row.key for rows in SECTIONS.values() for row in rows} | set(LISTS)
    known |= {f"{name}_{row.key}" for name in SCENES for row in CONTACT_FIGURES}
    if known.isdisjoint(figures):
        raise ConfigurationError(
            f"{arguments[0]} holds no figures of the cloth", "give the output of: foldcell bench cloth --json"
        )
    tell(page(figures))
    return 0


if __name__ == "__main__":
    sys.exit(command(main))
