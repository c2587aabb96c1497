"""Makes the film of the README, a whole run in the simulated cell: `python -m benchmarks.film [GARMENT] [SEED]`.

The film is docs/pictures/GARMENT_folded.webp. It shows the robot, the garment and the table from in front, and in
a corner what the camera over the robot's head sees, with the plan. It is faster than the cell. Moments at which
the cell only looks or computes are left out.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.driver import OpenCell
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.report.camera_pictures.live_picture import draw_live
from foldcell.cell.report.pictures.film import FilmFrame, encode_film
from foldcell.cell.runs.fold_run import fold_once
from foldcell.cell.simulation.camera import camera
from foldcell.cell.simulation.camera.display_drawing import DisplayDrawing
from foldcell.cell.simulation.camera.render_server import Scene, Shot
from foldcell.cell.simulation.truth import Truth
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import State
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.vocabulary import CameraCalibration

FOLDER = Path(__file__).parents[1] / "docs" / "pictures"
DEFAULT = ("long_sleeve_shirt_small", "7")
SIZE, INSET = (720, 450), (256, 192)
"""Width and height of the film, and of the camera's picture in it [px]."""
EYE, TARGET, FOCAL = (2.15, -0.85, 1.05), (0.38, -0.08, 0.06), 0.92
"""Where the film is seen from, which point is in its middle [m, base frame], and the focal length in widths."""
FRAMES, FRAME_MS, LAST_MS, QUALITY = 110, 85, 1500, 55
FINE = 2
"""Samples along each side of a pixel."""
MOVING = (
    State.APPROACHING, State.GRASPING, State.LIFTING, State.FOLDING, State.RELEASING, State.RETREATING,
    State.PRESSING,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Moment:
    """One moment of a run. frame: the camera's picture, without the plan; context: what the executive knew."""

    state: State
    shot: Shot
    frame: CameraFrame
    context: RunContext


class RunFilm:
    """Watches a run of the simulated cell, twelve times a second of its time. As an observer it hears of the
    plan."""

    def __init__(self) -> None:
        self.moments: list[Moment] = []
        self.scene: Scene | None = None
        self._state, self._context = State.IDLE, RunContext()

    def entered(self, t: float, step: Step) -> None:
        self._state = step.target

    def performed(self, t: float, step: Step, result: Result) -> None:
        self._context = result.context

    def watch(self, opened: OpenCell, _: CommandQueue) -> None:
        simulated, film = opened.simulated, self
        assert simulated is not None
        shots: list[Shot] = []

        class Noting(DisplayDrawing):
            def __init__(self, scene: Scene) -> None:
                film.scene = scene
                super().__init__(scene)

            def picture(self, shot: Shot):  # type: ignore[no-untyped-def]
                shots.append(shot)
                return super().picture(shot)

        def note(truth: Truth) -> None:
            if truth.garment is not None and (self._state in MOVING or not self.moments):
                frame = simulated.display.take()()
                assert frame is not None
                self.moments.append(Moment(self._state, shots[-1], frame, self._context))

        camera.DisplayDrawing = Noting  # type: ignore[misc]
        simulated.truth.watch(note)


def look_at(eye: Array, target: Array) -> Array:
    """Return the pose (4, 4) of a camera at `eye` with `target` in its middle and its upper edge up."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.transpose([x, np.cross(z, x), z]), eye
    return T


def draw(
    moment: Moment, drawing: DisplayDrawing, names: list[str], calibration: CameraCalibration
) -> NDArray[np.uint8]:
    """Draw one frame of the film, (h, w, 3). drawing: of the scene as the film is seen; names: of the joints."""
    seen = drawing.picture(replace(moment.shot, T_base_camera=look_at(np.array(EYE), np.array(TARGET))))
    picture = cv2.resize(seen.rgb, SIZE, interpolation=cv2.INTER_AREA)
    attempt, progress = moment.context.fold.attempt, None
    if attempt is not None and moment.state in (State.LIFTING, State.FOLDING):
        q = np.array([moment.shot.joints[name] for name in names])
        planned = attempt.motion.fold
        progress = float(planned.t[np.argmin(np.abs(planned.q - q).max(axis=1))] / max(planned.duration, 1e-3))
    plan = draw_live(moment.frame, moment.context.sight.calibration(calibration), attempt, progress)
    inset = cv2.copyMakeBorder(
        cv2.resize(plan, INSET, interpolation=cv2.INTER_AREA),
        2,
        2,
        2,
        2,
        cv2.BORDER_CONSTANT,
        value=(250, 250, 250),
    )
    h, w = inset.shape[:2]
    picture[-h - 6 : -6, 6 : w + 6] = inset
    return np.asarray(picture, np.uint8)


def seen_from_front(scene: Scene) -> DisplayDrawing:
    """Return the drawing of a scene with the lens of the film."""
    width, height = (FINE * n for n in SIZE)
    focal, centre = FOCAL * width, (width / 2, height / 2)
    return DisplayDrawing(replace(scene, width=width, height=height, focal=(focal, focal), centre=centre))


def main() -> int:
    garment, seed = (*sys.argv[1:], *DEFAULT[len(sys.argv) - 1 :])
    settings, film = load_settings(), RunFilm()
    with tempfile.TemporaryDirectory() as logs:
        request = FoldRequest(garment, int(seed), "sim", settings, Path(logs), record=False, record_truth=False)
        result = fold_once(request, film.watch, (film,))
    assert film.scene is not None
    chosen = [film.moments[i] for i in np.linspace(0, len(film.moments) - 1, FRAMES).round().astype(int)]
    drawing, calibration = seen_from_front(film.scene), camera_calibration(settings)
    names = list(load_robot(settings).joint_names)
    pictures = [draw(moment, drawing, names, calibration) for moment in chosen]
    durations = [*[FRAME_MS] * (len(pictures) - 1), LAST_MS]
    path = FOLDER / f"{garment}_folded.webp"
    frames = [FilmFrame(p, ms) for p, ms in zip(pictures, durations, strict=True)]
    write_whole(path, encode_film(frames, QUALITY))
    print(f"{path}: {len(pictures)} frames, {path.stat().st_size / 1e6:.2f} MB, seed {seed}: {result.result}")
    return result.exit_code


if __name__ == "__main__":
    sys.exit(main())
