"""The camera port: a picture that was taken after the request, or a fault with its reason."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from puppet import CAMERA, HandClock, Puppet, wait

from foldcell.cell.executive.effects.seeing import PICTURE_AGE
from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.baxter.ros.ports import camera as camera_module
from foldcell.robots.baxter.ros.ports.camera import RosCamera, read_colour, read_depth, read_intrinsics
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import CameraFrame
from foldcell.robots.ros.driver import CameraTopics
from foldcell.robots.ros.installation import find_ros
from foldcell.robots.ros.node import Node
from tests.optional_parts import ROS

pytestmark = [
    pytest.mark.filterwarnings("ignore:notifyAll"),  # a warning of rospy
    ROS.required,
]
HEIGHT, WIDTH = 3, 4


def image(pixels: np.ndarray, encoding: str, stamp: float = 0.0, padding: int = 0) -> Any:
    m = load_messages()
    height, width = pixels.shape[:2]
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1)
    data = np.pad(rows, ((0, 0), (0, padding)), constant_values=0xAB)
    return m.image(
        header=m.header(stamp=m.time.from_sec(stamp)), height=height, width=width, encoding=encoding,
        is_bigendian=int(pixels.dtype.byteorder == ">"), step=data.shape[1], data=data.tobytes(),
    )  # fmt: skip


def figures(height: int = HEIGHT, width: int = WIDTH, fx: float = 5.0, fy: float = 6.0) -> Any:
    return load_messages().camera_info(height=height, width=width, K=[fx, 0.0, 2.0, 0.0, fy, 1.5, 0.0, 0.0, 1.0])


def colours(n: int) -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 3), n % 256, np.uint8)


def depths(n: int) -> np.ndarray:
    return np.full((HEIGHT, WIDTH), n + 0.5, np.float32)


class Film:
    """Takes a picture on every third tick while a subscriber exists. The n-th picture has colour n and depth n +
    0.5.

    colour, depth: time of the n-th exposure [s]; None: the message is lost.
    """

    def __init__(self, puppet: Puppet) -> None:
        self.puppet = puppet
        self.colour: Callable[[int], float | None] = lambda n: 50.0 + 0.033 * n
        self.depth: Callable[[int], float | None] = lambda n: 50.0 + 0.033 * n
        self.pictures: Callable[[int], tuple[Any, Any]] = lambda n: (
            image(colours(n), "rgb8"), image(depths(n), "32FC1"),
        )  # fmt: skip
        self.info: Any = figures()
        self.taken = 0
        self.unwatched = 0
        puppet.film = self

    def __call__(self) -> Iterator[tuple[str, Any]]:
        if not all(self.puppet.listeners(topic) for topic in CAMERA.values()):
            self.unwatched += 1
            return
        if self.puppet.ticks % 3:
            return
        n, self.taken = self.taken, self.taken + 1
        if self.info is not None:
            yield CAMERA["info"], self.info
        for topic, message, when in zip(
            (CAMERA["rgb"], CAMERA["depth"]), self.pictures(n), (self.colour(n), self.depth(n)), strict=True
        ):
            if when is not None:
                message.header.stamp = load_messages().time.from_sec(when)
                yield topic, message


@pytest.fixture
def film(puppet: Puppet) -> Film:
    return Film(puppet)


@pytest.fixture
def camera(node: Node) -> RosCamera:
    return RosCamera(node, HandClock(), CameraTopics(**CAMERA), exposures=1)


def fault(act: Callable[[], Any]) -> str:
    with pytest.raises(DriverError) as caught:
        act()
    assert caught.value.kind is FailureKind.CAMERA_FAULT
    return caught.value.what


# taking a picture --------------------------------------------------------------------------------------


def test_a_picture_exposed_before_the_request_is_not_returned(film: Film, camera: RosCamera) -> None:
    number = 0
    for _ in range(3):
        film.taken = 0
        frame = camera.capture()
        assert frame.rgb.max() >= 1
        assert frame.sequence > number and frame.stamp == 100.0
        number = frame.sequence
        wait(lambda: not film.puppet.listeners(CAMERA["rgb"]), "nobody looks any more")


def test_colour_and_depth_of_the_same_time_are_combined(film: Film, camera: RosCamera) -> None:
    film.depth = lambda n: 50.010 + 0.033 * n
    for _ in range(3):
        frame = camera.capture()
        np.testing.assert_array_equal(frame.depth, depths(int(frame.rgb[0, 0, 0])))
        assert frame.rgb.shape == (HEIGHT, WIDTH, 3) and frame.depth.dtype == np.float32
        assert not frame.rgb.flags.writeable and not frame.depth.flags.writeable


def test_depth_of_an_earlier_exposure_is_not_used(film: Film, camera: RosCamera) -> None:
    """At 60 pictures per second two depth pictures are near enough in time, and the wrong one arrives first."""
    film.colour = film.depth = lambda n: 50.0 + n / 60
    for _ in range(3):
        frame = camera.capture()
        np.testing.assert_array_equal(frame.depth, depths(int(frame.rgb[0, 0, 0])))


def test_a_picture_with_lost_depth_is_replaced_by_the_next_one(film: Film, camera: RosCamera) -> None:
    film.depth = lambda n: None if n in (1, 2) else 50.0 + 0.033 * n
    frame = camera.capture()
    assert frame.rgb[0, 0, 0] >= 3
    np.testing.assert_array_equal(frame.depth, depths(int(frame.rgb[0, 0, 0])))


def test_a_picture_has_the_camera_intrinsics(film: Film, camera: RosCamera) -> None:
    k = camera.capture().intrinsics
    assert (k.width, k.height, k.fx, k.fy, k.cx, k.cy) == (WIDTH, HEIGHT, 5.0, 6.0, 2.0, 1.5)


def test_the_camera_subscribes_only_while_it_takes_a_picture(
    film: Film, puppet: Puppet, camera: RosCamera
) -> None:
    puppet.let(10)
    assert film.taken == 0
    camera.capture()
    wait(lambda: not any(puppet.listeners(topic) for topic in CAMERA.values()), "nobody looks any more")
    puppet.stays(lambda: film.taken)


# faults ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("silent", "patience"), [(("rgb", "depth", "info"), 0.3), (("depth",), 2.0)])
def test_a_silent_camera_is_a_fault_that_names_the_topics(
    film: Film, camera: RosCamera, monkeypatch, silent: tuple[str, ...], patience: float
) -> None:
    monkeypatch.setattr(camera_module, "ANSWER_S", patience)
    film.puppet.silent |= {CAMERA[name] for name in silent}
    what = fault(camera.capture)
    assert {name for name, topic in CAMERA.items() if topic in what} == set(silent)
    wait(lambda: not any(film.puppet.listeners(topic) for topic in CAMERA.values()), "nobody looks any more")


def test_a_frozen_picture_is_a_fault(film: Film, camera: RosCamera, monkeypatch) -> None:
    monkeypatch.setattr(camera_module, "ANSWER_S", 2.0)
    film.colour = film.depth = lambda n: 50.0
    assert "stands still" in fault(camera.capture)


def test_depth_of_other_moments_is_a_fault(film: Film, camera: RosCamera, monkeypatch) -> None:
    monkeypatch.setattr(camera_module, "ANSWER_S", 2.0)
    film.depth = lambda n: 60.0 + 0.033 * n
    assert "different moments" in fault(camera.capture)


@pytest.mark.parametrize(
    ("colour", "depth", "says"),
    [
        (image(colours(0)[..., 0], "mono8") if find_ros() else None, None, "'mono8'"),
        (None, image(np.ones((6, 8), np.float32), "32FC1") if find_ros() else None, "8x6"),
        (None, image(np.ones((HEIGHT, WIDTH), np.uint8), "8UC1") if find_ros() else None, "'8UC1'"),
    ],
    ids=["colour's encoding", "unregistered depth", "depth's encoding"],
)
def test_an_unreadable_picture_is_a_fault_with_its_reason(
    film: Film, camera: RosCamera, colour: Any, depth: Any, says: str
) -> None:
    usual = film.pictures
    film.pictures = lambda n: (colour or usual(n)[0], depth or usual(n)[1])
    assert says in fault(camera.capture)


def test_the_camera_takes_pictures_again_after_a_fault(film: Film, camera: RosCamera, monkeypatch) -> None:
    film.info = figures(width=99)
    fault(camera.capture)
    film.info = figures()
    assert camera.capture().intrinsics.width == WIDTH


# reading -----------------------------------------------------------------------------------------------

RGB = np.arange(HEIGHT * WIDTH * 3, dtype=np.uint8).reshape(HEIGHT, WIDTH, 3)


@pytest.mark.parametrize("padding", [0, 5])
def test_colours_are_read_in_either_order(padding: int) -> None:
    np.testing.assert_array_equal(read_colour(image(RGB, "rgb8", padding=padding)), RGB)
    np.testing.assert_array_equal(read_colour(image(RGB[..., ::-1], "bgr8", padding=padding)), RGB)


@pytest.mark.parametrize("padding", [0, 3, 8])
@pytest.mark.parametrize("order", ["<", ">"])
def test_depth_is_in_metres_and_nan_where_nothing_was_seen(padding: int, order: str) -> None:
    colour = image(RGB, "rgb8")
    metres = np.array([[0.0, 1.25, np.nan, np.inf], [-1.0, 0.5, 2.0, 3.0], [4.0, 5.0, 6.0, 7.0]])
    seen = np.where(np.isfinite(metres) & (metres > 0.0), metres, np.nan)
    read = read_depth(image(metres.astype(f"{order}f4"), "32FC1", padding=padding), colour)
    np.testing.assert_array_equal(read, seen.astype(np.float32))
    millimetres = np.nan_to_num(1000.0 * seen).astype(f"{order}u2")
    read = read_depth(image(millimetres, "16UC1", padding=padding), colour)
    assert read.dtype == np.float32
    np.testing.assert_allclose(read, np.where(millimetres > 0, seen, np.nan), rtol=1e-6)


def test_truncated_pictures_are_refused() -> None:
    short = image(RGB, "rgb8")
    short.data = short.data[:-1]
    assert "complete rows" in fault(lambda: read_colour(short))
    narrow = image(RGB, "rgb8")
    narrow.step -= 1
    assert "complete rows" in fault(lambda: read_colour(narrow))


@pytest.mark.parametrize("wrong", [{"width": 5}, {"height": 2}, {"fx": 0.0}, {"fy": 0.0}])
def test_intrinsics_of_another_picture_size_are_refused(wrong: dict) -> None:
    assert "intrinsics" in fault(lambda: read_intrinsics(figures(**wrong), image(RGB, "rgb8")))


def test_a_picture_counts_once_the_brightness_has_settled(film: Film, node: Node) -> None:
    clock = HandClock()
    camera = RosCamera(node, clock, CameraTopics(**CAMERA), settle=0.5)
    taken: list[CameraFrame] = []
    thread = threading.Thread(target=lambda: taken.append(camera.capture()), daemon=True)
    thread.start()
    wait(lambda: film.puppet.listeners(CAMERA["rgb"]), "it looks")
    film.puppet.let(20)
    assert not taken
    clock.time += 0.6
    thread.join(30.0)
    assert taken and taken[0].stamp == clock.time


def test_a_still_pictures_depth_is_the_mean_of_its_exposures(film: Film, node: Node) -> None:
    film.pictures = lambda n: (image(colours(n), "rgb8"), image(1.0 + 0.001 * depths(n), "32FC1"))
    camera = RosCamera(node, HandClock(), CameraTopics(**CAMERA), exposures=8)
    frame = camera.capture()
    last = float(frame.rgb[0, 0, 0])
    mean = (float(frame.depth[0, 0]) - 1.0) / 0.001 - 0.5
    assert last - 20.0 < mean < last - 3.499, (
        "depth is the mean of eight exposures, of which some may get lost; the last one gives the colours"
    )


def test_a_slow_camera_returns_the_exposures_taken_in_time(film: Film, node: Node) -> None:
    film.pictures = lambda n: (image(colours(n), "rgb8"), image(1.0 + 0.001 * depths(n), "32FC1"))
    clock = HandClock()
    camera = RosCamera(node, clock, CameraTopics(**CAMERA), exposures=1000)
    taken: list[CameraFrame] = []
    thread = threading.Thread(target=lambda: taken.append(camera.capture()), daemon=True)
    thread.start()
    wait(lambda: film.taken >= 4, "it looks")
    assert not taken
    clock.time += camera_module.EXPOSED_S + 0.05
    thread.join(30.0)
    assert taken and 1.001 < taken[0].depth[0, 0] < 2.0
    assert clock.now() - taken[0].stamp < PICTURE_AGE, "an older picture would be refused by the caller"


def test_a_timeout_keeps_the_exposures_taken_so_far(film: Film, node: Node, monkeypatch) -> None:
    monkeypatch.setattr(camera_module, "ANSWER_S", 2.0)
    camera = RosCamera(node, HandClock(), CameraTopics(**CAMERA), exposures=1000)
    assert camera.capture().depth.shape == (HEIGHT, WIDTH)


def test_a_camera_of_a_slow_clock_is_waited_for(film: Film, node: Node, monkeypatch) -> None:
    """A simulated robot on a busy machine: its clock and its camera are slow alike."""
    monkeypatch.setattr(camera_module, "ANSWER_S", 0.3)
    clock, taken = HandClock(), film.taken
    camera = RosCamera(node, clock, CameraTopics(**CAMERA))
    film.puppet.silent |= set(CAMERA.values())
    ticking = threading.Event()

    def advance() -> None:
        while not ticking.wait(0.02):
            clock.time += 0.002

    threading.Thread(target=advance, daemon=True).start()
    threading.Timer(1.2, film.puppet.silent.clear).start()
    try:
        assert camera.capture().rgb.shape == (HEIGHT, WIDTH, 3) and film.taken > taken
    finally:
        ticking.set()


def test_a_stop_ends_the_wait_for_a_picture(film: Film, node: Node) -> None:
    stopped = threading.Event()
    camera = RosCamera(node, HandClock(), CameraTopics(**CAMERA), settle=60.0, stopped=stopped.is_set)
    threading.Timer(0.3, stopped.set).start()
    with pytest.raises(DriverError) as caught:
        camera.capture()
    assert caught.value.kind is FailureKind.STOPPED
    wait(lambda: not film.puppet.listeners(CAMERA["rgb"]), "nobody looks any more")


def test_a_glimpse_never_waits_and_is_never_old(film: Film, node: Node) -> None:
    clock = HandClock()
    camera = RosCamera(node, clock, CameraTopics(**CAMERA))
    assert camera.glimpse() is None
    seen: list[CameraFrame] = []

    def looked() -> bool:
        frame = camera.glimpse()
        seen.extend([] if frame is None else [frame])
        return bool(seen)

    wait(looked, "it is there")
    assert seen[0].stamp == clock.time
    camera.glimpse()
    film.puppet.let(20)
    clock.time += 5.0
    assert camera.glimpse() is None, "a glimpse is not a picture of another time"
    wait(lambda: not film.puppet.listeners(CAMERA["rgb"]), "nobody looks any more")


def test_a_hanging_master_does_not_block_the_camera(
    film: Film, node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_module, "ANSWER_S", 0.2)
    monkeypatch.setattr(camera_module, "GRACE_S", 0.2)
    released = threading.Event()

    @contextmanager
    def stuck(*_: object, **__: object) -> Iterator[None]:
        released.wait(60.0)
        yield

    monkeypatch.setattr(node, "listening", stuck)
    try:
        with pytest.raises(DriverError, match="cannot be reached"):
            RosCamera(node, HandClock(), CameraTopics(**CAMERA)).capture()
    finally:
        released.set()


def test_a_slow_camera_is_not_waited_for_until_its_picture_is_old() -> None:
    """With an exposure every half second, waiting for another one would make the first too old. With one every
    fifth of a second, the camera waits."""
    wanted = camera_module._Wanted(first=1, settle=0.0, exposures=8)
    for arrivals, handed_over, exposures in (((10.0,), 10.3, 1), ((10.0, 10.2, 10.4), 10.42, 3)):
        pairs = [(t, t, None, None) for t in arrivals]
        shots = camera_module._Shots(info=object(), pairs=pairs)
        assert shots.chosen(wanted, handed_over - 0.01) == []
        assert len(shots.chosen(wanted, handed_over + 0.01)) == exposures
