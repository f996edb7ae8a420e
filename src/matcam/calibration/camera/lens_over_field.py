"""Change of the lens over the field, from the positions of dots and from the blur of edges and dots.

The dots are on a plane page. Their deviation from the pinhole projection of the plane is the distortion of the lens. The
blur is modelled as a quadratic function of the distance from the centre of the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from matcam.calibration.chart.registration import FEWEST_POSITIONS, radial_distortion
from matcam.camera.lens_field import Coefficient, LensField
from matcam.core.errors import FitError
from matcam.numerics.normal import robust_fit


class BlurSamples(NamedTuple):
    """Lens width at n positions in the image.

    Attributes:
        seen: (n, 2) positions in the image, px.
        sigma: (n,) lens width, px.
        sigma_std: (n,) standard deviation of `sigma`, px.
        printed: (n, 2) positions of dots on the page, in any unit. Default: None, the samples are not dots.
    """

    seen: np.ndarray
    sigma: np.ndarray
    sigma_std: np.ndarray
    printed: np.ndarray | None = None


def lens_over_field(positions: Sequence[BlurSamples], shape: tuple[int, int]) -> LensField | None:
    """Estimate the distortion and the growth of the blur over the field.

    The result is None if neither can be estimated.

    Args:
        positions: edges or dots of each image. Each of these groups has its own mean lens width. The blur of groups with
            fewer than 12 positions is not used.
        shape: height and width of the images, px.
    """
    middle, unit = ((shape[1] - 1) / 2, (shape[0] - 1) / 2), float(np.hypot(*shape) / 2)
    found = []
    for one in positions:
        if one.printed is not None:
            with suppress(FitError):
                found.append(radial_distortion(one.printed, one.seen, shape))
    # Without dots, the distortion is 0 with a standard deviation of 0.01.
    k1 = Coefficient(0.0, 0.01)
    if found:
        values, stds = np.array(found).T
        weight = np.maximum(stds, 1e-9) ** -2
        mean = float(np.average(values, weights=weight))
        chi2 = float(weight @ (values - mean) ** 2) / max(len(values) - 1, 1)
        # One coefficient about the image centre only approximates the distortion, to 2 %.
        k1 = Coefficient(mean, float(np.hypot(np.sqrt(max(chi2, 1.0) / weight.sum()), 0.02 * mean)))
    growth, holds_at = _growth([one for one in positions if len(one.seen) >= FEWEST_POSITIONS], np.array(middle), unit)
    if not found and growth is None:
        return None
    return LensField(middle, unit, k1, growth=growth or Coefficient(), holds_at=holds_at)


def _growth(groups: Sequence[BlurSamples], middle: np.ndarray, unit: float) -> tuple[Coefficient | None, float]:
    """Estimate the growth of the blur with rho^2, relative to the blur at a reference distance from the centre.

    rho is the distance from the centre of the image divided by half the diagonal (`unit`, px). The second result is the
    reference distance, px. The first result is None if there are no groups.
    """
    if not groups:
        return None, 0.0
    member = np.repeat(np.eye(len(groups)), [len(one.seen) for one in groups], axis=0)
    rho2 = np.concatenate([(((one.seen - middle) / unit) ** 2).sum(1) for one in groups])
    relative = np.concatenate([one.sigma / np.median(one.sigma) for one in groups])
    # All edges of a group get the same standard deviation. Individual ones would favour edges that are sharp by chance.
    std = member @ [float(np.median(one.sigma_std / one.sigma)) for one in groups]
    fit = robust_fit(np.column_stack([rho2, member]), relative, std)
    slope, *levels = (float(p) for p in fit.parameters)
    at = float(np.average(rho2[fit.kept], weights=std[fit.kept] ** -2))
    level = float(np.mean(levels)) + slope * at
    growth_std = float(np.sqrt(fit.covariance[0, 0] * max(fit.chi2, 1.0))) / level
    return Coefficient(float(np.clip(slope / level, -0.5, 0.5)), growth_std), float(np.sqrt(at) * unit)
