"""`foldcell calibrate paper`: calibrates the garments of the paper and prints the results beside the paper's
values."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from foldcell.calibration.shear import ShearCalibration, clip_and_lowest
from foldcell.cell.commands.calibrate.fabric_calibrations import hang_test, modulus, tilt_test
from foldcell.cell.commands.calibrate.run_on_fabric import add_action, provenance
from foldcell.cell.commands.shared import Commands, answer, check_garment_output, table, teller
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment, shipped_garment_path
from foldcell.cell.config.garments.material_file import with_material
from foldcell.cell.operator.progress.compiling import report_compilation
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.errors import ConfigurationError

PAPER = {
    "long_sleeve_shirt_large": (2.9, 24.3, 200, 0.7),
    "long_sleeve_shirt_small": (2.9, 24.7, 200, 0.7),
    "jeans": (2.9, 19.1, 200, 0.5),
    "pants": (1.7, 21.9, 340, 0.6),
    "large_towel": (2.2, 18.7, 260, 0.5),
    "medium_towel": (3.1, 22.3, 190, 0.6),
    "small_towel": (1.1, 24.3, 530, 0.7),
}
"""Values from the table of garments in Li et al. 2015: stretch [%], friction angle [degrees], shear resistance in
Maya, friction in Maya."""


def add_options(actions: Commands) -> None:
    about = "calibrate the paper's garments and print the results beside the paper's values"
    paper = add_action(actions, "paper", about, _run)
    paper.add_argument("garments", nargs="*", metavar="GARMENT", help="names (all seven)")
    paper.add_argument("--output", type=Path, metavar="DIR", help="folder for the calibrated garment files")
    paper.add_argument("--replace", action="store_true", help="write over files that exist")


def _run(options: argparse.Namespace) -> int:
    """Calibrate the garments with the paper's measurements and print the table. With --output, also write the
    garment files."""
    names = options.garments or list(PAPER)
    surface = load_settings(options.cell).surface
    tell = teller(options.json)
    if options.output is not None and not options.output.is_dir():
        raise ConfigurationError(
            f"cannot write into {options.output}: no such folder", "create it, or give another one"
        )
    for name in names:
        if name not in PAPER:
            raise ConfigurationError(f"the paper's table has no {name!r}", f"it has {', '.join(PAPER)}")
        if options.output is not None:
            check_garment_output(options.output / f"{name}.yaml", options.replace)
    rows = []
    with report_compilation(tell):
        for name in names:
            stretch, degrees, maya_shear, maya_friction = PAPER[name]
            garment = load_garment(name, surface)
            clip, lowest = clip_and_lowest(garment.template, garment.keypoints)
            l2 = math.dist(garment.template[clip], garment.template[lowest])
            hung = hang_test(garment, l2 * (1.0 + 0.01 * stretch), l2, None, tell)
            tilt = tilt_test(garment, math.sin(math.radians(degrees)), 1.0, tell)
            rows.append({
                "garment": name, "paper_stretch_percent": stretch,
                "simulated_stretch_percent": 100.0 * hung.simulated,
                "simulated_spread_percent": 100.0 * hung.spread,
                "hang_drop_m": hung.hang_drop, "membrane_modulus_N_per_m": modulus(garment, hung),
                "paper_maya_shear_resistance": maya_shear, "paper_friction_angle_deg": degrees,
                "friction": tilt.coefficient, "simulated_friction": tilt.simulated,
                "paper_maya_friction": maya_friction,
            })  # fmt: skip
            if options.output is not None:
                _write_paper(options.output / f"{name}.yaml", name, surface, hung)
            tell(f"{name} done")
    lines = table(
        ("garment", "stretch %: paper", "simulated", "spread", "hang drop m", "membrane N/m", "Maya shear",
         "angle deg: paper", "friction tan", "simulated", "Maya"),
        [tuple(v if isinstance(v, str) else f"{v:.3g}" for v in row.values()) for row in rows],
    )  # fmt: skip
    return answer(options, {"calibration": "paper", "simulated": True, "garments": rows}, lines)


def _write_paper(path: Path, name: str, surface: str, hung: ShearCalibration) -> None:
    text = shipped_garment_path(name).read_text(encoding="utf-8")
    values = {"hang_drop": round(hung.hang_drop, 3)}
    source = {"stretch_fraction": provenance("Li et al. 2015, table of garments")}
    write_whole(path, with_material(text, name, values, source, (), surface).encode())
