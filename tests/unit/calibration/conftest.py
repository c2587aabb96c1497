"""A fake cell that answers a procedure's effects, and a robot's model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import pytest

from foldcell.calibration.effects import ANSWERABLE, Effect, Note
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.model import RobotModel
from foldcell.skills.vocabulary import Failed, Outcome

RecordedAnswers = Mapping[type, Callable[[Any], Outcome]]


def done(_: Effect) -> Outcome:
    return Outcome(True)


def run(procedure: Any, answers: RecordedAnswers) -> tuple[Outcome, list[Effect]]:
    """Drive a procedure, as the runner in cell/calibrating does. Returns its outcome and its effects. An effect
    without a given answer succeeds."""
    asked: list[Effect] = []
    try:
        effect = next(procedure)
        while True:
            asked.append(effect)
            answer = Outcome(True) if isinstance(effect, Note) else answers.get(type(effect), done)(effect)
            if answer.failure and answer.failure.kind not in ANSWERABLE:
                return answer, asked
            effect = procedure.send(answer)
    except StopIteration as end:
        return end.value, asked
    except Failed as end:
        return Outcome(failure=end.failure), asked


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    return load_model()
