"""Interpolation of a band-limited image between the points of its grid.

An interpolated value is the sum of the values at neighbouring points, weighted by a narrow window. Before the
interpolation, the Fourier transform of the image must be divided by the Fourier transform of the window.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp

_REACH = 5
"""Support radius of the window, steps."""
_STEEPNESS = 0.97
"""Steepness of the logarithm of the window, relative to the steepness for which the transform of the window ends at the
lowest aliased frequency.
"""


class Reading(NamedTuple):
    """Window function for the interpolation on a grid.

    Attributes:
        steepness: factor s of the window exp(s (sqrt(1 - u^2) - 1)), no unit. Here u is the distance, relative to the support
            radius of the window.
    """

    steepness: float

    @classmethod
    def below(cls, limit: float) -> Reading:
        """Build the window for a band limit in (0, 0.5), cycles per step."""
        return cls(_STEEPNESS * 2 * np.pi * _REACH * (1 - limit))

    def window(self, steps: jax.Array) -> jax.Array:
        """Evaluate the weights, no unit, of grid points at the given distances in steps."""
        near = 1 - (steps / _REACH) ** 2
        return jnp.where(near > 0, jnp.exp(self.steepness * (jnp.sqrt(jnp.maximum(near, 1e-30)) - 1)), 0.0)

    def transfer(self, frequency: np.ndarray) -> np.ndarray:
        """Evaluate the Fourier transform of the window at frequencies below the band limit, cycles per step."""
        unit, weight = np.polynomial.legendre.leggauss(64)
        window = np.exp(self.steepness * (np.sqrt(1 - unit**2) - 1)) * weight * _REACH
        return np.cos(2 * np.pi * np.multiply.outer(frequency, _REACH * unit)) @ window

    def values(self, grid: jax.Array, row: jax.Array, column: jax.Array, *, mirrored: bool = False) -> jax.Array:
        """Interpolate values between the points of a grid.

        Args:
            grid: periodic grid, (rows, columns, channels).
            row: positions in steps from the first row, (positions,).
            column: positions in steps from the first column, (positions,).
            mirrored: True if the grid is continued by its mirror image beyond its first and last rows. Default: False.

        Returns:
            Values, (positions, channels).
        """
        taps, shares = [], []
        for at in (row, column):
            first = jnp.floor(jax.lax.stop_gradient(at)).astype(int) - (_REACH - 1)
            taps.append(first[:, None] + np.arange(2 * _REACH))
            shares.append(self.window(at[:, None] - taps[-1]))
        rows, columns = grid.shape[:2]
        down = taps[0] % (2 * rows if mirrored else rows)
        down = jnp.where(down < rows, down, 2 * rows - 1 - down)
        found = grid[down[:, :, None], (taps[1] % columns)[:, None, :]]
        return jnp.einsum("prck,pr,pc->pk", found, *shares)
