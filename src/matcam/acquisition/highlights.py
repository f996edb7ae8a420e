"""Highlight in an image of a sphere, and the direction of its lamp.

The highlight is fitted on the sphere by a lobe about one normal, on a uniform background. The lobe has separate widths in
the plane of incidence and across it, is foreshortened, and is blurred by the lens. Foreshortening shifts the highlight
towards the limb. The model includes this shift, so the fitted position is the mirror point. The value of a clipped pixel is
treated as a lower bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.optimize import least_squares

from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mirror_ball import MirrorBall, unit
from matcam.core.errors import FitError
from matcam.core.remark import Remark, gathered

_BROADEST = 0.12  # largest area of a highlight, as a share of the disc
_PIXELS = 3000  # largest number of pixels in a fit, which bounds its time


@dataclass(frozen=True)
class Highlight:
    """Position of the mirror image of a lamp.

    Attributes:
        row: row of the mirror point in the frame, px.
        column: column of the mirror point in the frame, px.
        covariance: covariance of row and column, px^2 (2, 2).
        normal: normal of the sphere at the mirror point, unit vector (3,).
        remarks: warnings and limitations.
    """

    row: float
    column: float
    covariance: np.ndarray
    normal: np.ndarray
    remarks: tuple[Remark, ...] = ()


def find_highlight(picture: MergedPicture, ball: MirrorBall, *, blur: float = 0.6) -> Highlight:
    """Find the highlight of the lamp in one image.

    Args:
        picture: image of one lamp.
        ball: the sphere in this frame.
        blur: standard deviation of lens and pixel together, px. Default: 0.6.

    Returns:
        The highlight. If the lobe cannot be fitted, its position is the centroid of the bright spot.

    Raises:
        FitError: the image contains too few pixels of the sphere, more than 30 % of the sphere is clipped, there is no
            highlight, or the brightest spot is too broad.
    """
    shape = picture.values.shape
    rows, columns = np.indices(shape) + np.array(picture.origin)[:, None, None]
    # pixels at the limb are mixed with the background
    on = np.hypot(rows - ball.row, columns - ball.column) < 0.995 * ball.radius
    main = np.bincount(picture.channel[on].ravel(), minlength=1).argmax() if on.any() else 0
    one = on & np.isfinite(picture.values) & (picture.channel == main)
    if one.sum() < 30:
        raise FitError(
            f"{picture.name}: the disc of the sphere contains {one.sum()} values, but at least 30 are required: check the "
            "centre and the radius of the outline"
        )
    lost = float(np.mean(picture.clipped[on]))
    # largest clipped share of the disc
    if lost > 0.3:
        raise FitError(f"{picture.name}: {lost:.0%} of the sphere is clipped; add a shorter exposure")
    spots, background = _spots(picture, one, on)
    if not spots:
        raise FitError(
            f"{picture.name}: the sphere shows no highlight; check that the lamp is on, and not behind the sphere"
        )
    first = spots[0]
    area = first[3] / np.count_nonzero(on)
    if area > _BROADEST:
        raise FitError(
            f"{picture.name}: the brightest spot covers {area:.0%} of the sphere, but a highlight covers at most "
            f"{_BROADEST:.0%}; specify the lamp's direction in frames.csv"
        )
    remarks = []
    others = spots[1:]
    if others:
        at = "; ".join(
            f"row {r + picture.origin[0]:.0f}, column {c + picture.origin[1]:.0f} ({light / first[2]:.0%})"
            for r, c, light, _ in others[:3]
        )
        remarks.append(
            Remark(
                "several-highlights",
                f"{picture.name}: there are bright spots besides the highlight, at {at}: remove their cause",
            )
        )
    near = (rows - picture.origin[0] - first[0]) ** 2 + (columns - picture.origin[1] - first[1]) ** 2
    near = near < max(5.0, 3.0 * np.sqrt(first[3] / np.pi) + 2) ** 2
    for r, c, _, size in others:
        near &= (rows - picture.origin[0] - r) ** 2 + (columns - picture.origin[1] - c) ** 2 > 2 * size / np.pi + 4
    near &= on & np.isfinite(picture.values)
    clipped = int(np.count_nonzero(picture.clipped & near))
    chosen = np.flatnonzero(near)
    if len(chosen) > _PIXELS:
        chosen = np.random.default_rng(0).choice(chosen, _PIXELS, replace=False)
    start = first[0] + picture.origin[0], first[1] + picture.origin[1]
    try:
        position, covariance = _lobe_position(picture, ball, blur, chosen, np.array(start), first[3], background)
    except FitError as error:
        position, covariance = np.array(start), np.eye(2) * (0.5 + np.sqrt(first[3] / np.pi) / 2) ** 2
        remarks.append(Remark("highlight-by-centroid", str(error)))
    if clipped:
        pixels = "pixel of the highlight is" if clipped == 1 else "pixels of the highlight are"
        text = f"{picture.name}: {clipped} {pixels} clipped: add a shorter exposure"
        remarks.append(Remark("clipped", text))
    normal = ball.normals(*position)
    row, column = map(float, position)
    return Highlight(row, column, covariance, normal, tuple(remarks))


def _spots(
    picture: MergedPicture, one: np.ndarray, on: np.ndarray
) -> tuple[list[tuple[float, float, float, int]], float]:
    """Find the bright spots, the brightest first, and the background level.

    Each spot consists of row and column, px, its light above the background, and its number of pixels.
    """
    light = np.where(one, picture.values, -np.inf)
    background = float(np.median(picture.values[one]))
    noise = float(np.median(picture.std[one]))
    if not np.all(one[on]):  # mosaic or missing pixels
        light = ndimage.maximum_filter(light, 3)
    light = np.where(on, light, -np.inf)
    peak = float(light.max())
    # smallest height of a highlight, relative to the median of the sphere
    if peak - background < max(10 * noise, 0.3 * abs(background)):
        return [], background
    # share of the height of the highlight above which a pixel is part of the highlight
    labels, count = ndimage.label(light > background + 0.3 * (peak - background), np.ones((3, 3)))
    index = np.arange(1, count + 1)
    above = np.where(labels > 0, light - background, 0.0)
    total = np.atleast_1d(ndimage.sum(above, labels, index))
    size = np.atleast_1d(ndimage.sum(labels > 0, labels, index)).astype(int)
    positions = np.array(ndimage.center_of_mass(above, labels, index)).reshape(-1, 2)
    # weaker spots are not reported
    order = [k for k in np.argsort(total)[::-1] if total[k] > 0.05 * total.max()]
    return [(float(positions[k, 0]), float(positions[k, 1]), float(total[k]), int(size[k])) for k in order], background


def _lobe_position(
    picture: MergedPicture,
    ball: MirrorBall,
    blur: float,
    chosen: np.ndarray,
    start: np.ndarray,
    size: int,
    background: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Fit row and column of the mirror point, px (2,), and their covariance, px^2 (2, 2).

    A FitError is raised if the fitted position is beside the sphere or far from the bright spot.

    Args:
        picture: image of one lamp.
        ball: the sphere in this frame.
        blur: standard deviation of lens and pixel together, px.
        chosen: indices of the fitted pixels in the flattened image.
        start: row and column of the centroid of the bright spot, px (2,).
        size: number of pixels of the bright spot.
        background: light of the sphere beside the highlight, in the unit of the image.
    """
    values, std, clipped = (array.ravel()[chosen] for array in (picture.values, picture.std, picture.clipped))
    channels, channel = np.unique(picture.channel.ravel()[chosen], return_inverse=True)
    rows, columns = np.unravel_index(chosen, picture.values.shape)
    normals = ball.normals(rows + picture.origin[0], columns + picture.origin[1])
    cosines = np.maximum((ball.views(normals) * normals).sum(-1), 1e-3)
    # a highlight may differ from the fitted lobe by 5 %
    error = np.hypot(std, 0.05 * np.maximum(values, background))
    background = max(abs(background), float(np.median(std)))

    def model(p: np.ndarray) -> np.ndarray:
        """Evaluate the light of each pixel, in the unit of the image.

        `p` contains the shift (row, column) from the start position, px, the logarithms of the two widths in rad, and the
        logarithm of the exponent. For each channel, the logarithm of the height and the relative background follow.
        """
        centre = ball.normals(*(start + p[:2]))
        if not np.isfinite(centre).all():
            return np.full(len(values), 1e9)
        view = ball.views(centre)
        cosine = max(float(view @ centre), 1e-3)
        across = np.cross(view, centre)
        across = unit(across) if np.linalg.norm(across) > 1e-9 else np.array([0.0, 1.0, 0.0])
        outwards = np.cross(across, centre)
        lens = blur / ball.radius
        lobe = np.exp(p[2:4])
        radial, tangential, exponent = np.hypot(lobe[0], lens / cosine), np.hypot(lobe[1], lens), np.exp(p[4])
        off = normals - centre
        turn = ((off @ outwards) / radial) ** 2 + ((off @ across) / tangential) ** 2
        # the width of the lens is not foreshortened
        share = (lobe[0] / radial) ** 2
        shape = (1 + turn / exponent) ** -exponent * (cosine / cosines) ** share
        return np.exp(p[5::2][channel]) * shape + p[6::2][channel] * background

    def residual(p: np.ndarray) -> np.ndarray:
        off = (values - model(p)) / error
        # a clipped pixel is at least as bright as its value; weak prior: the exponent of the lobe is about 2
        return np.append(np.where(clipped, np.maximum(off, 0.0), off), p[4] - np.log(2.0))

    width = max(np.sqrt(size / np.pi), blur) / ball.radius
    first = [0.0, 0.0, np.log(width), np.log(width), np.log(2.0)]
    for k in range(len(channels)):
        bright = values[channel == k].max() - background
        first += [np.log(max(bright, 1e-3 * background)), 1.0]
    room = 1.5 + np.sqrt(size / np.pi)  # the mirror point lies within the bright spot
    low, high = np.full(len(first), -np.inf), np.full(len(first), np.inf)
    low[:5], high[:5] = [-room, -room, -12, -12, -0.5], [room, room, -0.3, -0.3, 3.0]
    found = least_squares(
        residual,
        np.clip(first, low + 1e-9, high - 1e-9),
        bounds=(low, high),
        loss="soft_l1",
        x_scale="jac",
        max_nfev=60,
    )
    position = start + found.x[:2]
    if not np.isfinite(ball.normals(*position)).all() or np.abs(found.x[:2]).max() > 0.99 * room:
        raise FitError(
            f"{picture.name}: no lobe on the sphere fits the bright spot, so the spot's centroid is used: check the outline"
        )
    spread = np.linalg.pinv(found.jac.T @ found.jac)[:2, :2]
    return position, spread * max(1.0, 2 * found.cost / max(len(values) - len(first), 1))


def lamp_from_highlight(
    highlight: Highlight, ball: MirrorBall, lamp_distance: float = np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the direction of a lamp from the position of its highlight.

    Args:
        highlight: highlight, whose position is the mirror point.
        ball: the sphere in this frame.
        lamp_distance: distance of the lamp from the sphere's centre, radii. Default: infinite.

    Returns:
        Unit vector from the sphere's centre to the lamp (3,), and its covariance, rad^2 (3, 3). The covariance is
        propagated from that of the highlight.
    """
    here = ball.lamp_seen_at(highlight.normal, lamp_distance)
    step = 1e-3
    moved = [
        ball.lamp_seen_at(ball.normals(highlight.row + dr, highlight.column + dc), lamp_distance)
        for dr, dc in ((step, 0.0), (0.0, step))
    ]
    slopes = (np.array(moved) - here).T / step
    return here, slopes @ highlight.covariance @ slopes.T


def lamp_angles_apart(lamps: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Compute the angle between the directions of each pair (..., 3), rad."""
    lamps, others = np.broadcast_arrays(unit(np.asarray(lamps, float)), unit(np.asarray(others, float)))
    return np.arctan2(np.linalg.norm(np.cross(lamps, others), axis=-1), (lamps * others).sum(-1))


def find_highlights(
    pictures: Sequence[MergedPicture], ball: MirrorBall, *, blur: float = 0.6
) -> tuple[list[Highlight | None], tuple[Remark, ...]]:
    """Find the highlight of every image.

    Args:
        pictures: images, one for each lamp.
        ball: the sphere.
        blur: standard deviation of lens and pixel together, px. Default: 0.6.

    Returns:
        The highlight of each image, and the remarks. The highlight is None, with a remark, if none was found. Remarks of
        one kind on more than three images are combined.
    """
    found: list[Highlight | None] = []
    remarks: list[tuple[str, Remark]] = []
    for picture in pictures:
        try:
            one = find_highlight(picture, ball, blur=blur)
            found.append(one)
            remarks += [(picture.name, remark) for remark in one.remarks]
        except FitError as error:
            found.append(None)
            remarks.append((picture.name, Remark("no-highlight", str(error))))
    return found, tuple(gathered(remarks))
