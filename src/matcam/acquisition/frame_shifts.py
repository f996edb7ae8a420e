"""Position of the sphere in every frame.

The sphere or the camera moves by tenths of a pixel between images, and one lamp lights only part of the limb. One
radius, one centre and the shift of every frame are therefore fitted jointly to many partly lit limbs. The limb of a
mean of shifted frames would not be round, and its radius would be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.outline import EXPONENTS, FEWEST_SECTORS, Outline, OutlineFit
from matcam.core.errors import FitError
from matcam.core.remark import Remark
from matcam.numerics.normal import robust_std

_TURNS = 5
"""Largest number of Gauss-Newton steps."""
_BRIGHT = 0.5
"""Share of the largest contrast of the limb above which a sector is used."""
_STILL = 1e-3
"""Largest change of a shift or of the outline at convergence, px."""
_OUTLIER = 4.0
"""Number of standard deviations from the fitted limb above which a sector is omitted."""


class FrameShift(NamedTuple):
    """Shift of the sphere in one frame relative to the outline.

    Attributes:
        row: shift of the row, px, positive downwards.
        column: shift of the column, px, positive to the right.
        covariance: covariance of row and column, px^2 (2, 2). If the limb is lit on one side only, the covariance is
            large in one direction; without a visible limb it is that of the prior.
        sectors: number of sectors of the limb that were used.
    """

    row: float
    column: float
    covariance: np.ndarray
    sectors: int


def find_shifts(
    pictures: Sequence[MergedPicture], outline: Outline, shift_std: float
) -> tuple[Outline, list[FrameShift]]:
    """Estimate the shift of the sphere in every frame, and the common outline.

    Args:
        pictures: images of a lit sphere, one for each lamp.
        outline: outline of the sphere from the stack of these images.
        shift_std: prior standard deviation of the motion between frames, px.

    Returns:
        The outline at the mean position, and a shift for each image.

    Raises:
        FitError: no image shows enough of the limb.
    """
    position = np.array([outline.row, outline.column, outline.radius])
    shifts = np.zeros((len(pictures), 2))
    kind = "coated" if outline.coated else "lit"
    fits = [OutlineFit(one, kind, outline.sighting, EXPONENTS[kind], position) for one in pictures]
    sigma = max(outline.sigma, 0.05)
    used: list[np.ndarray] = []
    for _ in range(_TURNS):
        blocks, pulls, used, left, weights = [], [], [], [], []
        for fit, shift in zip(fits, shifts, strict=True):
            here = position + np.append(shift, 0.0)
            edges = fit.edges(here, sigma, fit.exponents)
            with np.errstate(invalid="ignore"):
                chosen = fit.usable(edges) & (np.abs(edges.offset) < 2.0)
                # near the ends of the terminator the radiance varies along the limb within a sector
                chosen &= edges.contrast > _BRIGHT * np.max(edges.contrast, where=chosen, initial=0.0)
                floor = robust_std(edges.offset[chosen]) if chosen.any() else 0.0
                std = np.sqrt(edges.std**2 * np.maximum(edges.misfit, 1.0) + min(outline.scatter, 0.2) ** 2)
                chosen &= np.abs(edges.offset) < _OUTLIER * np.hypot(std, floor)
            if chosen.sum() < FEWEST_SECTORS:
                chosen[:] = False
            matrix = fit.slopes(here, edges.azimuth)[chosen]
            weight = 1 / std[chosen] ** 2
            blocks.append((matrix.T * weight) @ matrix)
            pulls.append((matrix.T * weight) @ edges.offset[chosen])
            left.append((edges.offset[chosen], matrix))
            weights.append(weight)
            used.append(chosen)
        if not any(chosen.any() for chosen in used):
            raise FitError(
                "no image shows enough of the limb of the sphere: photograph the outline in front of a bright field"
            )
        step, covariance = _solved(np.array(blocks), np.array(pulls), shifts, shift_std)
        position, shifts = position + step[:3], shifts + step[3:].reshape(-1, 2)
        if np.abs(step).max() < _STILL:
            break
    chi2, number = 0.0, 0
    for k, ((offset, matrix), weight) in enumerate(zip(left, weights, strict=True)):
        residual = offset - matrix @ (step[:3] + np.append(step[3 + 2 * k : 5 + 2 * k], 0.0))
        chi2 += float(np.sum(weight * residual**2))
        number += len(residual)
    covariance = covariance * max(1.0, chi2 / max(number - 3, 1))
    found = []
    for k, (shift, chosen) in enumerate(zip(shifts, used, strict=True)):
        at = slice(3 + 2 * k, 5 + 2 * k)
        found.append(FrameShift(float(shift[0]), float(shift[1]), covariance[at, at], int(chosen.sum())))
    remarks = outline.remarks
    moved = float(np.sqrt(np.mean(np.sum(shifts**2, axis=1))))
    if moved > 2 * shift_std:
        text = f"the sphere moves by {moved:.2f} px rms between frames: fasten the sphere and the camera"
        remarks += (Remark("sphere-moved", text),)
    # the errors due to the lens and to the light near the limb are common to all frames
    common = outline.covariance - outline.noise
    return replace(
        outline,
        row=float(position[0]),
        column=float(position[1]),
        radius=float(position[2]),
        covariance=covariance[:3, :3] + common,
        remarks=remarks,
    ), found


def _solved(
    blocks: np.ndarray, pulls: np.ndarray, shifts: np.ndarray, shift_std: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the Gauss-Newton step of row, column, radius and all shifts, px, and its covariance, px^2.

    The prior mean of the shifts is 0.
    """
    count = len(blocks)
    information, pull = np.zeros((3 + 2 * count, 3 + 2 * count)), np.zeros(3 + 2 * count)
    information[:3, :3], pull[:3] = blocks.sum(0), pulls.sum(0)
    for k, (block, one) in enumerate(zip(blocks, pulls, strict=True)):
        at = slice(3 + 2 * k, 5 + 2 * k)
        information[:3, at], information[at, :3] = block[:, :2], block[:2]
        information[at, at] = block[:2, :2] + np.eye(2) / shift_std**2
        pull[at] = one[:2] - shifts[k] / shift_std**2
    covariance = np.linalg.inv(information)
    return covariance @ pull, covariance
