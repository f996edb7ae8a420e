"""Quadrature of the residual of a lens at the limb: few nodes, whose weights include the rings of the kernel.

The radiance ends at the limb, and the rings of the residual have the period of the cutoff frequency. A general rule
would therefore require thousands of nodes per pixel. However, as a function of c = sqrt(1 - (r / R)^2) and of the azimuth
about the optical axis, the radiance is smooth up to the limb. Here r is the distance from the axis, and R is the radius of
the limb. A polynomial through few nodes therefore approximates the radiance. The weights of the nodes are integrals of
the residual times each basis polynomial. The weights depend only on the residual, on the depth within the limb and on
the azimuth, and are computed once, on a lattice.

The residual carries at most 0.2 % of the light, so 1 % relative accuracy suffices.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from matcam.core.jax import jax, jnp
from matcam.core.workspace import default_workspace
from matcam.forward.integral.kernel_residual import MARGIN, KernelResidual
from matcam.forward.integral.scene import Scene
from matcam.numerics.approximation import four_about, lagrange_basis

_ACROSS = np.polynomial.legendre.leggauss(8)[0]
"""Gauss-Legendre nodes in c, in [-1, 1]."""
_ALONG = np.polynomial.legendre.leggauss(4)[0]
"""Gauss-Legendre nodes in the azimuth, in [-1, 1]."""
_DEPTHS = 7
"""Number of depths of the lattice per period of the cutoff frequency."""
_AZIMUTHS = 18
"""Number of azimuths of the lattice per quarter turn, the period for an isotropic lens with a square pixel."""
_BEYOND = 3
"""Number of entries beyond either end of the lattice, for cubic interpolation."""


class LimbRule(eqx.Module):
    """Quadrature rule for the residual of a lens at the limb, tabulated over depth and azimuth.

    Attributes:
        weights: weights of the nodes, (depths, azimuths, nodes), no unit.
        reach: support radius of the residual, px.
        quarter: True if the period of the weights is a quarter turn, False for a full turn.
    """

    weights: jax.Array
    reach: jax.Array
    quarter: bool = eqx.field(static=True)

    def record(self, scene: Scene, x: jax.Array, y: jax.Array) -> jax.Array:
        """Compute the contribution of the residual to the record, 1/sr, (pixels, channels).

        Args:
            scene: the scene, under one lamp or one lamp per pixel.
            x: positions of the pixels to the right of the optical axis, (pixels,), px.
            y: positions of the pixels above the optical axis, (pixels,), px.
        """
        limb, reach = scene.sample.radius, self.reach
        off, azimuth = jnp.hypot(x, y), jnp.arctan2(y, x)
        c, turn = _window(limb, reach, off)
        c = c[:, None, None] * (_ACROSS[:, None] + 1) / 2
        at = azimuth[:, None, None] + turn * _ALONG
        far = limb * jnp.sqrt(1 - c**2)
        of_nodes = scene.beside_nodes(2)
        element, _ = scene.sample.at(*of_nodes.from_sensor(far * jnp.cos(at), far * jnp.sin(at)))
        light = of_nodes.sent(element) * c[..., None]
        depths, azimuths, nodes = self.weights.shape
        step = 2 * reach / (depths - 1 - 2 * _BEYOND)
        period = np.pi / 2 if self.quarter else 2 * np.pi
        row, column = (
            four_about((off - limb + reach) / step + _BEYOND, depths),
            four_about(jnp.mod(azimuth / period, 1.0) * (azimuths - 2 * _BEYOND) + _BEYOND, azimuths),
        )
        weight = sum(
            (own * other)[:, None] * self.weights[row[0] + i, column[0] + j]
            for i, own in enumerate(row[1])
            for j, other in enumerate(column[1])
        )
        return jnp.sum(light.reshape(x.size, nodes, -1) * jnp.asarray(weight)[..., None], axis=1)


def _window(limb: Any, reach: Any, off: Any) -> tuple[Any, Any]:
    """Compute the limits of the integral about a position: the largest c, no unit, and half the range of the azimuth, rad.

    c = sqrt(1 - (r / limb)^2), where r is the distance from the optical axis.

    Args:
        limb: radius of the limb, px.
        reach: support radius of the residual, px.
        off: distance of the position from the axis, px.
    """
    nearest = jnp.maximum(off - reach, 0.0) / limb
    return jnp.sqrt(jnp.maximum(1 - nearest**2, 0.0)), reach / (limb - reach)


def limb_rule(residual: KernelResidual, limb: float) -> LimbRule | None:
    """Build the rule for a sphere; None if the support radius of the residual exceeds a quarter of `limb`.

    limb: radius of the limb, px.
    """
    if 4 * float(residual.reach) > limb:
        return None
    key = np.asarray(residual.grid).tobytes(), float(residual.reach), limb
    return default_workspace().remember("kernel residual at the limb", key, lambda: _made(residual, limb))


def _made(residual: KernelResidual, limb: float) -> LimbRule:
    reach, period, grid = float(residual.reach), float(residual.period), spline_filter(np.asarray(residual.grid))
    depths = int(np.ceil(2 * reach / period * _DEPTHS))
    off = limb - reach + 2 * reach * np.arange(-_BEYOND, depths + _BEYOND + 1) / depths
    around = 2 * np.pi / (4 if residual.even else 1)
    count = _AZIMUTHS * (1 if residual.even else 4)
    azimuth = around * np.arange(count) / count
    # several nodes in c and in the azimuth per period of the cutoff frequency everywhere
    (across, c_share), (along, turn_share) = (np.polynomial.legendre.leggauss(n) for n in (100, 50))
    basis = np.stack(lagrange_basis(_ACROSS, across)), np.stack(lagrange_basis(_ALONG, along))
    weights = np.zeros((off.size, count, _ACROSS.size * _ALONG.size))
    half = (grid.shape[0] - 1) / 2
    per_px = (half - MARGIN) / reach
    for row, at in enumerate(off):
        widest, turn = (float(a) for a in _window(limb, reach, at))
        if widest == 0:
            continue
        c = widest * (across + 1) / 2
        far = limb * np.sqrt(1 - c**2)[:, None]
        angle = azimuth[:, None, None] + turn * along
        dx = at * np.cos(azimuth)[:, None, None] - far * np.cos(angle)
        dy = at * np.sin(azimuth)[:, None, None] - far * np.sin(angle)
        kernel = map_coordinates(grid, [dx * per_px + half, dy * per_px + half], order=3, prefilter=False)
        kernel *= limb**2 * (widest / 2 * c_share)[:, None] * (turn * turn_share)
        weights[row] = np.einsum("aij,mi,nj->amn", kernel, *basis).reshape(count, -1)
    weights = np.concatenate([weights[:, -_BEYOND:], weights, weights[:, :_BEYOND]], axis=1)
    return LimbRule(jnp.asarray(weights), jnp.asarray(reach), residual.even)
