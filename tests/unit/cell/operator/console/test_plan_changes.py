"""The page asks for changes of the plan: which are offered, and where dragged points lie on the table."""

from __future__ import annotations

import json

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.operator.console.live_view import LiveView
from foldcell.cell.operator.console.messages import CommandMessage, EditMessage, PlanChange, read_message
from foldcell.cell.operator.console.plan_changes import offered_changes, on_picture, on_table, plan_edit
from foldcell.cell.report.camera_pictures.projected_drawing import SCALE, ProjectedDrawing
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.vocabulary import GraspId
from tests.builders.contexts import context_with
from tests.scenes import Scene, camera, render

TOWEL = load_garment("medium_towel")
STATE = TOWEL.flat_state(*TOWEL.poses.middle)
STEPS = plan_folds(STATE, TOWEL).unwrap()


def asked(index: int = 0) -> RunContext:
    return context_with(garment=TOWEL, flat=STATE, steps=STEPS, step=STEPS[index], index=index)


def test_places_of_the_picture_are_those_of_the_drawing() -> None:
    """A dragged point must lie where the cell has drawn it."""
    points = np.array([[0.5, 0.2], [0.7, -0.1], [0.62, 0.0]])
    frame = render(Scene(), camera())
    drawn = ProjectedDrawing(frame, camera()).pixels(points) / SCALE
    height, width = frame.rgb.shape[:2]
    np.testing.assert_allclose(on_picture(points, camera()) * [width, height], drawn, atol=0.6)


def test_a_place_of_the_picture_lies_on_the_table() -> None:
    for point in ((0.5, 0.2), (0.75, -0.3)):
        place = on_picture(np.array([point]), camera())[0]
        np.testing.assert_allclose(on_table((place[0], place[1]), camera()), point, atol=1e-9)


def test_key_points_can_be_moved_before_the_first_fold_only() -> None:
    first, second = (offered_changes(asked(k), camera()) for k in (0, 1))
    assert first is not None and second is not None
    assert {p["name"] for p in first["points"] if p["kind"] == "keypoint"} == set(STATE.keypoints)
    assert {p["kind"] for p in second["points"]} == {"grasp"}
    assert first["variants"] == ["left_onto_right", "right_onto_left"] and first["variant"] == "left_onto_right"
    assert offered_changes(RunContext(), camera()) is None


def test_a_dragged_grasp_becomes_an_edit_in_metres() -> None:
    place = on_picture(np.array([[0.6, 0.15]]), camera())[0]
    edit = plan_edit(PlanChange(grasp="left", to=(place[0], place[1])), camera(), "page 1")
    assert edit is not None and edit.by == "page 1" and edit.grasps[GraspId.LEFT] == pytest.approx((0.6, 0.15))


def test_changes_are_offered_with_the_question_about_a_fold_only() -> None:
    view = LiveView(camera(), offer=lambda work: True)
    step = Step(State.PLANNING_MOTION, Event.APPROVAL_NEEDED, State.AWAITING_APPROVAL, Effect.ASK_APPROVAL)
    view.performed(1.0, step, Result(Event.DONE, asked()))
    assert view.changes() is None
    view.entered(1.0, step)
    assert view.changes() is not None


@pytest.mark.parametrize(
    ("message", "valid"),
    [
        ({"edit": {"grasp": "left", "to": [0.5, 0.25]}, "question": 1}, True),
        ({"edit": {"keypoint": "near_left", "to": [0, 1]}, "question": 1}, True),
        ({"edit": {"variant": "x"}, "question": 1}, True),
        ({"edit": {"arc": "other"}, "question": 1}, True),
        ({"edit": {"arc": "best"}, "question": 1}, False),
        ({"edit": {"grasp": "left"}, "question": 1}, False),
        ({"edit": {"grasp": "middle", "to": [0.5, 0.5]}, "question": 1}, False),
        ({"edit": {"grasp": "left", "to": [0.5, 1.5]}, "question": 1}, False),
        ({"edit": {"grasp": "left", "to": [0.5, 0.5, 0.5]}, "question": 1}, False),
        ({"edit": {"grasp": "left", "to": ["0.5", 0.5]}, "question": 1}, False),
        ({"edit": {"variant": "x", "to": [0.5, 0.5]}, "question": 1}, False),
        ({"edit": {"variant": "x", "arc": "other"}, "question": 1}, False),
        ({"edit": {}, "question": 1}, False),
        ({"edit": {"variant": "x"}}, False),
        ({"edit": {"variant": "x"}, "question": True}, False),
        ({"edit": {"variant": "x"}, "question": 1, "say": "approve"}, False),
    ],
)
def test_messages_of_changes_are_checked_strictly(message: dict[str, object], valid: bool) -> None:
    read = read_message(json.dumps(message))
    assert isinstance(read, EditMessage) if valid else read is None


def test_other_messages_are_read_as_before() -> None:
    assert read_message('{"say": "approve", "question": 2}') == CommandMessage(say="approve", question=2)
