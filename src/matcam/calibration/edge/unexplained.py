"""The residual of an edge that no model explains: noise, outlying pixels, and the misfit of the cells.

Pixels that sample the edge at one phase, in one aligned column, should have equal values. A pixel is left out (a hot or
dead pixel, dust) if it is far from the others of its group, relative to their scatter and to the noise; this needs no
model of the edge. A ghost, the border of a shadow or dirt leaves residuals in few of many cells, and a rough edge
blurs: both increase the errors of an MTF.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.calibration.edge.free_curve import FreeCurve, SampledCurve, edge_basis
from matcam.calibration.edge.free_fit import LinearFit
from matcam.calibration.edge.geometry import AlignedRows, phased_rows
from matcam.calibration.edge.maximum_likelihood import Noise, light_of
from matcam.calibration.edge.start import side_levels
from matcam.core.arrays import repeated, xp

if TYPE_CHECKING:
    from matcam.core.jax import jax

_FAR = 6.0  # standard deviations: by chance once in 5e8 pixels
_ROUNDS = 2
_LEVEL_REACH = 6.0  # px from the edge: beyond it there are only levels and noise
_LEAST_NOISE = 1e-4  # relative to the step: rounding, and the error of any model
_SAME, _COARSEST = 1e-9, 0.1
"""Difference of neighbours, relative to the step, up to which they have one code; largest distance of codes."""
_ROBUST, _LARGE = 4, 20.0  # number of rounds; multiple of the mean square to which a difference is clipped
_OTHERS = 3  # smallest number of pixels for a comparison


def without_outliers(aligned: AlignedRows, curve: jax.Array, noise: Noise) -> AlignedRows:
    """Return rows whose outlying pixels count as missing."""
    phased = phased_rows(aligned, curve)
    member, columns = phased.member, aligned.value.shape[1]
    dark, bright = side_levels(aligned)
    level = (dark + bright) / 2
    level = xp.where(level > 0, level / xp.maximum(level.mean(), 1e-300), 1.0)[:, None]
    value = aligned.value / level
    variance = noise.variance(aligned.value, 1 / aligned.light[:, None]) / level**2

    def again(valid: jax.Array) -> jax.Array:
        def summed(*quantities: jax.Array) -> tuple[jax.Array, ...]:
            sums = member @ xp.concatenate([valid * q for q in quantities], 1)
            return tuple(sums[:, i * columns : (i + 1) * columns] for i in range(len(quantities)))

        count, total, apart = summed(xp.ones_like(value), value, phased.distance)
        some = xp.maximum(count, 1.0)
        mean = total / some
        # within a group the distances differ by an eighth of a px
        ends = (count[:, 2:] > 0) & (count[:, :-2] > 0)
        slope = xp.pad(xp.where(ends, (mean[:, 2:] - mean[:, :-2]) / (2 * aligned.step), 0.0), ((0, 0), (1, 1)))
        of = lambda a: a[phased.phase]  # noqa: E731
        off = value - of(mean) - of(slope) * (phased.distance - of(apart / some))
        first, second = summed(off, off**2)
        others = xp.maximum(of(count) - 1, 1.0)
        middle = (of(first) - off) / others
        scatter = xp.maximum((of(second) - off**2) / others - middle**2, variance)
        far = (off - middle) ** 2 > _FAR**2 * scatter * (1 + 1 / others)
        return valid * ~(far & (of(count) > _OTHERS))

    valid = repeated(_ROUNDS, again, aligned.valid)
    return aligned._replace(valid=valid, value=aligned.value * valid)


def estimated_noise(known: Noise, aligned: AlignedRows, distance: jax.Array) -> Noise:
    """Return the noise, with estimates of its unknown parts.

    The estimate uses the differences of pixels 2 px apart on both sides of the edge, which have one colour in a mosaic.
    """
    # second differences: light that changes across the edge does not count as noise
    difference = aligned.value[:, 4:] - 2 * aligned.value[:, 2:-2] + aligned.value[:, :-4]
    all_three = aligned.valid[:, 4:] * aligned.valid[:, 2:-2] * aligned.valid[:, :-4]
    away = distance[:, 2:-2]
    far = all_three * (xp.abs(away) > xp.minimum(_LEVEL_REACH, 0.3 * aligned.step * aligned.value.shape[1]))

    def side(part: jax.Array) -> tuple[jax.Array, jax.Array]:
        weight = far * part
        count = xp.maximum(weight.sum(), 1.0)
        power = xp.asarray(xp.inf)
        for _ in range(_ROBUST):  # a single hot pixel does not count as noise
            power = (weight * xp.minimum(difference**2, _LARGE * power)).sum() / count
        return (weight * aligned.value[:, 2:-2]).sum() / count, power / 6

    (low, v_low), (high, v_high) = side(away < 0), side(away > 0)
    # whole codes: if the noise is below one level, rounding is the noise
    step = xp.abs(aligned.value[:, 1:] - aligned.value[:, :-1])
    there = aligned.valid[:, 1:] * aligned.valid[:, :-1] * (step > _SAME * (high - low))
    level = xp.minimum(xp.min(xp.where(there > 0, step, xp.inf)), _COARSEST * xp.abs(high - low))
    v_low, v_high = (xp.maximum(v, level**2 / 12) for v in (v_low, v_high))
    gain = xp.clip((v_high - v_low) / (high - low), 0.0, v_high / xp.maximum(high, 1e-300))
    read2 = xp.maximum((v_low + v_high) / 2 - gain * (low + high) / 2, 0.0) + (_LEAST_NOISE * (high - low)) ** 2
    return Noise(
        xp.where(xp.isnan(known.gain), gain, known.gain),
        xp.where(xp.isnan(known.read), xp.sqrt(read2), known.read),
    )


_CORE = 7.0  # px
_WINDOW, _FEWEST, _TOGETHER = 2.0, 6, 6.0  # px, cells, standard deviations
_WINDOWS = np.arange(-10.0, 9.0)  # px, where they begin
_PER_MISFIT = 5.0  # of an MTF, per equal misfit of the cells: ghosts and shadows of tests/oracle/real_edges.py
_LOW = 0.1  # cycles/px, below which the error of an MTF decreases: at 0 the MTF is 1


class Unexplained(NamedTuple):
    """Roughness and misfit that noise does not explain, and their effect on an MTF.

    Attributes:
        roughness: px, of the edge. It blurs, as a lens does.
        misfit: of the cells near the edge, in units of the step.
    """

    roughness: jax.Array
    misfit: jax.Array

    def of(self, curve: SampledCurve, f: jax.Array) -> SampledCurve:
        """Add the effect to the standard deviation of a curve at f cycles/px."""
        blurred = 2 * (xp.pi * self.roughness * f) ** 2 * xp.abs(curve.value)
        unknown = _PER_MISFIT * self.misfit * xp.minimum(f / _LOW, 1.0)
        return SampledCurve(curve.value, xp.sqrt(curve.std**2 + blurred**2 + unknown**2))


def misfit_of(fit: LinearFit, curve: FreeCurve, excess: jax.Array) -> jax.Array:
    """Return the standard deviation of cells near the edge about the free curve, beyond the noise, in units of the step.

    curve: with its glare, if there is any; fit: without. excess: factor by which all variances were raised; 1 where the cells
    as a whole scatter no more than their noise.
    """
    distance, there = fit.cells.distance, fit.cells.pixels > 0
    basis = edge_basis(curve.shape, distance, fit.cells.spread)
    response = basis.pilot + curve.even @ (basis.even - basis.pilot) + curve.odd @ basis.odd
    light = light_of(curve.levels, fit.cells.terms)
    dark, bright = curve.levels[:2]
    left = fit.cells.value - light.addend - light.factor * (dark + (bright - dark) * response)
    core = there & (xp.abs(distance) < _CORE)
    everywhere = (1 - 1 / excess) * xp.where(core, (left / fit.step) ** 2, 0.0).sum()
    # a ghost affects few of many cells: windows of 2 px count if their chi2 exceeds that of noise by 6 standard deviations
    variance = excess / fit.weight
    window = there & (distance >= _WINDOWS[:, None]) & (distance < _WINDOWS[:, None] + _WINDOW)
    count = window.sum(1)
    beyond = (window * left**2 / variance).sum(1) - count
    off = (count >= _FEWEST) & (beyond > _TOGETHER * xp.sqrt(2.0 * count))
    spoilt = (window & off[:, None]).any(0)
    locally = xp.where(
        spoilt, (left**2 - variance) / fit.step**2, 0.0
    ).sum()  # the variance of an empty cell is infinite
    return xp.sqrt(xp.maximum(xp.maximum(everywhere, locally), 0.0) / xp.maximum(core.sum(), 1.0))
