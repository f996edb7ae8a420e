"""A sphere in the light of one distant lamp, drawn straight from the entries of a table."""

from __future__ import annotations

import numpy as np

from matcam import srgb
from matcam.angles import cosines

LAMP = np.radians(50.0)
"""Angle between lamp and camera."""


def ball(values: np.ndarray, size: int, zoom: float = 1.0) -> np.ndarray:
    """Radiance of a sphere under a lamp 50 degrees from the camera, (size, size, channels), by the nearest entries of a
    table's values (theta_h, theta_d, phi_d, channel); missing is dark. zoom: about its highlight."""
    t = ((np.arange(size) + 0.5) / size * 2 - 1) / zoom
    half = LAMP / 2
    x, y = np.meshgrid(t + (np.sin(half) if zoom > 1 else 0), -t)
    inside = x**2 + y**2 < 1
    z = np.sqrt(np.where(inside, 1 - x**2 - y**2, 1))
    along, up = x * np.cos(half) - z * np.sin(half), x * np.sin(half) + z * np.cos(half)
    theta_h = np.arctan2(np.hypot(along, y), up)
    azimuth = np.arctan2(y, along)
    phi_d = np.mod(np.pi - azimuth, np.pi)
    i = np.clip((90 * np.sqrt(np.clip(theta_h, 0, None) / (np.pi / 2))).astype(int), 0, 89)
    j, k = int(np.degrees(half)), np.clip((phi_d / np.pi * 180).astype(int), 0, 179)
    cos_i = np.asarray(cosines(theta_h, half, np.pi - azimuth)[0])
    light = np.nan_to_num(values[i, j, k]) * np.maximum(cos_i, 0)[..., None]
    return np.where(inside[..., None], light, 0.0)


def shown(picture: np.ndarray, white: float) -> np.ndarray:
    """A radiance as a screen shows it (sRGB), in [0, 1]: `white` is white, and what is brighter stays white."""
    return srgb.encoded(np.clip(picture / max(white, 1e-300), 0, 1))


def body_white(corrected: np.ndarray) -> float:
    """The radiance to show as white so that a ball's body is well exposed: what all but the brightest hundredth stay under."""
    lit = corrected[corrected > 0]
    return float(np.quantile(lit, 0.99)) if lit.size else 0.0
