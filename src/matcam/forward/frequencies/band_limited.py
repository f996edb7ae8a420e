"""Images through a band-limited lens, without an approximation by sums of Gaussians.

The transfer function of a diffraction-limited lens, with or without defocus and aberrations, is 0 above a limit B. A
measured MTF that reaches 0 has such a limit, too. Let picture_g be the image through a narrow Gaussian lens of standard
deviation s and a point-like pixel. The image through the band-limited lens is obtained by filtering picture_g:

    picture = F^-1 [ lens(f) pixel(f) / g(f)  F picture_g ],    g(f) = exp(-2 pi^2 s^2 f^2).

F is the Fourier transform, f the frequency, and lens(f) and pixel(f) are transfer functions. For a sphere in front of a
distant camera, picture_g is computed from the radiance on a grid (`light_grid.py`). Otherwise picture_g is computed at
`per_px` positions along the side of a pixel, by the operator for Gaussians. Frequencies above per_px - B alias to
frequencies below B, but the Gaussian attenuates them. s is small, so the filter amplifies errors little. The filter is
exact at all frequencies. Aliasing is therefore the only error of the transfer function of lens and pixel
(`BandLimit.error`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len
from scipy.special import erfc

from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import gaussian_sum
from matcam.camera.optics.optics import Optics
from matcam.camera.optics.zernike import ZernikeOptics
from matcam.camera.pixel import PixelResponse
from matcam.core.jax import is_concrete, jax, jnp, without_derivatives

POINT = 1e-3
"""Half width of the pixel of a fine record, px. The pixel is practically a point."""
_MOST_PER_PX = 8
_AMPLIFIED = 3.0
"""Largest factor by which a filter may amplify a frequency and the errors of the record."""
EXACT = 1e-6
"""Error of a transfer function below which no finer sampling is used."""
_SIGMAS = np.arange(0.1, 2.0, 0.025)
_FREQUENCIES = 120
_ANGLES = np.linspace(0, np.pi / 4, 5)
_REPLICAS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
_ROLL_OFF = 3.4
"""Argument at which erfc(x) / 2 is 1e-6."""
_LEAST_BLURRED = 1e-5
"""Transfer function of the fine record below which it is not undone, because rounding errors would dominate."""
APART = 160
"""Distance between the scene and its periodic copy, px. There, an Airy pattern of f/8 has decreased to 1e-7 of its peak."""


class BandLimit(NamedTuple):
    """Sampling and filter of an image through a band-limited lens.

    Attributes:
        per_px: number of positions along the side of a pixel, no unit.
        sigma: standard deviation of the Gaussian lens of the fine record, px.
        error: largest error of the transfer function of lens and pixel, no unit.
    """

    per_px: int
    sigma: float
    error: float


def band_limit(camera: Camera, enough: float = EXACT) -> BandLimit | None:
    """Choose the sampling of images of a camera.

    The result is None if a sum of Gaussians has at most the error of this sampling, or if parameters are traced. `enough`
    is the error of a transfer function below which no finer sampling is used, no unit. Default: `EXACT`.
    """
    if not concrete(camera):
        return None
    optics = without_derivatives(camera.optics)
    by_gaussians = float(gaussian_sum(optics).total_error)
    if by_gaussians == 0:
        return None
    best = sampling_of([optics], camera.pixel, enough)
    return best if best.error < by_gaussians else None


def concrete(camera: Camera) -> bool:
    """Check whether the parameters of lens and pixel are concrete. Derivatives with respect to them are allowed."""
    stopped = without_derivatives((camera.optics, camera.pixel))
    return all(is_concrete(leaf) for leaf in jax.tree.leaves(stopped))


def sampling_of(lenses: Sequence[Optics], pixel: PixelResponse, enough: float = EXACT) -> BandLimit:
    """Choose the sampling of images through several lenses, whose parameters must be concrete."""
    stopped = without_derivatives(list(lenses))
    pixel = without_derivatives(pixel)
    frequency = np.linspace(0, max(lens.band() for lens in stopped), _FREQUENCIES)
    passed = np.max([_at_most(lens, frequency) for lens in stopped], axis=0)
    along, across = (np.abs(np.asarray(pixel.mtf(frequency * part(_ANGLES[:, None])))) for part in (np.cos, np.sin))
    return _chosen(tuple(frequency.tolist()), tuple(map(tuple, (passed * along * across).tolist())), enough)


def _at_most(optics: Optics, frequency: np.ndarray) -> np.ndarray:
    """Compute an upper bound of the modulus of the transfer function of a lens at `frequency`, cycles/px.

    The bound holds for all directions. For an isotropic lens, it is the modulus itself. For any other lens, aberrations are
    omitted, because they only reduce the modulus.
    """
    if optics.isotropic:
        return np.abs(np.asarray(optics.mtf(frequency)))
    parts = [
        abs(float(weight))
        * np.abs(np.asarray((part.focused if isinstance(part, ZernikeOptics) else part).mtf(frequency)))
        for weight, part in optics.components()
    ]
    return np.sum(parts, axis=0)


@lru_cache(maxsize=32)
def _chosen(frequencies: tuple[float, ...], passed: tuple[tuple[float, ...], ...], enough: float) -> BandLimit:
    """Choose the coarsest sampling with a sufficiently small error, or else the sampling with the smallest error.

    `frequencies` are in cycles/px. `passed` is the modulus of the transfer function of lens and pixel along `_ANGLES`,
    (angles, frequencies).
    """
    f, total = np.array(frequencies), np.array(passed)
    fx, fy = (f * part(_ANGLES[:, None]) for part in (np.cos, np.sin))
    best = BandLimit(_MOST_PER_PX, 0.1, np.inf)
    for per_px in range(2, _MOST_PER_PX + 1):
        folded = np.array([(per_px * i - fx) ** 2 + (per_px * j - fy) ** 2 for i, j in _REPLICAS])
        for sigma in _SIGMAS:
            raised = total * np.exp(2 * (np.pi * sigma * f) ** 2)
            if raised.max() > _AMPLIFIED:
                break
            error = float((np.exp(-2 * (np.pi * sigma) ** 2 * folded).sum(axis=0) * raised).max())
            if error < best.error:
                best = BandLimit(per_px, float(sigma), error)
        if best.error < enough:
            break
    return best


class FineLine(NamedTuple):
    """Positions along one axis at which an image is recorded before it is filtered.

    Attributes:
        at: positions, px, in the order of the pixels, in steps of a fraction of a pixel.
        first: index in `at` of the first pixel of the image.
        step: 1.0 if positions increase to the right or upwards, otherwise -1.0.
    """

    at: np.ndarray
    first: int
    step: float


def fine_line(pixels: np.ndarray, low: float, high: float, per_px: int) -> FineLine:
    """Compute the positions of a fine record, px.

    The positions cover the pixels of an image and the interval from `low` to `high`, px.
    """
    step = 1.0 if pixels.size < 2 else float(np.sign(pixels[1] - pixels[0]))
    ends = (low, high) if step > 0 else (high, low)
    before, after = max(0.0, step * (pixels[0] - ends[0])), max(0.0, step * (ends[1] - pixels[-1]))
    first = int(np.ceil(before * per_px))
    count = first + (pixels.size - 1) * per_px + int(np.ceil(after * per_px)) + 1
    return FineLine(pixels[0] + step * (np.arange(count) - first) / per_px, first, step)


class FineRecord(NamedTuple):
    """Fourier transform of a fine record.

    Attributes:
        spectrum: transform of the real values, complex, (rows, columns / 2 + 1, channels), as computed by `rfft2`.
        fx: frequencies of the columns of the transform, to the right, cycles/px.
        fy: frequencies of the rows of the transform, upwards, cycles/px.
        padded: rows and columns of the record including the distance to its periodic copy.
        size: rows and columns of the record.
    """

    spectrum: jax.Array
    fx: np.ndarray
    fy: np.ndarray
    padded: tuple[int, int]
    size: tuple[int, int]

    def values(self) -> jax.Array:
        """Compute the values of the record, (rows, columns, channels)."""
        return jnp.fft.irfft2(self.spectrum, self.padded, axes=(0, 1))[: self.size[0], : self.size[1]]

    def blurred(self, variance: float | jax.Array) -> FineRecord:
        """Filter by a Gaussian. `variance` is its variance along each axis, px^2."""
        gaussian = jnp.exp(-2 * jnp.pi**2 * variance * (self.fx**2 + self.fy[:, None] ** 2))
        return self._replace(spectrum=self.spectrum * gaussian[..., None])

    def undone(self, sigma: float | jax.Array, highest: float, *, compact: bool) -> FineRecord:
        """Undo the blur by a Gaussian lens and a pixel of half width `POINT`, up to a frequency.

        Args:
            sigma: standard deviation of the lens, px.
            highest: frequency up to which the result has the spectrum of the radiance, cycles/px.
            compact: True for a spectrum that decreases smoothly to 0 between this frequency and its aliases, so that a point
                of light has a compact image. The frequency must be below half the sampling frequency. Otherwise the spectrum
                is 0 above.
        """
        blur, frequency = recorded(sigma, self.fx, self.fy[:, None]), np.hypot(self.fx, self.fy[:, None])
        if compact:
            middle = float(np.abs(self.fx).max())
            rolled = erfc(_ROLL_OFF * (frequency - middle) / (middle - highest)) / 2
            inverse = rolled * blur / (blur**2 + _LEAST_BLURRED**2)
        else:
            inverse = jnp.where(frequency <= highest, 1 / jnp.where(frequency <= highest, blur, 1.0), 0.0)
        return self._replace(spectrum=self.spectrum * inverse[..., None])

    def only(self, channels: slice | list[int]) -> FineRecord:
        return self._replace(spectrum=self.spectrum[..., channels])

    def of(self, values: jax.Array) -> FineRecord:
        return self._replace(spectrum=jnp.fft.rfft2(values, self.padded, axes=(0, 1)))


def transformed(values: jax.Array, across: FineLine, along: FineLine, per_px: int, periodic: bool) -> FineRecord:
    """Compute the Fourier transform of a fine record.

    Args:
        values: the record, (rows, columns, channels).
        across: positions of the columns.
        along: positions of the rows.
        per_px: number of positions along the side of a pixel.
        periodic: True if the record is constant along y, as for a cylinder.
    """
    height, width = values.shape[:2]
    rows, columns = (next_fast_len(n + APART * per_px, real=True) for n in (height, width))
    rows = height if periodic else rows
    fx, fy = np.fft.rfftfreq(columns, 1 / per_px) * across.step, np.fft.fftfreq(rows, 1 / per_px) * along.step
    spectrum = jnp.fft.rfft2(values, (rows, columns), axes=(0, 1))
    return FineRecord(spectrum, fx, fy, (rows, columns), (height, width))


def filtered(light: FineRecord, optics: Optics, pixel: PixelResponse, shift: jax.Array) -> jax.Array:
    """Filter radiance by lens and pixel.

    Args:
        light: transform of the radiance, exact up to the cutoff frequency of the lens.
        optics: the lens.
        pixel: the pixel.
        shift: shift of the image, (right, up), px.

    Returns:
        Transform of the image.
    """
    fx, fy = np.broadcast_arrays(light.fx, light.fy[:, None])
    rows, columns = np.nonzero(np.hypot(fx, fy) <= optics_band(optics))
    fx, fy = fx[rows, columns], fy[rows, columns]
    lens = optics.otf(fx, fy) * pixel.mtf(fx) * pixel.mtf(fy)
    if np.any(np.asarray(jax.lax.stop_gradient(shift))):
        lens = lens * jnp.exp(-2j * jnp.pi * (fx * shift[0] + fy * shift[1]))
    passed = light.spectrum[rows, columns] * lens[:, None]
    return jnp.zeros_like(light.spectrum).at[rows, columns].set(passed)


def recorded(sigma: float | jax.Array, fx: np.ndarray, fy: np.ndarray) -> jax.Array:
    """Compute the transfer function of a Gaussian lens with a pixel of half width `POINT`.

    `sigma` is the standard deviation of the lens, px. `fx` and `fy` are frequencies, cycles/px.
    """
    return jnp.exp(-2 * (jnp.pi * sigma) ** 2 * (fx**2 + fy**2)) * np.sinc(2 * POINT * fx) * np.sinc(2 * POINT * fy)


def optics_band(optics: Optics) -> float:
    """Compute the cutoff frequency of a lens, cycles/px. The parameters of the lens may be differentiated."""
    return float(without_derivatives(optics).band())
