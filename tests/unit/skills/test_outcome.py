"""A skill ends with the failure that it unwraps; elsewhere, an unwrapped failure is an error with its words."""

from __future__ import annotations

import pytest

from foldcell.skills.vocabulary import Failed, Failure, FailureKind, Outcome, refuse, skill

LOST = Failure(FailureKind.SLIPPED, "the hand lost the cloth", "grasp more cloth", {"what": "grip"})


def halved(found: Outcome[float], refused: Failure | None) -> Outcome[float]:
    refuse(refused)
    return Outcome(found.unwrap() / 2.0)


def test_a_skill_ends_with_the_failure_of_what_it_called() -> None:
    assert skill(halved)(Outcome(3.0), None).unwrap() == 1.5
    assert skill(halved)(Outcome(failure=LOST), None).failure is LOST
    assert skill(halved)(Outcome(3.0), LOST).failure is LOST


def test_elsewhere_an_unwrapped_failure_says_what_happened() -> None:
    with pytest.raises(Failed, match="lost the cloth\n  grasp more cloth") as error:
        halved(Outcome(failure=LOST), None)
    assert error.value.failure is LOST and error.value.values == LOST.values


def test_other_errors_of_a_skill_stay_errors() -> None:
    with pytest.raises(TypeError):
        skill(halved)(Outcome("3.0"), None)
