"""The record of a specular lobe around its peak, and the response there: recorded peak over true peak (docs/model.md 4).

In the tangent plane a curved sample is replaced by theta = theta_o + t / (r_s cos theta_o) (paper (7)). A lobe that is a
mixture of Gaussians arrives on the sensor as a mixture of Gaussians, stretched by the sample's `px_per_rad`. Through Gaussian
optics and a separable pixel each has a closed form, the product of

    b(u; s) = sqrt(2 pi) s pixel.of_gaussian(u, sqrt(s^2 + sigma^2)).

Any other lens is integrated over frequencies, and EPD has a table. On a sphere of 256 px the plane is good to 1e-5 up to 83
degrees for lobes narrower than 0.002 rad, and to 2 % at 80 degrees for 0.05 rad. The exact route integrates over the curved
sample itself, with its limb (docs/model.md 3), for every NDF.
"""

from __future__ import annotations

from functools import partial, singledispatch
from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike

from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.optics import Rule
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import AnyArray, jax, jnp
from matcam.core.programs import kept_program
from matcam.forward.integral.blur import BlurTerms, Imaging, groups_of, imaging_of
from matcam.forward.integral.integrals import HighlightPanels, Scene, highlight_x, record_around
from matcam.forward.peaks.peak_tables import tabulated_peak
from matcam.material.masking import MASKINGS, Masking
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import MixtureNDF, SlopeDistribution
from matcam.material.ndf.power_lobes import EPD
from matcam.rigs import Rig
from matcam.sample.shape import Curved, Flat

# Frequency rule for lenses without a closed form: crowded towards 0, where the widest Gaussians of a mixture live
_FREQUENCY_PANELS, _GRADE = 24, 4


@kept_program
def lobe_record(rig: Rig, ndf: MixtureNDF, theta_o: AnyArray, x: AnyArray, y: AnyArray) -> jax.Array:
    """Record a lobe at offsets from its peak, relative to the true peak.

    Args:
        rig: the rig; a flat sample records the lobe as it is.
        ndf: the lobe.
        theta_o: viewing angle of the peak, rad, (slices,).
        x: offsets towards the limb, px, (slices, points).
        y: offsets across, px, (slices, points).

    Returns:
        Relative record, (slices, points), no unit. At offset (0, 0) it is the response at the peak.
    """
    theta_o = jnp.asarray(theta_o)
    weights, widths = ndf.mixture()
    (scale_x, scale_y), (lamp_x, lamp_y) = rig.px_per_rad(theta_o), rig.lamp_spread(theta_o)
    lobe = _SensorLobe(
        std_x=scale_x[:, None] * widths,
        std_y=scale_y[:, None] * widths,
        lamp_x=_finite(lamp_x * scale_x)[:, None],
        lamp_y=_finite(lamp_y * scale_y)[:, None],
        x=jnp.asarray(x),
        y=jnp.asarray(y),
    )
    if isinstance(rig.camera.optics, GaussianOptics):
        return jax.vmap(partial(_product_of_closed_forms, rig.camera, weights))(lobe)
    rule = rig.camera.optics.frequency_rule(_FREQUENCY_PANELS, _GRADE)
    frequency = jnp.asarray(rule.frequency)
    transfer = rig.camera.transfer(frequency[:, None], frequency)
    return jax.lax.map(partial(_by_frequencies, rule, transfer, weights), lobe)


@kept_program
def line_record(rig: Rig, ndf: MixtureNDF, theta_o: jax.Array) -> jax.Array:
    """Return the response at the peak in one dimension, (slices,).

    It is the paper's, towards the limb.
    """
    weights, widths = ndf.mixture()
    scale, lamp = rig.px_per_rad(theta_o)[0], rig.lamp_spread(theta_o)[0]
    std, lamp = scale[:, None] * widths, _finite(scale * lamp)[:, None]
    camera = rig.camera
    if isinstance(camera.optics, GaussianOptics):
        return _gaussian_record(camera, jnp.zeros(()), std, lamp) @ weights
    rule = camera.optics.frequency_rule(_FREQUENCY_PANELS, _GRADE)
    transfer = 2 * rule.weight * camera.mtf(rule.frequency)
    spectra = _gaussian_spectrum(rule, std[..., None], lamp[..., None])
    return jnp.where(jnp.isinf(std), 1.0, spectra @ transfer) @ weights


class _SensorLobe(NamedTuple):
    """A lobe on the sensor, px; the leading axis counts slices.

    Attributes:
        std_x: standard deviations of its Gaussians towards the limb, (slices, n).
        std_y: the same across.
        lamp_x: standard deviation of the lamp's disc towards the limb, (slices, 1).
        lamp_y: the same across.
        x: offsets at which it is recorded, towards the limb, (slices, points).
        y: the same across.
    """

    std_x: jax.Array
    std_y: jax.Array
    lamp_x: jax.Array
    lamp_y: jax.Array
    x: jax.Array
    y: jax.Array


def _product_of_closed_forms(camera: Camera, weights: jax.Array, lobe: _SensorLobe) -> jax.Array:
    along = _gaussian_record(camera, lobe.x[:, None], lobe.std_x, lobe.lamp_x)
    across = _gaussian_record(camera, lobe.y[:, None], lobe.std_y, lobe.lamp_y)
    return jnp.dot(along * across, weights)


def _gaussian_record(camera: Camera, u: jax.Array, std: jax.Array, lamp: jax.Array) -> jax.Array:
    """Return b(u; s), 1 where s is infinite.

    It is the record of a line with a Gaussian profile of unit peak.
    """
    uniform = jnp.isinf(std)
    std = jnp.where(uniform, 1.0, std)
    total = jnp.sqrt(std**2 + camera.optics.sigma**2 + lamp**2)  # type: ignore[attr-defined]
    return jnp.where(uniform, 1.0, jnp.sqrt(2 * jnp.pi) * std * camera.pixel.of_gaussian(u, total))


def _by_frequencies(rule: Rule, transfer: jax.Array, weights: jax.Array, lobe: _SensorLobe) -> jax.Array:
    """Return the same by a tensor rule over (fx, fy).

    The spectrum of the mixture is multiplied by the camera's transfer function.
    """

    def wave(u: jax.Array) -> jax.Array:
        return jnp.asarray(2 * rule.weight * jnp.cos(2 * jnp.pi * rule.frequency * u[:, None]))

    along = _gaussian_spectrum(rule, lobe.std_x[:, None], lobe.lamp_x[:, None])
    across = _gaussian_spectrum(rule, lobe.std_y[:, None], lobe.lamp_y[:, None])
    spectrum = jnp.einsum("j,ja,jb->ab", weights, along, across) * transfer
    return jnp.sum((wave(lobe.x) @ spectrum) * wave(lobe.y), axis=-1)


def _gaussian_spectrum(rule: Rule, std: jax.Array, lamp: jax.Array) -> jax.Array:
    """Return the Fourier transform of a unit-peak Gaussian line.

    Its width is `std` px, spread further by the lamp.
    """
    blur = jnp.exp(-2 * (jnp.pi * rule.frequency) ** 2 * (std**2 + lamp**2))
    return jnp.sqrt(2 * jnp.pi) * std * blur


def _finite(x: jax.Array) -> jax.Array:
    return jnp.where(jnp.isfinite(x), x, 0.0)


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
    imaging = imaging_of(rig, gaussian_disc=True)
    material = Microfacet(ndf, 1.0, masking=masking)
    groups = groups_of(imaging.blur, imaging.sample)
    # lengths as arrays: what is compiled for one rig serves all of its kind
    reaches = jnp.asarray([group.scale.reach for group in groups])
    terms = tuple(BlurTerms(imaging.blur, group.terms) for group in groups)
    return _responses(material, imaging, terms, reaches, theta)


@kept_program
def _responses(
    material: Microfacet, imaging: Imaging, blurs: tuple[BlurTerms, ...], reaches: jax.Array, theta: jax.Array
) -> jax.Array:
    def one(angle: jax.Array) -> jax.Array:
        sample, near = imaging.sample, imaging.lamp_nearness
        scene = Scene(material, sample, sample.lamp_angle(angle, near), near)
        x = highlight_x(sample, scene.lamp_angle, near)
        element, _ = sample.at(x, jnp.zeros(()))
        centre = jnp.zeros(1)
        recorded = sum(
            record_around(scene, blur, x[None], centre, reach, _PANELS)[0, 0, 0]
            for blur, reach in zip(blurs, reaches, strict=True)
        )
        return recorded / scene.sent(element)[0]

    return jax.lax.map(one, theta)
