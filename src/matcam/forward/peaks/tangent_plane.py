"""The record of a specular lobe around its peak, in the tangent plane (docs/model.md 4).

At the peak a curved sample is replaced by its tangent plane: theta = theta_o + t / (r_s cos theta_o) (paper (7)). A lobe
that is a mixture of Gaussians arrives on the sensor as a mixture of Gaussians, stretched by the sample's `px_per_rad`.
Through Gaussian optics and a separable pixel each has a closed form, the product of

    b(u; s) = sqrt(2 pi) s pixel.of_gaussian(u, sqrt(s^2 + sigma^2)).

Any other lens is integrated over frequencies. On a sphere of 256 px the plane is good to 1e-5 up to 83 degrees for lobes
narrower than 0.002 rad, and to 2 % at 80 degrees for 0.05 rad.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx

from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.optics import Rule
from matcam.core.jax import AnyArray, jax, jnp
from matcam.material.ndf.distribution import MixtureNDF
from matcam.rigs import Rig

# Frequency rule for lenses without a closed form: crowded towards 0, where the widest Gaussians of a mixture live
_PANELS, _GRADE = 24, 4


@eqx.filter_jit
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
    (scale_x, scale_y), (lamp_x, lamp_y) = rig.sample.px_per_rad(theta_o), rig.lamp_spread(theta_o)
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
    rule = rig.camera.optics.frequency_rule(_PANELS, _GRADE)
    frequency = jnp.asarray(rule.frequency)
    transfer = rig.camera.transfer(frequency[:, None], frequency)
    return jax.lax.map(partial(_by_frequencies, rule, transfer, weights), lobe)


@eqx.filter_jit
def line_record(rig: Rig, ndf: MixtureNDF, theta_o: jax.Array) -> jax.Array:
    """Return the response at the peak in one dimension, (slices,).

    It is the paper's, towards the limb.
    """
    weights, widths = ndf.mixture()
    scale, lamp = rig.sample.px_per_rad(theta_o)[0], rig.lamp_spread(theta_o)[0]
    std, lamp = scale[:, None] * widths, _finite(scale * lamp)[:, None]
    camera = rig.camera
    if isinstance(camera.optics, GaussianOptics):
        return _gaussian_record(camera, jnp.zeros(()), std, lamp) @ weights
    rule = camera.optics.frequency_rule(_PANELS, _GRADE)
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
