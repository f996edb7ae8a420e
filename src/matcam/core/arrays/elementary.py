"""Elementary functions of arrays that XLA computes in vectors.

XLA evaluates the sine, arcsine, logarithm and reciprocal square root of doubles one number at a time, by library functions.
All other operations of the same loop are then not computed in vectors, either. Polynomials are 4 to 30 times faster. For
an error function, XLA evaluates three rational functions and uses only one of the three results.
"""

from __future__ import annotations

from math import log, pi, sqrt
from typing import TYPE_CHECKING

from matcam.core.arrays.control import with_derivatives
from matcam.core.arrays.namespace import has_jax, special, xp

if TYPE_CHECKING:
    from matcam.core.jax import jax

# sin(x) / x as a polynomial in x^2 that interpolates it at 10 Chebyshev nodes of [0, (pi/2)^2], lowest power first. The
# constant is two units in the last place below 1, so that no sine exceeds 1
_SINE = (
    1 - 2**-52, -0.16666666666666666, 0.008333333333333333, -0.0001984126984126967, 2.755731922394071e-06,
    -2.5052108378602197e-08, 1.6059043206300948e-10, -7.647127739966418e-13, 2.8102145350022103e-15, -7.982518961783833e-18,
)  # fmt: skip

# asin(x) / x as a polynomial in x^2 that interpolates it at 13 Chebyshev nodes of [0, 1/4], lowest power first
_ARCSINE = (
    1.0, 0.16666666666664942, 0.07500000000385201, 0.044642856805998936, 0.03038195969768514, 0.022371749733164054,
    0.01735977964134998, 0.01388484282640208, 0.012170138592391726, 0.0065293020047365695, 0.019513468251252167,
    -0.016187392271599134, 0.03187962140081284,
)  # fmt: skip

# erfc(x) exp(x^2) for x from 0 to 12, as a polynomial in y that interpolates it at 20 Chebyshev nodes of [-1, 1], lowest power
# first; y = 7.5 / (3 + x) - 1.5
_ERFC = (
    0.25539567631050575, 0.3559882061782986, 0.22714955814254298, 0.11153315544518862, 0.04028574030768065,
    0.009387969071182027, 0.0006821213644623329, -0.0003485728525382432, -9.280797049222007e-05, 1.2823907631487892e-05,
    7.3662158098635915e-06, -7.682872157585413e-07, -5.875160933530135e-07, 8.679806775760814e-08, 4.671524790646956e-08,
    -1.216908515581164e-08, -3.194591422729746e-09, 1.5205691873759856e-09, 1.323744012350584e-10, -1.1954546228059737e-10,
)  # fmt: skip

# (atan(x) - x) / x^3 as a polynomial in x^2 that interpolates it at 10 Chebyshev nodes of [0, tan^2(pi/8)], lowest power first
_ARCTANGENT = (
    -0.3333333333333325, 0.19999999999898407, -0.14285714266096616, 0.11111109636534268, -0.09090852557173042,
    0.07691055158338801, -0.06649613694717543, 0.05736332162387198, -0.04483334610673672, 0.022750526834630722,
)  # fmt: skip

# (ln m - 2 z) / z^3 for z = (m - 1) / (m + 1) and m from sqrt(1/2) to sqrt(2), as a polynomial in z^2 that interpolates it at 8
# Chebyshev nodes, lowest power first
_LOGARITHM = (
    0.6666666666666666, 0.4000000000000088, 0.2857142857080361, 0.22222222391714783, 0.18181795640040438, 0.15386239707844115,
    0.1326877300396345, 0.13086627556452163,
)  # fmt: skip
_MANTISSA_BITS, _BITS_OF_HALF_ROOT = 52, 0x3FE6A09E667F3BCD  # number of bits of a mantissa, and the bits of sqrt(1/2)


def sine(angle: jax.Array) -> jax.Array:
    """Compute the sine of angles in [-pi/2, pi/2], rad.

    The result is accurate to all digits except the last.
    """
    return _odd(_SINE, angle, angle * angle)


def cosine(angle: jax.Array) -> jax.Array:
    """Compute the cosine of angles in [0, pi], rad.

    The error is below 5e-16.
    """
    return sine(pi / 2 - angle)


def inverse_root(x: jax.Array) -> jax.Array:
    """Compute 1 / sqrt(x) of positive numbers.

    XLA transforms a quotient of a number and a root into a product with a reciprocal square root.
    """
    return xp.sqrt(1 / x)


def arcsine(x: jax.Array) -> jax.Array:
    """Compute the arcsine of x in [-1, 1], rad.

    The result is accurate to all digits except the last. For |x| > 1/2 it is computed from the arcsine of
    sqrt((1 - |x|) / 2).
    """
    size = xp.abs(x)
    steep = size > 0.5
    square = xp.where(steep, (1 - size) / 2, size * size)
    small = _odd(_ARCSINE, xp.where(steep, xp.sqrt(xp.where(steep, square, 1.0)), size), square)
    return xp.sign(x) * xp.where(steep, xp.pi / 2 - 2 * small, small)


def angle_of(y: jax.Array, x: jax.Array) -> jax.Array:
    """Compute the angle of the vector (x, y) to the x axis, rad, as arctan2 does, for y >= 0.

    The error is below 3e-16 rad. Angles above pi/2 are replaced by pi/2.
    """
    x = xp.maximum(x, 0.0)
    steep = y > x
    ratio = xp.minimum(x, y) / xp.maximum(xp.maximum(x, y), 1e-300)  # prevents 0 / 0
    middle = ratio > sqrt(2) - 1  # tan(pi/8): beyond it, the angle is computed from its difference to pi/4
    ratio = xp.where(middle, (ratio - 1) / (ratio + 1), ratio)
    square = ratio * ratio
    angle = ratio + ratio * square * _polynomial(_ARCTANGENT, square) + xp.where(middle, pi / 4, 0.0)
    return xp.where(steep, pi / 2 - angle, angle)


def _logarithm(x: jax.Array) -> jax.Array:
    if not has_jax(x):
        return xp.log(x)
    from matcam.core.jax import jax, jnp

    bits = jax.lax.bitcast_convert_type(x, jnp.int64)
    exponent = (bits - _BITS_OF_HALF_ROOT) >> _MANTISSA_BITS
    mantissa = jax.lax.bitcast_convert_type(bits - (exponent << _MANTISSA_BITS), jnp.float64)
    z = (mantissa - 1) / (mantissa + 1)
    square = z * z
    return exponent.astype(jnp.float64) * log(2) + (2 * z + z * square * _polynomial(_LOGARITHM, square))


def arcsinh(x: jax.Array) -> jax.Array:
    """Compute the inverse hyperbolic sine of x >= 0 with an error below 5e-16 (1 + asinh x)."""
    return logarithm(x + xp.sqrt(x * x + 1))


logarithm = with_derivatives(_logarithm, lambda change, _, x: change / x)
"""Natural logarithm of positive normal numbers.

The relative error is below 5e-16.
"""


power = with_derivatives(
    lambda x, p: xp.exp(p * _logarithm(x)) if has_jax(x, p) else x**p,
    lambda change, value, x, p: change * value * p / x,
    lambda change, value, x, p: change * value * logarithm(x),
)
"""Power x^p of positive numbers. The relative error is below 5e-16 |p ln x|. The derivatives reuse the value of the power."""


def _erfc(x: jax.Array) -> jax.Array:
    if not has_jax(x):
        return special.erfc(x)
    size = xp.abs(x)
    y = 7.5 / (3 + size) - 1.5
    # even and odd powers separately, which a processor computes at the same time
    even, odd = (_polynomial(_ERFC[start::2], y * y) for start in (0, 1))
    tail = (even + y * odd) * xp.exp(-size * size)
    return xp.where(x < 0, 2 - tail, tail)


erfc = with_derivatives(_erfc, lambda change, _, x: -2 / sqrt(pi) * xp.exp(-x * x) * change)
"""Complementary error function.

The relative error is below 1e-14 up to x = 6, and below 5e-14 up to 12, where the function is 1e-64.
"""


def plane_length(x: jax.Array, y: jax.Array) -> jax.Array:
    """Compute sqrt(x^2 + y^2) with a derivative of zero at x = y = 0.

    `hypot` of JAX 0.12 and later has no derivative there. A smooth function of the squared length would then have no
    derivative either.
    """
    square = x * x + y * y
    nowhere = square == 0
    return xp.where(nowhere, 0.0, xp.sqrt(xp.where(nowhere, 1.0, square)))


def _odd(coefficients: tuple[float, ...], x: jax.Array, square: jax.Array) -> jax.Array:
    return _polynomial(coefficients, square) * x


def _polynomial(coefficients: tuple[float, ...], x: jax.Array) -> jax.Array:
    """Evaluate a polynomial. Its coefficients are in the order of ascending powers."""
    total = xp.full_like(x, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = total * x + coefficient
    return total
