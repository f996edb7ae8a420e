"""Images and thumbnails of spheres, computed from a table, and figures of rendered or simulated images."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import imagecodecs
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from matcam.core.grid import cosines, merl_grid
from matcam.core.io import replacing
from matcam.figures.style import GREY, drawing
from matcam.files import tone_curve as srgb

LAMP = np.radians(50.0)
"""Angle between lamp and camera, rad."""


def table_sphere(
    values: np.ndarray, size: int, zoom: float = 1.0, lamp: float = LAMP, azimuth: float = 0.0
) -> np.ndarray:
    """Compute the radiance of a sphere under a distant lamp of irradiance 1.

    The result is in 1/sr and has the shape (size, size, channel).

    Args:
        values: values of a table (theta_h, theta_d, phi_d, channel), 1/sr. The cell that contains a direction is used, and
            missing entries are dark.
        size: height and width, px.
        zoom: magnification about the highlight (no unit). Default: 1, the whole sphere.
        lamp: angle between lamp and camera, rad. Default: 50 degrees.
        azimuth: azimuth of the lamp about the optical axis, from right towards up, rad. Default: 0.
    """
    t = ((np.arange(size) + 0.5) / size * 2 - 1) / zoom
    half = lamp / 2
    x, y = np.meshgrid(t + (np.sin(half) if zoom > 1 else 0), -t)
    x, y = x * np.cos(azimuth) + y * np.sin(azimuth), y * np.cos(azimuth) - x * np.sin(azimuth)
    inside = x**2 + y**2 < 1
    z = np.sqrt(np.where(inside, 1 - x**2 - y**2, 1))
    along, up = x * np.cos(half) - z * np.sin(half), x * np.sin(half) + z * np.cos(half)
    theta_h = np.arctan2(np.hypot(along, y), up)
    azimuth = np.arctan2(y, along)
    phi_d = np.mod(np.pi - azimuth, np.pi)
    cells = merl_grid("centre").index(theta_h=np.clip(theta_h, 0, np.pi / 2), theta_d=half, phi_d=phi_d)
    cos_i = np.asarray(cosines(theta_h, half, np.pi - azimuth)[0])
    light = np.nan_to_num(values[cells]) * np.maximum(cos_i, 0)[..., None]
    return np.where(inside[..., None], light, 0.0)


def whole_sphere(values: np.ndarray, size: int) -> np.ndarray:
    """Compute the image of `table_sphere`, with an average over the pixel that contains the highlight.

    The average is required, because a highlight may be much narrower than a pixel and lie between pixel centres.

    Args:
        values: values of a table (theta_h, theta_d, phi_d, channel), 1/sr.
        size: height and width, px.
    """
    picture = table_sphere(values, size)
    row, column = size // 2, int((np.sin(LAMP / 2) + 1) / 2 * size)
    # the average over the pixel has 32 x 32 points
    picture[row, column] = table_sphere(values, 32, zoom=size).mean(axis=(0, 1))
    return picture


def encoded_for_screen(picture: np.ndarray, white: float) -> np.ndarray:
    """Encode a radiance for a screen (sRGB), in [0, 1].

    `white` is the radiance that is displayed as white. Larger values are clipped.
    """
    return srgb.encoded(np.clip(picture / max(white, 1e-300), 0, 1))


def body_white(corrected: np.ndarray) -> float:
    """Compute the radiance that is displayed as white for a well exposed sphere.

    This is the 99th percentile of the lit pixels, or 0 if no pixel is lit.
    """
    lit = corrected[corrected > 0]
    return float(np.quantile(lit, 0.99)) if lit.size else 0.0


_BODY = 0.12
"""Grey level of radiances below the scale, so that a sphere without diffuse light is visible."""
_GROUND = 0.45
"""Grey level of the background of a sphere on a logarithmic scale, so that a black body has a visible outline."""


def logarithmic_range(*pictures: np.ndarray) -> tuple[float, float]:
    """Compute the radiances of black and white for a common logarithmic scale.

    Args:
        pictures: radiances (height, width, channel), any number of them.

    Returns:
        Black and white. White is the largest value. Black is the 5 % quantile of the positive values, limited to the range
        from 2 to 8 decades below white. If negative noise was set to 0, black is the level of the noise.
    """
    lit = np.concatenate([picture[picture > 0] for picture in pictures])
    if not lit.size:
        return 1e-2, 1.0
    white = float(lit.max())
    # half of the noise is negative, so there are as many positive values of noise as zeros in pixels with another colour
    dark = sum(int((picture[(picture > 0).any(axis=-1)] <= 0).sum()) for picture in pictures)
    decades = np.clip(np.log10(white / np.quantile(lit, np.clip(dark / lit.size, 0.05, 0.98))), 2.0, 8.0)
    return white * 10.0 ** -float(decades), white


def logarithmic(picture: np.ndarray, black: float, white: float) -> np.ndarray:
    """Encode a radiance on a logarithmic scale, in [0, 1].

    The highlight of a mirror is 10^6 times brighter than the other parts of the sphere. On a linear scale the image
    would be a dot on black. The scale applies to the brightest channel. The ratios of the channels are encoded as in
    sRGB. The background of the sphere is grey.

    Args:
        picture: radiance from `table_sphere`, (size, size, channel).
        black: radiance at the lower end of the scale.
        white: radiance at the upper end of the scale.
    """
    largest = picture.max(axis=-1, keepdims=True)
    level = np.log(np.maximum(largest, black) / black) / np.log(white / black)
    colour = srgb.encoded(np.clip(picture, 0, None) / np.where(largest > 0, largest, 1.0))
    shown = np.where(largest > 0, _BODY + (1 - _BODY) * level * colour, _BODY)
    t = (np.arange(len(picture)) + 0.5) / len(picture) * 2 - 1
    shown[t[:, None] ** 2 + t**2 >= 1] = _GROUND
    return np.clip(shown, 0, 1)


SIZE = 64
"""Height of a thumbnail and width of each of its halves, px."""
_INSET = 26
"""Side of the magnified highlight in a thumbnail, px, which fits into the unlit side of the sphere."""


def highlight_zoom(*tables: np.ndarray) -> float | None:
    """Choose the largest magnification at which all highlights are complete.

    The magnifications are 200, 60, 20 and 6. A highlight is complete if it decreases to 30 % of its peak at the border
    of the image. The result is None if no magnification shows all highlights completely.

    Args:
        tables: values (theta_h, theta_d, phi_d, channel), 1/sr.
    """
    # from the finest cells of a table, 2e-4 rad, to a lobe of about 10 degrees
    for zoom in (200.0, 60.0, 20.0, 6.0):
        pictures = [table_sphere(values, _INSET, zoom).max(axis=-1) for values in tables]
        border = np.ones((_INSET, _INSET), bool)
        border[1:-1, 1:-1] = False
        # an image contains a highlight completely if it decreases to 30 % of its peak at the border
        if all(one[border].max() < 0.3 * one.max() for one in pictures):
            return zoom
    return None


def write_thumbnail(path: str | Path, raw: xr.DataArray, corrected: xr.DataArray, *, force: bool = False) -> None:
    """Write a PNG of a sphere before and after the correction.

    The image has 128 x 64 px. The sphere of the recorded table is on the left, and that of the corrected table on the
    right. Both have the same logarithmic scale. Each half shows the magnified highlight in its lower left corner, on a
    linear scale. This inset is omitted if no magnification shows the highlights completely.
    """
    tables = raw.values, corrected.values
    spheres = [whole_sphere(table, SIZE) for table in tables]
    black, brightest = logarithmic_range(*spheres)
    halves = [logarithmic(one, black, brightest) for one in spheres]
    if zoom := highlight_zoom(*tables):
        closer = [table_sphere(table, _INSET, zoom) for table in tables]
        white = max(float(one.max()) for one in closer)
        for half, inset in zip(halves, closer, strict=True):
            half[-_INSET - 1 :, : _INSET + 1] = _GROUND
            half[-_INSET:, :_INSET] = encoded_for_screen(inset, white)
    both = np.concatenate(halves, axis=1)
    if both.shape[-1] != 3:
        both = np.repeat(both[..., :1], 3, axis=-1)
    encoded = imagecodecs.png_encode(np.ascontiguousarray((both * 255 + 0.5).astype(np.uint8)))
    with replacing(path, force=force) as temporary:
        temporary.write_bytes(encoded)


def spheres_figure(pictures: Mapping[str, np.ndarray], light: str, exposure: float = 1.0) -> Figure:
    """Draw rendered spheres beside each other at one exposure, encoded as sRGB.

    Args:
        pictures: linear radiances (size, size, 3) by their titles.
        light: description of the light source.
        exposure: factor before display: radiance 1 / exposure is white. Default: 1.
    """
    with drawing(3.6 * len(pictures), 4.15) as figure:
        for axes, (title, picture) in zip(
            figure.subplots(1, len(pictures), squeeze=False)[0], pictures.items(), strict=True
        ):
            axes.imshow(srgb.encoded(np.clip(picture * exposure, 0, 1)), interpolation="nearest")
            axes.set_title(title, parse_math=False)
            axes.set_axis_off()
        figure.supxlabel(f"{light}; white: radiance {1 / exposure:.3g}", fontsize=8.5, color=GREY)
    return figure


def picture_figure(data: xr.DataArray, title: str) -> Figure:
    """Draw the image of a rig beside the profile through the optical axis.

    The left panel shows the image encoded for display, with the 99.5th percentile of lit pixels as white and the 0.5th
    percentile of all pixels as black. The right panel shows the row through the optical axis on a logarithmic scale, so that
    small values are visible.

    Args:
        data: image (row, column[, channel]), from `picture`.
        title: title.
    """
    values = np.nan_to_num(data.values)
    lit = values[values > 0]
    white = np.percentile(lit, 99.5) if lit.size else 1.0
    black = np.percentile(values, 0.5)  # the black level of a raw image
    display = np.clip((values - black) / max(white - black, 1e-300), 0, 1) ** (1 / 2.2)
    x, y = data["x"].values, data["y"].values
    with drawing(8.6, 4.0) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
        left.grid(False)
        edges = (x[0] - 0.5, x[-1] + 0.5, y[-1] - 0.5, y[0] + 0.5)
        grey = display[..., 0] if display.ndim == 3 and display.shape[2] == 1 else display
        left.imshow(grey, extent=edges, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        left.set_xlabel("x, towards the lamp [px]")
        left.set_ylabel("y [px]")
        row = values[len(y) // 2]
        row = row.mean(axis=-1) if row.ndim == 2 else row
        above = row > 0
        right.semilogy(x[above], row[above])
        right.set_xlabel("x [px]")
        what = data.attrs["quantity"].replace("digital", "raw value")
        right.set_ylabel(f"{what} in the row through the axis [{data.attrs['units']}]")
        figure.suptitle(title, x=0.01, ha="left", fontsize=9.5, fontweight="bold")
    return figure
