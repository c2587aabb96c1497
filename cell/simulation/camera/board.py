"""The calibration board in the simulated world, and the person who holds it in front of the camera."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.calibration.board import BOARD
from foldcell.cell.simulation.noise import BoardNoise, BuildNoise
from foldcell.robots.ports import Array, BoardPlace, Intrinsics, Side
from foldcell.skills.vocabulary import Table

PIXELS_A_METRE = 4000
IN_HAND = {BoardPlace.LEFT_HAND: Side.LEFT, BoardPlace.RIGHT_HAND: Side.RIGHT}


def built_table(table: Table, noise: BuildNoise, rng: np.random.Generator) -> Table:
    """Return the true table. Its height differs from the nominal height by a random error [m]."""
    return Table(table.height + noise.table_height * float(rng.standard_normal()), table.x, table.y)


def built_lens(drawn: Intrinsics, noise: BuildNoise, rng: np.random.Generator) -> Intrinsics:
    """Return the true intrinsics of the colour camera [px]. They differ from the data sheet by random errors."""
    fx, fy = np.array([drawn.fx, drawn.fy]) * (1.0 + noise.focal * rng.standard_normal(2))
    cx, cy = np.array([drawn.cx, drawn.cy]) + noise.centre * rng.standard_normal(2)
    return Intrinsics(drawn.width, drawn.height, float(fx), float(fy), float(cx), float(cy))


class WorldBoard:
    """One printed calibration board. `bring` moves it to a place and draws a new random pose."""

    def __init__(self, noise: BoardNoise, rng: np.random.Generator) -> None:
        self._noise, self._rng = noise, rng
        self.scale = 1.0 + noise.print_scale * float(rng.standard_normal())
        self._place = BoardPlace.AWAY
        self._T = np.eye(4)

    @property
    def picture(self) -> NDArray[np.uint8]:
        """(h, w, 3) RGB picture of the printed card."""
        return np.asarray(cv2.cvtColor(BOARD.image(PIXELS_A_METRE), cv2.COLOR_GRAY2RGB), dtype=np.uint8)

    @property
    def size(self) -> tuple[float, float]:
        """Width and height as printed [m]."""
        return BOARD.size[0] * self.scale, BOARD.size[1] * self.scale

    def bring(self, place: BoardPlace) -> None:
        self._place = place
        self._T = self._shown() if place is BoardPlace.SHOWN else self._held()

    def pose(self, T_base_camera: Array, T_base_tool: Mapping[Side, Array]) -> Array | None:
        """Return the present pose (4, 4) of the board in the base frame; None if its place is AWAY."""
        if self._place is BoardPlace.AWAY:
            return None
        if self._place is BoardPlace.SHOWN:
            return np.asarray(T_base_camera @ self._T)
        return np.asarray(T_base_tool[IN_HAND[self._place]] @ self._T)

    def _shown(self) -> Array:
        """Draw a random pose (4, 4) of the board in the camera frame: tilted, within the camera's view."""
        rng, noise = self._rng, self._noise
        z = noise.shown_distance.draw(rng)
        T = np.eye(4)
        T[:3, 3] = z * np.array([rng.uniform(-0.38, 0.38), rng.uniform(-0.27, 0.27), 1.0])
        lean = noise.shown_tilt * float(np.sqrt(rng.random()))
        about = rng.uniform(0.0, 2 * np.pi)
        turn = rng.uniform(-0.5, 0.5)
        axis = lean * np.array([np.cos(about), np.sin(about), 0.0])
        T[:3, :3] = cv2.Rodrigues(axis)[0] @ cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0]
        return T

    def _held(self) -> Array:
        """Draw a random pose (4, 4) of the board in the tool frame: its tab is between the pads, with a small
        error."""
        rng, noise = self._rng, self._noise
        T = np.array(BOARD.T_tool_board)
        T[:3, :3] = T[:3, :3] @ cv2.Rodrigues(noise.held_angle * rng.standard_normal(3))[0]
        T[:3, 3] += noise.held_position * rng.standard_normal(3)
        return T
