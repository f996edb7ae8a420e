"""What a pupil with an error of its wavefront makes of a point: amplitude on the sensor, and transfer function.

The error is a sum of Zernike terms, orthonormal on the unit disc (Noll 1976), so that a coefficient is the term's rms. The
transfer function is the autocorrelation of exp(2 pi i W) over the overlap of two shifted discs (Goodman 6.3.3). Places in the
overlap are written with two angles, in which integrand and borders are entire functions:

    nu = cos(end),  across the shift  v = sin(end s),  along it  u = (cos(end s) - nu) t,  s, t in [-1, 1].

So Gauss-Legendre converges faster than any power, and as a function of `end` and of the direction the transfer function is
entire, too: it may be interpolated across frequency 0 and the cutoff, where as a function of frequency it has kinks.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.numerics.approximation import POINTS, lagrange_basis

_LEAST, _PER_PHASE = 20, 1.3
"""Gauss-Legendre nodes along an overlap: these, and as many more for each radian of phase."""
_AT_ONCE = 128
_NODES_AT_ONCE = 1 << 20
_PHASES = (0, 1, 2, 4, 6, 8, 12, 16)  # rad
LARGEST_PHASE = _PHASES[-1]
"""Error of a wavefront, rad, that the quadratures are made for."""
_BEYOND = POINTS // 2
"""Steps by which a table reaches beyond its ends."""


def wavefront(terms: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    """Return the wavefront's error at places of the pupil in its radii, waves; terms: (8,), waves rms."""
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
    """Return a bound of the wavefront's error, rad, what the quadratures are sized by: one of few, each a compilation."""
    defocus, *pairs, spherical = np.abs(terms)
    norms = np.hypot(pairs[::2], pairs[1::2]) * np.sqrt([6, 8, 8])
    bound = float(2 * np.pi * (np.sqrt(3) * defocus + norms.sum() + np.sqrt(5) * spherical))
    return next((size for size in _PHASES if size >= bound), int(np.ceil(bound)))


@partial(jax.jit, static_argnums=3)
def amplitude(terms: jax.Array, x: jax.Array, y: jax.Array, sizes: tuple[int, int]) -> jax.Array:
    """Return the mean over the pupil of exp(2 pi i (W + p . x)).

    Args:
        terms: of the wavefront, (8,), waves rms.
        x: places on the sensor, (places,), in half periods of the cutoff.
        y: the same.
        sizes: count of nodes along the radius, and round.
    """
    node, weight = np.polynomial.legendre.leggauss(sizes[0])
    turn = 2 * np.pi * np.arange(sizes[1]) / sizes[1]
    radius = (1 + node)[:, None] / 2
    at_x, at_y = (jnp.asarray((radius * part).ravel()) for part in (np.cos(turn), np.sin(turn)))
    share = jnp.asarray(np.repeat(weight * (1 + node) / 2 / sizes[1], sizes[1]))
    error = wavefront(terms, at_x, at_y)

    def at(place: tuple[jax.Array, jax.Array]) -> jax.Array:
        return jnp.exp(2j * jnp.pi * (error + place[0] * at_x + place[1] * at_y)) @ share

    return jax.lax.map(at, (x, y), batch_size=max(1, _NODES_AT_ONCE // error.size))


def pupil_sizes(phase: int, reach: float) -> tuple[int, int]:
    """Return the nodes (along the radius, round) for an error of `phase` rad, to places `reach` half periods away."""
    turns = phase + 2 * np.pi * reach
    return 16 + int(0.7 * turns), 2 * (16 + int(1.2 * turns))


def overlap_order(phase: int) -> int:
    """Return how many nodes resolve an overlap for an error of `phase` rad."""
    return _LEAST + int(_PER_PHASE * phase)


@partial(jax.jit, static_argnums=3)
def overlap(terms: jax.Array, end: jax.Array, angle: jax.Array, order: int) -> jax.Array:
    """Return the transfer function at frequencies cos(end) of the cutoff, along `angle`, rad; arrays (n,), complex.

    It is the entire continuation where `end` lies outside [0, pi/2].
    """
    node, weight = np.polynomial.legendre.leggauss(order)
    s, t = jnp.asarray(node[:, None]), jnp.asarray(node)

    def at(place: tuple[jax.Array, jax.Array]) -> jax.Array:
        stop, direction = place
        nu, half = jnp.cos(stop), jnp.cos(stop * s) - jnp.cos(stop)
        along, across = half * t, jnp.sin(stop * s)
        cosine, sine = jnp.cos(direction), jnp.sin(direction)

        def pupil(shift: jax.Array) -> jax.Array:
            u = along + shift
            return wavefront(terms, u * cosine - across * sine, u * sine + across * cosine)

        wave = jnp.exp(2j * jnp.pi * (pupil(nu) - pupil(-nu))) @ jnp.asarray(weight)
        return stop / jnp.pi * jnp.sum(jnp.asarray(weight) * (jnp.cos(stop * s) * half)[:, 0] * wave)

    return jax.lax.map(at, (end, angle), batch_size=_AT_ONCE)


@partial(jax.jit, static_argnums=1)
def overlap_table(terms: jax.Array, phase: int) -> jax.Array:
    """Return `overlap` on a grid of `end` and angle, for `from_table`; (ends, angles), complex.

    It is integrated on few lines and directions, and interpolated between them by Chebyshev's polynomial and by Fourier's
    series. The grid reaches a few steps beyond its ends.
    """
    lines, half = 40 + 4 * phase, 20 + 8 * phase
    cheb = np.cos(np.pi * (np.arange(lines) + 0.5) / lines)
    ends, turns = np.pi / 4 * (1 + 1.1 * cheb), np.pi * np.arange(half) / half
    end, angle = (a.ravel() for a in np.meshgrid(ends, turns, indexing="ij"))
    values = overlap(terms, jnp.asarray(end), jnp.asarray(angle), overlap_order(phase)).reshape(lines, half)
    values = jnp.concatenate([values, jnp.conj(values)], axis=1)  # of a real kernel

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
    return jnp.asarray(by_line) @ values @ jnp.asarray(by_turn.T)


def _fineness(phase: int) -> tuple[int, int]:
    """Return the steps of a table from 0 to pi/2 of `end`, and round."""
    return 96 + 12 * phase, 128 + 48 * phase


@partial(jax.jit, static_argnums=1)
def from_table(table: jax.Array, phase: int, end: jax.Array, angle: jax.Array) -> jax.Array:
    """Return the transfer function at end in [0, pi/2] and any angle, rad, (n,), between the points of a table."""
    fine, round_fine = _fineness(phase)
    flat, width, steps = table.ravel(), table.shape[1], np.arange(POINTS)
    row, column = (
        end * (fine / (np.pi / 2)) + _BEYOND,
        jnp.mod(angle, 2 * jnp.pi) * (round_fine / (2 * np.pi)) + _BEYOND,
    )

    def at(place: tuple[jax.Array, jax.Array]) -> jax.Array:
        first = [jnp.floor(a).astype(jnp.int32) - (POINTS // 2 - 1) for a in place]
        weights = [
            jnp.stack(lagrange_basis(np.arange(float(POINTS)), a - one)) for a, one in zip(place, first, strict=True)
        ]
        index = (first[0] + steps)[:, None] * width + first[1] + steps
        return weights[0] @ flat[index] @ weights[1]

    return jax.lax.map(at, (row, column), batch_size=1 << 14)
