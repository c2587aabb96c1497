"""The true reason why a photograph is refused."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import foldcell
from foldcell.robots.errors import Failure, FailureKind
from foldcell.skills.perception import perceive
from foldcell.skills.perception.segmentation.mask import Segmentation
from foldcell.skills.vocabulary import Outcome

ROWS, COLUMNS = 450, 600
BLUE, CREAM, SKIN, YELLOW = (50, 70, 130), (225, 215, 190), (200, 140, 110), (220, 190, 40)
SHIRT = np.array([[-10, 90], [330, 90], [430, 60], [470, 140], [400, 180], [400, 290], [470, 320], [430, 390],
                  [330, 360], [-10, 360]])  # fmt: skip
ACROSS = np.array([[-10, 90], [300, 105], [610, 80], [610, 250], [300, 235], [-10, 270]])
IN_CORNER = np.array([[610, 460], [350, 460], [338, 380], [341, 275], [465, 270], [610, 280]])
BOOK = np.array([[500, -10], [610, -10], [610, 90], [490, 80]])
PRINT = np.array([[150, 150], [290, 150], [290, 290], [150, 290]])
ARM = np.array([[280, 450], [290, 200], [265, 130], [285, 125], [300, 180], [310, 90], [330, 90], [335, 200],
                [350, 450]])  # fmt: skip
TURN = np.linspace(0, 2 * np.pi, 120, endpoint=False)
FLOWER = (300, 225) + (100 + 55 * np.cos(6 * TURN))[:, None] * np.column_stack([np.cos(TURN), np.sin(TURN)])


def photograph(*things: tuple[np.ndarray, tuple[int, int, int]], relief: float = 0.0) -> np.ndarray:
    """A picture of things on a grey ground. relief: lightness of the edge on the side of the lamp, and of the
    shadow on the other."""
    rng = np.random.default_rng(2)
    shade = cv2.GaussianBlur(rng.normal(0, 1, (ROWS, COLUMNS)), (0, 0), 40)
    rgb = np.full((ROWS, COLUMNS, 3), 120.0) * (1 + 0.5 * shade)[..., None]
    for polygon, colour in things:
        cover = cv2.fillPoly(np.zeros((ROWS, COLUMNS), np.float32), [np.round(polygon).astype(np.int32)], 1.0)
        cover = cv2.GaussianBlur(cover, (0, 0), 0.8)
        rgb += cover[..., None] * (np.array(colour) - rgb)
        height = cv2.GaussianBlur(cover, (0, 0), 4.0)
        rgb *= np.exp(relief * (height - np.roll(height, 4, axis=1)))[..., None]
    return np.clip(rgb + rng.normal(0, 2, rgb.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("things", "kind", "words"),
    [
        ((), FailureKind.NO_GARMENT, "no garment is visible"),
        ((((BOOK, CREAM)),), FailureKind.NO_GARMENT, "nothing that lies wholly in the picture"),
        ((((SHIRT, BLUE)),), FailureKind.OUT_OF_VIEW, "the left edge of the picture cuts the garment off"),
        ((((ACROSS, BLUE)),), FailureKind.OUT_OF_VIEW, "the left edge of the picture cuts the garment off"),
        ((((IN_CORNER, BLUE)),), FailureKind.OUT_OF_VIEW, "the lower edge of the picture cuts the garment off"),
        (((SHIRT, BLUE), (PRINT, YELLOW)), FailureKind.OUT_OF_VIEW, "left edge"),
        ((((ARM, SKIN)),), FailureKind.VIEW_OBSTRUCTED, "an arm reaches into the picture from its lower edge"),
        ((((FLOWER, CREAM)),), FailureKind.NO_GARMENT, "like a print"),
    ],
    ids=["nothing", "a book at the edge", "cut off", "cut off at both sides", "cut off at a corner",
         "a print on what is cut off", "arm", "print on the ground"],
)  # fmt: skip
def test_a_photograph_without_a_whole_garment_is_refused_for_its_true_reason(
    things: tuple[tuple[np.ndarray, tuple[int, int, int]], ...], kind: FailureKind, words: str
) -> None:
    failure = foldcell.perceive(photograph(*things), unit="px").failure
    assert failure is not None and failure.kind is kind
    assert words in failure.what


def test_cloth_whose_edges_rise_is_no_print_on_the_ground() -> None:
    failure = foldcell.perceive(photograph((FLOWER, CREAM), relief=1.5), unit="px").failure
    assert failure is not None and failure.kind is FailureKind.NOT_FLAT


def test_a_rectangle_too_long_for_a_towel_is_no_skirt() -> None:
    """It resembles a towel more than any skirt, so that a skirt's fit does not count."""
    long = np.array([[60, 130], [560, 140], [556, 280], [56, 270]])
    failure = foldcell.perceive(photograph((long, BLUE)), unit="px").failure
    assert failure is not None and "towel" in failure.what and "proportions" in failure.what


def test_a_long_towel_is_one() -> None:
    long = np.array([[60, 130], [500, 140], [496, 300], [56, 290]])
    seen = foldcell.perceive(photograph((long, BLUE)), unit="px")
    assert seen.category == "towel"
    found = np.array(list(seen.keypoints.values()))
    assert np.linalg.norm(found[:, None] - long, axis=2).min(axis=0).max() < 6.0


def test_a_skirt_with_two_like_ends_is_refused_because_either_may_be_the_upper_one() -> None:
    u = np.linspace(-1.0, 1.0, 60)[:, None]
    side = np.hstack([160 * u, 100 + 8 * (1.0 - u**2)])
    skirt = np.vstack([side, -side]) + np.array([300, 225])
    failure = foldcell.perceive(photograph((skirt, BLUE)), garment="skirt", unit="px").failure
    assert failure is not None and "which end of skirt is the upper one" in failure.what
    assert "hem" in failure.hint and "sleeves" not in failure.hint


def test_a_small_rectangle_is_a_towel_only_if_it_is_named() -> None:
    small = np.array([[220, 150], [400, 155], [397, 278], [218, 272]])
    picture = photograph((small, BLUE), relief=0.5)
    assert foldcell.perceive(picture, garment="medium_towel", unit="px").category == "towel"
    failure = foldcell.perceive(picture, unit="px").failure
    assert failure is not None and "may be a print" in failure.what


@pytest.mark.parametrize(("confidence", "sought"), [(0.95, False), (0.85, True), (None, True)])
def test_only_clear_edges_of_a_garment_of_the_grounds_colour_end_the_search(
    confidence: float | None, sought: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_colours: list[bool] = []

    def by_edges(rgb: np.ndarray, valid: np.ndarray) -> Segmentation | None:
        """A part of the ground, which is no garment."""
        part = np.zeros(valid.shape, bool)
        part[100:300, 100:110] = True
        corners = np.array([[100.0, 100.0], [109.0, 100.0], [109.0, 299.0], [100.0, 299.0]])
        line = np.concatenate(
            [np.linspace(a, b, 200) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
        )
        return None if confidence is None else Segmentation(part, line, confidence, part & False)

    def propose(rgb: np.ndarray, valid: np.ndarray) -> tuple[Segmentation, ...]:
        by_colours.append(True)
        return ()

    monkeypatch.setattr(perceive, "segment_by_edges", by_edges)
    monkeypatch.setattr(perceive, "propose_garments", propose)
    assert foldcell.perceive(photograph(), unit="px").failure is not None
    assert bool(by_colours) is sought


FITTED, MISFIT, CUT = (
    Failure(kind, kind) for kind in (FailureKind.LOW_CONFIDENCE, FailureKind.NOT_FLAT, FailureKind.OUT_OF_VIEW)
)
SHIRTS_POINTS, TOWELS_POINTS = ("hem", "collar", "cuff", "armpit", "shoulder"), ("a", "b", "c", "d")


def look(rows: int, columns: int, names: tuple[str, ...], failure: Failure | None) -> perceive._Look:
    """What came of a region in the upper left corner of a photograph. failure: None for an accepted one, which is
    not sure."""
    mask = np.zeros((100, 100), bool)
    mask[:rows, :columns] = True
    outcome = Outcome(SimpleNamespace(fit=0.8)) if failure is None else Outcome(failure=failure)
    places = dict.fromkeys(names, np.zeros(2))
    return perceive._Look(Segmentation(mask, np.zeros((1, 2)), 1.0, mask & False), True, outcome, places)


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        (look(80, 80, SHIRTS_POINTS, FITTED), look(30, 30, TOWELS_POINTS, None), FITTED),
        (look(80, 80, SHIRTS_POINTS, FITTED), look(78, 80, TOWELS_POINTS, None), FITTED),
        (look(80, 80, SHIRTS_POINTS, FITTED), look(78, 80, SHIRTS_POINTS, None), None),
        (look(80, 80, (), CUT), look(30, 30, TOWELS_POINTS, None), CUT),
        (look(80, 80, SHIRTS_POINTS, MISFIT), look(60, 80, SHIRTS_POINTS, FITTED), MISFIT),
        (look(80, 80, SHIRTS_POINTS, MISFIT), look(60, 80, SHIRTS_POINTS, None), MISFIT),
        (look(70, 80, SHIRTS_POINTS, MISFIT), look(80, 80, (), CUT), MISFIT),
        (look(30, 80, SHIRTS_POINTS, MISFIT), look(80, 80, (), CUT), CUT),
    ],
    ids=[
        "a print on a garment that is uncertain", "the same thing, but of another kind", "the same thing",
        "a print on what is cut off", "two garments, the upper one uncertain", "two garments, the upper one sure",
        "a garment and a sun spot at the edge", "a part of what is cut off",
    ],
)  # fmt: skip
def test_regions_of_a_photograph_are_judged_together_in_any_order(
    first: perceive._Look, second: perceive._Look, told: Failure | None
) -> None:
    for looks in ([first, second], [second, first]):
        assert perceive._best(iter(looks), named=False).outcome.failure is told


@pytest.mark.parametrize("wide", [6, 20])
def test_a_ragged_rim_of_the_ground_is_no_garment_below_another(wide: int) -> None:
    garment, both = look(60, 60, SHIRTS_POINTS, None), look(60, 60, SHIRTS_POINTS, MISFIT)
    both.segmentation.mask[:, 60:] = (np.arange(100) % (2 * wide) < wide)[:, None]
    told = perceive._best(iter([both, garment]), named=False)
    assert (told is garment) is (wide < 10)


def test_of_two_accepted_regions_a_print_is_not_taken_and_of_two_kinds_the_earlier_is() -> None:
    shirt, towel = look(80, 80, SHIRTS_POINTS, None), look(78, 80, TOWELS_POINTS, None)
    printed = look(30, 30, TOWELS_POINTS, None)
    printed.outcome.unwrap().fit = 0.81  # type: ignore[misc]
    for looks in ([printed, shirt], [shirt, printed], [shirt, towel]):
        assert perceive._best(iter(looks), named=False) is shirt
    assert perceive._best(iter([towel, shirt]), named=False) is towel
