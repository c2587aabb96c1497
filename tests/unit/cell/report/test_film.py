"""Films: frames, durations and sizes, read back by another decoder (Pillow)."""

from __future__ import annotations

import io

import numpy as np
import pytest
import synthetic_run as show
from PIL import Image

from foldcell.cell.report.pictures.film import (
    CAPTION,
    FRAMES,
    SIZE,
    SPEED,
    CaptionedPicture,
    FilmFrame,
    TrueFrame,
    captioned,
    draw_hold,
    encode_film,
    film_file,
    holds,
    spread,
)
from foldcell.cell.report.pictures.fold_pictures import KeyFrame, Scenery, motion_view


def decoded(film: bytes) -> tuple[list[np.ndarray], list[int]]:
    """The pictures and durations [ms] of a film."""
    pictures, durations = [], []
    with Image.open(io.BytesIO(film)) as image:
        for k in range(getattr(image, "n_frames", 1)):
            image.seek(k)
            pictures.append(np.asarray(image.convert("RGB")))
            durations.append(int(image.info["duration"]))
    return pictures, durations


def plain(colour: tuple[int, int, int], size: tuple[int, int] = (64, 48)) -> np.ndarray:
    return np.full((size[1], size[0], 3), colour, np.uint8)


def test_a_film_has_its_frames_in_order_with_their_durations_and_colours() -> None:
    colours, durations = [(200, 30, 30), (30, 180, 40), (20, 40, 210)], [120, 400, 1500]
    pictures, shown = decoded(
        encode_film([FilmFrame(plain(c), d) for c, d in zip(colours, durations, strict=True)])
    )
    assert shown == durations
    for picture, colour in zip(pictures, colours, strict=True):
        assert np.abs(picture.astype(int) - colour).mean() < 8.0, "red, green and blue are not swapped"


def test_a_captioned_picture_has_the_size_of_the_film() -> None:
    picture = captioned(plain((10, 20, 30), (640, 480)), "12.3 s", SIZE)
    assert picture.shape == (SIZE[1] + CAPTION, SIZE[0], 3)
    assert (picture[: SIZE[1]] == (10, 20, 30)).all()
    assert (picture[SIZE[1] :] < 128).any(), "the caption is written"


def moving(begin: float, count: int, dt: float = 0.1) -> list[TrueFrame]:
    towel = show.Towel.make(7, 9)
    flat = np.column_stack([towel.material, np.full(len(towel.material), 0.001)])
    line = show.steps()[0].line
    return [
        (begin + dt * k, show.turned(flat, line, np.pi * k / count, 0.003), {}) for k in range(count)
    ]  # fmt: skip


def test_the_film_shows_the_run_at_its_speed_between_the_first_and_the_last_picture() -> None:
    recorded = [*moving(3.0, 50), *moving(15.0, 50)]
    view = motion_view([KeyFrame(v) for _, v, _ in recorded], (), SIZE)
    triangles = show.Towel.make(7, 9).triangles
    drawn = [
        draw_hold(f"fold {k}", hold, len(hold) / len(recorded), triangles, view, Scenery())
        for k, hold in enumerate(holds(recorded))
    ]
    assert [len(hold.pictures) for hold in drawn] == [FRAMES // 2, FRAMES // 2]
    assert [hold.times[0] for hold in drawn] == [3.0, 15.0]
    before, after = (
        CaptionedPicture(plain((90, 60, 30), SIZE), "before"),
        CaptionedPicture(plain((30, 60, 90), SIZE), "after"),
    )
    pictures, durations = decoded(film_file(before, drawn, [], after))
    assert len(pictures) == FRAMES + 2
    assert np.abs(pictures[0][: SIZE[1]].astype(int) - (90, 60, 30)).mean() < 6.0
    assert np.abs(pictures[-1][: SIZE[1]].astype(int) - (30, 60, 90)).mean() < 6.0
    first_hold = durations[1 : FRAMES // 2]
    assert sum(first_hold) == pytest.approx(1e3 * (drawn[0].times[-1] - 3.0) / SPEED, rel=0.03)


def test_without_recorded_garment_the_film_shows_the_camera_and_without_both_there_is_none() -> None:
    stills = [CaptionedPicture(plain((40 * k, 90, 90), (640, 480)), f"{k} s") for k in range(4)]
    pictures, _ = decoded(film_file(None, [], stills, None))
    assert len(pictures) == 4
    still = CaptionedPicture(plain((1, 2, 3)), "the table")
    assert film_file(still, [], [], still) == b"", "nothing moved"


def test_spread_indices_have_both_ends_and_no_repetition() -> None:
    for count in (1, 2, 5, 6, 7, 100):
        chosen = spread(count, 6)
        assert chosen[0] == 0 and chosen[-1] == count - 1
        assert len(chosen) == len(set(chosen)) == min(count, 6)
    assert spread(0, 6) == []
