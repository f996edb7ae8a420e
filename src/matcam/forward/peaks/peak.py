"""The response at the specular peak: recorded peak over true peak (docs/model.md 4).

Two routes. In the tangent plane it has a closed form for mixtures of Gaussians, and a table for EPD. The exact route integrates
over the curved sample itself, with its limb (docs/model.md 3), for every NDF.
"""

from __future__ import annotations

from functools import singledispatch

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import BlurTerms, groups_of, imaging_of
from matcam.forward.integral.integrals import HighlightPanels, Scene, highlight_x, record_around
from matcam.forward.peaks.peak_tables import tabulated_peak
from matcam.forward.peaks.tangent_plane import line_record, lobe_record
from matcam.material.masking import MASKINGS, Masking
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import MixtureNDF, SlopeDistribution
from matcam.material.ndf.power_lobes import EPD
from matcam.rigs import Rig
from matcam.sample.shape import Curved, Flat

_PANELS = HighlightPanels(graded=10, even=6, order=8)


def peak_response(
    rig: Rig,
    ndf: SlopeDistribution,
    theta: ArrayLike,
    dims: int = 2,
    exact: bool = False,
    masking: Masking = "smith",
) -> jax.Array:
    """Return the recorded peak over the true peak of a highlight.

    In the tangent plane the response lies in (0, 1]. On a sphere, lobes much narrower than the kernel lose at most
    cos(theta) relative to theta = 0. EPD comes from a table, within 1e-4: Gaussian optics, box pixel and point lamp only.
    The exact response may exceed 1 close to the limb, where the BRDF bends upwards. Its relative error is below 1e-6 for
    Gaussian lenses; other lenses are sums of Gaussians.

    Args:
        rig: camera, sample and lamp.
        ndf: distribution of the microfacets' normals, such as `GGX(0.01)`.
        theta: viewing angle of the highlight, half the angle between lamp and camera, in [0, pi/2), rad, any shape.
        dims: 2 for a real sample, 1 for the paper's one-dimensional model, towards the limb only. Default: 2.
        exact: True for the curved sample with its limb, in two dimensions, for any NDF. Default: False, the tangent plane,
            which is faster and good to 1e-3 up to 75 degrees for lobes narrower than 0.05 rad.
        masking: "smith" (height-correlated), "smith-separable", "van-ginneken" or None (no masking). Only the exact
            response depends on it. Default: "smith".

    Returns:
        Response, of theta's shape, no unit. Differentiable in rig, ndf and theta.

    Raises:
        ArgumentError: an argument is out of its range, or EPD's table does not reach the rig.

    Source:
        Holzschuch and Pacanowski (2017), section 3, as corrected in docs/model.md 4: a(w r cos theta) a(w r).

    Example:
        >>> response = matcam.peak_response(matcam.rigs.merl(), matcam.GaussianNDF(0.002), np.radians([0, 75]))
        >>> print(np.round(response, 3))
        [0.437 0.146]
    """
    theta = checks.viewing_angle("theta", theta)
    checks.choice("dims", dims, (1, 2))
    checks.choice("masking", masking, MASKINGS)
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), got {type(rig).__name__}")
    if not isinstance(ndf, SlopeDistribution):
        raise ArgumentError(f"ndf must be an NDF such as GGX(0.1), got {type(ndf).__name__}")
    flat = jnp.reshape(theta, -1)
    if exact:
        if dims != 2:
            raise ArgumentError("exact=True is a real sample's: dims must be 2, got 1")
        return _exact_response(rig, ndf, flat, masking).reshape(theta.shape)
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


def _exact_response(rig: Rig, ndf: SlopeDistribution, theta: jax.Array, masking: Masking) -> jax.Array:
    """Return recorded over true peak on the curved sample; theta: (n,)."""
    if isinstance(rig.sample, Flat):
        return jnp.ones_like(theta)
    if not isinstance(rig.sample, Curved):
        raise ArgumentError(
            f"an exact peak needs a Sphere, a Cylinder or a Flat sample, not a {type(rig.sample).__name__}"
        )
    imaging = imaging_of(rig)
    material = Microfacet(ndf, 1.0, masking=masking)
    groups = groups_of(imaging.blur, imaging.sample)
    # lengths as arrays: what is compiled for one rig serves all of its kind
    reaches = jnp.asarray([group.scale.reach for group in groups])
    return _responses(material, imaging.sample, tuple(BlurTerms(imaging.blur, g.terms) for g in groups), reaches, theta)


@eqx.filter_jit
def _responses(
    material: Microfacet, sample: Curved, blurs: tuple[BlurTerms, ...], reaches: jax.Array, theta: jax.Array
) -> jax.Array:
    def one(angle: jax.Array) -> jax.Array:
        scene = Scene(material, sample, sample.lamp_angle(angle))
        x = highlight_x(sample, scene.lamp_angle)
        element, _ = sample.at(x, jnp.zeros(()))
        centre = jnp.zeros(1)
        recorded = sum(
            record_around(scene, blur, x[None], centre, reach, _PANELS)[0, 0, 0]
            for blur, reach in zip(blurs, reaches, strict=True)
        )
        return recorded / scene.sent(element)[0]

    return jax.lax.map(one, theta)
