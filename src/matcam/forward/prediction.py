"""Prediction of the loss at the peak for a rig."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from matcam.forward.peaks.peak import peak_response
from matcam.material.ndf.distribution import NDF
from matcam.rigs import Rig

LOSS = 0.05
"""Relative loss above which an angle is not trusted (`loss_angle`)."""
_ANGLES = np.radians(np.append(np.arange(0, 90, 0.25), 89.9))


class Prediction(NamedTuple):
    """Predicted response at the peak, for several lobes of one family.

    Attributes:
        family: name of the family.
        roughness: of the lobes, (lobes,).
        theta: viewing angles, rad, (angles,).
        response: recorded over true peak, (lobes, angles), no unit.
        loss_angle: see `loss_angle`, rad, (lobes,).
    """

    family: str
    roughness: np.ndarray
    theta: np.ndarray
    response: np.ndarray
    loss_angle: np.ndarray

    @property
    def relative_response(self) -> np.ndarray:
        """Divide the response by that at theta = 0, no unit."""
        return self.response / self.response[:, :1]

    def columns(self) -> dict[str, Sequence[Any]]:
        """Return the values by name and unit: a row for each lobe and angle."""
        lobes, angles = self.response.shape
        arrays = {
            "roughness": np.repeat(self.roughness, angles),
            "theta_rad": np.tile(self.theta, lobes),
            "response": self.response.ravel(),
            "relative_response": self.relative_response.ravel(),
            "loss_angle_rad": np.repeat(self.loss_angle, angles),
        }
        return {name: array.tolist() for name, array in arrays.items()}


def predict(rig: Rig, ndfs: Sequence[NDF], dims: int = 2, exact: bool = False, fast: bool = False) -> Prediction:
    """Predict the loss at the peak for several lobes of one family.

    Args:
        rig: camera, sample and lamp.
        ndfs: the lobes.
        dims: see `peak_response`. Default: 2.
        exact: see `peak_response`; masking is Smith's. Default: False.
        fast: True for a quarter of the angles by `response_preview`, in two dimensions on a sphere, without defocus.
            Default: False.
    """
    if fast:
        from matcam.forward.previews import response_preview

        angles = _ANGLES[::4]
        response = np.stack([np.asarray(response_preview(rig, ndf, angles)) for ndf in ndfs])
    else:
        angles = _ANGLES
        response = np.stack([np.asarray(peak_response(rig, ndf, angles, dims=dims, exact=exact)) for ndf in ndfs])
    return Prediction(
        family=ndfs[0].family,
        roughness=np.array([float(ndf.roughness) for ndf in ndfs]),
        theta=angles,
        response=response,
        loss_angle=np.array([_first_beyond(angles, row / row[0]) for row in response]),
    )


def loss_angle(rig: Rig, ndf: NDF, dims: int = 2) -> float:
    """Find the first angle whose relative loss exceeds 5 %.

    The loss is that of the peak in the tangent plane, relative to theta = 0 (see `peak_response`).

    Args:
        rig: camera, sample and lamp.
        ndf: distribution of the microfacets' normals, such as `GGX(0.01)`.
        dims: 2 for a real sample, 1 for the paper's one-dimensional model. Default: 2. The relative loss of Gaussian lobes is
            the same in both.

    Returns:
        Angle, rad; pi/2 if the loss is smaller at all angles below 89.9 degrees.

    Raises:
        ArgumentError: see `peak_response`.

    Source:
        Holzschuch and Pacanowski (2017), section 3; docs/model.md 4.

    Example:
        >>> angle = matcam.loss_angle(matcam.rigs.merl(), matcam.GGX(0.02))
        >>> print(f"{np.degrees(angle):.1f} degrees")
        57.1 degrees
    """
    return float(predict(rig, [ndf], dims).loss_angle[0])


def _first_beyond(theta: np.ndarray, relative: np.ndarray) -> float:
    loss = 1 - relative - LOSS
    beyond = np.flatnonzero(loss > 0)
    if not beyond.size:
        return np.pi / 2
    i = beyond[0]
    return float(np.interp(0.0, loss[i - 1 : i + 1], theta[i - 1 : i + 1]))
