"""The cloth of the simulated cell, behind one protocol: our own solver's, or MuJoCo's flex."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from numpy.typing import NDArray

from robots.errors import ConfigurationError
from skills.cloth.mesh import ClothMesh
from skills.cloth.pinch import PadGeometry, PinchReport
from skills.cloth.settings import SolverSettings
from skills.cloth.solver import ClothSimulation
from skills.vocabulary import Array, Material

__all__ = ["FRAME_RATE", "BodyTraits", "ClothBody", "build_body", "check_body"]

FRAME_RATE = 60
"""Cloth frames in a second."""


class ClothBody(Protocol):
    """One garment's cloth on the table z = 0 of the table frame, advanced in frames of 1 / FRAME_RATE.

    Hands are 0 and 1; a hand's pose is position (3,) and rotation (3, 3) R_table_tool. What `pads` says when a
    hand grips is what that grip has.
    """

    pads: PadGeometry

    @property
    def positions(self) -> Array:
        """(n, 3) [m], table frame (a copy)."""

    def advance(self, frames: int = 1) -> None:
        """Go on by so many frames, with the hands where they were last."""

    def advance_along(
        self, position: Array, rotation: Array, capsules: tuple[Array, Array, Array] | None = None
    ) -> None:
        """Go on along sampled motions, one sample a frame bound: position (frames + 1, 2, 3) and rotation
        (frames + 1, 2, 3, 3) of both hands; capsules that push the cloth: ends (frames + 1, k, 3) twice and
        radius (k,) [m]."""

    def grip(self, hand: int, position: Array, rotation: Array, force: float) -> PinchReport:
        """Close the pads of `hand` at a pose, squeezing with `force` [N]: what is between them is held, as a
        line about which it can hang, and follows the hand."""

    def release(self, hand: int) -> None:
        """Open the pads of `hand`."""

    def set_grip_force(self, hand: int, force: float) -> None:
        """Squeeze with another force [N]; the cloth slips out beyond 2 * pad friction * force."""

    def held(self, hand: int) -> bool:
        """Whether `hand` still has cloth between its pads."""

    def pinch_force(self, hand: int) -> Array:
        """(3,) [N] mean force of the cloth on the hand over the last frame."""

    def checkpoint(self) -> dict[str, Array]:
        """Everything that decides what comes next, as named arrays."""

    def restore(self, saved: Mapping[str, NDArray]) -> None:
        """Back to a checkpoint of a body with the same mesh, material and traits."""


@dataclass(frozen=True)
class BodyTraits:
    """What of this piece the garment file does not say. anisotropy: stiffness along material y over that along x
    (our own body's only: MuJoCo's shell is isotropic); damping: of stretch and bending, over the usual;
    residual_curvature [1/m]: friction in bending as `SolverSettings` has it (our own body's only: MuJoCo's shell
    has none)."""

    anisotropy: float = 1.0
    damping: float = 1.0
    residual_curvature: float = 0.0


def check_body(world: str, garment: str, layers: int) -> None:
    """Raises ConfigurationError when the world `world` cannot have such a garment, or is not installed."""
    if world != "mujoco":
        return
    if layers != 1:
        raise ConfigurationError(
            f"the mujoco world carries one layer of cloth, and {garment} has {layers}",
            "fold a towel there, or take the world xpbd",
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
    """The cloth of `world`, at rest at `positions` (n, 3). Raises ConfigurationError as `check_body`."""
    check_body(world, "the garment", int(mesh.layer.max()) + 1)
    if world == "mujoco":
        from cell.simulation.garment.mujoco_cloth import MujocoCloth, MujocoSettings

        usual = MujocoSettings()
        settings = MujocoSettings(damping=usual.damping * traits.damping)
        return MujocoCloth(mesh, material, positions, settings, pads=pads)
    base = SolverSettings()
    return ClothSimulation(
        mesh,
        material,
        positions,
        SolverSettings(
            frame_rate=FRAME_RATE,
            anisotropy=traits.anisotropy,
            stretch_damping=base.stretch_damping * traits.damping,
            bend_damping=base.bend_damping * traits.damping,
            residual_curvature=traits.residual_curvature,
        ),
        pads=pads,
    )
