"""All that spreads a piece of surface's light over the sensor, as a sum of Gaussians seen by the pixel: closed forms.

The lens is a sum of Gaussians (camera/gaussian_sum.py); registration is one. A lens out of focus spreads light over a disc
and a lamp's disc spreads the half vector over an ellipse (MODEL 3): both are taken as Gaussians of the disc's own standard
deviations, a quarter of its diameter. Those two depend on the place and on the lamp.

The lengths that a blur sets for an integral over it, and the terms of a blur that share them.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.camera.optics.gaussian import gaussian_sum
from matcam.camera.pixel import PixelResponse
from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax, jnp
from matcam.rigs import Rig
from matcam.sample.shape import Curved

STEEPEST = 0.1
"""Cosine of theta_d below which a lamp's disc spreads the half vector no further: its ellipse is as long as the sample."""


class Blur(eqx.Module):
    """sum_j weight_j N(std_j) on the sensor, px, through `pixel`; weights and stds have shape (terms,)."""

    pixel: PixelResponse
    weights: jax.Array
    stds: jax.Array
    lamp_radius: jax.Array
    aperture: jax.Array
    focus: jax.Array
    varies: bool = eqx.field(static=True)
    """Whether lamp or focus spread the light by more than the lens, the pixel and the registration do."""

    def spread(self, sample: Curved, normal_z: jax.Array, lamp_angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Variances, px^2, that focus and lamp add along x and y for a piece of surface with this n_z."""
        if not self.varies:
            return jnp.zeros(()), jnp.zeros(())
        circle = sample.radius * self.aperture * (normal_z - jnp.cos(self.focus))
        theta_d = sample.theta_d(lamp_angle)
        scale_x, scale_y = sample.px_per_rad(theta_d)
        along = scale_x * self.lamp_radius / 4
        across = jnp.where(jnp.isinf(scale_y), 0.0, scale_y) * self.lamp_radius / 4
        across /= jnp.maximum(jnp.cos(theta_d), STEEPEST)
        defocus = circle**2 / 16
        return defocus + along**2, defocus + across**2

    def kernel(self, offset: jax.Array, term: int, variance: jax.Array) -> jax.Array:
        """One term along one axis, 1/px, at `offset` px from the pixel's centre."""
        return self.pixel.of_gaussian(offset, self._std(term, variance))

    def rule(self, term: int, variance: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Five-node Gauss rule (offsets px, weights; on a trailing axis) whose weight function is the term's kernel along
        one axis: exact for polynomials of degree 9, so for whatever is smooth on the kernel's scale."""
        m2, m4, m6, m8 = self._moments(self._std(term, variance))
        a = (m2 * m8 - m4 * m6) / (m2 * m6 - m4**2)
        b = (a * m4 - m6) / m2
        root = jnp.sqrt(a**2 / 4 - b)
        inner, outer = a / 2 - root, a / 2 + root
        w_inner = (m4 - m2 * outer) / (2 * inner * (inner - outer))
        w_outer = (m4 - m2 * inner) / (2 * outer * (outer - inner))
        x, y = jnp.sqrt(inner), jnp.sqrt(outer)
        weights = jnp.stack([w_outer, w_inner, 1 - 2 * (w_inner + w_outer), w_inner, w_outer], axis=-1)
        return jnp.stack([-y, -x, 0 * x, x, y], axis=-1), weights

    def _std(self, term: int, variance: jax.Array) -> jax.Array:
        return jnp.sqrt(self.stds[term] ** 2 + variance) if self.varies else self.stds[term]

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


def blur_of(rig: Rig) -> Blur:
    """The blur of a rig."""
    lens = gaussian_sum(rig.camera.optics)
    still = all(is_concrete(a) and float(a) == 0 for a in (rig.lamp_radius, rig.aperture))
    return Blur(
        pixel=rig.camera.pixel,
        weights=lens.weights,
        stds=jnp.sqrt(lens.sigmas**2 + rig.jitter**2),
        lamp_radius=rig.lamp_radius,
        aperture=rig.aperture,
        focus=rig.focus,
        varies=not still,
    )


def kernel_error(rig: Rig) -> float:
    """Largest error of the camera's transfer function that taking its lens as a sum of Gaussians makes; 0 for Gaussians."""
    return float(gaussian_sum(rig.camera.optics).total_error)


_TOGETHER = 1.4
_SHARP = 0.7
"""Standard deviation, in half widths of the pixel, below which its borders show as steps."""


class Scale(NamedTuple):
    """Lengths on the sensor, px, that a blur's terms of about one width set."""

    near: float
    """Half the side of the square around the highlight in which the nodes go about the half vector."""
    margin: float
    """Distance from the ends of the light from which on a pixel's surroundings are smooth."""
    reach: float
    """How far the kernel is followed."""
    finest: float
    """Standard deviation of the narrowest term without the pixel."""
    spacing: float
    """Grid on which a record is known everywhere: it holds nothing finer."""
    cuts: tuple[float, ...]
    """Offsets inside its reach at which the kernel must be cut to be smooth in between; () where it is smooth."""


class Group(NamedTuple):
    """Terms of a blur of about one width."""

    terms: tuple[int, ...]
    scale: Scale


def groups_of(blur: Blur, sample: Curved) -> tuple[Group, ...]:
    """The terms of a blur, those of about one width together. Needs numbers: ArgumentError inside jit."""
    numbers = [jax.lax.stop_gradient(a) for a in (blur.stds, blur.pixel.half_width, sample.radius, blur.lamp_radius)]
    if not all(is_concrete(a) for a in numbers):
        raise ArgumentError(
            "the rig's numbers set how its picture is integrated: call this outside of jax.jit and vmap"
        )
    stds, half = np.asarray(numbers[0]), float(numbers[1])
    widened = np.sqrt(stds**2 + _widest_spread(blur, sample))
    radius = float(numbers[2])
    if np.min(stds) >= radius:
        raise ArgumentError(
            f"the sample's radius must exceed the camera's blur, of standard deviation {np.min(stds):g} px, got {radius:g} px"
        )
    groups, left = [], list(np.argsort(stds))
    while left:
        together = [j for j in left if stds[j] <= _TOGETHER * stds[left[0]]]
        groups.append(Group(tuple(int(j) for j in together), _scale(half, stds[together], widened[together])))
        left = left[len(together) :]
    return tuple(groups)


def _scale(half: float, stds: np.ndarray, widened: np.ndarray) -> Scale:
    widest, narrowest = float(np.max(widened)), float(np.min(stds))
    std, finest = (float(np.hypot(s, half / np.sqrt(3))) for s in (widest, narrowest))
    reach = half + 5.2 * widest
    inner = max(half - 5.2 * widest, half / 4)
    return Scale(
        near=10 * std,
        margin=4.8 * std,
        reach=reach,
        finest=narrowest,
        spacing=min(0.4 * narrowest, 0.36 * finest),
        cuts=(-half, -inner, inner, half) if narrowest < _SHARP * half else (),
    )


def _widest_spread(blur: Blur, sample: Curved) -> float:
    """Largest variance, px^2, that focus and lamp add anywhere."""
    if not blur.varies:
        return 0.0
    aperture, focus, lamp, radius = (
        float(jax.lax.stop_gradient(a)) for a in (blur.aperture, blur.focus, blur.lamp_radius, sample.radius)
    )
    depth = max(np.cos(focus), 1 - np.cos(focus))
    return (radius * aperture * depth / 4) ** 2 + (radius * lamp / 4 / STEEPEST) ** 2
