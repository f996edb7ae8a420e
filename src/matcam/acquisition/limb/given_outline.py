"""Outline of a sphere without outline frames: a circle in capture.toml, or a mask."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from matcam.acquisition.limb.limb_edges import LimbSectors
from matcam.acquisition.outline import Outline, Sighting
from matcam.core.errors import FitError
from matcam.files.capture import Capture
from matcam.files.photographs import open_photograph

_STATED_STD = 0.5
"""Standard deviation of a circle that is specified without one, px: such a circle is usually read from a screen."""
_FEWEST = 100
"""Smallest number of pixels of a sphere in a mask."""
_ROUND = 0.02
"""Relative difference of the radii by area and by second moments above which a mask is not a disc: 1 % for an ellipse
whose axes differ by 22 %, 2.3 % for a square.
"""


def given_outline(
    capture: Capture, sighting: Sighting, sigma: float, shape: tuple[int, int] | None = None
) -> Outline | None:
    """Determine the outline of a sphere from a specified circle or, without a circle, from a mask.

    The result is None if neither is specified.

    Args:
        capture: capture of a sphere.
        sighting: geometry of the camera.
        sigma: standard deviation of the lens's blur, px.
        shape: width and height of the frames, px. Default: None, the size of the mask is not checked.

    Raises:
        FileFormatError: the mask cannot be read.
        FitError: the mask shows no disc, or its size is not that of the frames.
    """
    if capture.circle is not None:
        centre, radius = capture.circle
        return stated_circle(centre, radius.value, radius.std, sighting, sigma)
    if capture.mask is not None:
        return mask_outline(capture.mask, capture.settings["outline"]["mask_std_px"], sighting, sigma, shape)
    return None


def stated_circle(centre: tuple[float, float], radius: float, std: float, sighting: Sighting, sigma: float) -> Outline:
    """Convert a specified circle to an outline.

    Args:
        centre: column and row, px.
        radius: radius of the limb, px.
        std: standard deviation of radius, column and row each, px; 0: unknown, 0.5 px is used.
        sighting: geometry of the camera.
        sigma: standard deviation of the lens's blur, px.
    """
    return _outline(centre[1], centre[0], radius, np.full(3, std or _STATED_STD), sighting, sigma)


def mask_outline(
    path: Path, std: float, sighting: Sighting, sigma: float, shape: tuple[int, int] | None = None
) -> Outline:
    """Measure the outline of the disc in a mask.

    The area determines the radius, and the first moments the centre.

    Args:
        path: image of two values; the value at the border marks the pixels outside the sphere.
        std: standard deviation of the radius, px. An offset of the edge of the mask changes the radius but not the centre,
            so the standard deviation of the centre is assumed to be half as large.
        sighting: geometry of the camera.
        sigma: standard deviation of the lens's blur, px.
        shape: width and height of the frames, px. Default: None, not checked.

    Raises:
        FileFormatError: the image cannot be read.
        FitError: the image shows no disc, or its size is not that of the frames.
    """
    values = np.asarray(open_photograph(path).values, dtype=float)
    values = values.max(axis=2) if values.ndim == 3 else values
    if shape is not None and values.shape != shape[::-1]:
        raise FitError(
            f"{path}: the mask has {values.shape[1]} x {values.shape[0]} px, but the frames have {shape[0]} x "
            f"{shape[1]} px: give a mask of a whole frame"
        )
    bright = values > (values.min() + values.max()) / 2
    border = np.concatenate([bright[0], bright[-1], bright[:, 0], bright[:, -1]])
    sphere = bright if border.mean() < 0.5 else ~bright
    area = int(sphere.sum())
    if area < _FEWEST or (border != border[0]).any():
        raise FitError(
            f"{path}: the mask shows no disc inside the frame: give an image with one value on the sphere and another around it"
        )
    rows, columns = np.nonzero(sphere)
    row, column, radius = float(rows.mean()), float(columns.mean()), float(np.sqrt(area / np.pi))
    by_moments = float(np.sqrt(2 * (rows.var() + columns.var())))  # the variance of a disc along a line is radius^2 / 4
    if abs(by_moments / radius - 1) > _ROUND:
        raise FitError(
            f"{path}: the shape in the mask is not a disc: the radius is {radius:.1f} px by area, but {by_moments:.1f} px by "
            "second moments: exclude the stand from the mask"
        )
    return _outline(row, column, radius, np.array([std / 2, std / 2, std]), sighting, sigma)


def _outline(row: float, column: float, radius: float, std: np.ndarray, sighting: Sighting, sigma: float) -> Outline:
    none = LimbSectors(*(np.zeros(0) for _ in LimbSectors._fields))
    covariance = np.diag(std**2)
    return Outline(
        row=row,
        column=column,
        radius=radius,
        covariance=covariance,
        sigma=sigma,
        sigma_std=sigma,
        sighting=sighting,
        sectors=none,
        used=np.zeros(0, bool),
        scatter=0.0,
        noise=covariance,
    )
