"""A fake cell that answers a procedure's effects, and a robot's model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import pytest

from calibration.effects import Effect, Note
from robots.baxter.robot import load_model
from robots.model import RobotModel
from skills.vocabulary import Outcome

RecordedAnswers = Mapping[type, Callable[[Any], Outcome]]


def run(procedure: Any, answers: RecordedAnswers) -> tuple[Outcome, list[Effect]]:
    """Drive a procedure. Returns its outcome and its effects. An effect without a given answer succeeds."""
    asked: list[Effect] = []
    try:
        effect = next(procedure)
        while True:
            asked.append(effect)
            answer = answers.get(type(effect), lambda _: Outcome(True))
            effect = procedure.send(Outcome(True) if isinstance(effect, Note) else answer(effect))
    except StopIteration as end:
        return end.value, asked


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    return load_model()
