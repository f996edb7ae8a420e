"""A lens behind a pixel of unknown size, so that both can be told apart: diffraction x Gaussian core x square pixel (MODEL 7).

The core and the pixel differ in nothing but the shape of their transforms: in a Gaussian's and a box's fourth cumulants,
2 (half width)^4 / 15 for the pixel. A lens whose core is not quite Gaussian would pass for another pixel. Therefore the core
may have an excess kurtosis, known to be 0 within a stated tolerance; the errors of core and pixel contain what that leaves
open.
"""

from __future__ import annotations

from matcam._jax import jax, jnp
from matcam.calibration.profiles import LensModel
from matcam.camera.diffraction import DiffractionOptics
from matcam.camera.gaussian import GaussianOptics
from matcam.camera.optics import Optics
from matcam.camera.pixel import BoxPixel

KURTOSIS = 0.02
"""Standard deviation of the core's excess kurtosis about 0: what is believed of a lens that is called Gaussian."""
_NARROWEST = 0.05  # px


class Separable(LensModel):
    """Parameters: ln of the standard deviation of core and pixel together (px), which every edge knows well; half width of the
    pixel (px); excess kurtosis of the core.

    f_number: of the picture; 0: no diffraction. wavelength, pixel_pitch: m.
    """

    f_number: jax.Array
    wavelength: jax.Array
    pixel_pitch: jax.Array

    @property
    def names(self) -> tuple[str, ...]:
        """Of the fitted numbers."""
        return ("optics.sigma_px", "pixel.half_width_px", "kurtosis")

    @property
    def longest(self) -> tuple[float, ...]:
        """Longest steps."""
        return (0.3, 0.08, 0.05)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        """A pixel that is sensitive nearly all over, and a Gaussian core."""
        half = jnp.full_like(log_sigma, 0.42)
        return jnp.stack([jnp.log(jnp.exp(2 * log_sigma) + half**2 / 3) / 2, half, jnp.zeros_like(half)])

    def numbers(self, parameters: jax.Array) -> jax.Array:
        """Sigma px, half width px, kurtosis."""
        return parameters.at[0].set(jnp.sqrt(_variance(parameters)))

    def optics(self, parameters: jax.Array) -> Optics:
        """The core alone, as the Gaussian that it is but for its kurtosis."""
        return GaussianOptics(jnp.sqrt(_variance(parameters)))

    def mtf(self, parameters: jax.Array, f: jax.Array, angle: jax.Array, half_width: jax.Array) -> jax.Array:
        """Total MTF at f cycles/px, signed; the half width is the fitted one."""
        s2 = (2 * jnp.pi * f) ** 2 * _variance(parameters)
        # Gram and Charlier's first term; a fourth cumulant in the exponent would grow without bound
        core = jnp.exp(-s2 / 2) * (1 + parameters[2] * s2**2 / 24)
        there = self.f_number > 0
        lens = DiffractionOptics(jnp.where(there, self.f_number, 1.0), self.wavelength, self.pixel_pitch)
        pixel = BoxPixel(parameters[1])
        box = pixel.mtf(f * jnp.cos(angle)) * pixel.mtf(f * jnp.sin(angle))
        return core * jnp.where(there, lens.mtf(f), 1.0) * box


def _variance(parameters: jax.Array) -> jax.Array:
    """Of the core, px^2: a square's along any direction is a third of its half width's square."""
    return jnp.maximum(jnp.exp(2 * parameters[0]) - parameters[1] ** 2 / 3, _NARROWEST**2)
