"""Computes log colours, and fits Gaussian mixtures to them. A change of illumination adds the same offset to all
channels of a log colour."""

from __future__ import annotations

import cv2
import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.compiled import cached
from foldcell.skills.perception.segmentation.mask import Field, Image, Mask

FLOOR = -18.0
"""Lower bound of all log densities of colours, so that an outlier has a limited effect."""
_LOG = np.log(np.arange(256, dtype=np.float32) + 8.0)
_OPPONENT = np.array(
    [[1 / 3, 1 / 3, 1 / 3], [0.5**0.5, -(0.5**0.5), 0.0], [6**-0.5, 6**-0.5, -2 * 6**-0.5]], np.float32
)


def log_colour(rgb: Image) -> Field:
    """Compute the smoothed log colours (H, W, 3) of rgb (H, W, 3). An offset limits the noise of dark pixels."""
    return np.asarray(cv2.LUT(cv2.GaussianBlur(rgb, (0, 0), 0.8), _LOG), dtype=np.float32)


def opponent(colour: Field) -> Field:
    """Convert log colours (..., 3) to log luminance and two log chromaticities (..., 3). The chromaticities do not
    depend on the light's intensity."""
    return np.asarray(cv2.transform(colour, _OPPONENT), dtype=np.float32)


def noise_scale(rgb: Image, smooth: float = 2.0) -> Field:
    """Compute the relative noise (H, W) of log colours: it is proportional to 1 / intensity. smooth: sigma of the
    blur of the intensity [px]."""
    grey = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), (0, 0), smooth).astype(np.float32)
    return 128.0 / (grey + 8.0)


def colour_likelihood(image: Field, noise: Field, core: Mask) -> Field:
    """Compute the log density (H, W) of each pixel's log colour in a mixture of three Gaussians, which is fitted
    to the pixels inside `core`."""
    inner = cv2.erode(core.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    core_pixels = np.flatnonzero((inner if np.count_nonzero(inner) > 300 else core).ravel())
    channels = opponent(image)
    sample = channels.reshape(-1, 3)[core_pixels[:: max(len(core_pixels) // 3000, 1)]].astype(float)
    weights, centres, covariances = cluster_colours(sample)
    core_noise = float(np.median(noise.ravel()[core_pixels]))
    roots = [np.linalg.inv(np.linalg.cholesky(c)) for c in covariances]
    constants = [np.log(w) + np.log(np.diag(root)).sum() - 2.7568 for w, root in zip(weights, roots, strict=True)]
    return np.asarray(
        _mixture(
            channels, noise, np.float32(core_noise), np.array(centres, np.float32), np.array(roots, np.float32),
            np.array(constants, np.float32),
        ),
        dtype=np.float32,
    )  # fmt: skip


@cached()
def _mixture(channels, noise, core_noise, centres, roots, constants):  # type: ignore[no-untyped-def]
    """Computes the log density (h, w) of the most likely Gaussian at each pixel. roots: inverse Cholesky factors
    of the covariances. Where the noise exceeds `core_noise`, the Gaussians are wider by the ratio of the two."""
    rows, columns = noise.shape
    out = np.empty((rows, columns), np.float32)
    for i in range(rows):
        for j in range(columns):
            inverse_width = core_noise / max(noise[i, j], core_noise)
            best = np.float32(FLOOR)
            for k in range(len(constants)):
                a = channels[i, j, 0] - centres[k, 0]
                b = channels[i, j, 1] - centres[k, 1]
                c = channels[i, j, 2] - centres[k, 2]
                u = roots[k, 0, 0] * a
                v = roots[k, 1, 0] * a + roots[k, 1, 1] * b
                w = roots[k, 2, 0] * a + roots[k, 2, 1] * b + roots[k, 2, 2] * c
                best = max(
                    best, constants[k] - np.float32(0.5) * (u * u + v * v + w * w) * inverse_width * inverse_width
                )
            out[i, j] = best
    return out


def cluster_colours(sample: Array, count: int = 3) -> tuple[list[float], list[Array], list[Array]]:
    """Cluster colours (n, 3) by Lloyd's algorithm, which starts from quantiles of the luminance. Return the
    clusters' weights, centres (3,) and covariances (3, 3)."""
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
