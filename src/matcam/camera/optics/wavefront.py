"""Image of a point through a pupil with a wavefront error: amplitude on the sensor, and transfer function.

The wavefront error W, waves, is a sum of Zernike terms that are orthonormal on the unit disc (Noll 1976). A coefficient is
therefore the rms of its term. The transfer function is the autocorrelation of exp(2 pi i W), which is an integral over the
overlap of two shifted discs (Goodman, Introduction to Fourier Optics, 6.3.3). At a frequency of cos(end) times the cutoff,
the position in the overlap is, in radii of the pupil,

    v = sin(end s) across the shift,  u = (cos(end s) - cos(end)) t along the shift,  with s and t in [-1, 1].

The integrand is an entire function of s and t, so Gauss-Legendre quadrature converges faster than any power of the number
of nodes. The transfer function is also an entire function of `end` and of the direction. Interpolation in `end` is therefore
accurate near frequency 0 and near the cutoff, where the transfer function has kinks as a function of frequency.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from matcam.core.arrays import compiled_by_jax, first_axis_map, xp
from matcam.numerics.approximation import lagrange_basis

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray, jax

_PHASES = (0, 1, 2, 4, 6, 8, 12, 16)  # bounds of the wavefront error for which quadratures are compiled, rad
LARGEST_PHASE = _PHASES[-1]
"""Largest wavefront error for which the quadratures are accurate, rad."""
_POINTS = 8
"""Number of points per axis between which a table is interpolated."""
_BEYOND = _POINTS // 2
"""Number of steps by which a table extends beyond its ends."""


def wavefront(terms: AnyArray, x: jax.Array, y: jax.Array) -> jax.Array:
    """Evaluate the wavefront error, waves.

    terms: coefficients in the order of `ZernikeOptics.terms`, (8,), waves rms. x, y: positions in the pupil, in radii of the
    pupil.
    """
    square = x**2 + y**2
    defocus, astig, astig_45, coma_x, coma_y, trefoil, trefoil_y, spherical = terms
    return (
        np.sqrt(3) * defocus * (2 * square - 1)
        + np.sqrt(6) * (astig * (x**2 - y**2) + astig_45 * 2 * x * y)
        + np.sqrt(8) * (3 * square - 2) * (coma_x * x + coma_y * y)
        + np.sqrt(8) * (trefoil * x * (x**2 - 3 * y**2) + trefoil_y * y * (3 * x**2 - y**2))
        + np.sqrt(5) * spherical * (6 * square**2 - 6 * square + 1)
    )


def phase_of(terms: np.ndarray) -> int:
    """Compute an upper bound of the wavefront error, rad.

    The bound determines the size of the quadratures. Up to `LARGEST_PHASE` it is rounded up to one of a few values, because
    each size requires a compilation.
    """
    defocus, *pairs, spherical = np.abs(terms)
    norms = np.hypot(pairs[::2], pairs[1::2]) * np.sqrt([6, 8, 8])
    bound = float(2 * np.pi * (np.sqrt(3) * defocus + norms.sum() + np.sqrt(5) * spherical))
    return next((size for size in _PHASES if size >= bound), int(np.ceil(bound)))


@partial(compiled_by_jax, static=(3,))
def amplitude(terms: jax.Array, x: jax.Array, y: jax.Array, sizes: tuple[int, int]) -> jax.Array:
    """Compute the complex amplitude on the sensor relative to the peak of a perfect lens, (positions,).

    It is the mean of exp(2 pi i (W + p . (x, y))) over the pupil. W is the wavefront error, waves, at the position p in the
    pupil, in radii of the pupil.

    Args:
        terms: coefficients in the order of `ZernikeOptics.terms`, (8,), waves rms.
        x: horizontal positions on the sensor, (positions,), in units of 2 / (cutoff frequency).
        y: vertical positions, same shape and unit.
        sizes: numbers of nodes along the radius and the circumference.
    """
    node, weight = np.polynomial.legendre.leggauss(sizes[0])
    turn = 2 * np.pi * np.arange(sizes[1]) / sizes[1]
    radius = (1 + node)[:, None] / 2
    at_x, at_y = (xp.asarray((radius * part).ravel()) for part in (np.cos(turn), np.sin(turn)))
    share = xp.asarray(np.repeat(weight * (1 + node) / 2 / sizes[1], sizes[1]))
    error = wavefront(terms, at_x, at_y)

    def at(x: jax.Array, y: jax.Array) -> jax.Array:
        return xp.exp(2j * np.pi * (error + x[:, None] * at_x + y[:, None] * at_y)) @ share

    # 2^20 positions times nodes are evaluated at once, which limits memory
    return first_axis_map(at, (x, y), max(1, (1 << 20) // error.size))


def pupil_sizes(phase: int, reach: float) -> tuple[int, int]:
    """Compute the numbers of nodes along radius and circumference of the pupil.

    phase: bound of the wavefront error, rad. reach: largest distance of a position, in units of
    2 / (cutoff frequency).
    """
    turns = phase + 2 * np.pi * reach
    return 16 + int(0.7 * turns), 2 * (16 + int(1.2 * turns))


def overlap_order(phase: int) -> int:
    """Compute the number of quadrature nodes per axis that resolve an overlap.

    phase: bound of the wavefront error, rad.
    """
    return 20 + int(1.3 * phase)


@partial(compiled_by_jax, static=(3,))
def overlap(terms: AnyArray, end: AnyArray, angle: AnyArray, order: int) -> jax.Array:
    """Compute the complex transfer function by quadrature, (n,).

    terms: coefficients in the order of `ZernikeOptics.terms`, (8,), waves rms. end: arccosine of the frequency divided by
    the cutoff, rad, (n,); outside [0, pi/2] the result is the analytic continuation. angle: direction of the frequency,
    rad, (n,). order: number of nodes per axis.
    """
    node, weight = np.polynomial.legendre.leggauss(order)
    s, t = xp.asarray(node[:, None]), xp.asarray(node)

    def at(ends: jax.Array, directions: jax.Array) -> jax.Array:
        stop, direction = ends[:, None, None], directions[:, None, None]
        nu, half = xp.cos(stop), xp.cos(stop * s) - xp.cos(stop)
        along, across = half * t, xp.sin(stop * s)
        cosine, sine = xp.cos(direction), xp.sin(direction)

        def pupil(shift: jax.Array) -> jax.Array:
            u = along + shift
            return wavefront(terms, u * cosine - across * sine, u * sine + across * cosine)

        wave = xp.exp(2j * np.pi * (pupil(nu) - pupil(-nu))) @ weight
        return ends / np.pi * xp.sum(weight * (xp.cos(stop * s) * half)[..., 0] * wave, axis=-1)

    # 128 frequencies are evaluated at once, which limits memory
    return first_axis_map(at, (end, angle), 128)


@partial(compiled_by_jax, static=(1,))
def overlap_table(terms: jax.Array, phase: int) -> jax.Array:
    """Tabulate the complex result of `overlap` for `from_table`, shape (values of `end`, angles).

    `overlap` is computed for a few values of `end` and a few angles. The results are interpolated by Chebyshev
    polynomials of `end` and a Fourier series of the angle. The table extends a few steps beyond `end` = 0 and pi/2 and
    beyond a full turn of the angle.

    terms: coefficients in the order of `ZernikeOptics.terms`, (8,), waves rms. phase: bound of the wavefront error, rad.
    """
    lines, half = 40 + 4 * phase, 20 + 8 * phase
    cheb = np.cos(np.pi * (np.arange(lines) + 0.5) / lines)
    ends, turns = np.pi / 4 * (1 + 1.1 * cheb), np.pi * np.arange(half) / half
    end, angle = (a.ravel() for a in np.meshgrid(ends, turns, indexing="ij"))
    values = overlap(terms, xp.asarray(end), xp.asarray(angle), overlap_order(phase)).reshape(lines, half)
    values = xp.concatenate([values, xp.conj(values)], axis=1)  # because the kernel is real

    fine, round_fine = _fineness(phase)
    at = (np.arange(-_BEYOND, fine + _BEYOND + 1) / fine * 2 - 1) / 1.1
    order = np.arange(lines)
    fit = 2 / lines * np.cos(order[:, None] * np.arccos(cheb))
    fit[0] /= 2
    by_line = np.polynomial.chebyshev.chebvander(at, lines - 1) @ fit
    wave = np.fft.fftfreq(2 * half, 1 / (2 * half))
    every = 2 * np.pi * np.arange(-_BEYOND, round_fine + _BEYOND + 1) / round_fine
    by_turn = np.exp(1j * every[:, None] * wave) * (np.abs(wave) < half)
    by_turn = by_turn @ np.exp(-1j * wave[:, None] * np.pi * np.arange(2 * half) / half) / (2 * half)
    return xp.asarray(by_line) @ values @ xp.asarray(by_turn.T)


def _fineness(phase: int) -> tuple[int, int]:
    """Compute the numbers of steps of a table: in `end` from 0 to pi/2, and in the angle over a full turn.

    phase: bound of the wavefront error, rad.
    """
    return 96 + 12 * phase, 128 + 48 * phase


@partial(compiled_by_jax, static=(1,))
def from_table(table: jax.Array, phase: int, end: jax.Array, angle: jax.Array) -> jax.Array:
    """Interpolate the complex transfer function in a table, (n,).

    table: result of `overlap_table` for the same `phase`. end: arccosine of the frequency divided by the cutoff, rad, in
    [0, pi/2], (n,). angle: direction of the frequency, rad, (n,).
    """
    fine, round_fine = _fineness(phase)
    flat, width, steps = table.ravel(), table.shape[1], np.arange(_POINTS)
    row, column = (
        end * (fine / (np.pi / 2)) + _BEYOND,
        xp.mod(angle, 2 * xp.pi) * (round_fine / (2 * np.pi)) + _BEYOND,
    )

    def at(*position: jax.Array) -> jax.Array:
        first = [xp.floor(a).astype(int) - (_POINTS // 2 - 1) for a in position]
        down, across = (
            xp.stack(lagrange_basis(np.arange(float(_POINTS)), a - one), axis=-1)
            for a, one in zip(position, first, strict=True)
        )
        index = (first[0][:, None] + steps)[:, :, None] * width + (first[1][:, None] + steps)[:, None, :]
        return xp.sum(down[:, :, None] * xp.take(flat, index) * across[:, None, :], axis=(1, 2))

    return first_axis_map(at, (row, column), 1 << 14)
