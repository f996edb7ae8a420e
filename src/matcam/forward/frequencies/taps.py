"""Distribution of points of light over a regular grid, accurate below a frequency limit.

Each point is distributed by a windowed sinc, whose transform is 1 below the limit and 0 at frequencies that alias to
frequencies below the limit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from matcam.core.arrays.elementary import sine
from matcam.core.jax import AnyArray, jax, jnp

_LOST = 14.0
"""Logarithm of the inverse error of the distribution, for an error of 1e-6."""


class Taps(NamedTuple):
    """Weights of a point of light at neighbouring points of a grid.

    Attributes:
        reach: support radius of the windowed sinc, steps.
    """

    reach: int

    @classmethod
    def below(cls, limit: float) -> Taps:
        """Choose the smallest support for frequencies below a limit, in (0, 0.5), cycles per step."""
        return cls(math.ceil(_LOST / (math.pi * (1 - 2 * limit))))

    def weights(self, at: jax.Array, start: AnyArray, count: int) -> jax.Array:
        """Compute the weights of grid points for points of light, (..., count, positions), no unit.

        Args:
            at: positions of light in steps from the grid's first point, (..., positions).
            start: index of the first requested grid point, (...).
            count: number of requested points.
        """
        nearest = jnp.round(jax.lax.stop_gradient(at))
        off = (at - nearest)[..., None, :]
        whole = (jnp.asarray(start)[..., None] - nearest)[..., None, :] + np.arange(count)[:, None]
        away = whole - off
        on_it = jnp.abs(away) < 1e-9
        # up to its sign, sin(pi away) equals sin(pi off), so one sine suffices for all grid points
        sign = 4 * jnp.abs(whole / 2 - jnp.floor(whole / 2)) - 1
        sinc = jnp.where(on_it, 1.0, sign * sine(jnp.pi * off) / (jnp.pi * jnp.where(on_it, 1.0, away)))
        window = _polynomial(_window(), (away / self.reach) ** 2)
        return jnp.where(jnp.abs(away) < self.reach, sinc * window, 0.0)


def _window() -> np.ndarray:
    """Compute the coefficients of the window as a polynomial in (distance / support radius)^2, to 3e-7.

    The highest power is first.
    """
    at = (1 + np.cos(np.pi * (np.arange(400) + 0.5) / 400)) / 2
    fitted = np.polynomial.Chebyshev.fit(at, np.exp(_LOST * (np.sqrt(1 - at) - 1)), 12, domain=[0, 1])
    return fitted.convert(kind=np.polynomial.Polynomial).coef[::-1]


def _polynomial(coefficients: np.ndarray, at: jax.Array) -> jax.Array:
    total = jnp.full_like(at, coefficients[0])
    for one in coefficients[1:]:
        total = total * at + one
    return total
