"""The loss at the specular peak: how much of a highlight's brightness the camera keeps (MODEL 4)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch

import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from matcam import checks
from matcam._jax import jax, jnp
from matcam.errors import ArgumentError
from matcam.forward.lobe import line_record, lobe_record
from matcam.forward.peak_tables import tabulated_peak
from matcam.material.epd import EPD
from matcam.material.ndf import NDF, MixtureNDF
from matcam.rigs import Rig

LOSS = 0.05
"""Relative loss beyond which an angle is no longer trusted (`loss_angle`)."""


def peak_response(rig: Rig, ndf: NDF, theta: ArrayLike, dims: int = 2) -> jax.Array:
    """Recorded peak / true peak of a material's highlight, in the tangent plane.

    theta: viewing angle of the highlight = half the angle between lamp and camera, rad, [0, pi/2), any shape.
    dims: 2, a real sample; 1, the paper's one-dimensional model (towards the limb only). In (0, 1]; on a sphere the
    loss relative to theta = 0 is at most cos(theta), for lobes much narrower than the kernel.
    Closed forms for mixtures of Gaussians; EPD by a table, within 1e-4: Gaussian optics, box pixel, point lamp only, and
    ArgumentError outside its range.
    Source: Holzschuch & Pacanowski (2017), section 3, as corrected in MODEL 4: a(w r cos theta) a(w r).
    """
    theta = checks.viewing_angle("theta", theta)
    checks.choice("dims", dims, (1, 2))
    _check_kinds(rig, ndf)
    return _in_tangent_plane(ndf, rig, jnp.reshape(theta, -1), dims).reshape(theta.shape)


@singledispatch
def _in_tangent_plane(ndf: NDF, rig: Rig, theta: jax.Array, dims: int) -> jax.Array:
    raise ArgumentError(f"no peak response is known for the lobe of {type(ndf).__name__}")


@_in_tangent_plane.register(MixtureNDF)
def _closed_form(ndf: MixtureNDF, rig: Rig, theta: jax.Array, dims: int) -> jax.Array:
    if dims == 1:
        return line_record(rig, ndf, theta)
    centre = np.zeros((theta.size, 1))
    return lobe_record(rig, ndf, theta, centre, centre)[:, 0]


@_in_tangent_plane.register(EPD)
def _from_table(ndf: EPD, rig: Rig, theta: jax.Array, dims: int) -> jax.Array:
    return tabulated_peak(rig, ndf, theta, dims)


def predict(rig: Rig, ndfs: Sequence[NDF], dims: int = 2) -> xr.Dataset:
    """What to expect of a rig, for several lobes of one family.

    Dataset over (roughness, theta): response, relative_response (to theta = 0); over roughness: loss_angle, the first
    angle, rad, whose relative loss exceeds 5 % (pi/2 where none below 89.9 degrees does).
    """
    theta = np.radians(np.append(np.arange(0, 90, 0.25), 89.9))
    response = np.stack([np.asarray(peak_response(rig, ndf, theta, dims=dims)) for ndf in ndfs])
    relative = response / response[:, :1]
    return xr.Dataset(
        {
            "response": (("roughness", "theta"), response),
            "relative_response": (("roughness", "theta"), relative),
            "loss_angle": ("roughness", [_first_beyond(theta, row) for row in relative], {"units": "rad"}),
        },
        coords={"roughness": [float(ndf.roughness) for ndf in ndfs], "theta": ("theta", theta, {"units": "rad"})},
        attrs={"ndf": ndfs[0].family, "loss": LOSS, "dims": dims},
    )


def loss_angle(rig: Rig, ndf: NDF, dims: int = 2) -> float:
    """First angle, rad, at which the peak has lost more than 5 % against theta = 0; pi/2 if none has below 89.9 degrees."""
    return float(predict(rig, [ndf], dims)["loss_angle"][0])


def _first_beyond(theta: np.ndarray, relative: np.ndarray) -> float:
    lost = 1 - relative - LOSS
    beyond = np.flatnonzero(lost > 0)
    if not beyond.size:
        return np.pi / 2
    i = beyond[0]
    return float(np.interp(0.0, lost[i - 1 : i + 1], theta[i - 1 : i + 1]))


def _check_kinds(rig: Rig, ndf: NDF) -> None:
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), got {type(rig).__name__}")
    if not isinstance(ndf, NDF):
        raise ArgumentError(f"ndf must be an NDF such as GGX(0.1), got {type(ndf).__name__}")
