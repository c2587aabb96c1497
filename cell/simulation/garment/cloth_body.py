"""The cloth of the simulated cell: a common protocol for foldcell's own solver and MuJoCo's flex."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from numpy.typing import NDArray

from foldcell.robots.errors import ConfigurationError
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.pinch import PadGeometry, PinchReport
from foldcell.skills.cloth.settings import CREASE_TIME, SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.vocabulary import Array, Material

FRAME_RATE = 60
"""Rate of the cloth frames [Hz]."""


class ClothBody(Protocol):
    """The cloth of one garment, on the table z = 0 of the table frame. It advances in frames of 1 / FRAME_RATE
    [s].

    The hands are numbered 0 and 1. The pose of a hand is a position (3,) [m] and a rotation (3, 3) R_table_tool. A
    grip uses the pad geometry that `pads` has when the grip begins.
    """

    pads: PadGeometry

    @property
    def positions(self) -> Array:
        """A copy of the vertices (n, 3) [m], table frame."""

    def set_positions(self, positions: Array) -> None:
        """Put the vertices at positions (n, 3) [m], at rest. Releases both hands."""

    def advance(self, frames: int = 1) -> None:
        """Advance by `frames`, with the hands at their last poses."""

    def advance_along(
        self, position: Array, rotation: Array, capsules: tuple[Array, Array, Array] | None = None
    ) -> None:
        """Advance along motions of both hands, sampled at the bounds of the frames: position (frames + 1, 2, 3)
        and rotation (frames + 1, 2, 3, 3). capsules: bodies that push the cloth, with both ends (frames + 1, k, 3)
        and radius (k,) [m]."""

    def press(self, pressure: Array) -> None:
        """Let bodies press on the vertices with `pressure` (n,) [Pa] until the next call. Creases take a set."""

    def grip(self, hand: int, position: Array, rotation: Array, force: float) -> PinchReport:
        """Close the pads of `hand` at a pose with `force` [N]. They hold the cloth between them along a line. The
        cloth follows the hand and can turn about that line."""

    def release(self, hand: int) -> None:
        """Open the pads of `hand`."""

    def set_grip_force(self, hand: int, force: float) -> None:
        """Change the grip force [N]. The cloth slips out if it pulls with more than 2 * pad friction * force."""

    def held(self, hand: int) -> bool:
        """Whether `hand` still has cloth between its pads."""

    def pinch_force(self, hand: int) -> Array:
        """Mean force (3,) [N] of the cloth on the hand over the last frame."""

    def checkpoint(self) -> dict[str, Array]:
        """Return the complete state as named arrays."""

    def restore(self, saved: Mapping[str, NDArray]) -> None:
        """Restore a checkpoint of a body with the same mesh, material and traits."""


@dataclass(frozen=True)
class BodyTraits:
    """Properties of one piece of cloth that are not in the garment file.

    anisotropy: stretch stiffness along material y divided by that along x. bending_ratio: the same of the
    rigidities. damping: damping of stretch and bending, divided by the default. residual_curvature [1/m]: bending
    friction, crease_set, crease_time [s]: plastic set of pressed creases, all as in `SolverSettings`. MuJoCo's
    shell is isotropic and keeps no bends.
    """

    anisotropy: float = 1.0
    damping: float = 1.0
    residual_curvature: float = 0.0
    bending_ratio: float = 1.0
    crease_set: float = 0.0
    crease_time: float = CREASE_TIME


def check_body(world: str, garment: str, layers: int) -> None:
    """Check the cloth model `world`. Raises ConfigurationError if it cannot simulate the garment or is missing."""
    if world != "mujoco":
        return
    if layers != 1:
        raise ConfigurationError(
            f"the mujoco world simulates one layer of cloth, but {garment} has {layers}",
            "fold a towel there, or use the world xpbd",
            layers=layers,
        )
    try:
        import mujoco  # noqa: F401
    except ModuleNotFoundError as e:
        raise ConfigurationError(
            "MuJoCo, the cloth of this world, is not installed",
            "install the optional extra: pip install -c constraints.txt -e '.[peers]'",
        ) from e


def build_body(
    world: str, mesh: ClothMesh, material: Material, positions: Array, traits: BodyTraits, pads: PadGeometry
) -> ClothBody:
    """Build the cloth of `world`, which `check_body` has checked, at rest at `positions` (n, 3) [m]."""
    if world == "mujoco":
        from foldcell.cell.simulation.garment.mujoco_cloth import MujocoCloth, MujocoSettings

        default = MujocoSettings()
        settings = MujocoSettings(damping=default.damping * traits.damping)
        return MujocoCloth(mesh, material, positions, settings, pads=pads)
    return ClothSimulation(mesh, material, positions, solver_settings(traits), pads=pads)


def solver_settings(traits: BodyTraits) -> SolverSettings:
    """Return the settings of foldcell's own solver for a piece of cloth."""
    base = SolverSettings()
    return SolverSettings(
        frame_rate=FRAME_RATE,
        anisotropy=traits.anisotropy,
        stretch_damping=base.stretch_damping * traits.damping,
        bend_damping=base.bend_damping * traits.damping,
        residual_curvature=traits.residual_curvature,
        bending_ratio=traits.bending_ratio,
        crease_set=traits.crease_set,
        crease_time=traits.crease_time,
    )
