"""Values of a picture between the points of the grid on which its transform is known.

A value is a sum over the points about it, weighted by a narrow window. What the window does to each frequency the transform has
been divided by before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp

_REACH = 5
"""Steps to either side from which a value is read."""
_STEEPNESS = 0.97
"""Of the window's logarithm, over that with which its transform ends where a frequency would come back."""


class Reading(NamedTuple):
    """Say how values are read off.

    Attributes:
        steepness: of the window's logarithm, no unit.
    """

    steepness: float

    @classmethod
    def below(cls, limit: float) -> Reading:
        """Return how to read what holds no frequency above a limit, in (0, 0.5), cycles a step."""
        return cls(_STEEPNESS * 2 * np.pi * _REACH * (1 - limit))

    def window(self, steps: jax.Array) -> jax.Array:
        """Return the weight of a point so many steps away, no unit."""
        near = 1 - (steps / _REACH) ** 2
        return jnp.where(near > 0, jnp.exp(self.steepness * (jnp.sqrt(jnp.maximum(near, 1e-30)) - 1)), 0.0)

    def transfer(self, frequency: np.ndarray) -> np.ndarray:
        """Return the window's transform at frequencies below the limit, cycles a step."""
        unit, weight = np.polynomial.legendre.leggauss(64)
        window = np.exp(self.steepness * (np.sqrt(1 - unit**2) - 1)) * weight * _REACH
        return np.cos(2 * np.pi * np.multiply.outer(frequency, _REACH * unit)) @ window

    def values(self, grid: jax.Array, row: jax.Array, column: jax.Array, *, mirrored: bool = False) -> jax.Array:
        """Return values between a grid's points.

        Args:
            grid: periodic, (rows, columns, channels).
            row: places, counted in steps from the first row.
            column: the same from the first column.
            mirrored: whether the grid's mirror image follows on its last row, and stands before its first. Default: False.

        Returns:
            (places, channels).
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
