"""What a fitted edge response says: ESF, LSF, MTF and MTF50, each with its standard deviation under noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from matcam._jax import jax, jnp
from matcam.calibration.free_core import EVEN, GLARE, ODD, edge_basis, line_basis, transfer_basis
from matcam.calibration.free_fit import FreeCurve

FREQUENCIES = np.arange(81) / 64
"""cycles/px, at which an MTF is tabulated."""
_FINE = 11  # samples within one of their intervals: over 1.6e-3 cycles/px a curve bends by 1e-6


class Sampled(NamedTuple):
    """A curve and its standard deviation."""

    value: jax.Array
    std: jax.Array


def edge_response(curve: FreeCurve, distance: jax.Array) -> Sampled:
    """ESF at px from the edge: 0 on the dark side, 1 on the bright one."""
    basis = edge_basis(curve.shape, distance, jnp.zeros(()))
    return _combined(curve, basis.pilot, basis.even - basis.pilot, basis.odd)


def line_response(curve: FreeCurve, distance: jax.Array) -> Sampled:
    """LSF at px from the edge, 1/px."""
    basis = line_basis(curve.shape, distance)
    return _combined(curve, basis.pilot, basis.even - basis.pilot, basis.odd)


def transfer(curve: FreeCurve, f: jax.Array) -> tuple[Sampled, Sampled]:
    """Total MTF at f cycles/px along the normal, and that of the core alone, without glare.

    The modulus of a noisy number is too large by its noise: the noise's power is subtracted.
    """
    basis = transfer_basis(curve.shape, f)
    towards = basis.even - basis.pilot
    total = _combined(curve, basis.pilot, towards, jnp.zeros((ODD, f.size)))
    glare, share = basis.even[GLARE], curve.even[GLARE]
    # (M - g M_glare) / (1 - g)
    core_value = (total.value - share * glare) / (1 - share)
    slopes = towards.at[GLARE].set(core_value - basis.pilot) / (1 - share)
    core = Sampled(core_value, _std(curve, jnp.concatenate([slopes, jnp.zeros((ODD + 1, f.size))])))
    odd = _combined(curve, jnp.zeros(f.shape), jnp.zeros((EVEN, f.size)), basis.odd)
    return _modulus(total, odd), _modulus(core, Sampled(odd.value / (1 - share), odd.std / (1 - share)))


def half(value: jax.Array, response: Callable[[jax.Array], Sampled]) -> Sampled:
    """Lowest frequency, cycles/px, at which an MTF is one half, and its standard deviation; NaN where there is none.

    value: the MTF at `FREQUENCIES`. The interval in which it falls through one half is divided
    once more, so finely that a straight line does for the rest.
    """
    below = (value < 0.5).at[0].set(False)
    i, coarse = jnp.argmax(below), jnp.asarray(FREQUENCIES)
    grid = coarse[i - 1] + (coarse[i] - coarse[i - 1]) * jnp.linspace(0, 1, _FINE)
    fine = response(grid)
    k = jnp.argmax((fine.value <= 0.5).at[0].set(False))
    before, after, width = fine.value[k - 1], fine.value[k], grid[1] - grid[0]
    f = grid[k - 1] + width * (before - 0.5) / (before - after)
    std = (fine.std[k - 1] + fine.std[k]) / 2 / (before - after) * width
    return Sampled(jnp.where(below.any(), f, jnp.nan), jnp.where(below.any(), std, jnp.nan))


def _combined(curve: FreeCurve, pilot: jax.Array, even: jax.Array, odd: jax.Array) -> Sampled:
    columns = jnp.concatenate([even, odd, jnp.zeros((1, pilot.size))])
    return Sampled(pilot + curve.even @ even + curve.odd @ odd, _std(curve, columns))


def _std(curve: FreeCurve, columns: jax.Array) -> jax.Array:
    return jnp.sqrt(jnp.maximum(jnp.sum(columns * (curve.covariance @ columns), 0), 0.0))


def _modulus(even: Sampled, odd: Sampled) -> Sampled:
    power = even.value**2 - even.std**2 + odd.value**2 - odd.std**2
    size = jnp.sqrt(jnp.maximum(power, 0.0))
    safe = jnp.where(size > 0, size, 1.0)
    std = jnp.hypot(even.value * even.std, odd.value * odd.std) / safe
    return Sampled(size, jnp.where(size > even.std, std, jnp.hypot(even.std, odd.std)))
