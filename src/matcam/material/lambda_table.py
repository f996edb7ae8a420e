"""Table of Smith's Lambda of a lobe, for evaluation in many directions.

The directions of the table are the same for all lobes. The position of a direction depends neither on the lobe nor on
the number of entries. A fit evaluates successive lobes in the same directions, so it computes each position once. An
entry is ln(cot theta (1 + Lambda)), which is finite at the horizon. The entries are equally spaced in asinh(cot theta /
1e-5). For roughnesses from 1e-4 to 1, the error of 1 / (1 + Lambda) is at most 3e-6 with 187 entries, and 1e-9 with 2400
entries. For lobes as steep as an EPD with a power of 1.8, the error is at most 1e-5 with 187 entries.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.core.arrays import xp
from matcam.core.arrays.elementary import arcsinh
from matcam.material.masking import NEAREST, SlopeDensity, cot_of, smith_lambda
from matcam.numerics.approximation import AnyValues, between_entries, first_of_four

if TYPE_CHECKING:
    from matcam.core.jax import jax

_KNEE = 1e-5  # cot theta below which the entries are equally spaced in cot theta: a tenth of the least roughness
_LEVEL = 1e4  # largest cot theta of the table, at which masking is negligible
_END = float(np.arcsinh(_LEVEL / _KNEE))
_MANY = 2400  # number of entries for an error of 1e-9
_CUBICS = np.linalg.inv(np.vander([-1.0, 0.0, 1.0, 2.0], increasing=True))
"""Coefficients of the cubic through four entries, as a matrix (powers, entries)."""


def cots_of_table(entries: int) -> np.ndarray:
    """Compute cot theta of the directions of a table, (entries,)."""
    return np.maximum(_KNEE * np.sinh(np.linspace(0.0, _END, entries)), NEAREST)


def table_of(lambdas: AnyValues) -> AnyValues:
    """Compute a table, (entries,), from Lambda in the directions of `cots_of_table`, (entries,)."""
    return xp.log(cots_of_table(lambdas.size) * (1 + lambdas))


def position_of(cos: AnyValues) -> AnyValues:
    """Compute the positions of directions in a table, in [0, 1].

    The result is a NumPy array if `cos` is a NumPy array.
    """
    return arcsinh(_cot_in_table(cos) / _KNEE) / _END  # type: ignore[return-value]


def lambda_at(table: jax.Array, cos: jax.Array) -> jax.Array:
    """Interpolate Lambda in directions by cubics through four entries.

    cos: cosines of the angles of the directions to the normal, > 0.
    """
    log = between_entries(table, position_of(cos) * (table.size - 1))
    return xp.maximum(xp.exp(log) / _cot_in_table(cos) - 1, 0.0)


def _cot_in_table(cos: AnyValues) -> AnyValues:
    return xp.minimum(cot_of(cos), _LEVEL)


class TabulatedDirections(NamedTuple):
    """Directions in which Lambda of successive lobes is interpolated, as positions in a table.

    Attributes:
        first: index of the first of the four entries about each direction, (cells, ...).
        offset: distance of the direction from the second of the four entries, in entries, (cells, ...).
        log_cot: ln cot theta, (cells, ...).
    """

    first: np.ndarray
    offset: np.ndarray
    log_cot: np.ndarray

    @classmethod
    def of(cls, cos: np.ndarray, entries: int) -> TabulatedDirections:
        """Locate directions in a table.

        cos: cosines of the angles to the normal, (cells, ...). entries: number of entries of the table.
        """
        position = np.asarray(position_of(cos)) * (entries - 1)
        first = first_of_four(position, entries)
        return cls(first, position - first - 1, np.log(_cot_in_table(cos)))

    def one_plus_lambda(self, table: np.ndarray) -> np.ndarray:
        """Interpolate 1 + Lambda, (cells, ...)."""
        lower, highest = np.split(_cubics(table), [3])
        log = np.take(highest[0], self.first)
        for coefficients in lower[::-1]:
            log *= self.offset
            log += np.take(coefficients, self.first)
        log -= self.log_cot
        return np.asarray(np.exp(log))

    def by_tables(self, by_log: np.ndarray, tables: np.ndarray) -> np.ndarray:
        """Differentiate a sum over each cell with respect to changes of the table, (changes, cells).

        by_log: derivatives of the sum with respect to ln(1 + Lambda) in each direction, (cells, ...). tables: changes of the
            table, (changes, entries).
        """
        cells, intervals = len(self.first), tables.shape[1] - 3
        bins = (
            np.arange(0, cells * intervals, intervals).reshape(-1, *[1] * (self.first.ndim - 1)) + self.first
        ).ravel()
        weight, offset, total = by_log.ravel(), self.offset.ravel(), np.zeros((len(tables), cells))
        for coefficients in np.moveaxis(_cubics(tables), 1, 0):
            total += coefficients @ np.bincount(bins, weight, cells * intervals).reshape(cells, intervals).T
            weight = weight * offset
        return total


def _cubics(table: np.ndarray) -> np.ndarray:
    """Compute the coefficients of the cubics between the entries of tables, (..., powers, intervals)."""
    return np.asarray(_CUBICS @ np.moveaxis(np.lib.stride_tricks.sliding_window_view(table, 4, axis=-1), -1, -2))


def integrated_lambda(slope_density: SlopeDensity, scale: jax.Array, cos: jax.Array) -> jax.Array:
    """Compute Smith's Lambda of an isotropic slope density by quadrature.

    For more than 2400 directions, Lambda is interpolated in a table of 2400 entries. The error of 1 / (1 + Lambda) is then
    1e-9.

    Args:
        slope_density: P22 as a function of the squared slope.
        scale: scale of the slopes on which P22 decreases, shape ().
        cos: cosines of the angles of the directions to the normal, > 0.
    """
    cot = cot_of(cos)
    if cot.size <= _MANY:
        return smith_lambda(slope_density, scale, cot)
    return lambda_at(table_of(smith_lambda(slope_density, scale, xp.asarray(cots_of_table(_MANY)))), cos)
