"""Prediction of the loss at the peak of a highlight for a rig."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.results.summary import Quantity, Summary
from matcam.forward.peaks.peak import peak_response
from matcam.material.ndf.distribution import NDF
from matcam.rigs import Rig

if TYPE_CHECKING:
    import xarray as xr

LOSS = 0.05
"""Relative loss that defines the loss angle (`loss_angle`), no unit."""
_ANGLES = np.radians(np.append(np.arange(0, 90, 0.25), 89.9))


class Prediction(NamedTuple):
    """Predicted response at the peak, for several lobes of one family.

    Attributes:
        family: name of the family.
        roughness: roughness of the lobes, (lobes,); rad for Gaussian lobes, no unit for other families.
        theta: viewing angles, rad, (angles,).
        response: recorded peak divided by true peak, (lobes, angles), no unit.
        loss_angle: smallest viewing angle with a relative loss above 5 %, rad, (lobes,); see the function `loss_angle`.
    """

    family: str
    roughness: np.ndarray
    theta: np.ndarray
    response: np.ndarray
    loss_angle: np.ndarray

    @property
    def relative_response(self) -> np.ndarray:
        return self.response / self.response[:, :1]

    def columns(self) -> dict[str, Sequence[Any]]:
        """Tabulate the values, with one row for each lobe and angle. The names of columns of angles end in "_rad"."""
        lobes, angles = self.response.shape
        arrays = {
            "roughness": np.repeat(self.roughness, angles),
            "theta_rad": np.tile(self.theta, lobes),
            "response": self.response.ravel(),
            "relative_response": self.relative_response.ravel(),
            "loss_angle_rad": np.repeat(self.loss_angle, angles),
        }
        return {name: array.tolist() for name, array in arrays.items()}

    def dataset(self) -> xr.Dataset:
        import xarray as xr

        from matcam.core.results.labelled import named

        dims, unit = ("roughness", "theta"), "rad" if self.family == "gaussian" else "1"
        data = xr.Dataset(
            {
                "response": (dims, self.response),
                "relative_response": (dims, self.relative_response),
                "loss_angle": ("roughness", self.loss_angle),
            },
            coords={"roughness": self.roughness, "theta": self.theta},
            attrs={"family": self.family},
        )
        return named(
            data,
            {
                "response": "recorded over true peak",
                "relative_response": "recorded over true peak, relative to theta = 0",
                "loss_angle": f"first angle at which {LOSS:.0%} of the peak is lost [rad]",
                "roughness": f"roughness of the {self.family} lobe [{unit}]",
            },
        )


def predict(rig: Rig, ndfs: NDF | Sequence[NDF], *, dims: int = 2, exact: bool = False) -> xr.Dataset:
    """Predict the recorded share of the peak of a highlight.

    The command `matcam predict` prints the result.

    Args:
        rig: camera, sample and lamp.
        ndfs: lobes of one family, such as `[GGX(0.01), GGX(0.1)]`, or a single lobe.
        dims: 2 for a real sample, 1 for the one-dimensional model of Holzschuch and Pacanowski. Default: 2.
        exact: True for the curved sample with its limb, as in `peak_response`, with Smith's masking. Default: False, the
            tangent plane of the sample.

    Returns:
        Dataset over `roughness` (rad for Gaussian lobes, no unit for other families) and `theta` (viewing angle of the
        highlight, rad). `response` is the recorded peak divided by the true peak, no unit. `relative_response` is the
        response divided by the response at theta = 0, no unit. `loss_angle`, rad, is the smallest angle with a relative
        loss above 5 %, or pi/2 if the loss is smaller at all angles up to 89.9 degrees.
        `result.matcam.plot()` draws the dataset.

    Raises:
        ArgumentError: see `peak_response`, or the lobes are of several families.

    Source:
        Holzschuch and Pacanowski (2017), section 3; docs/model.md 4.

    Example:
        >>> found = matcam.predict(matcam.rigs.merl(), [matcam.GGX(0.005), matcam.GGX(0.02)])
        >>> print(np.degrees(found["loss_angle"].values).round(1))
        [28.9 57.1]
        >>> print(found["response"].sel(roughness=0.02).sel(theta=np.radians(75), method="nearest").item().__round__(2))
        0.76
    """
    lobes = [ndfs] if isinstance(ndfs, NDF) else checks.instances("ndfs", ndfs, NDF)  # type: ignore[type-abstract]
    families = sorted({lobe.family for lobe in lobes})
    if len(families) != 1:
        raise ArgumentError(f"ndfs must be lobes of one family, got {', '.join(families) or 'none'}")
    return predicted(rig, lobes, dims, exact).dataset()


def prediction_summary(data: xr.Dataset) -> Summary:
    kept, angles = data["response"].values[:, 0], np.degrees(data["loss_angle"].values)
    names = [f"roughness {value:g}" for value in data["roughness"].values]
    losses = [f"{angle:.1f}°" if angle < 90 else "none below 90°" for angle in angles]
    return Summary(
        f"Recorded peaks of {data.attrs['family']} lobes",
        sections={
            "Recorded share of the peak at 0°": [Quantity(*pair) for pair in zip(names, kept.tolist(), strict=True)],
            f"First angle with a relative loss of {100 * LOSS:g} %": [
                Quantity(*pair) for pair in zip(names, losses, strict=True)
            ],
        },
    )


def predicted(rig: Rig, ndfs: Sequence[NDF], dims: int = 2, exact: bool = False, fast: bool = False) -> Prediction:
    """Predict the response at the peak for several lobes of one family, as arrays, without importing xarray.

    Args:
        rig: camera, sample and lamp.
        ndfs: the lobes.
        dims: see `peak_response`. Default: 2.
        exact: see `peak_response`; the masking is Smith's. Default: False.
        fast: True to use `response_preview`, and only a quarter of the angles. The preview is valid in two dimensions, on a
            sphere and without defocus. Default: False.
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
    """Compute the smallest viewing angle with a relative loss above 5 %.

    The loss refers to the peak in the tangent plane, relative to theta = 0 (see `peak_response`).

    Args:
        rig: camera, sample and lamp.
        ndf: distribution of the microfacets' normals, such as `GGX(0.01)`.
        dims: 2 for a real sample, 1 for the one-dimensional model of Holzschuch and Pacanowski. For a Gaussian lobe and
            a Gaussian lens, the relative loss is the same in both cases. Default: 2.

    Returns:
        Angle, rad; pi/2 if the loss is smaller at all angles up to 89.9 degrees.

    Raises:
        ArgumentError: see `peak_response`.

    Source:
        Holzschuch and Pacanowski (2017), section 3; docs/model.md 4.

    Example:
        >>> angle = matcam.loss_angle(matcam.rigs.merl(), matcam.GGX(0.02))
        >>> print(f"{np.degrees(angle):.1f} degrees")
        57.1 degrees
    """
    return float(predicted(rig, [ndf], dims).loss_angle[0])


def _first_beyond(theta: np.ndarray, relative: np.ndarray) -> float:
    loss = 1 - relative - LOSS
    beyond = np.flatnonzero(loss > 0)
    if not beyond.size:
        return np.pi / 2
    i = beyond[0]
    return float(np.interp(0.0, loss[i - 1 : i + 1], theta[i - 1 : i + 1]))
