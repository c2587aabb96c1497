"""Which pixels are garment: three methods on the rectified view, one result.

`segment_reference` (the default) compares with a picture of the empty table. A shadow scales a colour but
hardly turns it, so that the comparison is made in log colour, where light is a common offset: a pixel that
is the table's colour times some factor below 1 can be shadow; the rest is garment. The garment's own
colours are learnt from what is surely garment; then each pixel is what it more likely is: garment, lit table
or table in some shadow.

`segment_plain` does the same with a smooth table colour fitted to the view's rim, when there is no
reference. `segment_grabcut`, also without one, does not ask the table to be of one colour: what has the rim's
colours is table, and a cut through the colour edges between the two says where it ends (Rother, Kolmogorov and
Blake, GrabCut, SIGGRAPH 2004). `segment_watershed` is the paper's: corners are background, the centre is
foreground (Vincent and Soille 1991).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.boundary import refine_boundary

__all__ = [
    "Segmentation",
    "SegmentationSettings",
    "segment_grabcut",
    "segment_plain",
    "segment_reference",
    "segment_watershed",
]

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Field = NDArray[np.floating]


_FLOOR = -18.0
"""No colour is less likely than this (log density): there are always surprises."""


_SMALL = 180
"""Longer edge of the picture that GrabCut works on [px]: the boundary is refined on the whole one."""
_RIM = 0.04
"""Width of the rim that is taken for table, relative to the view's longer edge."""
_STRANGE = 3.5
"""What lies further than this from every colour of the rim may be garment [standard deviations]."""
_TRUST = 1.5
"""Log odds between the two sides of GrabCut's boundary, against those of a pixel's own colour."""
_STRIDE = 3
"""Of the pixels by which the box around the garment is found."""
_MIXED = 0.1
"""Share of a dark region that lies flat from which it is cloth and shadow together."""
_WIDE = 25
"""Square over which mean height tells cloth from a shadow beside it [px]."""
_LOG = np.log(np.arange(256, dtype=np.float32) + 8.0)
_OPPONENT = np.array(
    [[1 / 3, 1 / 3, 1 / 3], [0.5**0.5, -(0.5**0.5), 0.0], [6**-0.5, 6**-0.5, -2 * 6**-0.5]], np.float32
)


@dataclass(frozen=True)
class SegmentationSettings:
    """Lengths in view pixels, colours in units of the natural logarithm of intensity."""

    deepest_shadow: float = 1.0
    """A shadow may darken the table to exp(-1.0) = 37 %."""
    shadow_share: float = 0.05
    """How much of the table may lie in shadow, before anything is known of a pixel."""
    surely_garment: float = 6.0
    """Distance from every shade of the table, in standard deviations."""
    dark_offset: float = 0.04
    """What is darker than the table by this much, and wider than a shadow's rim, may be a dark garment."""
    shadow_rim: int = 13
    """Cast shadows of a flat garment are narrower than this."""
    garment_height: float = 0.0006
    """Mean height over a dark region that tells cloth from shadow [m]."""
    smallest_area: int = 2500
    """Smaller regions are no garment (1 dm2 at 2 mm a pixel)."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """mask: (H, W) bool. contour: (n, 2) sub-pixel (column, row), one per pixel of boundary, not closed.

    confidence: 0..1, the share of the boundary where cloth and table could be told apart, times the share
    of the foreground that this one region holds. An empty mask has confidence 0 and no contour.
    others: (H, W) bool, what else lies there that is not the table, larger than a tenth of the smallest garment.
    """

    mask: Mask
    contour: Array
    confidence: float
    others: Mask

    @property
    def found(self) -> bool:
        return len(self.contour) > 0


def segment_reference(
    rgb: Image,
    reference: Image,
    valid: Mask,
    height: Field | None = None,
    settings: SegmentationSettings | None = None,
) -> Segmentation:
    """Garment against a picture of the empty table, both (H, W, 3) uint8 in the same view.

    valid: (H, W), where both pictures see the table. height: (H, W) [m] above the empty table's own
    measured height, NaN where unknown; it tells whether a dark, wide region is cloth or shadow, and helps where
    colours leave a doubt.
    """
    settings = settings or SegmentationSettings()
    image, table = _log_colour(rgb), _log_colour(reference)
    light = _light_change(image, table, valid)
    few = np.s_[::_STRIDE, ::_STRIDE]
    sparse = _opponent(image[few] - table[few] - _plane(light, valid.shape, few))
    sparse_noise = _noise_scale(np.ascontiguousarray(rgb[few]), 2.0 / _STRIDE)
    spread = _table_spread(sparse, sparse_noise, valid[few])
    box = _changed(sparse, sparse_noise, spread, valid[few], settings)
    if box is None:
        return _nothing(valid.shape)
    lit = table[box] + _plane(light, valid.shape, box)
    inside = None if height is None else height[box]
    found = _in_box(rgb[box], image[box], lit, valid[box], inside, spread, settings)
    if not found.found:
        return _nothing(valid.shape)
    contour = found.contour + np.array([box[1].start, box[0].start])
    mask, others = np.zeros(valid.shape, bool), np.zeros(valid.shape, bool)
    mask[box], others[box] = found.mask, found.others
    return Segmentation(mask, contour, found.confidence, others)


def _in_box(
    rgb: Image,
    image: Field,
    table: Field,
    valid: Mask,
    height: Field | None,
    spread: tuple[float, float],
    settings: SegmentationSettings,
) -> Segmentation:
    """The garment in a part of the view; image, table: log colours (h, w, 3)."""
    noise = _noise_scale(rgb)
    difference = _opponent(image - table)
    core = _core(difference, noise, spread, valid, height, settings)
    if np.count_nonzero(core) < settings.smallest_area // 4:
        return _nothing(valid.shape)
    odds = _garment_likelihood(image, noise, core)
    odds -= _table_likelihood(difference, noise, spread, settings)
    if height is not None:
        odds += _height_odds(height, core)
    mask, others, share = _clean((cv2.GaussianBlur(odds, (0, 0), 0.8) > 0) & valid, settings)
    if not mask.any():
        return _nothing(valid.shape)
    contour, clear = refine_boundary(mask, rgb, np.exp(table))
    return Segmentation(_filled(contour, valid), contour, share * clear, others)


def segment_plain(
    rgb: Image, valid: Mask, height: Field | None = None, settings: SegmentationSettings | None = None
) -> Segmentation:
    """Garment on a table of one colour, which is fitted to the rim of the view (a plane in log colour)."""
    return segment_reference(rgb, _fitted_table(rgb, valid), valid, height, settings)


def segment_grabcut(rgb: Image, valid: Mask, settings: SegmentationSettings | None = None) -> Segmentation:
    """Garment on a table of any pattern that is also seen along the view's rim, by GrabCut on a small picture."""
    settings = settings or SegmentationSettings()
    small, inside = _small(rgb, valid)
    colour = _unlit(small, inside)
    rim = inside & ~_eroded(inside, max(round(_RIM * max(inside.shape)), 2))
    strange = _strangeness(colour, rim)
    labels = np.where(strange > _STRANGE, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[~inside] = cv2.GC_BGD
    if np.count_nonzero(labels == cv2.GC_PR_FGD) < 20 or np.count_nonzero(labels != cv2.GC_PR_FGD) < 20:
        return _nothing(valid.shape)
    cv2.setRNGSeed(0)  # its colour clusters start from chance
    cv2.grabCut(colour, labels, (0, 0, 0, 0), np.zeros((1, 65)), np.zeros((1, 65)), 4, cv2.GC_INIT_WITH_MASK)
    cloth = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.float32)
    whole = np.asarray(cv2.resize(cloth, valid.shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32)
    mask, others, share = _clean(_by_colour(rgb, valid, whole) & valid, settings)
    if not mask.any():
        return _nothing(valid.shape)
    contour, clear = refine_boundary(mask, rgb, None)
    return Segmentation(_filled(contour, valid), contour, share * clear, others)


def _by_colour(rgb: Image, valid: Mask, coarse: Field) -> Mask:
    """Each pixel by the colours on both sides of a coarse boundary: a cut bridges what is narrower than its
    pixels, such as the table between two legs. coarse: (H, W), 1 where the garment is."""
    image = _log_colour(rgb) - np.log(_fitted_table(rgb, valid).astype(np.float32) + 8.0)
    noise = _noise_scale(rgb)
    garment, table = _eroded(coarse > 0.5, 4), _eroded((coarse < 0.5) & valid, 4)
    if min(np.count_nonzero(garment), np.count_nonzero(table)) < 500:
        return coarse > 0.5
    odds = _garment_likelihood(image, noise, garment) - _garment_likelihood(image, noise, table)
    return np.asarray(cv2.GaussianBlur(odds, (0, 0), 0.8) + _TRUST * (coarse - 0.5) > 0)


def _small(rgb: Image, valid: Mask) -> tuple[Image, Mask]:
    scale = min(_SMALL / max(valid.shape), 1.0)
    size = (max(round(valid.shape[1] * scale), 8), max(round(valid.shape[0] * scale), 8))
    inside = cv2.resize(valid.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8), inside


def _unlit(rgb: Image, inside: Mask) -> Image:
    """Log luminance and chromaticities (h, w, 3) as bytes, the light's slope along the rim taken out."""
    colour = _opponent(_log_colour(rgb) - np.log(_fitted_table(rgb, inside).astype(np.float32) + 8.0))
    return np.clip(128.0 + colour * np.array([60.0, 160.0, 160.0], np.float32), 0, 255).astype(np.uint8)


def _strangeness(colour: Image, rim: Mask) -> Field:
    """Distance (h, w) of each pixel's colour from the nearest of the rim's four, in standard deviations."""
    sample = colour[rim].astype(float)
    _, centres, covariances = _colours(sample, 4)
    floor = np.diag([4.0, 3.0, 3.0]) ** 2
    best = np.full(colour.shape[:2], np.inf)
    for centre, covariance in zip(centres, covariances, strict=True):
        z = (colour - centre) @ np.linalg.inv(np.linalg.cholesky(covariance + floor)).T
        best = np.minimum(best, np.sqrt((z * z).sum(axis=2)))
    return best


def _eroded(mask: Mask, reach: int) -> Mask:
    ball = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return cv2.erode(mask.astype(np.uint8), ball, borderValue=0) > 0


def segment_watershed(
    rgb: Image, valid: Mask, settings: SegmentationSettings | None = None
) -> Segmentation:
    """The paper's: watershed from the four corners (background) and the centre (foreground)."""
    settings = settings or SegmentationSettings()
    rows, columns = np.nonzero(valid)
    top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
    radius = max(min(bottom - top, right - left) // 20, 2)
    markers = np.zeros(valid.shape, np.int32)
    for row in (top + radius, bottom - radius):
        inside = np.flatnonzero(valid[row])
        for column in (inside[0] + radius, inside[-1] - radius):
            cv2.circle(markers, (int(column), int(row)), int(radius), 1, -1)
    cv2.circle(markers, (int(left + right) // 2, int(top + bottom) // 2), int(radius), 2, -1)
    markers[~valid] = 1
    labels = cv2.watershed(np.ascontiguousarray(cv2.medianBlur(rgb, 5)), markers)
    mask, others, share = _clean(labels == 2, settings)
    if not mask.any():
        return _nothing(valid.shape)
    contour, clear = refine_boundary(mask, rgb, None)
    return Segmentation(_filled(contour, valid), contour, share * clear, others)


def _nothing(shape: tuple[int, ...]) -> Segmentation:
    return Segmentation(np.zeros(shape, bool), np.zeros((0, 2)), 0.0, np.zeros(shape, bool))


def _filled(contour: Array, valid: Mask) -> Mask:
    """The pixels whose centres lie within a sub-pixel contour."""
    # Four times finer than the picture: fillPoly also paints every cell that the outline touches.
    fine = np.zeros((4 * valid.shape[0], 4 * valid.shape[1]), np.uint8)
    cv2.fillPoly(fine, [np.round((contour + 0.5) * 4 * 16 - 8).astype(np.int32)], 255, shift=4)
    image = cv2.resize(fine, (valid.shape[1], valid.shape[0]), interpolation=cv2.INTER_AREA)
    return (image > 127) & valid


def _log_colour(rgb: Image) -> Field:
    """The offset keeps the noise of dark pixels finite."""
    return np.asarray(cv2.LUT(cv2.GaussianBlur(rgb, (0, 0), 0.8), _LOG), dtype=np.float32)


def _noise_scale(rgb: Image, smooth: float = 2.0) -> Field:
    """Noise of log colour grows as 1 / intensity."""
    grey = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), (0, 0), smooth).astype(np.float32)
    return 128.0 / (grey + 8.0)


def _light_change(image: Field, table: Field, valid: Mask) -> Field:
    """How the light (or the exposure) changed since the reference: a plane per channel, (3, 3), see `_plane`.

    Fitted to the pixels that agree with the commonest change; the garment is an outlier.
    """
    rows, columns = valid.shape
    r, c = np.mgrid[0:rows:6, 0:columns:6]
    keep = valid[r, c]
    d = (image[::6, ::6] - table[::6, ::6])[keep].astype(float)
    r, c = r[keep], c[keep]
    basis = np.stack([np.ones(len(r)), r / rows - 0.5, c / columns - 0.5], axis=1)
    centre = np.array([_mode(channel) for channel in d.T])
    plane = np.zeros((3, 3))
    plane[0] = centre
    for tolerance in (0.12, 0.08, 0.08):
        inlier = np.abs(d - basis @ plane).max(axis=1) < tolerance
        if np.count_nonzero(inlier) < 50:
            break
        plane = np.linalg.lstsq(basis[inlier], d[inlier], rcond=None)[0]
    return np.asarray(plane, dtype=np.float32)


def _plane(plane: Field, shape: tuple[int, ...], where: tuple[slice, slice]) -> Field:
    """A plane per channel (value in the middle, slopes down and right) in a part of the view: (h, w, 3)."""
    rows, columns = shape
    along = (np.arange(rows) / rows - 0.5).astype(np.float32)[where[0], None, None]
    across = (np.arange(columns) / columns - 0.5).astype(np.float32)[None, where[1], None]
    return np.asarray((plane[0] + along * plane[1]) + across * plane[2], dtype=np.float32)


def _changed(
    difference: Field, noise: Field, spread: tuple[float, float], valid: Mask, settings: SegmentationSettings
) -> tuple[slice, slice] | None:
    """The box, in view pixels, around all that is no lit table; `difference` is every `_STRIDE`-th pixel."""
    light, chroma = difference[..., 0], np.hypot(difference[..., 1], difference[..., 2])
    darker = np.maximum(settings.dark_offset, 4.0 * spread[0] * noise)
    odd = (chroma > 4.0 * spread[1] * noise) | (np.abs(light) > darker)
    odd = _open(_close(odd & valid, 3), 3)
    rows, columns = np.flatnonzero(odd.any(axis=1)), np.flatnonzero(odd.any(axis=0))
    if not len(rows):
        return None
    margin = 40
    return (
        slice(max(int(rows[0]) * _STRIDE - margin, 0), int(rows[-1]) * _STRIDE + margin + 1),
        slice(max(int(columns[0]) * _STRIDE - margin, 0), int(columns[-1]) * _STRIDE + margin + 1),
    )


def _mode(values: Array) -> float:
    """The commonest value, from a smoothed histogram 0.02 wide."""
    edges = np.arange(-2.0, 2.02, 0.02)
    counts, _ = np.histogram(np.clip(values, -1.99, 1.99), edges)
    best = int(np.argmax(np.convolve(counts, np.ones(5), mode="same")))
    near = values[np.abs(values - (edges[best] + 0.01)) < 0.05]
    return float(np.median(near)) if len(near) else 0.0


def _opponent(colour: Field) -> Field:
    """Log luminance and the two log chromaticities, which no change of light's strength alters: (..., 3)."""
    return np.asarray(cv2.transform(colour, _OPPONENT), dtype=np.float32)


def _table_spread(difference: Field, noise: Field, valid: Mask) -> tuple[float, float]:
    """Standard deviations of the bare table's log luminance and log chromaticity, over the noise scale."""
    light, c1, c2 = difference[..., 0], difference[..., 1], difference[..., 2]
    table = valid & (np.abs(light) < 0.1) & (np.hypot(c1, c2) < 0.08)
    chroma = max(_spread(c1, noise, table), _spread(c2, noise, table), 0.006)
    return max(_spread(light, noise, table), 0.008), chroma


def _spread(values: Field, noise: Field, where: Mask) -> float:
    """Robust standard deviation of values / noise."""
    sample = values[where] / noise[where]
    return float(1.4826 * np.median(np.abs(sample - np.median(sample)))) if len(sample) > 20 else 0.03


def _core(
    difference: Field,
    noise: Field,
    spread: tuple[float, float],
    valid: Mask,
    height: Field | None,
    settings: SegmentationSettings,
) -> Mask:
    """What is surely garment: no shade of the table, or a wide dark region that stands above it."""
    light, c1, c2 = difference[..., 0], difference[..., 1], difference[..., 2]
    light_sigma, chroma_sigma = max(spread[0], 0.02) * noise, spread[1] * noise
    beyond = np.maximum(light, 0.0) + np.maximum(-light - settings.deepest_shadow, 0.0)
    doubt = np.sqrt((c1 * c1 + c2 * c2) / chroma_sigma**2 + (beyond / light_sigma) ** 2)
    core = _open((doubt > settings.surely_garment) & valid, 5)
    dark = light < -np.maximum(settings.dark_offset, 4.0 * spread[0] * noise)
    dark = _open(_close(dark & valid, 5), settings.shadow_rim) & ~core
    if dark.any():
        core |= _cloth_of(dark, height, settings)
    return core


def _cloth_of(dark: Mask, height: Field | None, settings: SegmentationSettings) -> Mask:
    """The dark, wide regions that are cloth by their height; without depth all of them are taken for it.

    Cloth and a shadow beside it can make one region: of that, only what stands up is cloth.
    """
    if height is None:
        return dark
    mean, known = _mean_height(height, _WIDE)
    flat = known & (mean < 0.5 * settings.garment_height)
    cloth = np.zeros(dark.shape, bool)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8))
    for i in range(1, count):
        left, top, width, rows, area = stats[i]
        box = np.s_[top : top + rows, left : left + width]
        region = labels[box] == i
        if area < 200 or not _stands_up(region, height[box], settings):
            continue
        mixed = np.count_nonzero(region & flat[box]) > _MIXED * area
        cloth[box] |= _open(region & ~flat[box], settings.shadow_rim) if mixed else region
    return cloth


def _stands_up(region: Mask, height: Field, settings: SegmentationSettings) -> bool:
    samples = height[region]
    samples = samples[np.isfinite(samples)]
    return len(samples) < 50 or float(samples.mean()) > settings.garment_height


def _table_likelihood(
    difference: Field, noise: Field, spread: tuple[float, float], settings: SegmentationSettings
) -> Field:
    """Log density of each pixel's colour as lit table, or as table in a shadow of any depth."""
    light, c1, c2 = difference[..., 0], difference[..., 1], difference[..., 2]
    light_sigma, chroma_sigma = spread[0] * noise, spread[1] * noise
    lit = np.exp(-0.5 * np.minimum((light / light_sigma) ** 2, 80.0)) / (2.5066 * light_sigma)
    shaded = (light < 0) & (light > -settings.deepest_shadow)
    density = (1 - settings.shadow_share) * lit + settings.shadow_share / settings.deepest_shadow * shaded
    colour = -0.5 * (c1 * c1 + c2 * c2) / chroma_sigma**2 - 2.0 * np.log(chroma_sigma) - 1.8379
    return np.maximum(np.log(density + 1e-12) + colour, _FLOOR)


def _garment_likelihood(image: Field, noise: Field, core: Mask) -> Field:
    """Log density of each pixel's colour under a mixture of three colours learnt inside `core`."""
    inner = cv2.erode(core.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    where = np.flatnonzero((inner if np.count_nonzero(inner) > 300 else core).ravel())
    channels = _opponent(image)
    sample = channels.reshape(-1, 3)[where[:: max(len(where) // 3000, 1)]].astype(float)
    weights, centres, covariances = _colours(sample)
    level = float(np.median(noise.ravel()[where]))
    roots = [np.linalg.inv(np.linalg.cholesky(c)) for c in covariances]
    constants = [np.log(w) + np.log(np.diag(root)).sum() - 2.7568 for w, root in zip(weights, roots, strict=True)]
    return np.asarray(
        _mixture(
            channels, noise, np.float32(level), np.array(centres, np.float32), np.array(roots, np.float32),
            np.array(constants, np.float32),
        ),
        dtype=np.float32,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _mixture(channels, noise, level, centres, roots, constants):  # type: ignore[no-untyped-def]
    """Log density (h, w) of the likeliest of some Gaussians; roots: inverse Cholesky factors of their covariances.
    Where noise is above `level`, they are as much wider."""
    rows, columns = noise.shape
    out = np.empty((rows, columns), np.float32)
    for i in range(rows):
        for j in range(columns):
            blur = level / max(noise[i, j], level)
            best = np.float32(_FLOOR)
            for k in range(len(constants)):
                a = channels[i, j, 0] - centres[k, 0]
                b = channels[i, j, 1] - centres[k, 1]
                c = channels[i, j, 2] - centres[k, 2]
                u = roots[k, 0, 0] * a
                v = roots[k, 1, 0] * a + roots[k, 1, 1] * b
                w = roots[k, 2, 0] * a + roots[k, 2, 1] * b + roots[k, 2, 2] * c
                best = max(best, constants[k] - np.float32(0.5) * (u * u + v * v + w * w) * blur * blur)
            out[i, j] = best
    return out


def _height_odds(height: Field, core: Mask) -> Field:
    """What depth says for the doubtful: at most two units of log odds, where cloth is thick enough to see."""
    known = np.isfinite(height)
    cloth = height[core & known]
    if len(cloth) < 500 or (top := float(np.median(cloth))) < 0.0015:
        return np.zeros(height.shape, np.float32)
    mean, seen = _mean_height(height, 7)
    return np.where(seen, np.clip(4.0 * (mean / top - 0.5), -2.0, 2.0), 0.0).astype(np.float32)


def _mean_height(height: Field, size: int) -> tuple[Field, Mask]:
    """Mean (h, w) over a square of `size` pixels of what depth knows, and where it knows enough."""
    known = np.isfinite(height)
    total = cv2.boxFilter(np.where(known, height, np.float32(0.0)), -1, (size, size))
    share = cv2.boxFilter(known.astype(np.float32), -1, (size, size))
    return np.asarray(total / np.maximum(share, 1e-3), dtype=np.float32), share > 0.3


def _colours(sample: Array, count: int = 3) -> tuple[list[float], list[Array], list[Array]]:
    """Cluster weights, centres (3,) and covariances (3, 3) by Lloyd's algorithm from luminance quantiles."""
    order = np.argsort(sample[:, 0], kind="stable")
    centres = sample[order[[int(len(order) * (i + 0.5) / count) for i in range(count)]]]
    scale = np.array([0.3, 1.0, 1.0])
    label = np.zeros(len(sample), int)
    for _ in range(8):
        gap = (sample[:, None] - centres[None]) * scale
        label = np.argmin((gap**2).sum(axis=2), axis=1)
        centres = np.array(
            [sample[label == i].mean(axis=0) if (label == i).any() else centres[i] for i in range(count)]
        )
    floor = np.diag([0.04**2, 0.012**2, 0.012**2])
    kept = [i for i in range(count) if np.count_nonzero(label == i) > 20]
    weights = [float(np.mean(label == i)) for i in kept]
    return weights, [centres[i] for i in kept], [np.cov(sample[label == i].T) + floor for i in kept]


def _close(mask: Mask, size: int) -> Mask:
    ball = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, ball) > 0


def _open(mask: Mask, size: int) -> Mask:
    ball = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, ball) > 0


def _clean(mask: Mask, settings: SegmentationSettings) -> tuple[Mask, Mask, float]:
    """The largest region, closed, opened and without holes; other large ones; its share of all the foreground."""
    ball = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    # Closed by no more than a pixel: the table between two legs is narrow.
    work = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((2, 2), np.uint8))
    work = cv2.morphologyEx(work, cv2.MORPH_OPEN, ball)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(work)
    areas = stats[1:, cv2.CC_STAT_AREA]
    if count < 2 or areas.max() < settings.smallest_area:
        return np.zeros(mask.shape, bool), np.zeros(mask.shape, bool), 0.0
    largest = (labels == 1 + int(np.argmax(areas))).astype(np.uint8)
    contours, _ = cv2.findContours(largest, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(largest, contours, -1, 1, thickness=cv2.FILLED)
    large = np.flatnonzero(areas > settings.smallest_area // 10)
    others = np.isin(labels, 1 + large[large != int(np.argmax(areas))]) & (largest == 0)
    return largest > 0, others, float(areas.max() / max(areas[large].sum(), areas.max()))


def _fitted_table(rgb: Image, valid: Mask) -> Image:
    """A table picture guessed from the rim of the view: a plane in log colour, outliers left out."""
    rows, columns = valid.shape
    inner = cv2.erode(valid.astype(np.uint8), np.ones((41, 41), np.uint8), borderValue=0) > 0
    rim = valid & ~inner
    r, c = np.nonzero(rim)
    r, c = r[::11], c[::11]
    colour = _log_colour(rgb)
    d = colour[r, c].astype(float)
    basis = np.stack([np.ones(len(r)), r / rows - 0.5, c / columns - 0.5], axis=1)
    keep = np.ones(len(r), bool)
    plane = np.zeros((3, 3))
    for _ in range(4):
        plane = np.linalg.lstsq(basis[keep], d[keep], rcond=None)[0]
        residual = np.abs(d - basis @ plane).max(axis=1)
        keep = residual <= max(2.0 * float(np.median(residual)), 1e-3)
    along = (np.arange(rows) / rows - 0.5)[:, None, None]
    across = (np.arange(columns) / columns - 0.5)[None, :, None]
    table = np.exp(plane[0] + along * plane[1] + across * plane[2]) - 8.0
    return np.clip(table, 0, 255).astype(np.uint8)
