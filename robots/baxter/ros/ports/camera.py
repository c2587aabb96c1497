"""The RGB-D camera over ROS, as published by openni2_launch with the depth registered to the colour picture.

The driver subscribes to the topics only while it needs a picture. openni2 publishes only to subscribers.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from threading import Condition
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.depth_averaging import EXPOSURES, mean_depth
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import CameraFrame, Clock, Intrinsics, frozen
from foldcell.robots.ros.driver import CameraTopics
from foldcell.robots.ros.node import Node

ANSWER_S = 4.0
"""Time within which the camera has to answer [s], by the wall and by the cell's clock."""
SLOWEST = 10.0
"""The cell's clock of a simulated robot may be slower than the wall's by this factor."""
POLL_S = 0.02
GRACE_S = 1.0
"""Additional wall time [s]. If the thread that fetches a picture needs longer than its limit plus this time, it
counts as stuck."""
EXPOSED_S = 0.42
"""Maximum cell time from the first exposure of a still picture to its last [s]. After this time, the picture is
made from the exposures that have arrived. The limit is needed because a camera may be slow, and the caller accepts
no picture older than half a second."""
LAST_S = 0.3
"""Longest cell time to wait for one more exposure [s]."""
GLIMPSE_AGE_S = 0.5
"""Largest age of a glimpse, in cell time [s]."""
TOGETHER_S = 0.025
"""Largest difference of the stamps of a colour and a depth image that belong together [s]."""
HINT = "check the camera's cable and driver (openni2_launch with depth_registration:=true)"


@dataclass
class _Shots:
    """Messages since the request: colour and depth by stamp, the latest CameraInfo, and the matched pairs."""

    arrived: Condition = field(default_factory=Condition)
    colour: dict[float, Any] = field(default_factory=dict)
    depth: dict[float, Any] = field(default_factory=dict)
    info: Any = None
    pairs: list[tuple[float, float, Any, Any]] = field(default_factory=list)
    """(stamp of the colour image, cell time of arrival, colour, depth), one per colour image."""

    def pair(self, now: float) -> None:
        """Match each colour image with its closest depth image, once no closer depth image can arrive."""
        for t, colour in sorted(self.colour.items()):
            if any(t == seen for seen, *_ in self.pairs):
                continue
            near = min(self.depth, key=lambda u: abs(u - t), default=None)
            if near is not None and abs(near - t) <= TOGETHER_S and max(self.depth) >= t:
                self.pairs.append((t, now, colour, self.depth[near]))

    def chosen(self, wanted: _Wanted, now: float, last: bool = False) -> list[tuple[float, float, Any, Any]]:
        """Return the pairs for the picture; empty while more pairs must arrive. last: do not wait for more
        pairs."""
        if self.info is None:
            return []
        late = [p for p in self.pairs[wanted.first - 1 :] if p[1] >= self.pairs[0][1] + wanted.settle]
        over = late and now >= min(late[0][1] + EXPOSED_S, late[-1][1] + LAST_S)
        enough = last or over or len(late) >= wanted.exposures
        return late[: wanted.exposures] if enough else []


@dataclass(frozen=True)
class _Wanted:
    """The pairs (colour and depth image) that a picture needs. first: number of the first pair that may be used,
    counted from 1. settle: minimum time between the arrivals of pair 1 and of a pair that is used [s]. exposures:
    number of pairs."""

    first: int
    settle: float
    exposures: int


class _Patience:
    """The end of a wait for a camera, `seconds` after its beginning. A simulated robot on a busy machine has a
    slow clock and an equally slow camera. While the cell's clock advances, it therefore measures the wait, up to
    `SLOWEST` times as much wall time."""

    def __init__(self, clock: Clock, seconds: float) -> None:
        self._clock, self._seconds = clock, seconds
        self._began, self._wall = clock.now(), time.monotonic()

    @property
    def over(self) -> bool:
        wall, cell = time.monotonic() - self._wall, self._clock.now() - self._began
        if wall <= self._seconds:
            return False
        return cell <= 0.0 or cell > self._seconds or wall > SLOWEST * self._seconds


class RosCamera:
    """The camera. settle: streaming time before a picture is used, so that the exposure settles [s]. exposures:
    number of exposures in the mean depth of a still picture. stopped: returns whether the robot is stopped, which
    ends the waiting. A separate thread fetches each picture, so that a missing master blocks nothing else."""

    def __init__(
        self,
        node: Node,
        clock: Clock,
        topics: CameraTopics,
        settle: float = 0.0,
        stopped: Callable[[], bool] = lambda: False,
        exposures: int = EXPOSURES,
    ) -> None:
        self._node, self._clock, self._topics, self._exposures = node, clock, topics, exposures
        self._settle, self._stopped = settle, stopped
        # the numbers differ between processes, so that the executive recognises a repeated picture
        self._numbers = itertools.count(time.time_ns() // 1_000_000)
        self._glimpse: Future[CameraFrame] | None = None

    def capture(self) -> CameraFrame:
        """Take a still picture after the request. The first picture that arrives is skipped, because it may be
        older than the request. Raises DriverError: CAMERA_FAULT if the picture is missing, frozen or unreadable;
        STOPPED."""
        picture = self._fetch(_Wanted(2, self._settle, self._exposures))
        patience = _Patience(self._clock, ANSWER_S + self._settle + GRACE_S)
        while not wait([picture], POLL_S).done:
            self._refuse_stopped()
            if patience.over:
                raise DriverError(FailureKind.CAMERA_FAULT, "the camera's topics cannot be reached", HINT)
        return picture.result()

    def glimpse(self) -> CameraFrame | None:
        """Return the latest requested picture, or None while it has not arrived. A separate thread fetches it."""
        if self._glimpse is not None and self._glimpse.done():
            taken, self._glimpse = self._glimpse, None
            frame = taken.result()
            if self._clock.now() - frame.stamp <= GLIMPSE_AGE_S:
                return frame
        if self._glimpse is None:
            self._glimpse = self._fetch(_Wanted(1, 0.0, 1))
        return None

    def _fetch(self, wanted: _Wanted) -> Future[CameraFrame]:
        """Run `_picture` on a thread."""
        picture: Future[CameraFrame] = Future()

        def fetch() -> None:
            try:
                picture.set_result(self._picture(wanted))
            except BaseException as error:
                picture.set_exception(error)

        threading.Thread(target=fetch, name="picture", daemon=True).start()
        return picture

    def _picture(self, wanted: _Wanted) -> CameraFrame:
        """Wait for messages and return a picture: the colours of the last exposure and the mean depth."""
        shots, messages = _Shots(), load_messages()

        def colour(message: Any) -> None:
            self._put(shots, shots.colour, message)

        def depth(message: Any) -> None:
            self._put(shots, shots.depth, message)

        def info(message: Any) -> None:
            with shots.arrived:
                shots.info = message
                shots.arrived.notify_all()

        with (
            self._node.listening(self._topics.info, messages.camera_info, info),
            self._node.listening(self._topics.depth, messages.image, depth, queue=4),
            self._node.listening(self._topics.rgb, messages.image, colour, queue=4),
            shots.arrived,
        ):
            patience = _Patience(self._clock, ANSWER_S + wanted.settle)
            while not (chosen := shots.chosen(wanted, self._clock.now())):
                if self._stopped() or patience.over:
                    chosen = [] if self._stopped() else shots.chosen(wanted, self._clock.now(), last=True)
                    break
                shots.arrived.wait(POLL_S)
        if not chosen:
            self._refuse_stopped()
            raise DriverError(FailureKind.CAMERA_FAULT, self._missing(shots), HINT)
        _, arrived, rgb, _ = chosen[-1]
        mean = mean_depth([read_depth(depths, rgb) for _, _, _, depths in chosen])
        return CameraFrame(
            arrived, next(self._numbers), frozen(read_colour(rgb)), frozen(mean), read_intrinsics(shots.info, rgb)
        )

    def _refuse_stopped(self) -> None:
        if self._stopped():
            raise DriverError(FailureKind.STOPPED, "stopped before a picture came", "reset the stop first")

    def _put(self, shots: _Shots, where: dict[float, Any], message: Any) -> None:
        with shots.arrived:
            where[message.header.stamp.to_sec()] = message
            shots.pair(self._clock.now())
            shots.arrived.notify_all()

    def _missing(self, shots: _Shots) -> str:
        t = self._topics
        heard = {t.rgb: shots.colour, t.depth: shots.depth, t.info: shots.info}
        silent = [topic for topic, messages in heard.items() if not messages]
        if silent:
            return f"the camera does not answer: nothing on {', '.join(silent)} in {ANSWER_S:.0f} s"
        if not shots.pairs:
            return "colour and depth images are from different moments"
        return "the camera's picture stands still"


def read_colour(message: Any) -> NDArray[np.uint8]:
    """Return the pixels (H, W, 3), RGB, of a sensor_msgs/Image. Raises DriverError(CAMERA_FAULT) for another
    encoding."""
    if message.encoding not in ("rgb8", "bgr8"):
        raise _unread(message, "rgb8 or bgr8")
    rgb = _pixels(message, np.dtype(np.uint8), 3).reshape(message.height, message.width, 3)
    return np.ascontiguousarray(rgb if message.encoding == "rgb8" else rgb[..., ::-1])


def read_depth(message: Any, colour: Any) -> NDArray[np.float32]:
    """Return the depth (H, W) [m], NaN where there is no value. Raises DriverError(CAMERA_FAULT) for another
    encoding, or if the depth is not registered to the colour picture."""
    if (message.height, message.width) != (colour.height, colour.width):
        raise DriverError(
            FailureKind.CAMERA_FAULT,
            f"depth has {message.width}x{message.height} pixels, colour has {colour.width}x{colour.height}", HINT,
        )  # fmt: skip
    order = ">" if message.is_bigendian else "<"
    if message.encoding == "32FC1":
        depth = _pixels(message, np.dtype(f"{order}f4"), 1).astype(np.float32)
    elif message.encoding == "16UC1":
        depth = _pixels(message, np.dtype(f"{order}u2"), 1).astype(np.float32) / np.float32(1000.0)
    else:
        raise _unread(message, "32FC1 or 16UC1")
    return np.where(np.isfinite(depth) & (depth > 0.0), depth, np.float32(np.nan))


def read_intrinsics(info: Any, colour: Any) -> Intrinsics:
    """Return the intrinsics in a sensor_msgs/CameraInfo. Raises DriverError(CAMERA_FAULT) if they do not fit the
    picture or are no numbers."""
    fx, fy, cx, cy = (info.K[k] for k in (0, 4, 2, 5))
    fits = (info.height, info.width) == (colour.height, colour.width)
    if not (fits and np.isfinite([fx, fy, cx, cy]).all() and min(fx, fy) > 0.0):
        raise DriverError(
            FailureKind.CAMERA_FAULT,
            f"the intrinsics do not fit the picture ({info.width}x{info.height} pixels, fx = {fx:g}, fy = {fy:g},"
            f" cx = {cx:g}, cy = {cy:g})",
            HINT,
        )
    return Intrinsics(info.width, info.height, fx, fy, cx, cy)


def _pixels(message: Any, kind: np.dtype, channels: int) -> NDArray:
    """Return the pixels (H, W * channels) without row padding."""
    row = message.width * channels
    rows = np.frombuffer(message.data, dtype=np.uint8)
    empty = message.height == 0 or message.width == 0
    if empty or message.step < row * kind.itemsize or rows.size < message.height * message.step:
        raise _unread(message, "complete rows")
    rows = rows[: message.height * message.step].reshape(message.height, message.step)
    return np.ascontiguousarray(rows[:, : row * kind.itemsize]).view(kind)


def _unread(message: Any, wanted: str) -> DriverError:
    return DriverError(
        FailureKind.CAMERA_FAULT,
        f"the picture has encoding {message.encoding!r}, {message.width}x{message.height} pixels and step"
        f" {message.step}; supported: {wanted}",
        HINT,
    )
