"""`foldcell calibrate shear`: measures a garment's stretch by comparing its length when hung and when laid
flat."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from calibration.shear import ShearCalibration, calibrate_shear, clip_and_lowest
from cell.commands.calibrate.fabric_calibration import FabricTest, Tell, add_garment_action, add_output, provenance
from cell.commands.options import Commands
from skills.cloth.elasticity import membrane_modulus
from skills.garments.garment import Garment
from skills.vocabulary import REFERENCE_DROP

__all__ = ["add_options", "hang_test", "modulus"]


def add_options(actions: Commands) -> None:
    action = add_garment_action(
        actions, "shear", "a garment's stretch, from its length hanging and lying", _measure,
        {
            "--l1": "from the clip to the lowest point of the hanging garment",
            "--l2": "between the same two points of the garment spread on a table",
        },
        any_surface=False,
    )  # fmt: skip
    action.add_argument("--held", metavar="KEYPOINT", help="key point at the clip (an end of its longest line)")
    add_output(action)


def _measure(garment: Garment, options: argparse.Namespace, surface: str, tell: Tell) -> FabricTest:
    test = hang_test(garment, options.l1, options.l2, options.held, tell)
    l1, l2 = options.l1, options.l2

    def record(path: Path) -> None:
        from cell.view.material import record_shear

        record_shear(path, test)

    return FabricTest(
        values={"stretch_fraction": round(test.stretch_fraction, 5), "hang_drop": round(test.hang_drop, 4)},
        measured={"stretch_fraction": provenance(f"L1 {l1:g} m, L2 {l2:g} m, hung by {_held(garment, options)}")},
        fields=("stretch_fraction",),
        figures={
            "l1_m": l1, "l2_m": l2, "stretch_fraction": test.stretch_fraction,
            "simulated_stretch_fraction": test.simulated, "simulated_spread": test.spread,
            "hang_drop_m": test.hang_drop,
            "strip_stretch_fraction": test.strip_stretch, "membrane_modulus_N_per_m": modulus(garment, test),
            "hung_by": _held(garment, options), "simulations": test.simulations,
        },
        agrees=abs(test.simulated - test.stretch_fraction) <= 1e-3,
        record=record,
    )  # fmt: skip


def hang_test(garment: Garment, l1: float, l2: float, held: str | None, tell: Tell) -> ShearCalibration:
    return calibrate_shear(
        garment.template,
        garment.keypoints,
        garment.layers,
        garment.material,
        l1,
        l2,
        held,
        garment.size_range,
        tell,
        garment.mesh_edge_m,
    )


def _held(garment: Garment, options: argparse.Namespace) -> str:
    return garment.keypoints[clip_and_lowest(garment.template, garment.keypoints, options.held)[0]]


def modulus(garment: Garment, test: ShearCalibration) -> float:
    return membrane_modulus(replace(garment.material, stretch_fraction=test.strip_stretch), REFERENCE_DROP)
