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

from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.optics import Rule, checked_isotropic
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import AnyArray, is_concrete, jax, jnp
from matcam.core.programs import kept_program
from matcam.forward.integral.blur import BlurTerms, Imaging, imaging_of
from matcam.forward.integral.blur_groups import groups_of
from matcam.forward.integral.cylinder_discs import LinePlaces, line_record, places_under
from matcam.forward.integral.cylinder_record import light_at
from matcam.forward.integral.discs import LOBE, disc_fineness
from matcam.forward.integral.integrals import (
    HighlightPanels,
    record_around,
    record_around_turned,
)
from matcam.forward.integral.scene import Scene, Turn, highlight_x
from matcam.forward.peaks.disc_points import DiscPoints, has_discs, mean_over_discs
from matcam.forward.peaks.peak_tables import tabulated_peak
from matcam.lamp.lamps import Lamp, LampPoint, disc_of, lamp_points
from matcam.material.masking import MASKINGS, Masking
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import MixtureNDF, SlopeDistribution
from matcam.material.ndf.power_lobes import EPD
from matcam.rigs import Rig
from matcam.sample.curved import Cylinder
from matcam.sample.shape import Curved, Flat

# Frequency rule for lenses without a closed form: crowded towards 0, where the widest Gaussians of a mixture live
_FREQUENCY_PANELS, _GRADE = 24, 4
_VALUES = 1 << 20
"""Values of a lobe's Gaussians that are held at a time."""
_EVEN = 6
"""Panels of one length about an exact peak, in focus."""


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
    checked_isotropic(rig.camera.optics, "a prediction")
    theta_o, x, y = (jnp.asarray(a) for a in (theta_o, x, y))
    if not has_discs(rig):
        return _lobe_in_focus(rig, ndf, theta_o, x, y)

    def mean(slices: np.ndarray, points: DiscPoints) -> jax.Array:
        places = x[slices], y[slices]
        at = ((a[..., None] - p[:, None]).reshape(slices.size, -1) for a, p in zip(places, points[:2], strict=True))
        records = _lobe_in_focus(rig, ndf, theta_o[slices], *at)
        return records.reshape(*places[0].shape, -1) @ points.share

    return mean_over_discs(rig, theta_o, mean)


def response_across(rig: Rig, ndf: MixtureNDF, theta_o: jax.Array, one_plane: bool = False) -> jax.Array:
    """Return the response at the peak in one dimension, (slices,).

    It is the paper's, towards the limb. one_plane: whether only normals of that plane are there, as on a cylinder. A lamp's
    disc then turns the half vector away from all of them.
    """
    checked_isotropic(rig.camera.optics, "a prediction")
    if not has_discs(rig):
        return _line_in_focus(rig, ndf, theta_o, np.zeros((theta_o.size, 1)), None)[:, 0]

    def mean(slices: np.ndarray, points: DiscPoints) -> jax.Array:
        return _line_in_focus(rig, ndf, theta_o[slices], points.x, points.aside if one_plane else None) @ points.share

    roughness = jax.lax.stop_gradient(jnp.asarray(ndf.roughness))
    known = one_plane and is_concrete(roughness)
    return mean_over_discs(rig, theta_o, mean, LOBE * float(roughness) if known else np.inf)


@kept_program
def _lobe_in_focus(rig: Rig, ndf: MixtureNDF, theta_o: jax.Array, x: AnyArray, y: AnyArray) -> jax.Array:
    """Return the record of a lobe under a point lamp, through a lens in focus; see `lobe_record`."""
    weights, widths = ndf.mixture()
    scale_x, scale_y = rig.px_per_rad(theta_o)
    lobe = _SensorLobe(
        std_x=scale_x[:, None] * widths, std_y=scale_y[:, None] * widths, x=jnp.asarray(x), y=jnp.asarray(y)
    )
    if isinstance(rig.camera.optics, GaussianOptics):
        together = max(1, _VALUES // (lobe.x.shape[1] * widths.size))
        return jax.lax.map(partial(_product_of_closed_forms, rig, weights), lobe, batch_size=together)
    rule = rig.camera.optics.frequency_rule(_FREQUENCY_PANELS, _GRADE)
    frequency = jnp.asarray(rule.frequency)
    transfer = rig.camera.transfer(frequency[:, None], frequency)
    return jax.lax.map(partial(_by_frequencies, rule, transfer, weights, rig.jitter), lobe)


@kept_program
def _line_in_focus(rig: Rig, ndf: MixtureNDF, theta_o: jax.Array, x: AnyArray, aside: AnyArray | None) -> jax.Array:
    """Return the same in one dimension, at offsets from the peak, (slices, points).

    aside: angles by which the half vector misses the plane, rad, as x; None: it lies in it.
    """
    weights, widths = ndf.mixture()
    if aside is not None:
        weights = weights * jnp.exp(-0.5 * (aside[..., None] / widths) ** 2)
    std = rig.px_per_rad(theta_o)[0][:, None] * widths
    camera = rig.camera
    if isinstance(camera.optics, GaussianOptics):
        return _mixed(_gaussian_record(rig, jnp.asarray(x)[..., None], std[:, None]), weights)
    rule = camera.optics.frequency_rule(_FREQUENCY_PANELS, _GRADE)
    uniform = jnp.isinf(std)
    spectra = _gaussian_spectrum(rule, jnp.where(uniform, 1.0, std)[..., None], rig.jitter)
    lines = jnp.einsum("skf,f,spf->spk", spectra, camera.mtf(rule.frequency), _waves(rule, jnp.asarray(x)))
    return _mixed(jnp.where(uniform[:, None], 1.0, lines), weights)


def _mixed(records: jax.Array, weights: jax.Array) -> jax.Array:
    """Return the mixture of records, whose weights are the same everywhere, or of each point."""
    return records @ weights if weights.ndim == 1 else jnp.sum(records * weights, -1)


class _SensorLobe(NamedTuple):
    """A lobe on the sensor, px; the leading axis counts slices.

    Attributes:
        std_x: standard deviations of its Gaussians towards the limb, (slices, n).
        std_y: the same across.
        x: offsets at which it is recorded, towards the limb, (slices, points).
        y: the same across.
    """

    std_x: jax.Array
    std_y: jax.Array
    x: jax.Array
    y: jax.Array


def _product_of_closed_forms(rig: Rig, weights: jax.Array, lobe: _SensorLobe) -> jax.Array:
    along = _gaussian_record(rig, lobe.x[:, None], lobe.std_x)
    across = _gaussian_record(rig, lobe.y[:, None], lobe.std_y)
    return jnp.dot(along * across, weights)


def _gaussian_record(rig: Rig, u: jax.Array, std: jax.Array) -> jax.Array:
    """Return b(u; s), 1 where s is infinite.

    It is the record of a line with a Gaussian profile of unit peak.
    """
    uniform = jnp.isinf(std)
    std = jnp.where(uniform, 1.0, std)
    total = jnp.sqrt(std**2 + rig.camera.optics.sigma**2 + rig.jitter**2)  # type: ignore[attr-defined]
    return jnp.where(uniform, 1.0, jnp.sqrt(2 * jnp.pi) * std * rig.camera.pixel.of_gaussian(u, total))


def _by_frequencies(
    rule: Rule, transfer: jax.Array, weights: jax.Array, jitter: jax.Array, lobe: _SensorLobe
) -> jax.Array:
    """Return the same by a tensor rule over (fx, fy).

    The spectrum of the mixture is multiplied by the camera's transfer function.
    """
    along, across = (_gaussian_spectrum(rule, std[:, None], jitter) for std in (lobe.std_x, lobe.std_y))
    spectrum = jnp.einsum("j,ja,jb->ab", weights, along, across) * transfer
    return jnp.sum((_waves(rule, lobe.x) @ spectrum) * _waves(rule, lobe.y), axis=-1)


def _waves(rule: Rule, u: jax.Array) -> jax.Array:
    """Return what each frequency adds at offsets u, px; frequencies last."""
    return jnp.asarray(2 * rule.weight * jnp.cos(2 * jnp.pi * rule.frequency * u[..., None]))


def _gaussian_spectrum(rule: Rule, std: jax.Array, jitter: jax.Array) -> jax.Array:
    """Return the Fourier transform of a unit-peak Gaussian line of width `std` px, which jitter spreads further."""
    blur = jnp.exp(-2 * (jnp.pi * rule.frequency) ** 2 * (std**2 + jitter**2))
    return jnp.sqrt(2 * jnp.pi) * std * blur


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
    sample = rig.sample
    if dims == 1:
        return response_across(rig, ndf, theta)
    if isinstance(sample, Cylinder) and sample.distant and rig.lamp.nearness is None:
        return response_across(rig, ndf, theta, one_plane=True)  # every line across its axis is alike
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
    disc = disc_of(rig.lamp) > 0
    groups = groups_of(imaging.blur, imaging.sample, turned=disc)
    # lengths as arrays: what is compiled for one rig serves all of its kind
    reaches = jnp.asarray([group.scale.reach for group in groups])
    terms = tuple(BlurTerms(imaging.blur, group.terms) for group in groups)
    # a lens's disc reaches further than its blur, on whose scale the disc's border lies
    finer = max(group.scale.reach / group.scale.reach_in_focus for group in groups)
    even = _EVEN * int(np.exp2(np.ceil(np.log2(finer))))
    if not disc:
        return _responses(material, imaging, terms, reaches, theta, even)
    if not is_concrete(theta):
        raise ArgumentError("a lamp's disc sets how an exact peak is integrated: call this outside of jax.jit and vmap")
    lamps = np.asarray(imaging.sample.lamp_angle(theta, rig.lamp.nearness))
    if isinstance(rig.sample, Cylinder):
        return _responses_on_cylinder(material, rig, lamps)
    fineness = disc_fineness(rig, imaging, lamps, material)
    points = (_sampled_lamp(rig.lamp, *one) for one in zip(lamps, fineness, strict=True))
    return jnp.stack([_response_under_disc(material, imaging, terms, reaches, point, even) for point in points])


def _responses_on_cylinder(material: Microfacet, rig: Rig, lamp_angle: np.ndarray) -> jax.Array:
    """Return recorded over true peak under lamps with a disc before a cylinder."""
    sample, near = rig.sample, rig.lamp.nearness
    assert isinstance(sample, Cylinder)
    x = np.asarray(highlight_x(sample, jnp.asarray(lamp_angle), near))
    recorded = line_record(material, rig, LinePlaces(x, lamp_angle, np.zeros_like(x)))
    centre = places_under(x, np.zeros_like(x), LampPoint(lamp_angle, np.zeros_like(x), 1.0, 1.0), near)
    return recorded[:, 0] / light_at(material, sample, centre)[:, 0]


class _LampDisc(NamedTuple):
    """A lamp's disc as points.

    Attributes:
        angle: between the disc's centre and the optical axis, rad.
        angles: the same of its points, (points,).
        azimuths: of its points, rad.
        distances: of its points, over the centre's.
        shares: of its light; 0 where the points only fill the array up.
    """

    angle: np.ndarray
    angles: np.ndarray
    azimuths: np.ndarray
    distances: np.ndarray
    shares: np.ndarray


def _sampled_lamp(lamp: Lamp, angle: np.ndarray, fineness: float) -> _LampDisc:
    """Return the points of a lamp's disc, their count a power of 2: each is a program."""
    points = lamp_points(lamp, angle, 0.0, float(fineness))
    more = (1 << (len(points) - 1).bit_length()) - len(points)
    rows = [(p.angle, p.azimuth, p.distance, p.weight) for p in points]
    rows += [(*rows[-1][:3], 0.0)] * more
    return _LampDisc(np.asarray(angle), *np.array(rows, dtype=np.float64).T)


@kept_program
def _response_under_disc(
    material: Microfacet,
    imaging: Imaging,
    blurs: tuple[BlurTerms, ...],
    reaches: jax.Array,
    disc: _LampDisc,
    even: int,
) -> jax.Array:
    """Return recorded over true peak under a lamp's disc, the mean over its points."""
    sample, nearness = imaging.sample, imaging.lamp_nearness
    panels, at = HighlightPanels(graded=10, even=even, order=8), jnp.zeros(1)
    x = highlight_x(sample, disc.angle, nearness)

    def one(point: tuple[jax.Array, ...]) -> jax.Array:
        angle, azimuth, distance, share = point
        near = None if nearness is None else nearness / distance
        scene = Scene(material, sample, angle, near, Turn(jnp.cos(azimuth), jnp.sin(azimuth)))
        records = (
            record_around_turned(scene, blur, x[None], at, reach, panels)[0, 0, 0]
            for blur, reach in zip(blurs, reaches, strict=True)
        )
        return share * sum(records, jnp.zeros(()))

    recorded = jnp.sum(jax.lax.map(one, tuple(jnp.asarray(a) for a in disc[1:])))
    element, _ = sample.at(x, jnp.zeros(()))
    return recorded / Scene(material, sample, jnp.asarray(disc.angle), nearness).sent(element)[0]


@kept_program
def _responses(
    material: Microfacet,
    imaging: Imaging,
    blurs: tuple[BlurTerms, ...],
    reaches: jax.Array,
    theta: jax.Array,
    even: int,
) -> jax.Array:
    panels = HighlightPanels(graded=10, even=even, order=8)

    def one(angle: jax.Array) -> jax.Array:
        sample, near = imaging.sample, imaging.lamp_nearness
        scene = Scene(material, sample, sample.lamp_angle(angle, near), near)
        x = highlight_x(sample, scene.lamp_angle, near)
        element, _ = sample.at(x, jnp.zeros(()))
        centre = jnp.zeros(1)
        recorded = sum(
            record_around(scene, blur, x[None], centre, reach, panels)[0, 0, 0]
            for blur, reach in zip(blurs, reaches, strict=True)
        )
        return recorded / scene.sent(element)[0]

    return jax.lax.map(one, theta)
