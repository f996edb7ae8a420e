"""Elementary functions of arrays: sine, arcsine, complementary error function, and length of a vector.

For a sine of doubles, XLA calls a scalar library function. This function takes 15 to 30 times as long as a polynomial, and
would take a third of the time of an integral. For an error function, XLA evaluates three rational functions and uses only
one of the three results.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import pi, sqrt
from typing import TYPE_CHECKING

from matcam.core.arrays import has_jax, special, xp

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


def sine(angle: jax.Array) -> jax.Array:
    """Compute the sine of angles in [-pi/2, pi/2], rad.

    The result is accurate to all digits except the last.
    """
    return _odd(_SINE, angle, angle * angle)


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


def erfc(x: jax.Array) -> jax.Array:
    """Compute the complementary error function.

    The relative error is below 1e-14 up to x = 6, and below 5e-14 up to 12, where the function is 1e-64.
    """
    return _compiled_erfc()(x) if has_jax(x) else special.erfc(x)


@cache
def _compiled_erfc() -> Callable[[jax.Array], jax.Array]:
    from matcam.core.jax import jax

    @jax.custom_jvp
    def function(x: jax.Array) -> jax.Array:
        size = xp.abs(x)
        y = 7.5 / (3 + size) - 1.5
        # even and odd powers separately, which a processor computes at the same time
        even, odd = (_polynomial(_ERFC[start::2], y * y) for start in (0, 1))
        tail = (even + y * odd) * xp.exp(-size * size)
        return xp.where(x < 0, 2 - tail, tail)

    function.defjvps(lambda change, _, x: -2 / sqrt(pi) * xp.exp(-x * x) * change)
    return function


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
