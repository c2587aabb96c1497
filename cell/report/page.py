"""The report of one run as an HTML page: verdict, film, folds, score, failures and times.

The page is one file: pictures and film are inlined, drawings are SVG, and nothing is fetched. It has a light and a
dark theme and can be printed. A click enlarges a picture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.config.changed_settings import changed_settings
from foldcell.cell.record import words
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.report.failure_stories import FailureStory
from foldcell.cell.report.pictures.film import CaptionedPicture
from foldcell.cell.report.pictures.outline_drawing import outline_drawing
from foldcell.cell.states.state_chart import marked_chart
from foldcell.cell.states.transition_table import State
from foldcell.cell.support.files.encoded_picture import data_uri, jpeg_file, shrunk
from foldcell.cell.support.files.html_page import page_template
from foldcell.cell.support.json_values import flattened
from foldcell.robots.ports import Array

FILM = "film.webp"
"""Name of the film's file, in the folder of the run."""
PICTURE_WIDTH = 640
"""Wider pictures are scaled down to this width [px]."""
JPEG_QUALITY = 82
VERSIONS = ("foldcell", "pin", "ruckig", "pybullet", "rerun-sdk", "numba")


@dataclass(frozen=True, eq=False)
class FoldPictures:
    """The pictures of one fold. source: what the key frames were made from, in words. outlines: 'original' (flat,
    as it was laid), 'predicted' and 'observed' -> contours (k, 2) in the table frame [m]."""

    key_frames: tuple[CaptionedPicture, ...] = ()
    source: str = ""
    outlines: Mapping[str, Sequence[Array]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ReportPictures:
    """What the page shows beside the record. folds: fold name -> its pictures. overview: the empty table, the
    recognised garment, the last picture, the questions. film: an animated WebP, empty if nothing was filmed;
    film_note: what it shows. stories: the failures in pictures. estimates: the estimates that no story tells."""

    folds: Mapping[str, FoldPictures] = field(default_factory=dict)
    overview: tuple[CaptionedPicture, ...] = ()
    film: bytes = b""
    film_note: str = ""
    stories: tuple[FailureStory, ...] = ()
    estimates: tuple[CaptionedPicture, ...] = ()


def render(run: RunRecord, pictures: ReportPictures, title: str, settings: CellSettings) -> str:
    """Return the page as HTML text. title: name of the garment; settings: of the run, of which the page lists
    those that differ from the shipped ones."""
    template = page_template(
        Path(__file__).with_name("page.html"), capital=words.capital, data_uri=_inlined, figure=words.figure,
        garment=words.garment_name, metres=words.length, plain=words.plain, seconds=words.seconds,
        words=lambda name: words.capital(words.plain(name)), value=_value,
    )  # fmt: skip
    changed, shipped = changed_settings(settings, load_settings())
    return template.render(
        outline_drawing=outline_drawing,
        no_pictures=FoldPictures(),
        film_uri=data_uri(pictures.film, "webp"),
        run=run,
        run_id=Path(run.run_dir).name,
        title=title,
        sentence=words.verdict(run),
        pictures=pictures,
        film_name=FILM,
        figures=words.FIGURES,
        figure_notes=words.FIGURE_NOTES,
        longest_s=max([*run.stage_times_s.values(), 1e-9]),
        chart=Markup(marked_chart(run.state, [State(name) for name in run.stage_times_s])),
        losses="; ".join(f"not kept: {loss}" for loss in words.lost_in_words(run.recording)),
        versions={name: metadata.version(name) for name in VERSIONS},
        settings=list(flattened(changed)),
        shipped=dict(flattened(shipped)),
    )


def _value(setting: Any) -> str:
    return ", ".join(map(str, setting)) if isinstance(setting, list) else str(setting)


def _inlined(rgb: NDArray[np.uint8]) -> str:
    return data_uri(jpeg_file(shrunk(rgb, PICTURE_WIDTH), JPEG_QUALITY), "jpeg")
