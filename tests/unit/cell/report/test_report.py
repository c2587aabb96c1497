"""The report page and the pictures of folds: complete, self-contained and true to their input."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import synthetic_run as show
from shapely.geometry import Polygon
from synthetic_report import GOOD_SCORE, report_pictures, report_record

from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.record.run_record import (
    FailureRecord,
    FoldRecord,
    IdealRecord,
    RecordingLosses,
    RunEvent,
    RunRecord,
)
from foldcell.cell.record.words import verdict
from foldcell.cell.report.page import ReportPictures, render
from foldcell.cell.report.pictures.film import CaptionedPicture, FilmFrame, encode_film, held_during
from foldcell.cell.report.pictures.fold_pictures import (
    BACK,
    FRONT,
    KeyFrame,
    Scenery,
    View,
    draw_frame,
    fold_strip,
    join,
    motion_view,
)
from foldcell.cell.report.pictures.outline_drawing import outline_drawing
from foldcell.cell.report.report import report as write_report
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import State
from foldcell.robots.errors import FailureKind, StorageError
from foldcell.robots.ports import Side
from foldcell.skills.fold_figures.drawn_mesh import outline
from tests.builders.records import run_record, score_record
from tests.inspections import a_claim


class Page(HTMLParser):
    """A parser that collects a page's text and resources, and checks that its tags close."""

    VOID = frozenset({"meta", "img", "br", "path", "link", "hr", "input"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.open: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):  # type: ignore[no-untyped-def]
        self.sources += [v for k, v in attributes if k in {"src", "href", "srcset"} and v]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):  # type: ignore[no-untyped-def]
        self.sources += [v for k, v in attributes if k in {"src", "href", "srcset"} and v]

    def handle_endtag(self, tag):  # type: ignore[no-untyped-def]
        assert self.open.pop() == tag

    def handle_data(self, data):  # type: ignore[no-untyped-def]
        if self.open and self.open[-1] not in {"style", "script"}:
            self.words.append(data.strip())

    @property
    def text(self) -> str:
        return " ".join(w for w in self.words if w)


def page_of(
    run: RunRecord | None = None, pictures: ReportPictures | None = None, settings: CellSettings | None = None
) -> Page:
    """The page of a run; by default everything is that of the synthetic run."""
    return Page(text_of(run, pictures, settings))


def text_of(
    run: RunRecord | None = None, pictures: ReportPictures | None = None, settings: CellSettings | None = None
) -> str:
    pictures = pictures or report_pictures()
    return render(run or report_record(), pictures, "Medium towel", settings or load_settings())


def test_the_page_fetches_nothing_and_closes_its_tags() -> None:
    text = text_of()
    page = Page(text)
    assert page.open == []
    assert [s for s in page.sources if not s.startswith("data:image/")] == ["run.rrd"]
    assert "url(" not in text and "@import" not in text


def test_the_page_shows_the_given_pictures() -> None:
    pictures = report_pictures()
    uris = [s for s in page_of(pictures=pictures).sources if s.startswith("data:image/jpeg;base64,")]
    given = [*pictures.overview] + [p for fold in pictures.folds.values() for p in fold.key_frames]
    assert len(uris) == len(given) == 15
    for uri, picture in zip(uris, given, strict=True):
        data = np.frombuffer(base64.b64decode(uri.split(",")[1]), np.uint8)
        seen = cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
        assert seen.shape == picture.rgb.shape
        assert np.abs(seen.astype(int) - picture.rgb).mean() < 6.0


def test_the_report_shows_result_steps_and_failures() -> None:
    text = page_of().text
    for needed in (
        "Folded: Medium towel", "simulated", "81.4 s", "33.2 s", "optimised", "library", "12.3 mm", "18.8 mm",
        "Missed grasp", "Grasp again", "41.2 mm", "≤ 30.0 mm", "failed", "1.8°", "0.941", "27.3 mm",
        "IoU, aligned 0.970", "IoU, observed 0.940",
    ):  # fmt: skip
        assert needed in text, needed
    assert (
        "Score not passed" in text and "Score passed" in page_of(replace(report_record(), score=GOOD_SCORE)).text
    )
    assert "14.3 mm" in text, "the height of the ideal fold"


def test_each_fold_shows_what_the_pads_felt_at_which_height() -> None:
    text = page_of().text
    assert "right hand, 31.2 s 4.3 mm (tip) 0.21 N 1.1 mm 0 missed grasp" in text
    assert text.count("right hand, 44.8 s 4.1 mm (tip) 1.83 N 3.6 mm 2 held") == 2


def test_a_run_whose_ideal_fold_is_not_valid_is_not_shown_as_passed() -> None:
    ideal = IdealRecord(valid=False, reason="it does not come to rest")
    text = page_of(replace(report_record(), score=replace(GOOD_SCORE, passed=False, flat=None, ideal=ideal))).text
    assert "Score not passed" in text and "it does not come to rest" in text
    assert "Shape passed" in text and "Flat not judged" in text


def test_a_hardware_run_is_not_called_simulated() -> None:
    text = page_of(replace(report_record(), simulated=False, driver="ros", score=None, steps=())).text
    assert "simulated" not in text
    assert "on hardware" in text


def test_a_fault_with_the_fewest_figures_has_a_page() -> None:
    failure = FailureRecord(FailureKind.HARDWARE_FAULT, "joint <s1> is out of reach & hot", "look")
    run = run_record(result="fault", state=State.FAULT, failure=failure)
    page = Page(render(run, ReportPictures(), "jeans", load_settings()))
    assert page.open == []
    assert "Fault: Jeans" in page.text
    assert "joint <s1> is out of reach & hot" in page.text  # escaped in the page's source


def test_markup_in_names_is_escaped() -> None:
    run = run_record(
        steps=(FoldRecord("<script>alert(1)</script>"),), events=(RunEvent(0.0, "estimate", "<i>", ""),),
    )  # fmt: skip
    text = render(run, ReportPictures(), "<b>x</b>", load_settings())
    assert "<script>" not in text and "<b>" not in text and "<i>" not in text


def test_a_report_that_cannot_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(StorageError, match="cannot be written"):
        written(tmp_path / "missing")
    monkeypatch.setattr("os.replace", lambda *a: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(StorageError, match="No space"):
        written(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_outlines_keep_their_proportions_and_handedness() -> None:
    """A unit step in x is as long as one in y. Far is up, and left is left."""
    contour = np.array([[0.5, -0.1], [0.7, -0.1], [0.7, 0.3], [0.5, 0.3]])
    svg = str(outline_drawing({"observed": [contour]}))
    d = re.search(r'class="observed" d="M([^"]+) Z"', svg)
    assert d is not None
    uv = np.array([[float(v) for v in p.split()] for p in d[1].split(" L")])
    near_right, far_right, far_left, near_left = uv
    across, along = np.linalg.norm(far_left - far_right), np.linalg.norm(far_right - near_right)
    assert across == pytest.approx(2.0 * along, rel=0.01)
    assert far_left[1] < near_left[1]
    assert far_left[0] < far_right[0]
    assert outline_drawing({"observed": []}) is None


# figures


def sheet() -> tuple[show.Towel, np.ndarray]:
    towel = show.Towel.make(9, 13)
    return towel, np.column_stack([towel.material, np.full(len(towel.material), 0.001)])


def test_the_outline_of_a_flat_towel_is_its_rectangle():
    towel, vertices = sheet()
    (contour,) = outline(vertices, towel.triangles)
    drawn, true = Polygon(contour), Polygon([(0.4, -0.3), (0.8, -0.3), (0.8, 0.3), (0.4, 0.3)])
    assert drawn.intersection(true).area / drawn.union(true).area > 0.985


def test_the_outline_of_a_folded_towel_is_not_hollow():
    """Overlapping layers must add up and not cancel out: the outline has half the area and no holes."""
    towel, vertices = sheet()
    step = show.steps()[0]
    contours = outline(show.turned(vertices, step.line, np.pi, 0.004), towel.triangles)
    assert len(contours) == 1
    assert Polygon(contours[0]).area == pytest.approx(0.12, rel=0.12)


def test_the_nearer_layer_hides_the_farther_one():
    """Two sheets are one millimetre apart. The upper one is seen everywhere, for any order in the list."""
    towel, vertices = sheet()
    n = len(vertices)
    upper = vertices + np.array([0.0, 0.0, 0.001])
    both = np.vstack([vertices, upper])
    turned_over = towel.triangles[:, ::-1]  # the sheet's back faces upwards
    view = View(np.array([0.6, -0.2, 1.2]), np.array([0.6, 0.0, 0.0]), 300.0, 160, 120)
    for triangles in (
        np.vstack([towel.triangles, turned_over + n]),
        np.vstack([turned_over + n, towel.triangles]),
    ):
        picture = draw_frame(KeyFrame(both), triangles, view).astype(float)
        middle = picture[50:70, 70:90].reshape(-1, 3)
        hue = middle / middle.sum(axis=1, keepdims=True)
        expected = [np.array(c) / np.sum(c) for c in (FRONT, BACK)]
        distances = [np.linalg.norm(hue - e, axis=1).max() for e in expected]
        a, b, c = vertices[towel.triangles[0]]
        facing_up = np.cross(b - a, c - a)[2]
        seen = 1 if facing_up > 0 else 0
        assert distances[seen] < 0.02 < distances[1 - seen]


def test_cloth_and_arcs_fit_the_frame():
    _, vertices = sheet()
    step = show.steps()[0]
    arcs = [show.arc(step, i) for i in step.grasps]
    points = np.vstack([vertices, *arcs])
    view = View.around(points, 300, 200)
    uv = view.project(points)
    assert uv[:, 0].min() > 0.0
    assert uv[:, 1].min() > 0.0
    assert uv[:, 0].max() < 300.0
    assert uv[:, 1].max() < 200.0
    assert max(np.ptp(uv[:, 0]) / 300.0, np.ptp(uv[:, 1]) / 200.0) > 0.75


def test_a_fold_strip_has_one_picture_per_frame_and_shows_the_arcs():
    towel, vertices = sheet()
    step = show.steps()[0]
    arcs = {i.planned_arm: show.arc(step, i) for i in step.grasps}
    frames = [
        KeyFrame(show.turned(vertices, step.line, a, 0.003), {Side.LEFT: arcs[Side.LEFT][0]}, f"{a:.1f}")
        for a in np.linspace(0, np.pi, 6)
    ]
    paths = list(arcs.values())
    view = motion_view(frames, paths, (240, 180))
    pictures = fold_strip(frames, towel.triangles, view, Scenery(show.TABLE, paths))
    assert [p.shape for p in pictures] == [(180, 240, 3)] * 6
    for p in pictures:
        r, g, b = (p[:, :, k].astype(int) for k in range(3))
        assert ((b > r + 90) & (b > g + 60)).sum() > 100
    assert not np.array_equal(pictures[0], pictures[3])
    joined = join(pictures, [f.caption for f in frames])
    assert joined.shape[1] == 6 * 240 + 5 * 6
    assert fold_strip([], towel.triangles, view, Scenery()) == []


def test_the_page_takes_pictures_of_any_width() -> None:
    wide = CaptionedPicture(np.zeros((90, 2000, 3), np.uint8), "wide")
    uri = next(s for s in page_of(pictures=ReportPictures(overview=(wide,))).sources if s.startswith("data:"))
    assert cv2.imdecode(np.frombuffer(base64.b64decode(uri.split(",")[1]), np.uint8), 1).shape == (29, 640, 3)


def test_the_strip_shows_only_the_grasp_that_made_the_fold():
    """An earlier grasp that was lost, of this fold or of the next one, is not in the fold's strip."""
    held = [(3.0, 4.5), (9.0, 9.4), (15.0, 19.0)]
    frames = [(t, np.zeros((3, 3)), {}) for begin, end in held for t in np.arange(begin, end, 0.1)]

    def note(*stamps: float) -> SimpleNamespace:
        pictures = tuple(SimpleNamespace(stamp=t) for t in stamps)
        return SimpleNamespace(attempt=SimpleNamespace(pictures=pictures))

    for (begin, end), stamps in zip(held[::2], [(3.2, 4.4), (15.1, 19.2)], strict=True):
        times = [t for t, *_ in held_during(note(*stamps), frames)]
        assert begin <= times[0] and times[-1] < end and len(times) >= 15
    assert held_during(note(30.0, 31.0), frames) == [] and held_during(note(), frames) == []


def written(folder: Path, context: RunContext | None = None, **changes: Any) -> str:
    """The text of the page that is written for a run."""
    run = run_record(**{"result": "not_folded", "state": State.NOT_FOLDED, "run_dir": str(folder), **changes})
    page = write_report(run, context or RunContext(), load_settings(), None)
    return Page(page.read_text(encoding="utf-8")).text


def test_the_page_names_gaps_of_the_recording(tmp_path: Path) -> None:
    lost = RecordingLosses(dropped=7, errors=("the transcript ends early: disk full",))
    assert "not kept: the transcript ends early: disk full; not kept: 7 entries" in written(
        tmp_path, recording=lost
    )
    assert "not kept" not in written(tmp_path)


def test_times_that_include_waiting_for_the_operator_are_labelled_as_cell_time() -> None:
    """An answer that took ten minutes is cell time and not robot time."""
    text = page_of(replace(report_record(), robot_time_s=18.6, stage_times_s={"asking": 582.2})).text
    assert text.count("Robot time") == 1 and "Cell time" in text and "9 min 42 s" in text
    assert "include waiting for the operator" in text


def test_the_page_shows_what_lay_there_after_a_failure() -> None:
    says = "the fold is half made: the left corner slipped out 40 % along the way (confidence 0.80)"
    estimates = (CaptionedPicture(np.zeros((20, 30, 3), np.uint8), says),)
    page = text_of(pictures=replace(report_pictures(), estimates=estimates))
    assert "What lay there" in page and page.count(says) == 2  # under the picture, and as its description
    assert "What lay there" not in text_of()


def test_the_verdict_stands_at_the_top_in_one_sentence() -> None:
    run = replace(report_record(), claim=a_claim(says="folded as planned, 16 mm high (at most 22 mm)"))
    text, sentence = page_of(run).text, verdict(run)
    assert text.index("Folded: Medium towel") < text.index(sentence) < text.index("Robot time")


def test_there_is_no_score_where_nothing_was_folded(tmp_path: Path) -> None:
    score = score_record({"iou": 0.9}, passed=False, iou=0.312)
    assert "0.312" not in written(tmp_path, score=score) and "Score" not in written(tmp_path, score=score)
    attempt = SimpleNamespace(carried=True)
    carried: Any = SimpleNamespace(attempt=attempt, carried=True, note=lambda: None, index=0)
    assert "0.312" in written(tmp_path, replace(RunContext(), fold=carried), score=score)


def test_only_settings_that_differ_from_the_shipped_ones_are_listed() -> None:
    assert "All settings are the shipped ones" in page_of().text and "motion." not in page_of().text
    shipped = load_settings()
    slower = shipped.model_copy(update={"motion": shipped.motion.model_copy(update={"tool_speed": 0.123})})
    text = page_of(settings=slower).text
    assert f"motion.tool_speed 0.123 {shipped.motion.tool_speed}" in text
    assert text.count("motion.") == 1 and "table.height" not in text


def test_every_picture_can_be_enlarged_and_the_film_is_in_the_page() -> None:
    film = encode_film([FilmFrame(np.full((20, 30, 3), 30 * k, np.uint8), 100) for k in range(3)])
    text = text_of(pictures=replace(report_pictures(), film=film, film_note="The run in short"))
    page = Page(text)
    assert page.open == []
    assert len(re.findall(r'<input class="zoom" type="checkbox" /><img ', text)) == text.count("<img ") == 16
    assert [s for s in page.sources if not s.startswith("data:image/")] == ["film.webp", "run.rrd"]
    inlined = next(s for s in page.sources if s.startswith("data:image/webp;base64,"))
    assert base64.b64decode(inlined.split(",")[1]) == film


def test_the_browser_is_told_to_fetch_nothing() -> None:
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]+)"', text_of())
    assert policy is not None
    rules = dict(rule.strip().split(" ", 1) for rule in policy[1].split(";"))
    assert rules.pop("default-src") == "'none'"
    assert all("http" not in source and "*" not in source and "self" not in source for source in rules.values())


def test_figures_are_explained_where_they_stand() -> None:
    """Every label of a figure has an explanation, apart from words of everyday language."""
    text = text_of()
    labels = re.findall(r"<dt>(.*?)</dt>", text)
    plain = {re.sub(r"<[^>]+>", "", label) for label in labels if "<abbr" not in label}
    assert plain <= {"Garment", "Folds"} and len(labels) > 15
    assert all(len(note) > 15 for note in re.findall(r'<abbr tabindex="0" title="([^"]*)"', text))
