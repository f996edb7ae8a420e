"""What an earlier reconstruction found of a rig as the prior of another one: lens, distances, lamps and distortion.

Distances count in radii of the sphere: they are scaled where the other sphere is of another size. The outline is always the
sample's own. Everything has one covariance: a lamp's direction errs with the lamp's distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.remark import Remark
from matcam.reconstruction.picture_model import SCENE, LampFrame, lamp_frame
from matcam.reconstruction.rig.rig_document import SCENE_NAMES, EarlierRig

_LEAST = 1e-12  # of a variance: below it a parameter was not fitted


class KnownRig(NamedTuple):
    """Hold what is known of the rig of some pictures.

    Attributes:
        values: ln of the lens's width over its profile's, nearness of camera and of lamp, changes of k1 and of the blur's
            growth, (5,).
        lamps: place of each picture's lamp among the directions; -1: not known, (pictures,).
        directions: unit vectors, (lamps, 3).
        covariance: of values, and of two turns of each lamp, rad.
    """

    values: np.ndarray
    lamps: np.ndarray
    directions: np.ndarray
    covariance: np.ndarray

    @property
    def knows(self) -> np.ndarray:
        """Which of the values are known, (5,)."""
        return np.diag(self.covariance)[: len(SCENE_NAMES)] > _LEAST

    @property
    def lamp_std(self) -> np.ndarray:
        """Return the standard deviation of each lamp's direction along a tangent, rad, (lamps,)."""
        variance = np.diag(self.covariance)[len(SCENE_NAMES) :].reshape(-1, 2)
        return np.sqrt(variance.mean(axis=1))

    def prior(
        self, size: int, places: Sequence[int], own: Sequence[int], frames: Sequence[LampFrame]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and values of the prior: combinations of the parameters that are a value +- 1.

        Args:
            size: number of all parameters.
            places: of the five values among them.
            own: place of the first of the two turns of each picture's lamp.
            frames: of the pictures' lamps.
        """
        chosen, rows, values = [], [], []
        for index in np.flatnonzero(self.knows).tolist():
            row = np.zeros(size)
            row[places[index]] = 1.0
            chosen.append(index)
            rows.append(row)
            values.append(self.values[index])
        for k, at in enumerate(self.lamps):
            if at < 0:
                continue
            known, frame = lamp_frame(self.directions[at]), frames[k]
            along = max(float(frame.base @ known.base), 0.1)
            for axis, tangent in enumerate((known.first, known.second)):
                row = np.zeros(size)
                row[own[k] : own[k] + 2] = np.array([frame.first @ tangent, frame.second @ tangent]) / along
                chosen.append(len(SCENE_NAMES) + 2 * at + axis)
                rows.append(row)
                values.append(-float(frame.base @ tangent) / along)
        covariance = self.covariance[np.ix_(chosen, chosen)]
        scale = np.sqrt(np.maximum(np.diag(covariance), _LEAST))
        correlation = covariance / np.outer(scale, scale) + 1e-9 * np.eye(len(scale))
        root = np.linalg.inv(np.linalg.cholesky(correlation)) / scale
        return root @ np.array(rows), root @ np.array(values)


def known_rig(
    rig: EarlierRig,
    names: Sequence[str],
    frame: tuple[int, int] | None,
    sample_radius: float | None,
    sigma: float | None,
) -> tuple[KnownRig, tuple[Remark, ...]]:
    """Return what an earlier reconstruction says of the rig of these pictures.

    Args:
        rig: as from `read_rig`.
        names: of the lamp positions.
        frame: width and height of the frames, px; None: not known.
        sample_radius: of the sphere, mm; None: not stated.
        sigma: of the lens by the profile, px; None: no Gaussian. The earlier lens then counts for nothing.

    Raises:
        ArgumentError: the frames are of another size, or no lamp position has a name that the rig knows.
    """
    if rig.frame is not None and frame is not None and rig.frame != frame:
        raise ArgumentError(
            f"{rig.file}: is of frames of {rig.frame[0]} x {rig.frame[1]} px, these have {frame[0]} x {frame[1]} px: "
            "give a reconstruction of the same camera"
        )
    unknown = [name for name in names if name not in rig.lamps]
    if len(unknown) == len(names):
        raise ArgumentError(
            f"{rig.file}: knows none of the lamp positions {', '.join(names[:4])}: it has {', '.join(rig.lamps[:4])}; "
            "give the same names to the same positions"
        )
    remarks = []
    if unknown:
        remarks.append(
            Remark(
                "rig-lamp-unknown", f"{', '.join(unknown)}: not in {rig.file}; what frames.csv states of them is used"
            )
        )
    ratio = 1.0
    if rig.sample_radius is not None and sample_radius is not None:
        ratio = sample_radius / rig.sample_radius
    else:
        remarks.append(
            Remark(
                "rig-radius-not-stated", f"{rig.file}: the spheres' radii are not both stated: they are taken as equal"
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
    covariance: np.ndarray,
    scene: slice,
    field: slice,
    own: Sequence[int],
    frames: Sequence[LampFrame],
    lamps: np.ndarray,
) -> np.ndarray:
    """Return the covariance of a rig's parameters in the order of its document.

    Args:
        covariance: of all parameters of a joint fit.
        scene: place of lens, radius and nearnesses.
        field: place of the changes of the lens's field.
        own: place of the first of the two turns of each picture's lamp.
        frames: in which these turns count.
        lamps: directions that were found, (pictures, 3); the document's turns count from them.
    """
    size = len(SCENE_NAMES) + 2 * len(lamps)
    pick = np.zeros((size, len(covariance)))
    first = scene.start
    places = [first + SCENE.index(name) for name in ("lens", "camera", "lamp")] + [field.start, field.start + 1]
    pick[np.arange(len(places)), places] = 1.0
    for k, direction in enumerate(lamps):
        to, frame = lamp_frame(direction / np.linalg.norm(direction)), frames[k]
        for axis, tangent in enumerate((to.first, to.second)):
            pick[len(places) + 2 * k + axis, own[k] : own[k] + 2] = frame.first @ tangent, frame.second @ tangent
    whole = pick @ covariance @ pick.T
    return np.asarray((whole + whole.T) / 2)
