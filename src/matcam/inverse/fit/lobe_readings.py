"""Reported parameters of a fitted lobe: parameters of its family, or parameters that apply to any lobe.

A spline-modified lobe has no parameters of a family, and its coefficients have no direct meaning. The reported parameters of
such a lobe are its half width, its tail exponent, and its share of facets far from the peak, which is visible as haze.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.inverse.fit.fit_parameters import LobeKind, readable_value
from matcam.material.ndf.free_lobe import shadow_basis

HALF_WIDTH = "hwhm_rad"
"""Name of the parameter for the half width at half maximum of a lobe, rad."""
_NARROWEST_ANGLE, _WIDEST_ANGLE = 1e-9, 1.5
"""Range of angles in which half of the maximum is searched for, rad. Its lower end is below the width of any lobe."""
_HALVINGS = 60
_TAIL = (3.0, 10.0)
"""Range of angles over which the tail exponent is determined, in half widths of the lobe."""
_TAIL_ENDS = np.pi / 4
"""Upper limit of the range of the tail exponent, rad. Most cells show the lobe beyond this angle only at grazing incidence or
reflection.
"""
_TAIL_BEGINS = np.pi / 6
"""Upper limit of the angle at which the range of the tail exponent begins, rad. Wider lobes have no tail exponent, because
the range would be too short.
"""
_FARTHEST = 2e3
"""Upper limit of the slope in the integral of the haze share (no unit). The share of steeper facets is negligible."""
_NODES = np.polynomial.legendre.leggauss(60)
_GRAZING = np.radians(75.0)


class LobeReadings(NamedTuple):
    """Reported parameters of a lobe.

    Attributes:
        names: names of the parameters. A lobe of a family has the parameters of the family. Any other lobe has "hwhm_rad". If
            it is narrow enough, it also has "tail_exponent" and "haze_share". A lobe with free masking also has "masking_75",
            the masking at 75 degrees relative to the masking at normal incidence.
        values: value of each parameter, in its own unit, (names,).
        slopes: derivatives of the values with respect to the coordinates of the lobe, (names, lobe coordinates).
    """

    names: tuple[str, ...]
    values: np.ndarray
    slopes: np.ndarray


def lobe_readings(kind: LobeKind, q: np.ndarray) -> LobeReadings:
    if kind.of_family:
        pairs = np.array([readable_value(name, one) for name, one in zip(kind.names, q, strict=True)])
        return LobeReadings(kind.names, pairs[:, 0], np.diag(pairs[:, 1]))
    angle, by_q = half_maximum(kind, q)
    names, values, slopes = [HALF_WIDTH], [angle], [by_q]
    if _TAIL[0] * angle < _TAIL_BEGINS:
        both, by_lobe, by_angle = (np.asarray(one) for one in _tail(kind, placed(q), jnp.asarray(angle)))
        names += ["tail_exponent", "haze_share"]
        values += both.tolist()
        slopes += list(by_lobe + by_angle[:, None] * by_q)
    if kind.shadows:
        change = np.asarray(shadow_basis(np.cos(_GRAZING))) - np.asarray(shadow_basis(1.0))
        own = slice(kind.size - kind.shadows, kind.size)
        names.append("masking_75")
        values.append(float(np.exp(-change @ q[own])))
        slope = np.zeros(kind.size)
        slope[own] = -values[-1] * change
        slopes.append(slope)
    return LobeReadings(tuple(names), np.array(values), np.array(slopes))


def half_maximum_angle(kind: LobeKind, q: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Compute the half width at half maximum of D, rad, and its standard deviation.

    Args:
        kind: parametrisation of the lobe.
        q: coordinates of the lobe, (lobe coordinates,).
        covariance: covariance of the coordinates, (lobe coordinates, lobe coordinates).
    """
    angle, by_q = half_maximum(kind, q)
    return angle, float(np.sqrt(by_q @ covariance @ by_q))


def half_maximum(kind: LobeKind, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Compute the half width at half maximum of D, rad, and its derivatives.

    The derivatives are with respect to the coordinates of the lobe. The half width is found by bisection, and its derivatives
    by implicit differentiation. Half width and derivatives are NaN if D does not fall to half of its maximum.
    """
    beyond, low, by_angle, by_lobe = (np.asarray(a) for a in _half_maximum(kind, placed(q)))
    if beyond > 0:
        return float("nan"), np.full(len(q), np.nan)
    angle = float(np.exp(low))
    return angle, -angle * by_lobe / by_angle


@kept_program
def _half_maximum(kind: LobeKind, q: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Solve for the angle at which D is half of its maximum.

    The function f = ln(2 D / D(0)) is 0 at this angle.

    Returns:
        Four values: f at `_WIDEST_ANGLE`; ln(angle), the logarithm of the solution; and the derivatives of f at the solution,
        first with respect to ln(angle), then with respect to the coordinates of the lobe.
    """

    def excess(log_angle: jax.Array, q: jax.Array) -> jax.Array:
        ndf = kind.ndf(q)
        return jnp.log(2 * ndf.d(jnp.exp(log_angle)) / ndf.d(1e-9))

    def halve(_: int, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = ends
        middle = (low + high) / 2
        above = excess(middle, q) > 0
        return jnp.where(above, middle, low), jnp.where(above, high, middle)

    widest = jnp.log(_WIDEST_ANGLE)
    low, _ = jax.lax.fori_loop(0, _HALVINGS, halve, (jnp.log(_NARROWEST_ANGLE), widest))
    return excess(widest, q), low, *jax.grad(excess, argnums=(0, 1))(low, q)


@kept_program
def _tail(kind: LobeKind, q: jax.Array, angle: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Compute tail exponent and haze share, and their derivatives with respect to the coordinates and to the half width.

    angle: half width at half maximum, rad.
    """

    def both(q: jax.Array, angle: jax.Array) -> jax.Array:
        ends = jnp.stack([_TAIL[0] * angle, jnp.minimum(_TAIL[1] * angle, _TAIL_ENDS)])
        # haze share: integral of P22 beyond ten half widths, over the logarithm of the slope
        first = jnp.log(jnp.tan(jnp.minimum(_TAIL[1] * angle, _WIDEST_ANGLE)))
        length = jnp.log(_FARTHEST) - first
        slope = jnp.concatenate([jnp.tan(ends), jnp.exp(first + length * (_NODES[0] + 1) / 2)])
        p22 = kind.ndf(q).slope_density(slope**2)  # computed once, which halves the compile time
        near, far = jnp.log(p22[:2]) - 4 * jnp.log(jnp.cos(ends))
        share = jnp.sum(np.pi * length * _NODES[1] * slope[2:] ** 2 * p22[2:])
        return jnp.stack([(near - far) / jnp.log(ends[1] / ends[0]), share])

    return both(q, angle), *jax.jacfwd(both, argnums=(0, 1))(q, angle)
