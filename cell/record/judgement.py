"""The verdict of a person on a folded garment."""

from __future__ import annotations

from dataclasses import dataclass

ANSWERS = {"y": True, "yes": True, "n": False, "no": False, "u": None}


@dataclass(frozen=True)
class Judgement:
    """A person's verdict. passed: whether the garment is folded well; None: nobody can tell. why: in the person's
    words."""

    passed: bool | None
    why: str = ""


def judgement_of(line: str, unseen: bool = False) -> Judgement | None:
    """Return the verdict that a typed line gives; None if it gives none. A garment that is not folded well needs a
    reason. unseen: whether `u`, nobody can tell, is an answer."""
    word, _, why = " ".join(line.split()).partition(" ")
    passed = ANSWERS.get(word.lower())
    if word.lower() not in ANSWERS or (passed is None and not unseen) or (passed is False and not why):
        return None
    return Judgement(passed, why)
