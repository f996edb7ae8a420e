"""Whether a picture is slightly sharpened: neighbours whose noise errs apart, and an edge that no lens makes.

A lens spreads light, so that its line spread function is nowhere negative; an unsharp mask's is, beside the core. Therefore the
edge is fitted twice by any non-negative line spread function (a row of narrow bumps): as it is, and behind an unsharp mask. By
how much the mask lowers chi2 is what the edge says. The noise says its part in the same units. Defocus, ghosts and glare are
non-negative and cannot pass for a mask.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.special import ndtr

from matcam.calibration.photograph.flat_noise import LEAST_NOISE
from matcam.calibration.photograph.linear_filters import MASK
from matcam.core.arrays import FloatArray
from matcam.numerics.crossing import first_fall

AMOUNT, RADIUS = MASK
_FOUND, _SHARPER, _SOFT = (
    13.0,
    6.5,
    0.75,
)  # 2 ln likelihood; how it grows with the inverse of the blur; from which blur on, px
_LEAST_WIDTH, _WIDTH, _CORE, _COARSER = 0.2, 0.3, 6.0, 0.25  # px; blurs; blurs; of the distance: the bumps
_ROOM = 0.8  # of the region, to which bumps reach


class BareEdge(NamedTuple):
    """Set of n means of pixels across an edge.

    Attributes:
        distance: (n,) px from the edge.
        spread: (n,) px^2, variance of the distances in each mean.
        value: (n,) less the light that adds to the scene.
        std: (n,) standard deviation of the noise.
        step: (n,) bright less dark, in this light.
        light: (k, n) levels and light, as columns that any multiple may be taken of.
        blur: px, standard deviation of the line spread function.
    """

    distance: FloatArray
    spread: FloatArray
    value: FloatArray
    std: FloatArray
    step: FloatArray
    light: FloatArray
    blur: float


def edge_gain(edge: BareEdge) -> float:
    """Return by how much the mask lowers chi2 of an edge, behind any non-negative line spread function."""
    weight = 1 / np.hypot(edge.std, LEAST_NOISE * edge.step)
    given = edge.light * weight
    # what is free of any bound is taken out of everything
    basis = np.linalg.qr((given / np.maximum(np.linalg.norm(given, axis=1), 1e-300)[:, None]).T)[0]

    def beyond(columns: FloatArray) -> FloatArray:
        return columns - (columns @ basis) @ basis.T

    distance = edge.distance
    places, widths = _bumps(edge.blur, _ROOM * min(float(distance.max()), -float(distance.min())))

    def edges(more: float) -> FloatArray:
        return np.asarray(ndtr((distance - places[:, None]) / np.sqrt(widths[:, None] ** 2 + edge.spread + more**2)))

    lens, wider = edges(0.0), edges(RADIUS)
    wanted = beyond((edge.value * weight)[None])[0]
    left = [
        nnls(beyond(columns * edge.step * weight).T, wanted)[1] ** 2
        for columns in (lens, lens + AMOUNT * (lens - wider))
    ]
    return float(left[0] - left[1])


def needed_gain(blur: float) -> float:
    """Return by how much the mask must lower chi2 of noise and edge to be seen: two of 1,000 clean edges do.

    A sharp edge is flat up to its core, where noise asks for negative light that the mask alone can give: clean edges of
    sigma 0.3, 0.5 and 0.7 px at SNR 100 gain 7 +- 3, 5 +- 2 and 3 +- 1 by it.

    Args:
        blur: px, standard deviation of the line spread function.
    """
    return _FOUND + _SHARPER * max(0.0, 1 / blur - 1 / _SOFT)


def effect_on_half(frequency: FloatArray, mtf: FloatArray) -> float:
    """Return by how much the mask raises the frequency at which an MTF is one half, relative; 0 where it has none.

    Args:
        frequency: frequencies, cycles/px.
        mtf: MTF behind the mask, of the same shape.
    """
    before = mtf / (1 + AMOUNT * (1 - np.exp(-2 * (np.pi * RADIUS * frequency) ** 2)))
    share = float(first_fall(frequency, mtf) / first_fall(frequency, before)) - 1
    return share if np.isfinite(share) else 0.0


def _bumps(blur: float, reach: float) -> tuple[FloatArray, FloatArray]:
    """Return places and widths of the bumps of a line spread function, px: narrow in the core, coarser outside."""
    width = max(_LEAST_WIDTH, _WIDTH * blur)
    half = min(max(_CORE * blur, 5.0), reach)
    core = width * np.arange(int(2 * half / width) + 1)
    core -= core.mean()
    places, widths, at = [], [], float(core[-1])
    while at < reach:
        step = max(width, _COARSER * at)
        at += step
        places.append(at)
        widths.append(step)
    outside, wide = np.array(places[:-1]), np.array(widths[:-1])
    return np.concatenate([-outside[::-1], core, outside]), np.concatenate(
        [wide[::-1], np.full(core.size, width), wide]
    )
