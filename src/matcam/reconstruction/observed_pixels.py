"""Selection of the pixels of an image for a fit: all pixels about the highlight, and some elsewhere.

The window about the highlight determines the lens and a narrow lobe. Outside the window the image is smooth, and pixels at all
half angles determine tails and diffuse part. These pixels are drawn uniformly in the logarithm of the half angle, with
a fixed seed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.camera.lens_field import LensField
from matcam.reconstruction.picture_rule import WINDOW, window_about

SCATTERED = 768
"""Number of pixels of an image outside its window."""
LIMB = 3.0
"""Distance from the outline within which the integration rule of a single pixel or column does not resolve the outline, px."""
OUTSIDE = 1.5
"""Distance beyond the outline up to which a window is read, px. The background is not modelled."""
_SIMILAR_LEVELS = 15
"""Number of pixels of similar level. The median of their ratios of variance and level is used. Noise of 1 % to 30 % of the
level changes this median by at most 10 %. Unlike a mean, it follows the steps of the ratio between merged exposures.
"""
LIT = 0.1
"""Smallest cosine of the angle of incidence. Near the terminator the integration rule of a pixel or column is inaccurate."""


class ObservedPixels(NamedTuple):
    """Chosen pixels of one image.

    The pixels of the window, in the order of (v, u), precede the scattered pixels.

    Attributes:
        window: nodes and pixels about the highlight, as required by the model.
        column: column of the scattered pixels without the distortion of the lens, px, (SCATTERED,).
        row: row of the scattered pixels without the distortion of the lens, px, (SCATTERED,).
        values: values of all pixels, (WINDOW^2 + SCATTERED,); 0 if not used.
        std: standard deviation of the noise of the values, same shape; 1 if not used.
        clipped: True for pixels whose value is a lower bound, same shape.
        channel: index of the colour of each pixel, same shape.
        used: True for pixels that have a value and are fitted, same shape.
        positions: columns and rows of all pixels in the frame, px, (2, WINDOW^2 + SCATTERED).
    """

    window: Any
    column: np.ndarray
    row: np.ndarray
    values: np.ndarray
    std: np.ndarray
    clipped: np.ndarray
    channel: np.ndarray
    used: np.ndarray
    positions: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        """Columns and rows of the scattered pixels in the frame, px, (2, SCATTERED)."""
        return self.positions[:, self.positions.shape[1] - self.column.size :]

    def noise_at(self, level: np.ndarray) -> np.ndarray:
        """Compute the standard deviation of the noise of pixels whose expected values are known, (pixels,).

        `std` is partly derived from the value of each pixel, so it is too small where noise has lowered this value. With
        `std` as weight, a fit would be biased towards low values. Instead, the variance of a pixel is its expected value
        times the median ratio of variance to expected value among pixels of similar level.

        Args:
            level: expected values, (pixels,).
        """
        lit = np.flatnonzero(self.used & ~self.clipped & (level > self.std))
        order = lit[np.argsort(level[lit])]
        expected = self.std.copy()
        if lit.size >= _SIMILAR_LEVELS:
            gain = median_filter(self.std[order] ** 2 / level[order], _SIMILAR_LEVELS, mode="nearest")
            expected[order] = np.sqrt(gain * level[order])
        return expected


def chosen_pixels(
    picture: MergedPicture,
    ball: MirrorBall,
    lamp: np.ndarray,
    highlight: tuple[float, float],
    *,
    scale: float,
    plateau: float,
    seed: int,
    keep: ObservedPixels | None = None,
    field: LensField | None = None,
) -> ObservedPixels:
    """Choose the pixels of an image for the fit.

    Args:
        picture: values of the image and their noise.
        ball: the sphere, without the distortion of the lens.
        lamp: unit vector to the lamp, x right, y up, z to the camera, (3,).
        highlight: column and row of the highlight, px, without the distortion of the lens.
        scale: angle over which the lobe changes near its peak, rad.
        plateau: half the angular radius of the lamp, rad.
        seed: seed of the random selection of the scattered pixels.
        keep: earlier choice. If the new window has the same pixels, the earlier pixels are kept with new nodes. Default:
            None.
        field: distortion and blur of the lens over the field. Default: None, uniform.
    """
    window = window_about(
        ball,
        highlight,
        scale=scale,
        plateau=plateau,
        keep=None if keep is None else keep.window,
        field=field,
    )
    if (
        keep is not None
        and np.array_equal(keep.window.pixel_u, window.pixel_u)
        and np.array_equal(keep.window.pixel_v, window.pixel_v)
    ):
        far = keep.seen if field is None else np.array(field.true_position(*keep.seen))
        return keep._replace(window=window, column=far[0], row=far[1])
    first, second = np.meshgrid(window.pixel_u, window.pixel_v)
    near_column, near_row = (second, first) if window.turned else (first, second)
    far = _scattered(picture, ball, lamp, (near_column, near_row), seed, field)
    column, row = positions = np.concatenate([[near_column.ravel(), near_row.ravel()], far], axis=1)
    at_row, at_column = row.astype(int) - picture.origin[0], column.astype(int) - picture.origin[1]
    height, width = picture.values.shape
    inside = (at_row >= 0) & (at_row < height) & (at_column >= 0) & (at_column < width)
    at = np.where(inside, at_row, 0), np.where(inside, at_column, 0)
    values, std = picture.values[at], picture.std[at]
    if field is not None:
        column, row = field.true_position(column, row)
    away = np.hypot(column - ball.column, row - ball.row)
    used = inside & np.isfinite(values) & (std > 0) & (away < ball.radius + OUTSIDE)
    # the limb, with dirt and supports, is read only near the highlight
    # px from the highlight within which the limb is read, too
    used &= (away < ball.radius - LIMB) | (np.hypot(column - highlight[0], row - highlight[1]) < 9.0)
    return ObservedPixels(
        window=window,
        column=column[near_row.size :],
        row=row[near_row.size :],
        values=np.where(used, values, 0.0),
        std=np.where(used, std, 1.0),
        clipped=picture.clipped[at] & used,
        channel=picture.channel[at].astype(int),
        used=used,
        positions=positions,
    )


def _scattered(
    picture: MergedPicture,
    ball: MirrorBall,
    lamp: np.ndarray,
    near: tuple[np.ndarray, np.ndarray],
    seed: int,
    field: LensField | None,
) -> np.ndarray:
    """Draw pixels outside the window, uniformly in strata of the logarithm of the half angle theta_h.

    The result contains columns and rows in the frame, px, (2, SCATTERED). If there are fewer than `SCATTERED` pixels
    outside the window, the remaining positions are outside the frame.
    """
    height, width = picture.values.shape
    row, column = np.mgrid[0:height, 0:width]
    row, column = row.ravel() + picture.origin[0], column.ravel() + picture.origin[1]
    true_column, true_row = (column, row) if field is None else field.true_position(column, row)
    p_x, p_y = (true_column - ball.column) / ball.radius, (ball.row - true_row) / ball.radius
    depth2 = 1 - p_x**2 - p_y**2
    out = (np.abs(column - near[0].mean()) > WINDOW // 2) | (np.abs(row - near[1].mean()) > WINDOW // 2)
    keep = (np.hypot(p_x, p_y) < 1 - LIMB / ball.radius) & out
    depth = np.sqrt(np.where(keep, depth2, 1.0))
    keep &= p_x * lamp[0] + p_y * lamp[1] + depth * lamp[2] > LIT
    index = np.flatnonzero(keep)
    random = np.random.default_rng(seed)
    half = lamp + np.array([0.0, 0.0, 1.0])
    half /= max(np.linalg.norm(half), 1e-12)
    normal = np.stack([p_x[index], p_y[index], depth[index]])
    chord = np.linalg.norm(normal - half[:, None], axis=0)
    order = np.argsort(np.log(chord + 1e-9) + 1e-9 * random.random(index.size))
    edges = np.geomspace(max(chord.min(initial=1.0), 1e-4), max(chord.max(initial=1.0), 2e-4), 25)
    stratum = np.searchsorted(edges, chord[order])
    chosen: list[np.ndarray] = []
    left, strata = SCATTERED, np.unique(stratum)
    for count, one in enumerate(sorted(strata, key=lambda s: int((stratum == s).sum()))):
        members = order[stratum == one]
        share = min(left // (len(strata) - count), members.size)
        chosen.append(random.choice(members, share, replace=False))
        left -= share
    picked = index[np.concatenate(chosen)] if chosen else np.zeros(0, int)
    # positions without a pixel are far outside the frame, so that they are not used
    chosen_at = np.full((2, SCATTERED), -(10.0**6))
    chosen_at[:, : picked.size] = column[picked], row[picked]
    return chosen_at
