"""The RGB-D camera of the simulated cell: a client of the render process that adds the errors of the sensor."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.simulation.camera.display_drawing import DisplayDrawing
from foldcell.cell.simulation.camera.render_server import Picture, Scene, Shot
from foldcell.cell.simulation.camera.slabs import Slab, with_slabs
from foldcell.cell.simulation.noise import CameraNoise
from foldcell.cell.simulation.server_process import ServerProcess
from foldcell.robots.depth_averaging import mean_depth
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import CameraFrame, Intrinsics, frozen
from foldcell.skills.vocabulary import Array

PICTURE_TIMEOUT_S = 120.0
"""The render process is restarted if it gives no answer for this wall time [s]. A dead process is noticed at once,
but on a busy machine a picture can take half a minute."""
PICTURES_A_PROCESS = 100
"""After this number of pictures the render process is replaced, because the renderer leaks memory."""
ATTEMPTS = 2


class Renderer:
    """The render process. It starts with this object and is restarted if it dies. A picture depends only on its
    shot and the scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._lock = threading.Lock()
        self._last: tuple[Shot, Picture] | None = None
        self._process: ServerProcess | None = self._start()

    def _start(self) -> ServerProcess:
        process = ServerProcess("foldcell.cell.simulation.camera.render_server", silent=True)
        process.send(self.scene)
        self._count = 0
        return process

    def picture(self, shot: Shot) -> Picture:
        """Render a shot, on any thread. A shot equal to the last one gets the last picture. Raises
        DriverError(CAMERA_FAULT) if two processes in a row fail."""
        with self._lock:
            if self._last is None or not shot.same_as(self._last[0]):
                self._last = shot, self._picture(shot)
            return self._last[1]

    def _picture(self, shot: Shot) -> Picture:
        problem = ""
        for _ in range(ATTEMPTS):
            if self._count >= PICTURES_A_PROCESS:
                self.close()
            self._process = self._process or self._start()
            answer = _ask(self._process, shot)
            if isinstance(answer, Picture):
                self._count += 1
                return answer
            problem = answer
            self.close()
        raise DriverError(
            FailureKind.CAMERA_FAULT,
            f"the render process gave no picture: {problem.strip().splitlines()[-1] if problem else 'it died'}",
            "run `foldcell doctor`; PyBullet's TinyRenderer needs about 300 MB",
        )

    @property
    def pid(self) -> int | None:
        return self._process.pid if self._process else None

    def close(self) -> None:
        if self._process is not None:
            self._process.close(patience_s=1.0)
        self._process = None


def _ask(process: ServerProcess, shot: Shot) -> Picture | str:
    """Return the picture, or the reason why there is none."""
    try:
        process.send(shot)
        answer: Picture | str = process.answer(PICTURE_TIMEOUT_S)
        return answer
    except TimeoutError as error:
        return str(error)
    except (EOFError, OSError) as error:
        return f"the process died ({error or type(error).__name__})"


@dataclass(frozen=True, eq=False)
class _Look:
    """Constant errors of this camera, drawn once per world: gain of each colour channel, vignetting, and the part
    of the depth noise that is the same in every picture."""

    gain: Array
    vignette: NDArray[np.float32]
    grain: Array

    def tint(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the picture (h, w, 3) with these errors of colour."""
        factor = self.vignette[..., None] * self.gain.astype(np.float32)
        return np.asarray(cv2.multiply(rgb, factor, dtype=cv2.CV_8U), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class _DepthNoise:
    """Noise (h, w) of one exposure. grain: its standard deviation is 1; lost, lost_at_edge: pixels without depth,
    anywhere and only at an edge."""

    grain: Array
    lost_at_edge: NDArray[np.bool_]
    lost: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Noise:
    """Noise of one picture. gain: of the exposure; rgb: (h, w, 3) of standard deviation 1; depth: of each
    exposure."""

    gain: float
    rgb: NDArray[np.float32]
    depth: tuple[_DepthNoise, ...]


_Pixels = tuple[NDArray[np.uint8], NDArray[np.float32]]


class _Undeveloped(CameraFrame):
    """A picture that is still being made. Its pixels are set when they are first read, which waits for them."""

    @staticmethod
    def begun(stamp: float, sequence: int, intrinsics: Intrinsics, pixels: Future[_Pixels]) -> CameraFrame:
        frame = _Undeveloped.__new__(_Undeveloped)
        vars(frame).update(stamp=stamp, sequence=sequence, intrinsics=intrinsics, _pixels=pixels)
        return frame

    def __getattr__(self, name: str) -> Any:  # called for attributes that are not set
        if name not in {"rgb", "depth"}:
            raise AttributeError(name)
        rgb, depth = vars(self)["_pixels"].result()
        vars(self).update(rgb=rgb, depth=depth)
        return vars(self)[name]


class SimulatedCamera:
    """Pictures with the errors of the sensor. The noise of a picture depends only on the seed and its sequence
    number, so that the number of pictures changes no other random number of the world.

    shot: returns the world's present state; now: returns the world's time [s]; ideal: no errors.
    """

    def __init__(
        self,
        renderer: Renderer,
        intrinsics: Intrinsics,
        noise: CameraNoise,
        seed: int,
        shot: Callable[[], Shot],
        now: Callable[[], float],
        ideal: bool = False,
    ) -> None:
        self._ideal = ideal
        self._renderer, self._intrinsics, self._noise, self._seed = renderer, intrinsics, noise, seed
        self._shot, self._now = shot, now
        self.sequence = 0
        """Number of pictures taken so far. The last one has this number."""
        self._last: CameraFrame | None = None
        self._drawing: DisplayDrawing | None = None
        self._threads = ThreadPoolExecutor(2, "picture")
        """One thread renders; the other adds the noise."""
        self._look = self._draw_look(np.random.default_rng((seed, 0)), np.random.default_rng((seed, 2)))
        self.frozen = self.black = self.silent = False
        """Faults: the camera repeats its last picture, takes black pictures, or does not answer."""

    def _draw_look(self, rng: np.random.Generator, lasting: np.random.Generator) -> _Look:
        noise, k = self._noise, self._intrinsics
        gain = np.exp(rng.normal(0.0, noise.white_balance, 3))
        v, u = np.mgrid[0 : k.height, 0 : k.width]
        r2 = ((u - k.cx) / k.cx) ** 2 + ((v - k.cy) / k.cy) ** 2
        return _Look(gain, (1.0 - noise.vignette * r2 / 2).astype(np.float32), self._grain(u.shape, lasting))

    def _grain(self, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draw noise of standard deviation 1 in which neighbouring pixels are correlated."""
        width = self._noise.depth_grain_px
        blurred = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), width)
        # the factor makes the standard deviation 1 again after the blur
        return np.asarray(blurred * (2.0 * np.sqrt(np.pi) * width))

    def capture(self, exposures: int = 1, slabs: Sequence[Slab] = ()) -> CameraFrame:
        """Return a picture whose depth is the mean of `exposures` pictures. slabs: objects before the camera that
        are not part of the shot. Raises DriverError(CAMERA_FAULT) if `silent`.

        A picture of one exposure is returned at once and made while the world goes on. Reading its pixels waits
        for them; they are black and without depth if they cannot be rendered. A picture of several exposures is
        complete, or raises DriverError(CAMERA_FAULT).
        """
        if self.frozen and self._last is not None and not self.silent:
            return self._last
        self.sequence += not self.silent
        rng = np.random.default_rng((self._seed, 1, self.sequence))
        pixels = self._begun(exposures, slabs, rng)
        if exposures > 1:
            pixels.result()
        self._last = _Undeveloped.begun(self._now(), self.sequence, self._intrinsics, pixels)
        return self._last

    def close(self) -> None:
        """Complete the pictures that were begun, then close the renderer."""
        self._threads.shutdown()
        self._renderer.close()

    def display(self, slabs: Sequence[Slab] = ()) -> Callable[[], CameraFrame]:
        """Take the present state for a picture that a person sees. A person may look at any time, so this changes
        nothing that `capture` returns. The returned function draws the picture, on one thread at a time, without
        shadows, noise and the calibration board. Raises DriverError like `capture`."""
        last = self._last
        if self.frozen and last is not None and not self.silent:
            return lambda: last
        self._answers()
        now, sequence, black, shot = self._now(), self.sequence, self.black, self._shot()

        def draw() -> CameraFrame:
            self._drawing = self._drawing or DisplayDrawing(self._renderer.scene)
            picture = self._with_slabs(self._drawing.picture(shot), slabs, shot)
            rgb = np.zeros_like(picture.rgb) if black else self._look.tint(picture.rgb)
            return CameraFrame(now, sequence, frozen(rgb), frozen(picture.depth), self._intrinsics)

        return draw

    def _begun(self, exposures: int, slabs: Sequence[Slab], rng: np.random.Generator) -> Future[_Pixels]:
        """Begin a picture of the present state. The noise does not depend on what the picture shows, so it is
        drawn while another process renders."""
        self._answers()
        shot, black, shape = self._shot(), self.black, (self._intrinsics.height, self._intrinsics.width)
        rendered = self._threads.submit(self._renderer.picture, shot)

        def develop() -> _Pixels:
            noise = None if self._ideal else self._draw_noise(exposures, rng)
            if black or (exposures == 1 and rendered.exception()):
                return frozen(np.zeros((*shape, 3), np.uint8)), frozen(np.full(shape, np.nan, np.float32))
            picture = self._with_slabs(rendered.result(), slabs, shot)
            rgb, depth = picture.rgb, picture.depth
            if noise is not None:
                rgb = self._sense_colour(rgb, noise)
                depth = mean_depth([self._sense_depth(depth, exposure) for exposure in noise.depth])
            return frozen(rgb), frozen(depth)

        return self._threads.submit(develop)

    def _answers(self) -> None:
        if self.silent:
            raise DriverError(
                FailureKind.CAMERA_FAULT, "the camera does not answer", "check its cable and its driver"
            )

    def _with_slabs(self, picture: Picture, slabs: Sequence[Slab], shot: Shot) -> Picture:
        if not slabs:
            return picture
        scene = self._renderer.scene
        return with_slabs(picture, slabs, shot.T_base_camera, scene.focal, scene.centre)

    def resume(self, sequence: int) -> None:
        """Continue after the picture of this number, when a world is restored."""
        self.sequence, self._last = sequence, None

    def _draw_noise(self, exposures: int, rng: np.random.Generator) -> _Noise:
        """Draw the noise of one picture."""
        noise, shape = self._noise, (self._intrinsics.height, self._intrinsics.width)
        gain = np.exp(rng.normal(0.0, noise.exposure))
        rgb = rng.standard_normal((*shape, 3), dtype=np.float32)
        depth = tuple(
            _DepthNoise(
                self._grain(shape, rng), rng.random(shape) < noise.edge_loss, rng.random(shape) < noise.pixel_loss
            )
            for _ in range(exposures)
        )
        return _Noise(gain, rgb, depth)

    def _sense_colour(self, rgb: NDArray[np.uint8], drawn: _Noise) -> NDArray[np.uint8]:
        noise = self._noise
        image = np.asarray(cv2.GaussianBlur(rgb.astype(np.float32), (0, 0), noise.blur_px), dtype=np.float32)
        image *= (drawn.gain * self._look.gain).astype(np.float32)
        image *= self._look.vignette[..., None]
        image += drawn.rgb * np.float32(noise.rgb)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def _sense_depth(self, depth: NDArray[np.float32], drawn: _DepthNoise) -> NDArray[np.float32]:
        """Add the errors of stereo triangulation: noise proportional to z squared, quantised disparity, gaps at
        edges."""
        noise = self._noise
        hit = np.isfinite(depth)
        z = np.where(hit, depth, 1.0).astype(np.float64)
        lasting = noise.depth_lasting
        grain = lasting * self._look.grain + np.sqrt(1.0 - lasting**2) * drawn.grain
        noisy = z + noise.depth_sigma * z**2 * grain
        scale = self._intrinsics.fx * noise.depth_baseline / noise.disparity_step
        measured = scale / np.maximum(np.rint(scale / noisy), 1.0)
        lost = _edges(z, noise.edge_jump) & drawn.lost_at_edge | drawn.lost
        measured[~hit | lost] = np.nan
        return measured.astype(np.float32)


def _edges(z: Array, jump: float) -> NDArray[np.bool_]:
    """Return the mask of the pixels within one pixel of a step in depth larger than `jump` [m]."""
    kernel = np.ones((3, 3), np.uint8)
    z32 = z.astype(np.float32)
    return np.asarray(cv2.dilate(z32, kernel) - cv2.erode(z32, kernel) > jump)
