"""Noise, outlying pixels and unexplained residuals of an edge.

Pixels of one aligned column that sample the edge at the same phase should have equal values. A pixel is excluded if it
deviates from the other pixels of its group by much more than their scatter and the noise. Such outliers are hot or dead
pixels and dust. This test does not require a model of the edge. A ghost, the border of a shadow or dirt causes
residuals in a few of many cells, and a rough edge causes blur. Both effects increase the standard deviation of an MTF.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam.calibration.edge.free_curve import FreeCurve, SampledCurve
from matcam.calibration.edge.free_fit import LinearFit
from matcam.calibration.edge.geometry import AlignedRows, PhasedRows
from matcam.calibration.edge.maximum_likelihood import Noise
from matcam.calibration.edge.start import side_levels
from matcam.calibration.photograph.flat_noise import clipped_mean
from matcam.core.arrays import repeated, xp

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray, jax


def without_outliers(phased: PhasedRows, noise: Noise) -> AlignedRows:
    aligned, member = phased.rows, phased.member
    dark, bright = side_levels(aligned)
    level = (dark + bright) / 2
    level = xp.where(level > 0, level / xp.maximum(level.mean(), 1e-300), 1.0)[:, None]
    value = aligned.value / level
    variance = noise.variance(aligned.value, 1 / aligned.light[:, None]) / level**2

    border = np.zeros((len(member), 1))

    def again(valid: jax.Array) -> jax.Array:
        count = member @ valid
        some = xp.maximum(count, 1.0)
        mean, apart = (member @ (valid * q) / some for q in (value, phased.distance))
        # The distances in a group differ by at most an eighth of a px, which a linear term corrects.
        ends = (count[:, 2:] > 0) & (count[:, :-2] > 0)
        slope = xp.where(ends, (mean[:, 2:] - mean[:, :-2]) / (2 * aligned.step), 0.0)
        slope = xp.concatenate([border, slope, border], 1)
        of = lambda a: a[phased.phase]  # noqa: E731
        # The deviation of a pixel from the mean of its group is corrected for the difference of their distances.
        off = value - of(mean - slope * apart) - of(slope) * phased.distance
        first, second = (of(member @ (valid * q)) for q in (off, off**2))
        others = of(xp.maximum(count - 1, 1.0))
        middle = (first - off) / others
        scatter = xp.maximum((second - off**2) / others - middle**2, variance)
        # Noise exceeds 6 standard deviations with probability 2e-9.
        far = (off - middle) ** 2 > 6.0**2 * scatter * (1 + 1 / others)
        # Groups of three or fewer pixels do not determine their scatter.
        return valid * ~(far & of(count > 3))

    # A large outlier may hide other outliers in its group. Therefore the test is repeated.
    valid = repeated(2, again, aligned.valid)
    return aligned._replace(valid=valid, value=aligned.value * valid)


def estimated_noise(known: Noise, phased: PhasedRows) -> Noise:
    """Estimate the unknown parameters of the noise.

    The estimate uses second differences of samples on both sides of the edge. The samples are two columns apart, so that they
    have the same colour in a mosaic.
    """
    aligned = phased.rows
    # Second differences remove light that changes linearly across the edge.
    difference = aligned.value[:, 4:] - 2 * aligned.value[:, 2:-2] + aligned.value[:, :-4]
    all_three = aligned.valid[:, 4:] * aligned.valid[:, 2:-2] * aligned.valid[:, :-4]
    away = phased.distance[:, 2:-2]
    # The noise is estimated from pixels beyond 6 px from the edge.
    far = all_three * (xp.abs(away) > xp.minimum(6.0, 0.3 * aligned.step * aligned.value.shape[1]))

    def side(part: AnyArray) -> tuple[jax.Array, jax.Array]:
        weight = far * part
        count = xp.maximum(weight.sum(), 1.0)
        # Single hot pixels have little weight.
        power = clipped_mean(weight * difference**2, count, 20.0, 3)
        return (weight * aligned.value[:, 2:-2]).sum() / count, power / 6

    (low, v_low), (high, v_high) = side(away < 0), side(away > 0)
    # If the noise is below one quantisation level, rounding determines the variance.
    step = xp.abs(aligned.value[:, 1:] - aligned.value[:, :-1])
    # Codes are assumed equal up to a difference of 1e-9 of the step. Neighbouring codes differ by at most a tenth of it.
    there = aligned.valid[:, 1:] * aligned.valid[:, :-1] * (step > 1e-9 * (high - low))
    level = xp.minimum(xp.min(xp.where(there > 0, step, xp.inf)), 0.1 * xp.abs(high - low))
    v_low, v_high = (xp.maximum(v, level**2 / 12) for v in (v_low, v_high))
    gain = xp.clip((v_high - v_low) / (high - low), 0.0, v_high / xp.maximum(high, 1e-300))
    # The smallest noise, 1e-4 of the step, represents rounding and the errors of any model.
    read2 = xp.maximum((v_low + v_high) / 2 - gain * (low + high) / 2, 0.0) + (1e-4 * (high - low)) ** 2
    return Noise(
        xp.where(xp.isnan(known.gain), gain, known.gain),
        xp.where(xp.isnan(known.read), xp.sqrt(read2), known.read),
    )


def with_unexplained(curve: SampledCurve, f: jax.Array, roughness: jax.Array, misfit: jax.Array) -> SampledCurve:
    """Increase the standard deviation of an MTF at f cycles/px by the effect of roughness and misfit.

    `roughness`: standard deviation of the position of the edge between rows, px; it blurs the edge, as a lens does. `misfit`:
    standard deviation of the bins near the edge beyond noise, in units of the step.
    """
    blurred = 2 * (xp.pi * roughness * f) ** 2 * xp.abs(curve.value)
    # The ratio 5 follows from the ghosts and shadows of tests/oracle/real_edges.py. At frequency 0, the MTF is always 1.
    unknown = 5.0 * misfit * xp.minimum(f / 0.1, 1.0)
    return SampledCurve(curve.value, xp.sqrt(curve.std**2 + blurred**2 + unknown**2))


def misfit_of(fit: LinearFit, curve: FreeCurve, excess: jax.Array) -> jax.Array:
    """Compute the scatter of the bins near the edge about the free curve, beyond the noise.

    The result is a standard deviation in units of the step. `curve`: free curve, with glare if it was found. `fit`: fit
    without glare. `excess`: factor that was applied to all variances; 1 if the noise explains the total scatter of the
    bins.
    """
    distance, there, left = fit.cells.distance, fit.cells.pixels > 0, fit.misfit(curve)
    # Only bins within 7 px of the edge determine the misfit.
    core = there & (xp.abs(distance) < 7.0)
    everywhere = (1 - 1 / excess) * xp.where(core, (left / fit.step) ** 2, 0.0).sum()
    # A ghost affects few bins. A window of 2 px with at least 6 bins contributes if its chi-square exceeds the expectation
    # by 6 standard deviations.
    variance, begin = excess / fit.weight, np.arange(-10.0, 9.0)[:, None]
    window = there & (distance >= begin) & (distance < begin + 2.0)
    count = window.sum(1)
    beyond = (window * left**2 / variance).sum(1) - count
    off = (count >= 6) & (beyond > 6.0 * xp.sqrt(2.0 * count))
    spoilt = (window & off[:, None]).any(0)
    # The variance of an empty bin is infinite.
    locally = xp.where(spoilt, (left**2 - variance) / fit.step**2, 0.0).sum()
    return xp.sqrt(xp.maximum(xp.maximum(everywhere, locally), 0.0) / xp.maximum(core.sum(), 1.0))
