"""The effective kernel of one lens and a pixel: in closed form where there is one, by quadrature over frequencies elsewhere.

For lenses of one piece; `Camera` sums over the components of the others.
"""

from __future__ import annotations

from functools import partial

from matcam.camera import pixel as tilted_square
from matcam.camera.optics import fourier
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.optics import Optics
from matcam.camera.pixel import BoxPixel, PixelResponse
from matcam.core.jax import jax, jnp


def point(optics: Optics, pixel: PixelResponse, x: jax.Array, y: jax.Array) -> jax.Array:
    """What a pixel reads of a point of light (x, y) px from its centre, 1/px^2."""
    if isinstance(optics, GaussianOptics):
        return pixel.of_gaussian(x, optics.sigma) * pixel.of_gaussian(y, optics.sigma)
    reach, band = fourier.reach_of(jnp.hypot(x, y)), optics.band()
    rule = optics.frequency_rule(fourier.panels_for(reach + 1, band))
    turns = fourier.turns_for(reach + 1, band)
    return fourier.plane_kernel(rule, partial(transfer_along, optics, pixel), x, y, turns)


def line(optics: Optics, pixel: PixelResponse, x: jax.Array, angle: jax.Array) -> jax.Array:
    """What a pixel reads of a line x px away whose normal is at `angle`, 1/px."""
    if isinstance(optics, GaussianOptics) and isinstance(pixel, BoxPixel):
        return tilted_square.line(x, angle, pixel.half_width, optics.sigma)
    return fourier.line_kernel(rule_for(optics, x), partial(transfer_along, optics, pixel), x, angle)


def edge(optics: Optics, pixel: PixelResponse, x: jax.Array, angle: jax.Array) -> jax.Array:
    """What a pixel reads x px inside the bright side of a 0-1 edge whose normal is at `angle`."""
    if isinstance(optics, GaussianOptics) and isinstance(pixel, BoxPixel):
        return tilted_square.edge(x, angle, pixel.half_width, optics.sigma)
    return fourier.step_response(rule_for(optics, x), partial(transfer_along, optics, pixel), x, angle)


def transfer(optics: Optics, pixel: PixelResponse, fx: jax.Array, fy: jax.Array) -> jax.Array:
    """Total transfer function at (fx, fy) cycles/px."""
    return optics.mtf(jnp.hypot(fx, fy)) * pixel.mtf(fx) * pixel.mtf(fy)


def transfer_along(optics: Optics, pixel: PixelResponse, f: jax.Array, angle: jax.Array) -> jax.Array:
    """Total transfer function at f cycles/px along `angle`."""
    return optics.mtf(f) * pixel.mtf(f * jnp.cos(angle)) * pixel.mtf(f * jnp.sin(angle))


def rule_for(optics: Optics, x: jax.Array) -> fourier.Rule:
    """Frequencies that resolve the kernel out to all x px."""
    # the pixel's own transform oscillates as if 1 px further away
    return optics.frequency_rule(fourier.panels_for(fourier.reach_of(x) + 1, optics.band()))
