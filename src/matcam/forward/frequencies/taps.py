"""Points of light laid on the points of an even grid, for what is looked at below a frequency only.

Each is laid by a sinc under a window, whose transform is 1 below the limit and 0 where a frequency would come back below it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from matcam.core.jax import AnyArray, jax, jnp

_LOST = 14.0
"""Logarithm of one over the error of what is laid: 1e-6."""
_DEGREE = 12
"""Of the polynomial, in the squared distance, that stands for the window: it is within 3e-7."""
_ON_A_POINT = 1e-9  # steps


class Taps(NamedTuple):
    """Say how far a point of light is laid on its neighbours on a grid.

    Attributes:
        reach: steps to either side, beyond which there is nothing.
    """

    reach: int

    @classmethod
    def below(cls, limit: float) -> Taps:
        """Return the fewest that are right for frequencies below a limit, in (0, 0.5), cycles a step."""
        return cls(math.ceil(_LOST / (math.pi * (1 - 2 * limit))))

    def weights(self, at: jax.Array, start: AnyArray, count: int) -> jax.Array:
        """Return the shares that points of a grid have in points of light, (..., count, places), no unit.

        Args:
            at: places of light in steps from the grid's first point, (..., places).
            start: number of the first of the grid's points that are asked for, (...).
            count: how many of them.
        """
        nearest = jnp.round(jax.lax.stop_gradient(at))
        off = (at - nearest)[..., None, :]
        whole = (jnp.asarray(start)[..., None] - nearest)[..., None, :] + np.arange(count)[:, None]
        away = whole - off
        on_it = jnp.abs(away) < _ON_A_POINT
        # sin(pi away) is that of the rest of a step, up to its sign: one sine serves all points
        sign = 4 * jnp.abs(whole / 2 - jnp.floor(whole / 2)) - 1
        sinc = jnp.where(on_it, 1.0, sign * jnp.sin(jnp.pi * off) / (jnp.pi * jnp.where(on_it, 1.0, away)))
        window = _polynomial(_window(), (away / self.reach) ** 2)
        return jnp.where(jnp.abs(away) < self.reach, sinc * window, 0.0)


def _window() -> np.ndarray:
    """Return coefficients, highest first, of a polynomial in the squared distance over the reach."""
    at = (1 + np.cos(np.pi * (np.arange(400) + 0.5) / 400)) / 2
    fitted = np.polynomial.Chebyshev.fit(at, np.exp(_LOST * (np.sqrt(1 - at) - 1)), _DEGREE, domain=[0, 1])
    return fitted.convert(kind=np.polynomial.Polynomial).coef[::-1]


def _polynomial(coefficients: np.ndarray, at: jax.Array) -> jax.Array:
    total = jnp.full_like(at, coefficients[0])
    for one in coefficients[1:]:
        total = total * at + one
    return total
