"""Perceives the garment: computes its state on the table from one picture, or gives the reason why it cannot."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, frozen
from foldcell.skills.perception.camera_fault import camera_fault, same_picture
from foldcell.skills.perception.candidate import (
    CLEAR,
    choose_garment,
    fit_quality,
    flatness,
    misfit,
    wanted_garment,
)
from foldcell.skills.perception.classify import Match, classify, polygon_iou
from foldcell.skills.perception.outline import GarmentOutline, MemberOutline
from foldcell.skills.perception.rectification.heights import garment_height
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.registration.accuracy import (
    in_photograph,
    keypoint_sigmas,
    probability_within,
    with_shape,
)
from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.details.picture_refinement import refine_by_picture
from foldcell.skills.perception.registration.register import Registration, register
from foldcell.skills.perception.rivals import (
    SecondBest,
    astray,
    either,
    likely_matches,
    likeness,
    places_of,
    second_best,
)
from foldcell.skills.perception.segmentation.edges import segment_by_edges
from foldcell.skills.perception.segmentation.gaps import opened_gaps
from foldcell.skills.perception.segmentation.mask import Segmentation
from foldcell.skills.perception.segmentation.photograph import propose_cut_off, propose_garments
from foldcell.skills.perception.segmentation.surroundings import printed_on_ground
from foldcell.skills.perception.settings import MIN_SEGMENTATION, PerceptionSettings
from foldcell.skills.perception.silhouette import segmentations
from foldcell.skills.perception.usable_region import adjoined, small_rectangle, touches_border, unusable
from foldcell.skills.perception.views import Views, open_views
from foldcell.skills.vocabulary import (
    CameraCalibration,
    CameraFrame,
    Failure,
    FailureKind,
    GarmentState,
    Outcome,
    Table,
)

SURE_FIT = 0.82
"""A proposal with at least this quality of fit (`candidate.fit_quality`) is accepted before the others are
tried."""
ACCURATE_WITHIN = 0.010
"""The confidence is the probability that all key points lie within this distance of their true places, on a
garment of its nominal size."""
ACCURATE_SHARE = 0.02
"""The same in a picture of unknown scale, relative to the diagonal of the garment's key points."""
AUTO_CATEGORIES, AUTO_MARGIN = 3, 0.12
"""If no garment is named in a photograph, so many categories are registered, with a likeness within this of the
best one's."""
SAME = 0.97
"""Regions that overlap by more than this (intersection over union) are the same."""
WITHIN, ALIKE, MORE, MOST = 0.95, 0.80, 1.2, 0.65
"""A region that lies within a larger one by more than the first share is a print on it. Regions that overlap by
more than the second (intersection over union) show the same thing. One that is larger by the third factor shows
something else, too. One that covers more than the fourth share is most of it."""
EITHER_WAY = 0.25
"""An uncertain garment that lies the other way round with at least this probability is refused for that."""
COMPACT = 0.12
"""What shows of another garment beside one is at least twice this wide, relative to the root of the one's area.
Filled gaps, and the pattern of the ground along an edge, are not."""
UNLIKE = 0.8
"""A region that overlaps with no garment by more than this may be a print on the ground."""
TOO_NEAR, TOO_FAR = 0.01, 0.04
"""If the likeness of another category is within the first of the best one's, the garment is not recognised. Nor is
it if a category that does not fit, as a towel of unusual proportions, is ahead by more than the second: of narrow
skirts, towels were ahead by up to 0.03."""


@dataclass(frozen=True, eq=False)
class Perception:
    """The garment's state for planning, with the intermediate results for the record and the overlay.

    garment: name of the garment whose template fits. rgb: (H, W, 3), height: (H, W) above the table [m], mask:
    (H, W), and the contour of `segmentation` are in `view`'s pixels. top: mean height of the garment's upper side
    above the table [m]. fit: quality of the fit (0..1), see `candidate.fit_quality`. The confidence in `state` is
    the probability that all key points are accurate. second: the next category, if no garment was expected.
    """

    state: GarmentState
    garment: str
    registration: Registration
    segmentation: Segmentation
    view: TableView
    rgb: NDArray[np.uint8]
    height: NDArray[np.float32]
    top: float
    fit: float
    second: SecondBest | None = None

    @property
    def mask(self) -> NDArray[np.bool_]:
        return self.segmentation.mask


@dataclass(frozen=True, eq=False)
class Sought:
    """What was taken for the garment in a picture, and where its key points were expected: places: name -> (2,)
    [m]. missing: of a refused garment, name of the key point that fits least."""

    view: TableView
    segmentation: Segmentation
    places: Mapping[str, Array]
    missing: str | None


class _StageTimes:
    """Measures the wall times of the stages, for the record only."""

    def __init__(self) -> None:
        self.notes: dict[str, float | int | str] = {}
        self._last = time.perf_counter()

    def done(self, stage: str) -> None:
        now = time.perf_counter()
        self.notes[f"{stage}_time_s"] = now - self._last
        self._last = now


def perceive(
    frame: CameraFrame,
    calibration: CameraCalibration,
    table: Table,
    reference: CameraFrame | None,
    garments: Sequence[GarmentOutline],
    expected: str | None = None,
    *,
    settings: PerceptionSettings,
    previous: CameraFrame | None = None,
    on_region: Callable[[Sought], None] | None = None,
) -> Outcome[Perception]:
    """Segment, classify and register the garment in one picture.

    reference: picture of the empty table. garments: the candidates. expected: a garment's name, or None to accept
    any of them. previous: an earlier picture, to detect a frozen camera. on_region: called at the end with what
    was taken for the garment, even if it is refused.

    Failures: CAMERA_FAULT, VIEW_OBSTRUCTED, NO_GARMENT, OUT_OF_VIEW, NOT_FLAT, UNKNOWN_GARMENT, CATEGORY_MISMATCH,
    LOW_CONFIDENCE. Raises ValueError when `expected` is not among `garments`.
    """
    wanted = wanted_garment(garments, expected)
    stages = _StageTimes()

    if reference is not None:
        fault = camera_fault(reference, calibration, None, settings) or same_picture(frame, reference)
        if fault is not None:
            return Outcome(failure=fault, notes=stages.notes)
    opened = open_views(frame, calibration, table, reference, previous, settings)
    if opened.failure is not None:
        return Outcome(failure=opened.failure, notes=stages.notes)
    views = opened.unwrap()
    stages.done("view")
    looks = (
        _perceive_region(segmentation, method, views, garments, wanted, settings, stages)
        for method, segmentation in _regions(views, settings, stages)
    )
    decided = _without_prints(_best(looks, wanted is not None), views)
    if on_region is not None:
        on_region(_sought(decided, views, garments, wanted))
    return decided.outcome


def _without_prints(look: _Look, views: Views) -> _Look:
    """Return the look, or NO_GARMENT in place of the refusal of a print on the ground, which has the outline of no
    garment."""
    failure = look.outcome.failure
    if failure is None or not look.free or float(failure.values.get("best_iou", 1.0)) > UNLIKE:
        return look
    if not printed_on_ground(views.seen.rgb, look.segmentation):
        return look
    nothing = Failure(
        FailureKind.NO_GARMENT,
        "no garment is visible: what stands out has no edge that rises from the ground, like a print",
        "lay a garment flat in the middle of the picture",
        failure.values,
    )
    return replace(look, outcome=Outcome(failure=nothing, notes=look.outcome.notes))


_PROPOSAL = "proposal"
"""Name of the method that proposes regions in a photograph (`propose_garments`)."""


@dataclass(frozen=True, eq=False)
class _Look:
    """The result for one region that may be the garment. free: whether the garment may have any shape of its
    category. places: where its key points were expected: name -> (2,) [m]."""

    segmentation: Segmentation
    free: bool
    outcome: Outcome[Perception]
    places: Mapping[str, Array]

    @property
    def reached(self) -> tuple[int, int, int]:
        """How far a refused region came: 0 no garment, 1 something, 2 compared with garments or larger than the
        picture, 3 its key points are known but uncertain, or something hides it. In a photograph, it counts next
        how much of the outline is clearly visible, in steps of 5 %, and then the area."""
        failure = self.outcome.failure
        if failure is None or failure.kind is FailureKind.NO_GARMENT:
            return 0, 0, 0
        if not self.free:
            return 2 if self.places else 1, 0, 0
        stage = 2 if self.places or failure.kind is FailureKind.OUT_OF_VIEW else 1
        if self.fitted or failure.kind is FailureKind.VIEW_OBSTRUCTED:
            stage = 3
        return stage, round(20 * self.segmentation.confidence), int(np.count_nonzero(self.segmentation.mask))

    @property
    def fitted(self) -> bool:
        """Whether the region has the shape of a garment, even if its key points are uncertain."""
        failure = self.outcome.failure
        return failure is None or (bool(self.places) and failure.kind is FailureKind.LOW_CONFIDENCE)


def _sought(
    look: _Look, views: Views, garments: Sequence[GarmentOutline], wanted: GarmentOutline | None
) -> Sought:
    """Return what was taken for the garment. If it was refused before its key points were sought, they are
    expected where those of the likeliest garment would lie."""
    view, segmentation, places = views.view, look.segmentation, look.places
    failure = look.outcome.failure
    absent = failure is not None and failure.kind in (FailureKind.NO_GARMENT, FailureKind.VIEW_OBSTRUCTED)
    if failure is None or absent or not segmentation.found:
        return Sought(view, segmentation, places, None)
    contour = view.to_table(segmentation.contour)
    if not places:
        matches = likely_matches(contour, garments if wanted is None else [wanted], wanted is not None)
        places = places_of(max(matches, key=likeness).garment, contour)
    missing = str(failure.values.get("keypoint", "")) or astray(places, contour, view)
    return Sought(view, segmentation, places, missing)


def _regions(
    views: Views, settings: PerceptionSettings, stages: _StageTimes
) -> Iterator[tuple[str, Segmentation]]:
    """Yield the regions to try in turn, each with the name of the method that found it. In a photograph, what the
    picture's edge cuts off comes first. A garment of the ground's colour whose edges are clear follows and ends
    the search, because colours do not show where it ends. A region with gaps between its limbs is tried with open
    gaps before it is tried as it is, and a region that is the same as an earlier one is left out."""
    rgb, valid = views.seen.rgb, views.seen.valid
    proposing = settings.method == "reference" and views.empty is None
    tried: list[Segmentation] = []
    if proposing and not settings.size_known:
        yield from ((_PROPOSAL, found) for found in propose_cut_off(rgb, valid))
        edged = segment_by_edges(rgb, valid)
        stages.done("segment")
        if edged is not None:
            yield _PROPOSAL, edged
            if edged.confidence > CLEAR:
                return
            tried.append(edged)
    for method, found in segmentations(views, settings.method):
        stages.done("segment")
        if settings.size_known or not any(_same(found, other) for other in tried):
            tried.append(found)
            yield from ((method, each) for each in _with_gaps(found, views, settings))
    if proposing:
        proposals = propose_garments(rgb, valid)
        stages.done("segment")
        for found in (p for p in proposals if not any(_same(p, other) for other in tried)):
            yield from ((_PROPOSAL, each) for each in _with_gaps(found, views, settings))


def _with_gaps(found: Segmentation, views: Views, settings: PerceptionSettings) -> Iterator[Segmentation]:
    whole = found.found and not touches_border(found.mask, views.seen.valid, 3)
    if not settings.size_known and whole and found.confidence >= MIN_SEGMENTATION:
        gapped = opened_gaps(found, views.seen.rgb, views.seen.valid)
        if gapped is not None:
            yield gapped
    yield found


def _same(found: Segmentation, other: Segmentation) -> bool:
    """Whether another region, at least as clear, is the same one."""
    both = np.count_nonzero(found.mask & other.mask)
    same = both > SAME * np.count_nonzero(found.mask | other.mask)
    return bool(same and found.confidence < other.confidence + 0.05)


def _best(looks: Iterator[_Look], named: bool) -> _Look:
    """Return the first accepted region of a method, or the accepted proposal that fits best, unless another region
    makes it doubtful (named: see `_doubtful`). A method's region and a sure fit are compared with the earlier
    regions only, because they end the search. Of two accepted ones that show the same thing as other kinds, the
    earlier counts. If none is accepted, return the refusal of the region that came furthest, and of several in a
    photograph the one whose outline is clearest."""
    accepted: list[_Look] = []
    refused: list[_Look] = []

    def doubted(look: _Look, others: Sequence[_Look]) -> bool:
        return any(_doubtful(look, other, named) or _explains(other, look) for other in others)

    for look in looks:
        if not look.outcome.ok or doubted(look, [*accepted, *refused]):
            refused.append(look)
        elif not look.free or look.outcome.unwrap().fit >= SURE_FIT:
            return look
        else:
            accepted.append(look)
    others = [*accepted, *(look for look in refused if not look.outcome.ok)]
    sound = [look for look in accepted if not doubted(look, others)]
    if sound:
        return max(sound, key=lambda look: look.outcome.unwrap().fit)
    best = max(refused, key=lambda look: look.reached)
    return next((look for look in refused if _explains(look, best)), best)


def _explains(look: _Look, best: _Look) -> bool:
    """Whether a region of a photograph that no flat garment has tells more than what came furthest: an uncertain
    region is only a part of it, so that one garment lies on another, or it is most of what the picture's edge
    seems to cut off."""
    failure, told = look.outcome.failure, best.outcome.failure
    if not look.free or failure is None or failure.kind is not FailureKind.NOT_FLAT:
        return False
    mask, area = look.segmentation.mask, np.count_nonzero(look.segmentation.mask)
    both, furthest = np.count_nonzero(mask & best.segmentation.mask), np.count_nonzero(best.segmentation.mask)
    if told is not None and told.kind is FailureKind.OUT_OF_VIEW:
        return bool(both > MOST * furthest)
    if not best.fitted or both <= WITHIN * furthest or area <= MORE * furthest:
        return False
    width = 2 * int(COMPACT * np.sqrt(furthest)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    rest = cv2.morphologyEx((mask & ~best.segmentation.mask).astype(np.uint8), cv2.MORPH_OPEN, disc)
    return bool(np.count_nonzero(rest) > (MORE - 1.0) * furthest)


def _doubtful(look: _Look, other: _Look, named: bool) -> bool:
    """Whether an accepted region of a photograph is a print on another one that has the shape of a garment, or
    shows about the same as one that resembles another kind. named: whether the garment is named. If not, a
    rectangle on a thing that the picture's edge cuts off is a print, too."""
    if not look.free:
        return False
    mask, cloth = look.segmentation.mask, other.segmentation.mask
    both, area = np.count_nonzero(mask & cloth), np.count_nonzero(mask)
    part = bool(both > WITHIN * area and 2 * area < np.count_nonzero(cloth))
    failure = other.outcome.failure
    if failure is not None and failure.kind is FailureKind.OUT_OF_VIEW:
        return part and not named and len(look.places) == 4
    same = bool(both > ALIKE * np.count_nonzero(mask | cloth))
    return other.fitted and (part or (same and look.places.keys() != other.places.keys()))


def _perceive_region(
    segmentation: Segmentation,
    method: str,
    views: Views,
    garments: Sequence[GarmentOutline],
    wanted: GarmentOutline | None,
    settings: PerceptionSettings,
    stages: _StageTimes,
) -> _Look:
    """Judge and register one region."""
    free = method == _PROPOSAL or not settings.size_known

    def look(failure: Failure, places: Mapping[str, Array] | None = None) -> _Look:
        outcome: Outcome[Perception] = Outcome(failure=failure, notes=dict(stages.notes))
        return _Look(segmentation, free, outcome, places or {})

    view, height = views.view, views.height
    stages.notes["segmentation_method"] = method
    stages.notes["segmentation_confidence"] = segmentation.confidence
    referenced, proposed = views.empty is not None, method == _PROPOSAL
    failure = unusable(segmentation, views.seen, view, height, settings, referenced, proposed)
    if failure is not None:
        return look(failure)
    if free and (failure := adjoined(segmentation, views.seen, view)) is not None:
        return look(failure)

    top = garment_height(segmentation.mask, height)
    contour = view.to_table(segmentation.contour, top)
    nominal = {garment.name: garment for garment in garments}
    matches = likely_matches(contour, garments, wanted is not None) if free else classify(contour, garments)
    stages.done("classify")
    chosen = choose_garment(matches, wanted, settings)
    if chosen.failure is not None:
        shown = max(matches, key=likeness).garment if matches else None
        places = places_of(shown, contour) if free and shown is not None else None
        return look(flatness(chosen.failure, segmentation, settings), places)
    best = chosen.unwrap()
    judge = partial(_judged, free, segmentation, contour, top, views, settings, stages, wanted is not None)

    def judged(match: Match) -> _Look:
        return judge(second_best(matches, match) if wanted is None else None, match, nominal[match.garment.name])

    if not free or wanted is not None:
        return judged(best)
    rivals = {best.garment.category: best}
    for match in sorted(matches, key=likeness, reverse=True):
        if likeness(match) >= likeness(best) - AUTO_MARGIN and len(rivals) < AUTO_CATEGORIES:
            rivals.setdefault(match.garment.category, match)
    judged_as = {name: judged(match) for name, match in rivals.items()}
    # A category whose key points are uncertain is a doubt; one that does not fit is none, unless it is far ahead.
    ranked = sorted(rivals, key=lambda name: likeness(rivals[name]), reverse=True)
    near = [
        name
        for name in ranked
        if (failure := judged_as[name].outcome.failure) is None or "sigma_m" in failure.values
    ]
    if not near or likeness(rivals[near[0]]) < likeness(rivals[ranked[0]]) - TOO_FAR:
        return judged_as[ranked[0]]
    first, *others = near
    if others and likeness(rivals[others[0]]) > likeness(rivals[first]) - TOO_NEAR:
        return look(either(rivals[first], rivals[others[0]]), judged_as[first].places)
    # Without places, because a print tells less than a garment that the picture's edge cuts off.
    small = small_rectangle(len(judged_as[first].places), segmentation, views.seen)
    return judged_as[first] if settings.size_known or small is None else look(small)


def _judged(
    free: bool,
    segmentation: Segmentation,
    contour: Array,
    top: float,
    views: Views,
    settings: PerceptionSettings,
    stages: _StageTimes,
    named: bool,
    second: SecondBest | None,
    match: Match,
    nominal: GarmentOutline,
) -> _Look:
    """Register a garment in a region, and judge how well it fits. free: see `_Look`. contour: (n, 2) boundary of
    the region [m]. top: height of the garment's upper side [m]. nominal: the garment with its own shape."""
    garment = match.garment
    registered, fitted = register(contour, garment), isinstance(garment, MemberOutline)
    cloth = _cloth_picture(views, segmentation.mask, top)
    registration = refine_by_picture(registered, nominal, contour, cloth, not fitted)
    stages.done("register")

    def look(failure: Failure | None, value: Perception | None = None) -> _Look:
        outcome = Outcome(value, failure, notes=dict(stages.notes))
        return _Look(segmentation, free, outcome, registration.keypoints)

    if (failure := misfit(registered if free else registration, garment, contour, free, named)) is not None:
        return look(flatness(failure, segmentation, settings))
    iou = polygon_iou(registration.contour, contour)
    fit = fit_quality(segmentation, iou, registration)
    sigmas, turned = keypoint_sigmas(registration, nominal, contour), 0.0
    if settings.size_known:
        confidence = probability_within(sigmas, ACCURATE_WITHIN * registration.scale)
    else:
        diagonal = float(np.linalg.norm(np.ptp([*registration.keypoints.values()], axis=0)))
        if isinstance(garment, MemberOutline):
            sigmas, turned = with_shape(sigmas, garment, diagonal), garment.turned
        confidence = in_photograph((1.0 - turned) * probability_within(sigmas, ACCURATE_SHARE * diagonal))
    stages.notes |= {
        "iou": iou,
        "scale": match.scale,
        "fit": fit,
        "confidence": confidence,
        "boundary_rms_m": registration.residual,
        "updates": len(registration.history) - 1,
        "garment_height_m": top,
        "least_turn": registration.least_turn,
    }
    if fit < settings.min_fit:
        failure = Failure(
            FailureKind.LOW_CONFIDENCE,
            f"the outline of {garment.name} fits only to {fit:.2f} of 1",
            "straighten the garment, or check the light"
            if views.empty is None
            else "straighten the garment, or check light and the empty table's picture",
            {"fit": fit, "iou": iou, "boundary_rms_m": registration.residual},
        )
        return look(flatness(failure, segmentation, settings))
    if not confidence >= settings.least_confidence:  # also one that is not a number
        return look(_ambiguous(garment.name, sigmas, confidence, turned))
    state = GarmentState(
        garment.category, registration.contour, registration.keypoints, confidence, registration.ambiguous
    )
    rgb, height, view = frozen(views.seen.rgb), frozen(views.height), views.view
    return look(
        None, Perception(state, garment.name, registration, segmentation, view, rgb, height, top, fit, second)
    )


def _ambiguous(garment: str, sigmas: Mapping[str, float], confidence: float, turned: float) -> Failure:
    """The refusal of a garment whose key points are not visible well enough. sigmas: name -> [m]. turned:
    probability that it lies the other way round."""
    name = max(sigmas, key=lambda name: sigmas[name])
    upside_down = turned >= EITHER_WAY
    return Failure(
        FailureKind.LOW_CONFIDENCE,
        f"the picture does not show which end of {garment} is the upper one: its key points are accurate only "
        f"with a probability of {confidence:.2f}"
        if upside_down
        else f"the picture does not show where the {name} of {garment} is: its key points are accurate only with "
        f"a probability of {confidence:.2f}",
        "lay its hem out to the full width, or place the key points by hand (`foldcell garment new --edit`)"
        if upside_down
        else "lay sleeves and legs apart, or use a table of another colour or more even light",
        {"confidence": confidence, "keypoint": name, "sigma_m": sigmas[name]},
    )


def _cloth_picture(views: Views, mask: NDArray[np.bool_], top: float) -> ClothPicture:
    """The picture of a garment whose upper side is at the height `top` [m]."""
    view = views.view

    def to_photo(points: Array) -> Array:
        return view.to_image(np.column_stack([points, np.full(len(points), top)]))

    return ClothPicture(views.seen.rgb, mask, lambda points: view.at_height(points, top), views.photo, to_photo)
