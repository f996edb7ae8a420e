"""Spline modifications of lobes: a smooth factor of the lobe, and a free masking.

A spline-modified lobe can fit data of any family. A free masking is any smooth function of the angle instead of
Smith's masking: Bagher, Snyder & Nowrouzezahrai (2016) explain measured materials by such "free shadowing". A camera
causes a similar loss at grazing angles, which must be distinguished from masking.
"""

from __future__ import annotations

import numpy as np
from jax.typing import ArrayLike

from matcam.core.arrays.elementary import arcsinh
from matcam.core.jax import jax, jnp
from matcam.core.programs import kept_program
from matcam.material.lambda_table import integrated_lambda
from matcam.material.ndf.distribution import NDF, SlopeNDF
from matcam.numerics.approximation import combined, cubic_basis, cubic_spline, cubic_sums, smoothness

KNOTS = 17
"""Number of parameters of a spline modification."""
SHADOWS = 8
"""Number of parameters of a free masking."""
STIFFER = 10.0
"""Factor of the stiffness of a spline at slopes where the data hardly determine the shape."""
_STEEP = 0.9  # slope above which the stiffness is multiplied by `STIFFER`
# slope above which the knots are evenly spaced in the logarithm, and slope of the last knot
_FINEST, _LAST = 0.0015, 26.4
_END = float(np.arcsinh(_LAST / _FINEST))
_NODES = np.polynomial.legendre.leggauss(160)


class SplineNDF(SlopeNDF):
    """Lobe multiplied by a smooth factor of the slope.

    P22 is P22 of the base times exp(sum_k c_k B_k), normalised again. B_k are cubic B-splines, evenly spaced in
    asinh(slope / 0.0015); the first has derivative 0 at the peak, and all are constant beyond a slope of 26 (88
    degrees). This range includes the steep facets that mask others: with splines up to 45 degrees only, the family
    would determine the masking.

    Attributes:
        base: the lobe that is modified.
        coefficients: c_k, no unit, shape (KNOTS,); 0: the base itself.
        norm: integral of the modified density over slopes, before it is normalised.
    """

    base: NDF
    coefficients: jax.Array
    norm: jax.Array

    family = "spline"
    largest = 1.0

    def __init__(self, base: NDF, coefficients: jax.Array):
        self.base, self.coefficients = base, coefficients
        self.norm = _norm(base, coefficients)

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        return self.base.slope_density(slope2) * jnp.exp(spline_at(self.coefficients, slope2)) / self.norm

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        return integrated_lambda(self.slope_density, self.base.roughness, cos)

    @property
    def roughness(self) -> jax.Array:
        return self.base.roughness

    def __repr__(self) -> str:
        return f"SplineNDF({self.base!r}, {jnp.asarray(self.coefficients).tolist()!r})"


@kept_program
def _norm(base: NDF, coefficients: jax.Array) -> jax.Array:
    """Integrate the modified P22 over the plane of slopes, at Gauss-Legendre nodes in asinh(slope / scale)."""
    scale = jnp.minimum(base.roughness, 0.3) / 4
    t = jnp.arcsinh(2e3 / scale) * (_NODES[0] + 1) / 2
    slope = scale * jnp.sinh(t)
    area = 2 * jnp.pi * slope * scale * jnp.cosh(t) * jnp.arcsinh(2e3 / scale) / 2 * _NODES[1]
    return jnp.sum(area * base.slope_density(slope**2) * jnp.exp(spline_at(coefficients, slope**2)))


def spline_basis(slope2: jax.Array) -> jax.Array:
    """Evaluate the functions B_k at squared slopes, (KNOTS, ...): cubic B-splines, mirrored at 0."""
    return cubic_basis(_knot_at(slope2), KNOTS)


def spline_sums(slope2: jax.Array, weights: jax.Array, axes: int = 1) -> jax.Array:
    """Compute the sum of weights times B_k over the last `axes` axes, (KNOTS, ...)."""
    return cubic_sums(_knot_at(slope2), weights, KNOTS, axes)


@jax.custom_jvp
def spline_at(coefficients: jax.Array, slope2: jax.Array) -> jax.Array:
    """Compute sum_k c_k B_k at squared slopes."""
    return cubic_spline(coefficients, _knot_at(slope2))


def _knot_at(slope2: jax.Array) -> jax.Array:
    """Compute the position of squared slopes among the knots, counted from 0."""
    small = slope2 < 1e-24  # the derivative of the root is infinite at 0
    slope = jnp.where(small, 0.0, jnp.sqrt(jnp.where(small, 1.0, slope2)))
    return jnp.minimum(arcsinh(slope / _FINEST) / _END, 1.0) * (KNOTS - 1)


def spline_smoothness() -> np.ndarray:
    """Build the smoothness penalty of the coefficients, (rows, KNOTS).

    The penalty is the result of `smoothness`, with larger weights for facets steeper than about 45 degrees. Only a few
    cells, in the outermost pixels of the sphere, depend on such facets, but the number of these facets affects the masking
    at grazing angles. For steep facets the tail of the lobe continues as a power law. If the standard deviation of second
    differences is 1, the difference between the exponent of this power law and that of the family has a standard deviation of
    about 0.5.
    """
    rows, between = smoothness(KNOTS), np.arange(KNOTS - 1) + 0.5
    steep = slope_of_knot(np.concatenate([np.arange(1.0, KNOTS - 1), between, [0.0]])) > _STEEP
    rows[steep] *= STIFFER
    return rows


def slope_of_knot(position: np.ndarray) -> np.ndarray:
    """Compute the slope at a knot, counted from 0; fractional knots are allowed."""
    return _FINEST * np.sinh(position / (KNOTS - 1) * _END)


@spline_at.defjvp
def _spline_slopes(
    values: tuple[jax.Array, jax.Array], changes: tuple[jax.Array, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """Differentiate `spline_at` by the chain rule.

    The basis functions B_k and their derivatives are evaluated once, not for every direction of differentiation.
    """
    coefficients, slope2 = values
    value, by_slope2 = jax.jvp(lambda at: cubic_spline(coefficients, _knot_at(at)), (slope2,), (jnp.ones_like(slope2),))
    return value, combined(changes[0], spline_basis(slope2)) + by_slope2 * changes[1]


def shadow_basis(cos: ArrayLike) -> jax.Array:
    """Evaluate the functions B_k of a free masking, (SHADOWS, ...).

    cos: cosines of the angles of the directions to the normal.
    """
    return cubic_basis((1 - jnp.clip(cos, 0.0, 1.0)) * (SHADOWS - 1), SHADOWS)


class ShadowedNDF(NDF):
    """Lobe with a free masking, for the masking model "smith-separable".

    The masking G1 of one direction is given by ln G1 = -sum_k shadows_k B_k(1 - cos theta), with cubic B-splines B_k. G1 may
    exceed 1: only the shape of G1 matters, because the strength of each slice is a free parameter.

    Attributes:
        base: the lobe, whose density of normals D is not changed.
        shadows: coefficients, no unit, shape (SHADOWS,).
    """

    base: NDF
    shadows: jax.Array

    family = "shadowed"
    largest = 1.0

    def d(self, theta_h: ArrayLike) -> jax.Array:
        return self.base.d(theta_h)

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        return self.base.slope_density(slope2)

    def coordinate(self, theta_h: jax.Array) -> jax.Array:
        return self.base.coordinate(theta_h)

    def shape(self, r: jax.Array) -> jax.Array:
        return self.base.shape(r)

    def flattening(self, theta_h: jax.Array) -> jax.Array:
        return self.base.flattening(theta_h)

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """Compute Lambda = 1 / G1 - 1."""
        return jnp.expm1(combined(self.shadows, shadow_basis(cos)))

    @property
    def roughness(self) -> jax.Array:
        return self.base.roughness

    def __repr__(self) -> str:
        return f"ShadowedNDF({self.base!r}, {jnp.asarray(self.shadows).tolist()!r})"
