"""The loss at the specular peak of a real sphere or cylinder: curved, with a limb (MODEL 3, 4).

The loss at the specular peak: how much of a highlight's brightness the camera keeps (MODEL 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch

import equinox as eqx
import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Blur, blur_of, groups_of
from matcam.forward.integral.integrals import Detail, record_around
from matcam.forward.integral.scene import Scene
from matcam.forward.peaks.lobe import line_record, lobe_record
from matcam.forward.peaks.peak_tables import tabulated_peak
from matcam.material.masking import MASKINGS, Masking
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import NDF, MixtureNDF, SlopeDistribution
from matcam.material.ndf.epd import EPD
from matcam.rigs import Rig
from matcam.sample.shape import Curved, Flat

_DETAIL = Detail(graded=10, even=6, order=8)


def exact_peak(rig: Rig, ndf: SlopeDistribution, theta: jax.Array, masking: Masking) -> jax.Array:
    """Recorded peak / true peak, theta of shape (n,). May exceed 1 close to the limb, where the BRDF bends upwards, and falls
    once the kernel reaches over it. Relative error below 1e-6 for Gaussian lenses (tests); others are sums of them."""
    if isinstance(rig.sample, Flat):
        return jnp.ones_like(theta)
    if not isinstance(rig.sample, Curved):
        raise ArgumentError(f"no exact peak is known for a {type(rig.sample).__name__}")
    blur = blur_of(rig)
    material = Microfacet(ndf, 1.0, masking=masking)
    groups = groups_of(blur, rig.sample)
    # lengths as arrays: what is compiled for one rig serves all of its kind
    reaches = jnp.asarray([group.scale.reach for group in groups])
    return _responses(material, rig.sample, blur, tuple(group.terms for group in groups), reaches, theta)


@eqx.filter_jit
def _responses(
    material: Microfacet,
    sample: Curved,
    blur: Blur,
    terms: tuple[tuple[int, ...], ...],
    reaches: jax.Array,
    theta: jax.Array,
) -> jax.Array:
    def one(angle: jax.Array) -> jax.Array:
        scene = Scene(material, sample, sample.lamp_angle(angle))
        x = sample.surface(sample.highlight(scene.lamp_angle), jnp.zeros(())).x
        element, _ = sample.at(x, jnp.zeros(()))
        centre = jnp.zeros(1)
        recorded = sum(
            record_around(scene, blur, together, x[None], centre, reaches[i], _DETAIL)[0, 0, 0]
            for i, together in enumerate(terms)
        )
        return recorded / scene.sent(element)[0]

    return jax.lax.map(one, theta)


LOSS = 0.05
"""Relative loss beyond which an angle is no longer trusted (`loss_angle`)."""


def peak_response(
    rig: Rig, ndf: SlopeDistribution, theta: ArrayLike, dims: int = 2, exact: bool = False, masking: Masking = "smith"
) -> jax.Array:
    """Recorded peak / true peak of a material's highlight.

    theta: viewing angle of the highlight = half the angle between lamp and camera, rad, [0, pi/2), any shape.
    dims: 2, a real sample; 1, the paper's one-dimensional model (towards the limb only).

    exact=False, the tangent plane: in (0, 1]; on a sphere the loss relative to theta = 0 is at most cos(theta), for
    lobes much narrower than the kernel. Closed forms for mixtures of Gaussians; EPD by a table, within 1e-4: Gaussian
    optics, box pixel, point lamp only, and ArgumentError outside its range. Source: Holzschuch & Pacanowski (2017),
    section 3, as corrected in MODEL 4: a(w r cos theta) a(w r).

    exact=True, two dimensions only: the curved sample itself with its limb, under `masking`, for every NDF; the peak's
    pixel may then read more than the peak (MODEL 4).
    """
    theta = checks.viewing_angle("theta", theta)
    checks.choice("dims", dims, (1, 2))
    checks.choice("masking", masking, MASKINGS)
    _check_kinds(rig, ndf)
    flat = jnp.reshape(theta, -1)
    if exact:
        if dims != 2:
            raise ArgumentError("exact=True is a real sample's: dims must be 2, got 1")
        return exact_peak(rig, ndf, flat, masking).reshape(theta.shape)
    return _in_tangent_plane(ndf, rig, flat, dims).reshape(theta.shape)


@singledispatch
def _in_tangent_plane(ndf: SlopeDistribution, rig: Rig, theta: jax.Array, dims: int) -> jax.Array:
    raise ArgumentError(f"the tangent plane knows no {type(ndf).__name__}: ask with exact=True")


@_in_tangent_plane.register(MixtureNDF)
def _closed_form(ndf: MixtureNDF, rig: Rig, theta: jax.Array, dims: int) -> jax.Array:
    if dims == 1:
        return line_record(rig, ndf, theta)
    centre = np.zeros((theta.size, 1))
    return lobe_record(rig, ndf, theta, centre, centre)[:, 0]


@_in_tangent_plane.register(EPD)
def _from_table(ndf: EPD, rig: Rig, theta: jax.Array, dims: int) -> jax.Array:
    return tabulated_peak(rig, ndf, theta, dims)


def predict(rig: Rig, ndfs: Sequence[NDF], dims: int = 2, exact: bool = False) -> xr.Dataset:
    """What to expect of a rig, for several lobes of one family. exact: as `peak_response`, with Smith masking.

    Dataset over (roughness, theta): response, relative_response (to theta = 0); over roughness: loss_angle, the first
    angle, rad, whose relative loss exceeds 5 % (pi/2 where none below 89.9 degrees does).
    """
    theta = np.radians(np.append(np.arange(0, 90, 0.25), 89.9))
    response = np.stack([np.asarray(peak_response(rig, ndf, theta, dims=dims, exact=exact)) for ndf in ndfs])
    relative = response / response[:, :1]
    return xr.Dataset(
        {
            "response": (("roughness", "theta"), response),
            "relative_response": (("roughness", "theta"), relative),
            "loss_angle": ("roughness", [_first_beyond(theta, row) for row in relative], {"units": "rad"}),
        },
        coords={"roughness": [float(ndf.roughness) for ndf in ndfs], "theta": ("theta", theta, {"units": "rad"})},
        attrs={"ndf": ndfs[0].family, "loss": LOSS, "dims": dims, "exact": int(exact)},
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


def _check_kinds(rig: Rig, ndf: SlopeDistribution) -> None:
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), got {type(rig).__name__}")
    if not isinstance(ndf, SlopeDistribution):
        raise ArgumentError(f"ndf must be an NDF such as GGX(0.1), got {type(ndf).__name__}")
