"""Taking pictures: misleading pictures are refused, and the context keeps valid ones."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.control.motion import Tick
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.folding import _photographer
from foldcell.cell.executive.effects.seeing import await_garment, look, photograph_table
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import CameraFrame
from foldcell.skills.vocabulary import Outcome
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.scenes import TABLE, Scene, camera, empty
from tests.workcells import fake_workcell

recognise = EFFECTS[Effect.RECOGNISE]


class CountingCamera:
    """The fake camera, with a count of its pictures."""

    def __init__(self, camera: Any) -> None:
        self._camera = camera
        self.shots = 0

    def capture(self) -> CameraFrame:
        self.shots += 1
        return replace(self._camera.capture(), sequence=self.shots)

    def glimpse(self) -> CameraFrame:
        return self.capture()


def seeing(pan_calibrated: float = 0.0, **changes: Any) -> tuple[Workcell, CountingCamera]:
    """A cell whose head stands at 0 rad, with a camera calibrated at another angle."""
    ports = FakeCell().ports()
    camera = CountingCamera(ports.camera)
    workcell = fake_workcell(FakeCell(), ports=replace(ports, camera=camera), **changes)
    calibration = replace(workcell.calibration, head_pan=pan_calibrated)
    return replace(workcell, calibration=calibration), camera


@pytest.mark.parametrize("effect", [look, photograph_table])
@pytest.mark.parametrize("pan", [0.05, -0.011, float("nan")])
def test_a_turned_head_is_refused_before_the_picture(effect, pan: float) -> None:
    workcell, camera = seeing(pan)
    result = effect(workcell, RunContext())
    assert result.event is Event.FAILED
    assert result.context.failure.kind is FailureKind.CAMERA_FAULT
    assert "head" in result.context.failure.what and result.context.failure.hint
    assert camera.shots == 0 and result.context.sight.frame is None


@pytest.mark.parametrize("effect", [look, photograph_table])
def test_a_stale_head_reading_is_refused(effect) -> None:
    workcell, camera = seeing()
    old = replace(workcell.ports.arms.state(), stamp=workcell.ports.clock.now() - 0.5)
    arms = SimpleNamespace(state=lambda: old)
    result = effect(replace(workcell, ports=replace(workcell.ports, arms=arms)), RunContext())
    assert result.event is Event.FAILED and camera.shots == 0
    assert result.context.failure.kind is FailureKind.CAMERA_FAULT
    assert "500 ms old" in result.context.failure.what


def test_noise_of_the_head_angle_is_accepted() -> None:
    workcell, camera = seeing(0.008)
    assert look(workcell, RunContext()).event is Event.DONE
    assert camera.shots == 1


def test_the_context_keeps_the_last_two_pictures() -> None:
    """A frozen camera is detected by comparing the last picture with the previous one."""
    workcell, _ = seeing()
    workcell.ports.clock.sleep_until(20.0)
    context = RunContext()
    for _ in range(3):
        context = look(workcell, context).context
    assert (context.sight.frame.sequence, context.sight.previous.sequence) == (3, 2)


def test_the_view_uses_the_refined_camera_pose() -> None:
    """Contours and key points refer to this pose. With another pose they would be drawn at the wrong place."""
    shown: list[Any] = []
    recorder = SimpleNamespace(camera=lambda t, frame, calibration: shown.append(calibration))
    workcell, _ = seeing(recorder=recorder)
    refined = replace(workcell.calibration, T_table_camera=workcell.calibration.T_table_camera + 0.003)
    look(workcell, RunContext())
    look(workcell, context_with(refined=refined))
    watch = _photographer(workcell, refined, np.array([0.0]), [])
    watch(Tick(0.0, workcell.ports.arms.state()))
    assert shown == [workcell.calibration, refined, refined]


def test_a_fold_is_photographed_once_at_each_moment() -> None:
    """A picture that is not ready is asked for again. A camera that fails costs this picture, and no motion."""
    shown: list[Any] = []
    workcell, camera = seeing(recorder=SimpleNamespace(camera=lambda *_: shown.append(at)))
    answers: list[Any] = [None, "picture", DriverError(FailureKind.CAMERA_FAULT, "no picture"), "picture"]
    take = camera.glimpse

    def glimpse() -> CameraFrame | None:
        answer = answers.pop(0)
        if isinstance(answer, DriverError):
            raise answer
        return take() if answer else None

    camera.glimpse = glimpse  # type: ignore[method-assign, assignment]
    pictures: list[CameraFrame] = []
    watch = _photographer(workcell, workcell.calibration, np.array([0.2, 0.5, 0.8]), pictures)
    for at in np.arange(0.0, 1.0, 0.1).round(1):
        assert watch(Tick(float(at), workcell.ports.arms.state())) is None
    assert shown == [0.3, 0.8] and len(pictures) == 2 and not answers


def test_a_failed_look_counts_as_one_camera_fault() -> None:
    workcell, _ = seeing()
    good = look(workcell, RunContext()).context
    turned = replace(workcell, calibration=replace(workcell.calibration, head_pan=0.4))
    failed = look(turned, good)
    assert failed.event is Event.FAILED
    assert failed.context.attempts == {(0, "camera_fault"): 1}


class Camera:
    def __init__(self, frame: CameraFrame) -> None:
        self.capture = lambda: frame


@pytest.mark.parametrize("effect", [look, photograph_table])
def test_a_hanging_camera_is_detected(effect) -> None:
    """The camera returns an old picture of a table without arms, or with the arms in view."""
    cell = FakeCell()
    workcell = fake_workcell(cell)
    workcell = replace(workcell, calibration=replace(workcell.calibration, head_pan=0.0))
    old = workcell.ports.camera.capture()
    workcell.ports.clock.sleep_until(2.0)
    result = effect(replace(workcell, ports=replace(workcell.ports, camera=Camera(old))), RunContext())
    assert result.event is Event.FAILED and result.context.failure.kind is FailureKind.CAMERA_FAULT
    assert "2.0 s old" in result.context.failure.what and result.context.sight.frame is None


def test_a_black_picture_is_no_reference() -> None:
    workcell, _ = seeing()
    frame = workcell.ports.camera.capture()
    black = replace(frame, rgb=np.zeros_like(frame.rgb))
    result = photograph_table(replace(workcell, ports=replace(workcell.ports, camera=Camera(black))), RunContext())
    assert result.event is Event.FAILED and "black" in result.context.failure.what
    assert result.context.sight.reference is None
    assert result.context.sight.frame is None and result.context.sight.shown is black, "for a person"


@pytest.mark.parametrize("part", ["rgb", "depth"])
@pytest.mark.parametrize("since", ["reference", "look", "fold"])
def test_an_old_picture_with_a_fresh_stamp_is_detected(part: str, since: str) -> None:
    """Also one that is older than the last look, or was taken during the fold, and if only colours or depth are
    old."""
    workcell, _ = seeing()
    first = workcell.ports.camera.capture()
    noise = np.random.default_rng(1)
    depth = np.float32(noise.uniform(0.9, 1.1, first.depth.shape))
    old = replace(first, rgb=noise.integers(0, 255, first.rgb.shape, np.uint8), depth=depth)

    def show(frame: CameraFrame) -> Workcell:
        return replace(workcell, ports=replace(workcell.ports, camera=Camera(frame)))

    if since == "fold":
        context = context_with(pictures=(old,))
    else:
        context = look(show(old), RunContext()).context
        context = look(workcell, context).context if since == "reference" else context
    workcell.ports.clock.sleep_until(20.0)
    live = workcell.ports.camera.capture()
    fresh = replace(
        old,
        stamp=20.0,
        sequence=77,
        **{"depth" if part == "rgb" else "rgb": getattr(live, "depth" if part == "rgb" else "rgb")},
    )
    result = look(show(fresh), context)
    assert result.event is Event.FAILED and result.context.failure.kind is FailureKind.CAMERA_FAULT
    assert "old picture" in result.context.failure.what
    assert result.context.sight.frame is context.sight.frame
    assert look(show(live), result.context).event is Event.DONE, "a live camera is used again"


def test_a_recognised_garment_keeps_its_category(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a run with `auto`, a towel that was released half folded looks like a smaller flat one."""
    expected: list[str | None] = []

    def perceiving(*given: Any, **_: Any) -> Outcome[Any]:
        expected.append(given[5])
        return Outcome(failure=Failure(FailureKind.CATEGORY_MISMATCH, "it is smaller"))

    monkeypatch.setattr("foldcell.cell.executive.effects.seeing.perceive", perceiving)
    with ThreadPoolExecutor(1) as workers:
        workcell, _ = seeing(workers=workers)
        first = look(workcell, RunContext()).context
        recognise(workcell, first)
        recognise(workcell, context_with(first, garment=load_garment("medium_towel")))
        told = replace(workcell, expected=load_garment("small_towel"))
        recognise(told, context_with(first, garment=load_garment("medium_towel")))
    assert expected == [None, "medium_towel", "small_towel"], "the garment named on the command line has priority"


def test_the_first_look_at_the_garment_is_kept_until_it_is_laid_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A later look shows the garment where a fold has dragged it, and perhaps crumpled."""
    garment = load_garment("small_towel")
    tops = iter((0.004, 0.006, 0.005))

    def perceiving(*_: Any, **__: Any) -> Outcome[Any]:
        mask = np.ones((100, 100), bool)
        height = np.full(mask.shape, next(tops), np.float32)
        state = garment.flat_state(0.6, 0.0)
        return Outcome(SimpleNamespace(garment="small_towel", state=state, height=height, mask=mask))

    seeing_module = "foldcell.cell.executive.effects.seeing."
    monkeypatch.setattr(seeing_module + "perceive", perceiving)
    monkeypatch.setattr(seeing_module + "draw_on_camera", lambda *_: np.zeros((1, 1, 3), np.uint8))
    workcell, _ = seeing(garments=(garment,))
    recorder: Any = SimpleNamespace(perception=lambda *_: None, camera=lambda *_: None)
    workcell = replace(workcell, recorder=recorder)
    first = recognise(workcell, look(workcell, RunContext()).context)
    stack = 0.5 * garment.material.thickness
    assert first.record["camera_bias_m"] == pytest.approx(0.004 - stack, abs=1e-6)
    again = recognise(workcell, first.context)
    assert again.context.first_look is first.context.first_look and "camera_bias_m" not in again.record
    laid = await_garment(workcell, again.context).context
    assert laid.first_look is None
    assert recognise(workcell, laid).record["camera_bias_m"] == pytest.approx(0.005 - stack, abs=1e-6)


@pytest.mark.parametrize("index", [1, 2])
def test_between_two_folds_the_folded_garment_is_located_and_not_recognised_again(
    index: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folded garment looks like another garment."""
    found = Result(Event.DONE, RunContext())
    monkeypatch.setattr("foldcell.cell.executive.effects.seeing.find_folded", lambda *_: found)
    monkeypatch.setattr(
        "foldcell.cell.executive.effects.seeing.perceive",
        lambda *_, **__: pytest.fail("a folded garment is not recognised as a flat one"),
    )
    workcell, _ = seeing()
    assert recognise(workcell, context_with(look(workcell, RunContext()).context, index=index, steps=())) is found


@pytest.mark.parametrize("simulated", [True, False])
def test_the_time_in_which_a_person_lays_the_garment_is_not_robot_time(simulated: bool) -> None:
    """In simulation, laying takes the declared time, which counts as robot time."""
    workcell, _ = seeing()
    ports = workcell.ports
    ports.clock.sleep_until(20.0)
    laying: Any = SimpleNamespace(lay_garment=lambda: ports.clock.sleep_until(27.0))
    work = replace(workcell, ports=replace(ports, attendant=laying, simulated=simulated))
    result = await_garment(work, RunContext(waited_s=2.0))
    assert result.event is Event.DONE
    assert result.context.waited_s == (2.0 if simulated else 9.0)


def test_no_reference_picture_is_taken_if_it_is_disabled(tmp_path) -> None:
    (tmp_path / "cell.yaml").write_text("camera: {reference: none}")
    workcell, camera = seeing(settings=load_settings(tmp_path / "cell.yaml"))
    result = photograph_table(workcell, RunContext())
    assert (result.event, result.context.sight.reference, camera.shots) == (Event.DONE, None, 0)


def test_a_table_that_contradicts_the_calibration_is_refused() -> None:
    """The camera has been tilted by 2.3 degrees since it was calibrated."""
    cell, T = FakeCell(), np.array(camera().T_table_camera)
    frame = replace(empty(Scene(seed=3)), stamp=cell.ports().clock.now())
    T[:3, :3] = T[:3, :3] @ cv2.Rodrigues(np.array([0.04, 0.0, 0.0]))[0]
    off = replace(camera(), T_table_camera=T)
    ports = replace(cell.ports(), camera=Camera(frame))
    for calibration, good in ((camera(), True), (off, False)):
        with ThreadPoolExecutor(1) as workers:
            work = fake_workcell(cell, ports=ports, table=TABLE, calibration=calibration, workers=workers)
            result = photograph_table(work, RunContext())
        assert (result.event is Event.DONE) == good
    failure = result.context.failure
    assert failure is not None and "the table is tilted by" in failure.what
    assert result.context.sight.shown is frame


def test_an_invisible_table_leaves_the_calibration_unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    for judge in ("obstructed", "tilted_table"):  # the fake depth is no table
        monkeypatch.setattr(f"foldcell.cell.executive.effects.seeing.{judge}", lambda *_: None)
    with ThreadPoolExecutor(1) as workers:
        workcell, _ = seeing(workers=workers)
        result = photograph_table(workcell, RunContext())
    assert result.event is Event.DONE and result.record["refined"] is False
    assert result.context.sight.refined is None and result.context.sight.reference is not None
    assert result.context.sight.calibration(workcell.calibration) is workcell.calibration
    assert np.isfinite(workcell.calibration.T_table_camera).all()
