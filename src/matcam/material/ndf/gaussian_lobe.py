"""Gaussian lobe (Holzschuch & Pacanowski 2017)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam.core import checks
from matcam.core.arrays import xp
from matcam.core.arrays.elementary import angle_of
from matcam.material.lambda_table import integrated_lambda
from matcam.material.ndf.distribution import MixtureNDF, checked_roughness

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_SMALL = 1e-6  # squared slope below which a series gives the angle, because the derivative of the root is infinite at 0


class GaussianNDF(MixtureNDF):
    """Gaussian distribution of the tilt angle of microfacets (Holzschuch & Pacanowski 2017).

    The density of facet normals D, 1/sr, is proportional to exp(-theta_h^2 / (2 width^2)), where theta_h is the angle
    between the normals of facet and surface. Quadrature gives the factor for which the integral of D cos theta_h over
    the hemisphere is 1.

    Args:
        width: standard deviation of the lobe, rad, (0, 0.5].

    Raises:
        ArgumentError: width is out of range, or not a single number.

    Source:
        Holzschuch & Pacanowski (2017), section 3.

    Example:
        >>> lobe = matcam.GaussianNDF(0.01)
        >>> round(float(lobe.d(0.01) / lobe.d(0.0)), 4)
        0.6065
    """

    width: jax.Array

    family = "gaussian"
    largest = 0.5  # rad; a wider Gaussian in theta_h does not vanish at the horizon

    def __init__(self, width: ArrayLike):
        self.width = checked_roughness("width", width, self.largest, "rad")

    def d(self, theta_h: ArrayLike) -> jax.Array:
        """Compute D, 1/sr, proportional to exp(-theta_h^2 / (2 width^2))."""
        return self._of_squared_angle(xp.square(checks.number("theta_h", theta_h)))

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """Compute the density of slopes, P22 = D cos^4 theta_h."""
        small = slope2 < _SMALL
        angle = angle_of(xp.sqrt(xp.where(small, 1.0, slope2)), xp.ones(()))
        series = slope2 * (1 - slope2 * (2 / 3 - slope2 * 23 / 45))
        return self._of_squared_angle(xp.where(small, series, angle**2)) / (1 + slope2) ** 2

    def _of_squared_angle(self, theta2: jax.Array) -> jax.Array:
        return xp.exp(-theta2 / (2 * self.width**2)) / self._integral

    @property
    def _integral(self) -> jax.Array:
        nodes, weights = (xp.asarray(a) for a in np.polynomial.legendre.leggauss(64))
        reach = xp.minimum(xp.pi / 2, 9 * self.width)
        theta = reach * (nodes + 1) / 2
        inside = xp.exp(-((theta / self.width) ** 2) / 2) * xp.sin(2 * theta)
        return xp.pi * reach / 2 * (inside @ weights)

    def coordinate(self, theta_h: jax.Array) -> jax.Array:
        """Return theta_h, rad, which is the coordinate of this lobe."""
        return theta_h

    def shape(self, r: jax.Array) -> jax.Array:
        """Compute the lobe divided by its peak.

        The ratio is exp(-r^2 / (2 width^2)), where r = theta_h.
        """
        return xp.exp(-((r / self.width) ** 2) / 2)

    def flattening(self, theta_h: jax.Array) -> jax.Array:
        """Return ones, because the lobe is Gaussian in theta_h."""
        return xp.ones_like(theta_h)

    def mixture(self) -> tuple[jax.Array, jax.Array]:
        """Compute the weight and width of the single Gaussian in theta_h."""
        return xp.ones(1), self.width[None]

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """Compute Smith's Lambda by its integral over slopes."""
        return integrated_lambda(self.slope_density, self.width, cos)

    @property
    def roughness(self) -> jax.Array:
        """First parameter, the standard deviation of the lobe, rad."""
        return self.width
