"""Rig of an earlier reconstruction as a prior: lens, distances, lamps and distortion.

Distances are in radii of the sphere, and are scaled for a sphere of another size. The outline is not taken from the earlier
reconstruction. All parameters have a common covariance matrix, because the errors of the direction and the distance of a
lamp are correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.remark import Remark
from matcam.numerics.linalg import whitening
from matcam.reconstruction.joint.joint_problem import JointLayout
from matcam.reconstruction.picture_model import LampFrame, lamp_frame
from matcam.reconstruction.rig.rig_document import SCENE_NAMES, EarlierRig

_LEAST = 1e-12  # variance below which a parameter was not fitted


class KnownRig(NamedTuple):
    """Prior knowledge of the rig of a set of images.

    Attributes:
        values: ln of the lens width relative to the profile, inverse distances of camera and lamp (1/radii), and changes
            of the distortion coefficient k1 and of the growth of the blur, (5,).
        lamps: index of the lamp of each image in `directions`, (pictures,); -1: unknown.
        directions: unit vectors to the lamps, (lamps, 3).
        covariance: covariance of `values` and of the two rotations (rad) of each lamp, (5 + 2 lamps, 5 + 2 lamps).
    """

    values: np.ndarray
    lamps: np.ndarray
    directions: np.ndarray
    covariance: np.ndarray

    @property
    def knows(self) -> np.ndarray:
        """Mask of the known values, (5,)."""
        return np.diag(self.covariance)[: len(SCENE_NAMES)] > _LEAST

    @property
    def lamp_std(self) -> np.ndarray:
        """Standard deviation of each lamp's direction along a tangent, rad, (lamps,)."""
        variance = np.diag(self.covariance)[len(SCENE_NAMES) :].reshape(-1, 2)
        return np.sqrt(variance.mean(axis=1))

    def prior(self, layout: JointLayout, frames: Sequence[LampFrame]) -> tuple[np.ndarray, np.ndarray]:
        """Build the prior as linear combinations of the parameters with independent errors and unit variance.

        The results are the combinations, (rows, size), and their means, (rows,).

        Args:
            layout: order of the parameters.
            frames: base direction of the lamp of each image, with its tangents.
        """
        chosen, rows, values = [], [], []
        for index in np.flatnonzero(self.knows).tolist():
            row = np.zeros(layout.size)
            row[layout.rig[index]] = 1.0
            chosen.append(index)
            rows.append(row)
            values.append(self.values[index])
        for k, at in enumerate(self.lamps):
            if at < 0:
                continue
            known, frame = lamp_frame(self.directions[at]), frames[k]
            along = max(float(frame.base @ known.base), 0.1)
            for axis, tangent in enumerate((known.first, known.second)):
                row = np.zeros(layout.size)
                row[layout.turn(k)] = np.array([frame.first @ tangent, frame.second @ tangent]) / along
                chosen.append(len(SCENE_NAMES) + 2 * at + axis)
                rows.append(row)
                values.append(-float(frame.base @ tangent) / along)
        covariance = self.covariance[np.ix_(chosen, chosen)]
        scale = np.sqrt(np.maximum(np.diag(covariance), _LEAST))
        correlation = covariance / np.outer(scale, scale) + 1e-9 * np.eye(len(scale))
        root = whitening(correlation) / scale
        return root @ np.array(rows), root @ np.array(values)


def known_rig(
    rig: EarlierRig,
    names: Sequence[str],
    frame: tuple[int, int] | None,
    sample_radius: float | None,
    sigma: float | None,
) -> tuple[KnownRig, tuple[Remark, ...]]:
    """Match an earlier reconstruction to the rig of these images.

    Args:
        rig: earlier rig, as returned by `read_rig`.
        names: names of the lamp positions of these images.
        frame: width and height of the frames, px; None: unknown.
        sample_radius: radius of the sphere, mm; None: unknown.
        sigma: standard deviation of the lens according to the profile, px. None: the lens is not Gaussian, and the earlier
            lens is ignored.

    Raises:
        ArgumentError: the frames have another size, or the rig contains no lamp position of these images.
    """
    if rig.frame is not None and frame is not None and rig.frame != frame:
        raise ArgumentError(
            f"{rig.file}: the rig has frames of {rig.frame[0]} x {rig.frame[1]} px, but this capture has "
            f"{frame[0]} x {frame[1]} px: give a reconstruction of the same camera"
        )
    unknown = [name for name in names if name not in rig.lamps]
    if len(unknown) == len(names):
        raise ArgumentError(
            f"{rig.file}: the rig has none of the lamp positions {', '.join(names[:4])}, but it has "
            f"{', '.join(rig.lamps[:4])}: give the same names to the same positions"
        )
    remarks = []
    if unknown:
        remarks.append(
            Remark(
                "rig-lamp-unknown",
                f"{rig.file}: the rig does not contain lamp{'s' * (len(unknown) > 1)} {', '.join(unknown)}: the direction in "
                "frames.csv is used or, if it is not specified, that of the highlight",
            )
        )
    ratio = 1.0
    if rig.sample_radius is not None and sample_radius is not None:
        ratio = sample_radius / rig.sample_radius
    else:
        remarks.append(
            Remark(
                "rig-radius-not-stated",
                f"{rig.file}: both spheres are assumed to have the same radius, because at least one radius is unknown: "
                "specify sample.radius_mm in both captures",
            )
        )
    covariance = rig.covariance.copy()
    scale = np.ones(len(covariance))
    scale[1:3] = ratio
    if sigma is None or rig.sigma is None:
        scale[0] = 0.0
    covariance *= np.outer(scale, scale)
    lens = 0.0 if sigma is None or rig.sigma is None else float(np.log(rig.sigma / sigma))
    values = np.array([lens, ratio * rig.nearness[0], ratio * rig.nearness[1], 0.0, 0.0])
    lamps = np.array([rig.lamps.index(name) if name in rig.lamps else -1 for name in names])
    return KnownRig(values, lamps, rig.directions, covariance), tuple(remarks)


def rig_covariance(
    covariance: np.ndarray, layout: JointLayout, frames: Sequence[LampFrame], lamps: np.ndarray
) -> np.ndarray:
    """Compute the covariance of the parameters of a rig, in the order of the document of a reconstruction.

    Args:
        covariance: covariance of all parameters of a joint fit.
        layout: order of these parameters.
        frames: base direction of the lamp of each image, with its tangents.
        lamps: fitted directions, (pictures, 3), which are the base directions of the rotations in the document.
    """
    shared = len(SCENE_NAMES)
    pick = np.zeros((shared + 2 * len(lamps), len(covariance)))
    pick[np.arange(shared), layout.rig] = 1.0
    for k, (direction, frame) in enumerate(zip(lamps, frames, strict=True)):
        to = lamp_frame(direction)
        for axis, tangent in enumerate((to.first, to.second)):
            pick[shared + 2 * k + axis, layout.turn(k)] = frame.first @ tangent, frame.second @ tangent
    whole = pick @ covariance @ pick.T
    return np.asarray((whole + whole.T) / 2)
