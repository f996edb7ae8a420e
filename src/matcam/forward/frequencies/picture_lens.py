"""Filter of an image: one lens, one lens per colour, or several lenses between which the kernel is interpolated.

A lens that varies over the field is sampled at some positions (`position_shares.py`). The radiance is divided into one
share for each of these positions, by smooth weights that depend on the position of the surface element. Each share is
filtered by the lens at its position, and the filtered shares are added. Each surface element is thus blurred by the
kernel at its position.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.camera.camera import Camera
from matcam.camera.optics.colour import ColourOptics
from matcam.camera.optics.optics import Optics
from matcam.camera.optics.seidel import SeidelOptics
from matcam.camera.optics.wavefront import overlap, overlap_order, phase_of
from matcam.camera.optics.zernike import check_phase
from matcam.camera.pixel import PixelResponse
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.core.workspace import default_workspace
from matcam.forward.frequencies.band_limited import EXACT, BandLimit, band_limit, concrete, optics_band, sampling_of
from matcam.forward.frequencies.light_grid import FINE_ENOUGH
from matcam.forward.frequencies.position_shares import PositionShares

_DEGREES = (3, 6, 9, 12, 16)
"""Available degrees of the weights as polynomials of the position. The lowest sufficient degree is used."""
_ENOUGH = 1e-4
"""Error of an interpolated transfer function below which no higher degree is used."""
_LEFT_OUT = 1e-3
"""Largest norm of the neglected part of the 248 complex values of a transfer function."""
_TOLERABLE = 3e-4
"""Largest acceptable error of a transfer function of an image."""
_RINGS, _ROUND = (0.35, 0.65, 0.85, 1.0), 7
"""Distances from the centre, in radii, and number of directions, of the positions at which the error is determined."""
_FITTED = (0.05, 0.15, 0.27, 0.39, 0.51, 0.63, 0.75, 0.87), 31
"""Frequencies, as shares of the cutoff, and number of directions by which positions are chosen."""
_CHECKED = (0.1, 0.33, 0.57, 0.81), 13
"""Frequencies, as shares of the cutoff, and number of directions for which the error is determined."""


class ColourLens(NamedTuple):
    """Filter of one colour.

    Attributes:
        lenses: one lens for each share of the radiance.
        shift: shift of the image of this colour, (right, up), px.
    """

    lenses: tuple[Optics, ...]
    shift: jax.Array


class PictureLens(NamedTuple):
    """Filter of a fine record.

    Attributes:
        pixel: response of a pixel.
        limit: sampling of the record.
        colours: one filter for all channels, or one filter for each channel.
        shares: weights of the shares of the radiance; None: the radiance is not divided.
        error: largest error of a transfer function, no unit.
    """

    pixel: PixelResponse
    limit: BandLimit
    colours: tuple[ColourLens, ...]
    shares: PositionShares | None
    error: float

    @property
    def highest(self) -> float:
        """Largest cutoff frequency of the lenses, cycles/px."""
        return max(optics_band(lens) for colour in self.colours for lens in colour.lenses)

    def channels(self, material: int) -> int:
        """Compute the number of channels of an image.

        `material` is the number of channels of the material. An ArgumentError is raised if the material does not match
        the colours of the lens.
        """
        if len(self.colours) > 1 and material not in (1, len(self.colours)):
            raise ArgumentError(
                f"the lens has 3 colours, but the material has {material} channels: give a material with 1 or 3 channels"
            )
        return max(material, len(self.colours))


def picture_lens(camera: Camera, radius: float, error: float | None = None) -> PictureLens | None:
    """Build the filter of images of a camera.

    The result is None for an isotropic lens whose parameters are traced, or that a sum of Gaussians describes at least as
    well as the filter.

    Args:
        camera: the camera.
        radius: radius of the limb of the sample, px.
        error: target for the largest error of a transfer function. Default: None, `EXACT`.

    Raises:
        ArgumentError: the lens is not isotropic, and passes frequencies that are too high, varies too much over the sample
            or has traced parameters.
    """
    optics = camera.optics
    if optics.isotropic:
        limit = band_limit(camera, error or EXACT)
        return (
            None if limit is None else PictureLens(camera.pixel, limit, (colour_lens(optics, None),), None, limit.error)
        )
    if not concrete(camera):
        raise ArgumentError(
            f"{type(optics).__name__} must have concrete parameters: call this function outside jax.jit and jax.vmap"
        )
    if isinstance(optics, ColourOptics):
        parts: tuple[Optics, ...] = optics.lenses
        shifts: tuple[jax.Array, ...] = optics.shifts
    else:
        parts, shifts = (optics,), (jnp.zeros(2),)
    shares, between = shares_for(parts, radius)
    colours = tuple(colour_lens(one, shares, shift) for one, shift in zip(parts, shifts, strict=True))
    limit = sampling_of([lens for colour in colours for lens in colour.lenses], camera.pixel, error or EXACT)
    if limit.error > _TOLERABLE:
        raise ArgumentError(
            f"the {type(optics).__name__} passes frequencies up to {optics.band():.2g} cycles/px, which are too high for the "
            f"filter of an image (error {limit.error:.1g}): give a larger f-number, or wider Gaussians"
        )
    lens = PictureLens(camera.pixel, limit, colours, shares, limit.error + between)
    if shares is None:
        return lens
    # weights mix neighbouring frequencies, so the sampling must resolve all frequencies of the lens
    finer = max(limit.per_px, int(np.ceil(FINE_ENOUGH * lens.highest)))
    return lens._replace(limit=limit._replace(per_px=finer))


def varies_over_field(optics: Optics) -> bool:
    parts = optics.lenses if isinstance(optics, ColourOptics) else (optics,)
    return any(isinstance(one, SeidelOptics) for one in parts)


def colour_lens(optics: Optics, shares: PositionShares | None, shift: jax.Array | None = None) -> ColourLens:
    """Build the filter of one colour: one lens, or one lens for each share."""
    shift = jnp.zeros(2) if shift is None else shift
    if shares is None:
        return ColourLens((optics,), shift)
    if isinstance(optics, SeidelOptics):
        return ColourLens(tuple(optics.at(*position) for position in shares.positions), shift)
    return ColourLens((optics,) * len(shares.positions), shift)


def shares_for(optics: tuple[Optics, ...], radius: float) -> tuple[PositionShares | None, float]:
    """Choose the smallest number of shares that interpolates the lenses accurately.

    The results are the shares (None if no lens varies over the field) and the largest error of a transfer function, no unit.
    """
    varying = [jax.lax.stop_gradient(one) for one in optics if isinstance(one, SeidelOptics)]
    if not varying:
        return None, 0.0
    key = radius, *(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(varying))
    return default_workspace().remember("shares of a lens", key, lambda: _shares_of(varying, radius))


def _shares_of(varying: list[SeidelOptics], radius: float) -> tuple[PositionShares, float]:
    turn = 2 * np.pi * (np.arange(_ROUND) + 0.2) / _ROUND
    positions = radius * np.concatenate([ring * np.stack([np.cos(turn), np.sin(turn)], -1) for ring in _RINGS])
    true = _sampled(varying, positions, _CHECKED)

    def fitted(positions: np.ndarray) -> np.ndarray:
        return _sampled(varying, positions, _FITTED)

    error = np.inf
    for degree in _DEGREES:
        shares = PositionShares.of(degree, radius, fitted, _LEFT_OUT)
        error = float(np.abs(shares.at(positions) @ _sampled(varying, shares.positions, _CHECKED) - true).max())
        if error < _ENOUGH:
            break
    if error > _TOLERABLE:
        raise ArgumentError(
            f"the lens varies too much over a sample of {radius:g} px radius: interpolation of degree "
            f"{_DEGREES[-1]} has an error of {error:.1g} in the transfer function; increase the parameter `unit` of "
            "SeidelOptics, or decrease its coefficients"
        )
    return shares, error


def _sampled(
    lenses: list[SeidelOptics], positions: np.ndarray, frequencies: tuple[tuple[float, ...], int]
) -> np.ndarray:
    """Evaluate transfer functions, (positions, lenses times frequencies).

    `positions` are on the sensor, px, (positions, 2). `frequencies` contains frequencies as shares of the cutoff, and
    the number of directions.
    """
    angle = 2 * np.pi * (np.arange(frequencies[1]) + 0.3) / frequencies[1]
    share = np.array(frequencies[0])[:, None]
    end, direction = (np.broadcast_to(a, (share.size, angle.size)).ravel() for a in (np.arccos(share), angle))
    parts = []
    for lens in lenses:
        terms = np.asarray(lens.terms_at(positions[:, 0], positions[:, 1]))
        for one in terms:
            check_phase(one)
        order = overlap_order(max(map(phase_of, terms)))
        parts.append(np.stack([np.asarray(overlap(one, end, direction, order)) for one in terms]))
    return np.concatenate(parts, axis=1)
