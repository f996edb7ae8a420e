"""Position of the sphere in every frame.

The sphere or the camera moves by tenths of a pixel between images, and one lamp lights only part of the limb. One
radius, one centre and the shift of every frame are therefore fitted jointly to many partly lit limbs. The limb of a
mean of shifted frames would not be round, and its radius would be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.outline import EXPONENTS, FEWEST_SECTORS, Outline, OutlineFit, limb_slopes
from matcam.core.errors import FitError
from matcam.core.remark import Remark
from matcam.numerics.normal import robust_std


def find_shifts(pictures: Sequence[MergedPicture], outline: Outline, shift_std: float) -> tuple[Outline, np.ndarray]:
    """Estimate the shift of the sphere in every frame, and the common outline.

    Args:
        pictures: images of a lit sphere, one for each lamp.
        outline: outline of the sphere from the stack of these images.
        shift_std: prior standard deviation of the motion between frames, px.

    Returns:
        The outline at the mean position, and the shifts of row and column in each image, px (pictures, 2).

    Raises:
        FitError: no image shows enough of the limb.
    """
    position = np.array([outline.row, outline.column, outline.radius])
    shifts = np.zeros((len(pictures), 2))
    kind = "coated" if outline.coated else "lit"
    fits = [OutlineFit(one, kind, EXPONENTS[kind], position) for one in pictures]
    sigma = max(outline.sigma, 0.05)
    for _ in range(5):
        design, offsets, weights = [], [], []
        for k, (fit, shift) in enumerate(zip(fits, shifts, strict=True)):
            edges = fit.edges(position + np.append(shift, 0.0), sigma, fit.exponents)
            with np.errstate(invalid="ignore"):
                chosen = fit.usable(edges) & (np.abs(edges.offset) < 2.0)
                # near the ends of the terminator the radiance varies along the limb within a sector
                # share of the largest contrast of the limb above which a sector is used
                chosen &= edges.contrast > 0.5 * np.max(edges.contrast, where=chosen, initial=0.0)
                floor = robust_std(edges.offset[chosen]) if chosen.any() else 0.0
                std = np.sqrt(edges.std**2 * np.maximum(edges.misfit, 1.0) + min(outline.scatter, 0.2) ** 2)
                # sectors more than 4 standard deviations from the limb are omitted
                chosen &= np.abs(edges.offset) < 4.0 * np.hypot(std, floor)
            if chosen.sum() < FEWEST_SECTORS:
                continue
            slopes = limb_slopes(edges.azimuth[chosen])
            own = np.zeros((len(slopes), *shifts.shape))
            own[:, k] = slopes[:, :2]
            design.append(np.column_stack([slopes, own.reshape(len(slopes), -1)]))
            offsets.append(edges.offset[chosen])
            weights.append(1 / std[chosen] ** 2)
        if not design:
            raise FitError(
                "no image shows enough of the limb of the sphere: photograph the outline in front of a bright field"
            )
        matrix, offset, weight = map(np.concatenate, (design, offsets, weights))
        # Gauss-Newton step of row, column, radius and all shifts, whose prior mean is 0
        prior = np.append(np.zeros(3), np.full(shifts.size, 1 / shift_std**2))
        covariance = np.linalg.inv((matrix.T * weight) @ matrix + np.diag(prior))
        step = covariance @ ((matrix.T * weight) @ offset - prior * np.append(np.zeros(3), shifts))
        position, shifts = position + step[:3], shifts + step[3:].reshape(-1, 2)
        if np.abs(step).max() < 1e-3:
            break
    chi2 = float(np.sum(weight * (offset - matrix @ step) ** 2))
    covariance = covariance * max(1.0, chi2 / max(len(offset) - 3, 1))
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
    ), shifts
