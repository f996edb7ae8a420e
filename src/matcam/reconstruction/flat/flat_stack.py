"""Images of a flat sample on one grid of texels, and their Fourier transforms.

The grid is that of the sample seen head-on, with one texel per pixel. A tilt about the vertical axis of the image makes
the image narrower by the cosine of the tilt. Every image is interpolated onto the grid by a windowed sinc, which
preserves frequencies up to nearly the Nyquist limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from matcam.acquisition.merged_picture import MergedPicture
from matcam.camera.camera import Camera
from matcam.camera.optics.optics import checked_isotropic
from matcam.core.errors import FitError
from matcam.core.jax import jnp

TAPER = 16
"""Width of the border, texels, over which an image is faded out before its transform."""
MARGIN = 24
"""Width of the border that is omitted from the maps, texels."""
_REACH = 16  # half width of the sinc, px
_STEP = 1e-3
_PASSED = 1e-3
"""MTF of a lens below which its derivative is neglected."""


class FlatPicture(NamedTuple):
    """Image with its acquisition parameters.

    Attributes:
        picture: merged image, grey.
        tilt: tilt of the sample about the vertical axis of the image, rad; positive if the normal tilts towards +x.
        towards: direction to the lamp, x right, y up, z to the camera, (3,).
        gain_std: standard deviation of ln of the relative irradiance of the image, no unit.
    """

    picture: MergedPicture
    tilt: float
    towards: np.ndarray
    gain_std: float


class FlatStack(NamedTuple):
    """Fourier transforms of images on the grid of texels.

    Attributes:
        mean: mean of each image, weighted with `taper`, (pictures,).
        mean_std: standard deviation of these means, (pictures,).
        spectrum: transform of each image less its mean, times `taper`, divided by the root of the sum of the squares of
            `taper`, (pictures, rows, columns).
        transfer: transfer function of the camera at each frequency, 0 beyond the band of the sensor; same shape.
        lens_slope: derivative of ln transfer with respect to ln of the lens width, same shape.
        noise: power of the noise in `spectrum`, same shape.
        frequency: frequencies along the rows and across them, cycles/px, which broadcast to (rows, columns).
        tilts: tilts of the sample, rad, (pictures,).
        camera: camera of the transfer function.
        taper: weight of each texel, (rows, columns).
    """

    mean: np.ndarray
    mean_std: np.ndarray
    spectrum: np.ndarray
    transfer: np.ndarray
    lens_slope: np.ndarray
    noise: np.ndarray
    frequency: tuple[np.ndarray, np.ndarray]
    tilts: np.ndarray
    camera: Camera
    taper: np.ndarray

    @property
    def radius(self) -> np.ndarray:
        """Magnitude of each frequency, cycles/px, (rows, columns)."""
        return np.hypot(*self.frequency)

    def sensor_transfer(self, k: int, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Compute the signed transfer function of the camera in image k.

        The frequencies along the rows and across them are those of the texel grid, cycles/px.
        """
        return _transfer(self.camera, along / np.cos(self.tilts[k]), across)


def flat_stack(pictures: Sequence[FlatPicture], camera: Camera) -> FlatStack:
    """Resample the images of a flat sample onto its texels.

    Args:
        pictures: images of equal shape.
        camera: lens and pixel.

    Returns:
        Transforms of the images, with their noise.

    Raises:
        ArgumentError: the blur of the lens depends on direction, colour or position.
        FitError: a side of the images is shorter than 96 px, four times the border that is omitted from the maps.
    """
    checked_isotropic(camera.optics, "a reconstruction")
    height, width = pictures[0].picture.values.shape
    if min(height, width) < 4 * MARGIN:
        raise FitError(
            f"images of {height} x {width} px are too small: a flat sample needs at least {4 * MARGIN} px in each direction"
        )
    taper = _taper(height)[:, None] * _taper(width)
    area = (taper**2).sum()
    across, along = np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)[None, :]
    stack = []
    for one in pictures:
        values = _without_holes(one.picture.values.astype(float))
        variance = np.nanmean(np.where(np.isfinite(one.picture.values), one.picture.std.astype(float) ** 2, np.nan))
        cosine = np.cos(one.tilt)
        middle = float((values * taper).sum() / taper.sum())
        rectified = middle + (values - middle) @ _interpolation(width, cosine).T
        mean = float((rectified * taper).sum() / taper.sum())
        spectrum = np.fft.fft2((rectified - mean) * taper) / np.sqrt(area)
        sensor = _transfer(camera, along / cosine, across)
        # the windowed sinc is transparent up to 0.44 cycles/px on the sensor
        inside = (np.abs(along / cosine) < 0.44) & (np.abs(across) < 0.5)
        transfer = np.where(inside, sensor, 0.0)
        # white noise of the sensor; the tilt raises its density
        noise = np.full((height, width), variance / cosine)
        slope = np.where(inside, _lens_slope(camera, np.hypot(along / cosine, across)), 0.0)
        stack.append((mean, np.sqrt(variance * area) / taper.sum(), spectrum, transfer, slope, noise))
    mean_of, mean_std, spectra, transfers, slopes, noises = map(np.array, zip(*stack, strict=True))
    tilts = np.array([one.tilt for one in pictures])
    return FlatStack(mean_of, mean_std, spectra, transfers, slopes, noises, (along, across), tilts, camera, taper)


def _transfer(camera: Camera, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    return np.asarray(camera.transfer(jnp.asarray(along), jnp.asarray(across)))


def _lens_slope(camera: Camera, frequency: np.ndarray) -> np.ndarray:
    """Compute the derivative of ln MTF with respect to ln of the lens width, by a change of scale of the frequencies."""
    here, beyond = (np.asarray(camera.optics.mtf(frequency * factor)) for factor in (1 - _STEP, 1 + _STEP))
    passed = (here > _PASSED) & (beyond > _PASSED)
    return np.where(passed, np.log(np.where(passed, beyond, 1.0) / np.where(passed, here, 1.0)) / (2 * _STEP), 0.0)


def _taper(count: int) -> np.ndarray:
    rise = np.sin(np.pi / 2 * (np.arange(TAPER) + 0.5) / TAPER) ** 2
    return np.concatenate([rise, np.ones(count - 2 * TAPER), rise[::-1]])


def _interpolation(count: int, cosine: float) -> np.ndarray:
    if cosine == 1:
        return np.eye(count)
    position = np.arange(count) - (count - 1) / 2
    offset = position[:, None] * cosine - position
    window = np.where(np.abs(offset) < _REACH, np.cos(np.pi / 2 * np.clip(offset / _REACH, -1, 1)) ** 2, 0.0)
    weights = np.sinc(offset) * window
    return weights / weights.sum(axis=1, keepdims=True)


def _without_holes(values: np.ndarray) -> np.ndarray:
    holes = ~np.isfinite(values)
    if not holes.any():
        return values
    filled = np.where(holes, 0.0, values)
    total, count = (ndimage.convolve(one, np.ones((5, 5)), mode="constant") for one in (filled, (~holes).astype(float)))
    rest = float(values[~holes].mean()) if (~holes).any() else 0.0
    return np.where(holes, np.where(count > 0, total / np.maximum(count, 1), rest), values)
