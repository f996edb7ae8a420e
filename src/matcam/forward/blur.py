"""All that spreads a piece of surface's light over the sensor, as a sum of Gaussians seen by the pixel: closed forms.

Lens and registration are Gaussians (the lens a sum of them, camera/gaussian_sum.py). The lamp's disc spreads the half
vector uniformly over an ellipse (MODEL 3): in x, a semicircle's worth of lines, each of which is uniform in y.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam._jax import jax, jnp
from matcam.camera.pixel import PixelResponse


class Blur(NamedTuple):
    """sum_j weight_j N(std_j) on the sensor, px, through `pixel`. Shapes (terms,)."""

    pixel: PixelResponse
    weights: jax.Array
    stds: jax.Array

    def kernel(self, offset: jax.Array, term: int) -> jax.Array:
        """One term along one axis, 1/px, at `offset` px from the pixel's centre."""
        return self.pixel.of_gaussian(offset, self.stds[term])

    def rule(self, term: int) -> tuple[jax.Array, jax.Array]:
        """Five-node Gauss rule (offsets px, weights) whose weight function is the term's kernel along one axis: exact for
        polynomials of degree 9, so for whatever is smooth on the kernel's scale."""
        m2, m4, m6, m8 = self._moments(self.stds[term])
        a = (m2 * m8 - m4 * m6) / (m2 * m6 - m4**2)
        b = (a * m4 - m6) / m2
        root = jnp.sqrt(a**2 / 4 - b)
        inner, outer = a / 2 - root, a / 2 + root
        w_inner = (m4 - m2 * outer) / (2 * inner * (inner - outer))
        w_outer = (m4 - m2 * inner) / (2 * outer * (outer - inner))
        x, y = jnp.sqrt(inner), jnp.sqrt(outer)
        offsets = jnp.stack([-y, -x, 0 * x, x, y])
        return offsets, jnp.stack([w_outer, w_inner, 1 - 2 * (w_inner + w_outer), w_inner, w_outer])

    def _moments(self, std: jax.Array) -> tuple[jax.Array, ...]:
        """Second to eighth moment of Gaussian and pixel together."""
        nodes, weights = (jnp.asarray(a) for a in np.polynomial.legendre.leggauss(32))
        at = nodes * self.pixel.half_width
        share = weights * self.pixel.half_width * self.pixel.response(at)
        p2, p4, p6, p8 = (share @ at**n for n in (2, 4, 6, 8))
        g2, g4, g6, g8 = (factor * std**n for factor, n in ((1, 2), (3, 4), (15, 6), (105, 8)))
        return (
            g2 + p2,
            g4 + 6 * g2 * p2 + p4,
            g6 + 15 * g4 * p2 + 15 * g2 * p4 + p6,
            g8 + 28 * g6 * p2 + 70 * g4 * p4 + 28 * g2 * p6 + p8,
        )
