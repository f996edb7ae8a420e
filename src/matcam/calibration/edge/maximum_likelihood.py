"""Maximum likelihood for an edge of known profile: the profile's parameters, the levels, uneven light, the edge's curve.

A pixel is modelled as  [dark (1 - E(d)) + bright E(d)] (1 + gx x + gy y),  E the edge response at distance d. Its
variance is the MODEL's, gain * value + read^2, held fixed within a step (iteratively reweighted least squares: the fixed
point is the maximum of the Poisson likelihood where variance and mean are one, and nothing is biased by noise in weights,
docs/model.md 8).

Fisher scoring, a fixed number of steps: every step is the same small program, so that a thousand edges run side by side
under `vmap`, which a search with its own stopping rule (Optimistix) would hold up for its slowest member. Profile and levels
see the cells; the curve sees the pixels near the edge. The curve's shift is fitted along with the profile, its slope and
bow are orthogonal to everything else by symmetry, so that the two may take turns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from matcam.calibration.edge.geometry import EdgeCells, PhasedRows
from matcam.core.jax import AnyArray, jax, jnp
from matcam.numerics.linalg import scaled_inverse

LINEAR = 5
"""Parameters that every profile has: dark, bright, gx, gy, shift."""

Profile = Callable[[EdgeCells, jax.Array], tuple[jax.Array, jax.Array, jax.Array]]
"""(cells, parameters (k,)) -> means over the cells of E, of dE/dd, and of dE/dparameters (k, n)."""


class Noise(NamedTuple):
    """Hold the noise of a pixel, in the picture's own units.

    Attributes:
        gain: system gain; NaN: to be estimated.
        read: standard deviation of the read noise; NaN: to be estimated.
    """

    gain: AnyArray | np.float64
    read: AnyArray | np.float64

    def variance(self, value: AnyArray) -> jax.Array:
        """Return the variance of a pixel expected to read `value`."""
        return jnp.asarray(self.gain * jnp.maximum(value, 0.0) + self.read**2)


UNKNOWN_NOISE = Noise(np.float64(np.nan), np.float64(np.nan))


class State(NamedTuple):
    """Hold the parameters of the fit.

    Attributes:
        linear: (5,) dark, bright, gx and gy in 1/px, shift in px (added to every distance).
        profile: (k,) the profile's own.
    """

    linear: jax.Array
    profile: jax.Array


class EdgeModel(NamedTuple):
    """Hold what every cell should read, and its derivatives.

    Attributes:
        state: the parameters.
        value: (n,).
        edge: (n,) E.
        light: (n,) 1 + gx x + gy y.
        design: (5 + k, n) derivatives by the parameters.
    """

    state: State
    value: jax.Array
    edge: jax.Array
    light: jax.Array
    design: jax.Array


def edge_model(cells: EdgeCells, state: State, profile: Profile) -> EdgeModel:
    """Return what the cells should read."""
    dark, bright, gx, gy, shift = state.linear
    edge, line, slopes = profile(cells._replace(distance=cells.distance + shift), state.profile)
    light = 1 + gx * cells.x + gy * cells.y
    level = dark + (bright - dark) * edge
    step = (bright - dark) * light
    rows = [(1 - edge) * light, edge * light, level * cells.x, level * cells.y, step * line]
    return EdgeModel(state, level * light, edge, light, jnp.concatenate([jnp.stack(rows), step * slopes]))


def scoring_step(cells: EdgeCells, state: State, profile: Profile, noise: Noise, longest: jax.Array) -> State:
    """Return the parameters after a step of Fisher scoring.

    longest: (k,) largest change of the profile's parameters.
    """
    at = edge_model(cells, state, profile)
    weight = cells.pixels / noise.variance(at.value)
    inverse = scaled_inverse((at.design * weight) @ at.design.T)
    change = inverse @ (at.design @ (weight * (cells.value - at.value)))
    shift = jnp.clip(change[4], -1.0, 1.0)
    return State(
        state.linear + change[:LINEAR].at[4].set(shift),
        state.profile + jnp.clip(change[LINEAR:], -longest, longest),
    )


class CurveStep(NamedTuple):
    """Hold what the pixels near the edge say of its curve.

    Attributes:
        curve: (3,) coefficients.
        covariance: (3, 3) of them, for these levels and this profile.
        residual: standard deviation of the pixels about their model.
    """

    curve: jax.Array
    covariance: jax.Array
    residual: jax.Array


def curve_step(phased: PhasedRows, cells: EdgeCells, at: EdgeModel, noise: Noise) -> CurveStep:
    """Return the curve after a step of Fisher scoring, from single pixels.

    A pixel's model is its cell's, moved along the slope: within a cell the distances differ by a sixteenth of a px, and
    what the second order leaves is even in the distance, which tells nothing of position.
    """
    aligned, distance, curve, state = phased.rows, phased.distance, phased.curve, at.state
    near = aligned.near
    shape = (phased.member.shape[0], near.stop - near.start)
    size = shape[0] * shape[1]
    of_row = lambda a: a[:size].reshape(shape)[phased.phase]  # noqa: E731
    light = 1 + state.linear[2] * aligned.x[:, near] + state.linear[3] * aligned.y[:, None]
    slope = of_row(at.design[4] / at.light) * light
    expected = of_row(at.value / at.light) * light + slope * (distance[:, near] - of_row(cells.distance))
    weight = aligned.valid[:, near] / noise.variance(expected)
    # moving the curve by +1 px along x brings the bright side c px nearer
    tilt = 1 / jnp.sqrt(1 + (curve[1] + 2 * curve[2] * aligned.y) ** 2)
    by_row = -slope * tilt[:, None]
    information = (weight * by_row**2).sum(1)
    residual = aligned.valid[:, near] * (aligned.value[:, near] - expected)
    score = (weight * by_row * residual).sum(1)
    length = jnp.max(jnp.abs(aligned.y))
    powers = (aligned.y / length) ** jnp.arange(3)[:, None]
    normal = (powers * information) @ powers.T
    normal = normal + 1e-9 * jnp.trace(normal) * jnp.eye(3) + 1e-300 * jnp.eye(3)
    units = length ** -jnp.arange(3.0)
    covariance = jnp.linalg.inv(normal)
    change = jnp.clip(covariance @ (powers @ score), -1.0, 1.0)
    rms = jnp.sqrt((residual**2).sum() / jnp.maximum(aligned.valid[:, near].sum(), 1.0))
    return CurveStep(curve + change * units, covariance * units[:, None] * units, rms)
