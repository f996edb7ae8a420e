"""What neither lens nor light nor noise explains of an edge, and what it may have done to an MTF.

A ghost, a shadow's border or dirt leaves residuals in few of many cells; a rough edge blurs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.calibration.edge.free_curve import FreeCurve, SampledCurve, edge_basis
from matcam.calibration.edge.free_fit import LinearFit
from matcam.calibration.edge.maximum_likelihood import light_of
from matcam.core.arrays import xp

if TYPE_CHECKING:
    from matcam.core.jax import jax

_CORE = 7.0  # px
_WINDOW, _FEWEST, _TOGETHER = 2.0, 6, 6.0  # px, cells, standard deviations
_WINDOWS = np.arange(-10.0, 9.0)  # px, where they begin
_PER_MISFIT = 5.0  # of an MTF, by an equal misfit of the cells: ghosts and shadows of tests/oracle/real_edges.py
_LOW = 0.1  # cycles/px, below which an MTF is ever surer: at 0 it is 1


class Unexplained(NamedTuple):
    """Hold what no noise explains, and what it may have done to an MTF.

    Attributes:
        roughness: px, of the edge. It blurs, as a lens does.
        misfit: of the cells near the edge, in units of the step.
    """

    roughness: jax.Array
    misfit: jax.Array

    def of(self, curve: SampledCurve, f: jax.Array) -> SampledCurve:
        """Return a curve at f cycles/px whose standard deviation contains it."""
        blurred = 2 * (xp.pi * self.roughness * f) ** 2 * xp.abs(curve.value)
        unknown = _PER_MISFIT * self.misfit * xp.minimum(f / _LOW, 1.0)
        return SampledCurve(curve.value, xp.sqrt(curve.std**2 + blurred**2 + unknown**2))


def misfit_of(fit: LinearFit, curve: FreeCurve, excess: jax.Array) -> jax.Array:
    """Return the standard deviation of cells near the edge about the free curve, beyond the noise, in units of the step.

    curve: with its glare, if there is any; fit: without. excess: factor by which all variances were raised; 1 where the cells
    as a whole scatter no more than their noise.
    """
    everywhere = xp.where(excess > 1, xp.sqrt(1 - 1 / excess) * _residual(fit), 0.0)
    return xp.maximum(everywhere, _local_misfit(fit, _left(fit, curve), excess))


def _left(fit: LinearFit, curve: FreeCurve) -> jax.Array:
    """Return what a curve leaves of the cells."""
    basis = edge_basis(curve.shape, fit.cells.distance, fit.cells.spread)
    response = basis.pilot + curve.even @ (basis.even - basis.pilot) + curve.odd @ basis.odd
    light = light_of(curve.levels, fit.cells.terms)
    dark, bright = curve.levels[:2]
    return fit.cells.value - light.addend - light.factor * (dark + (bright - dark) * response)


def _residual(fit: LinearFit) -> jax.Array:
    """Return the standard deviation of the cells near the edge about the free curve, in units of the step."""
    near = (fit.cells.pixels > 0) & (xp.abs(fit.cells.distance) < _CORE)
    return xp.sqrt((near * (fit.left / fit.step) ** 2).sum() / xp.maximum(near.sum(), 1.0))


def _local_misfit(fit: LinearFit, left: jax.Array, excess: jax.Array) -> jax.Array:
    """Return the misfit of cells that stand off together, over the whole core: a ghost spoils few of many cells.

    Windows of 2 px count whose chi2 is beyond that of noise by 6 standard deviations.
    """
    distance = fit.cells.distance
    there, variance = fit.cells.pixels > 0, excess / fit.weight
    window = there & (distance >= _WINDOWS[:, None]) & (distance < _WINDOWS[:, None] + _WINDOW)
    count = window.sum(1)
    beyond = (window * left**2 / variance).sum(1) - count
    off = (count >= _FEWEST) & (beyond > _TOGETHER * xp.sqrt(2.0 * count))
    spoilt = (window & off[:, None]).any(0)
    more = xp.where(spoilt, (left**2 - variance) / fit.step**2, 0.0).sum()  # an empty cell's variance is infinite
    core = (there & (xp.abs(distance) < _CORE)).sum()
    return xp.sqrt(xp.maximum(more, 0.0) / xp.maximum(core, 1.0))
