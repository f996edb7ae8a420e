"""The change of the lens over the field, from the positions of dots and the blur of all edges.

Dots are on a plane page: a deviation from the pinhole projection of the plane is the distortion of the lens. The blur
of edges and dots is modelled as a constant, or as a quadratic function of the distance from the centre of the picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.calibration.chart.registration import radial_distortion
from matcam.camera.lens_field import Coefficient, LensField
from matcam.core.errors import FitError

_UNKNOWN = 0.01
"""Standard deviation of k1 where no dots have been measured."""
_FEWEST = 12  # in widths of the lens
_MODEL = 0.02
"""Standard deviation of k1 from the approximation of the distortion by one coefficient about the centre of the picture."""


class DotPlaces(NamedTuple):
    """Positions of dots on the page (in any unit) and in the picture (px), (n, 2) each, and the blur at each in px."""

    printed: np.ndarray
    seen: np.ndarray
    sigma: np.ndarray
    sigma_std: np.ndarray


class BlurPlaces(NamedTuple):
    """Width of the lens at n positions in the picture, and its standard deviation, px."""

    x: np.ndarray
    y: np.ndarray
    sigma: np.ndarray
    sigma_std: np.ndarray


def lens_over_field(dots: Sequence[DotPlaces], blurs: Sequence[BlurPlaces], shape: tuple[int, int]) -> LensField | None:
    """Return distortion and growth of the blur over the field, or None if neither was measured.

    Args:
        dots: of each picture of a page with dots.
        blurs: of edges or dots, each group with one width of its own; groups of fewer than 12 are left out.
        shape: height and width of the pictures, px.
    """
    middle, unit = ((shape[1] - 1) / 2, (shape[0] - 1) / 2), float(np.hypot(*shape) / 2)
    found = []
    for one in dots:
        try:
            found.append(radial_distortion(one.printed, one.seen, shape))
        except FitError:
            continue
    k1 = Coefficient(0.0, _UNKNOWN)
    if found:
        values, stds = np.array(found).T
        weight = 1 / np.maximum(stds, 1e-9) ** 2
        mean = float(np.sum(weight * values) / weight.sum())
        scatter = float(np.sqrt(np.sum(weight * (values - mean) ** 2) / max(len(values) - 1, 1)))
        k1 = Coefficient(mean, float(np.hypot(max(1.0, scatter) / np.sqrt(weight.sum()), _MODEL * mean)))
    growth, holds_at = _growth(blurs, middle, unit)
    if not found and growth is None:
        return None
    return LensField(middle, unit, k1, growth=growth or Coefficient(), holds_at=holds_at)


def _growth(blurs: Sequence[BlurPlaces], middle: tuple[float, float], unit: float) -> tuple[Coefficient | None, float]:
    """Return the growth of the blur with rho^2, and the distance from the centre that it refers to, px."""
    use = [one for one in blurs if len(one.x) >= _FEWEST]
    if not use:
        return None, 0.0
    rho2, relative, weight = [], [], []
    for one in use:
        here = ((one.x - middle[0]) ** 2 + (one.y - middle[1]) ** 2) / unit**2
        # Equal edges get equal standard deviations: that of a single edge would favour those that look sharp by chance.
        own = np.full(len(here), 1 / float(np.median(one.sigma_std / one.sigma)) ** 2)
        mean = float(np.median(one.sigma))
        rho2.append(here)
        relative.append(one.sigma / mean - 1)
        weight.append(own)
    x, y, w = map(np.concatenate, (rho2, relative, weight))
    groups = np.repeat(np.arange(len(use)), [len(one.x) for one in use])
    keep = np.ones(len(x), bool)
    for _ in range(3):
        design = np.column_stack([x, *(groups == k for k in range(len(use)))])[keep]
        root = np.sqrt(w[keep])
        p, *_ = np.linalg.lstsq(design * root[:, None], y[keep] * root, rcond=None)
        left = y - np.column_stack([x, *(groups == k for k in range(len(use)))]) @ p
        scale = 1.4826 * float(np.median(np.abs(left[keep])))
        keep = np.abs(left) < 4 * max(scale, 1e-12)
    freedom = max(int(keep.sum()) - len(p), 1)
    chi2 = float(np.sum(w[keep] * left[keep] ** 2)) / freedom
    normal = (design * root[:, None]).T @ (design * root[:, None])
    std = float(np.sqrt(np.linalg.pinv(normal)[0, 0] * max(chi2, 1.0)))
    at = float(np.sum(w[keep] * x[keep]) / w[keep].sum())
    level = 1 + float(np.average(p[1:])) + float(p[0]) * at
    return Coefficient(float(np.clip(p[0] / level, -0.5, 0.5)), std / level), float(np.sqrt(at) * unit)
