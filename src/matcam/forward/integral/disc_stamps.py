"""Records on a grid around a highlight through a lens out of focus, with light divided into shares by disc radius.

Each surface element is spread over its own disc. Around a highlight the radii c differ little, and the kernel is a
smooth function of c: a polynomial through few radii. Light is therefore divided into shares by the Lagrange basis at
its own c. Each share is recorded in focus, where nodes and kernel are products in x and y. Its record is averaged over
the disc of its radius: a convolution on the grid, by Fourier transform.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Blur
from matcam.numerics.approximation import POINTS, lagrange_basis, on_steps
from matcam.numerics.disc_chords import chords_of
from matcam.sample.shape import Curved, Element

_SHARES = (4, 6, 8, 12, 16, 24, 32)
_LEAST, _PER_BLUR = 4.3, 6.0
"""Number of shares of light for an error of 1e-6 of the peak of the kernel, and additional ones per standard deviation
of half the range of c.
"""
_ALONG = 8
"""Smallest number of positions along a chord of a disc."""


def shares_for(change: float) -> int:
    """Compute the number of shares. change: half the range of disc radii, in standard deviations of the blur."""
    needed = _LEAST + _PER_BLUR * change
    return next((count for count in _SHARES if count >= needed), _SHARES[-1])


def margin_for(disc: float, spacing: float) -> int:
    """Compute the margin of a grid for discs beyond its border, steps. disc: largest radius, px."""
    return math.ceil(disc / spacing) + POINTS // 2


class DiscShares(NamedTuple):
    """Division of light by disc radius; the radii of the shares are Chebyshev nodes of the range.

    Attributes:
        blur: the blur, with its discs.
        radius: radius of the sample, px.
        middle: middle of the range of radii, px, with the sign of `Blur.defocus`.
        half: half the range, px.
        unit: Chebyshev nodes in [-1, 1]; empty without defocus.
    """

    blur: Blur
    radius: jax.Array
    middle: jax.Array
    half: jax.Array
    unit: np.ndarray

    @classmethod
    def over(cls, blur: Blur, sample: Curved, element: Element, count: int) -> DiscShares:
        """Divide the light of surface elements into `count` shares; 0: it is not divided."""
        discs = blur.defocus(sample.radius, element.normal[2])
        low, high = (jax.lax.stop_gradient(end(discs)) for end in (jnp.min, jnp.max))
        unit = np.cos(np.pi * (np.arange(count) + 0.5) / max(count, 1))
        return cls(blur, sample.radius, (low + high) / 2, jnp.maximum((high - low) / 2, 1e-9), unit)

    @property
    def through(self) -> Blur:
        """Return the blur through which each share is recorded."""
        return self.blur.in_focus() if self.unit.size else self.blur

    def divided(self, light: jax.Array, element: Element) -> jax.Array:
        """Repeat the channels of light for each share, (..., channels x shares)."""
        if not self.unit.size:
            return light
        discs = self.blur.defocus(self.radius, element.normal[2])
        basis = jnp.stack(lagrange_basis(self.unit, (discs - self.middle) / self.half), axis=-1)
        return (light[..., None] * basis[..., None, :]).reshape(*light.shape[:-1], -1)

    def together(self, grids: jax.Array, spacing: jax.Array, margin: int) -> jax.Array:
        """Spread the record of each share over its discs, and add them up.

        Args:
            grids: records of the shares, (rows, columns, channels x shares).
            spacing: step of the grid, px.
            margin: number of rows and columns that the result lacks on each side.

        Returns:
            The record, (rows, columns, channels).
        """
        if not self.unit.size:
            return grids
        rows, columns = grids.shape[:2]
        radii = (self.middle + self.half * self.unit) / spacing
        discs = jax.vmap(lambda radius: _disc_on_grid(radius, margin, self.blur.chords))(radii)
        centred = jnp.zeros((self.unit.size, rows, columns)).at[:, : discs.shape[1], : discs.shape[2]].set(discs)
        centred = jnp.roll(centred, (-margin, -margin), axis=(1, 2))
        shares = grids.reshape(rows, columns, -1, self.unit.size)
        # the wrapped part stays within the margin
        spectrum = jnp.einsum("yxcm,myx->yxc", jnp.fft.rfft2(shares, axes=(0, 1)), jnp.fft.rfft2(centred))
        inner = slice(margin, -margin)
        return jnp.fft.irfft2(spectrum, s=(rows, columns), axes=(0, 1))[inner, inner]


def _disc_on_grid(radius: jax.Array, margin: int, chords: int) -> jax.Array:
    """Compute weights of grid points, (2 margin + 1, 2 margin + 1), for the mean over a disc. radius: in steps."""
    at, half, share = chords_of(chords)
    along, weight = np.polynomial.legendre.leggauss(max(chords, _ALONG))
    across = _cardinal(radius * at, margin)
    lengthwise = jnp.einsum("cak,a->ck", _cardinal(radius * half[:, None] * along, margin), weight / 2)
    return jnp.einsum("ck,cl,c->kl", lengthwise, across, share)


def _cardinal(position: jax.Array, margin: int) -> jax.Array:
    """Compute the weights of the points -margin to margin in an interpolated value, on a trailing axis."""
    first, weights = on_steps(position)
    places = first[..., None] + np.arange(POINTS) + margin
    return jnp.sum(weights[..., None] * (places[..., None] == np.arange(2 * margin + 1)), axis=-2)
