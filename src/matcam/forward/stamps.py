"""Small images of many single highlights: elliptical Gaussians through a Gaussian lens and a box pixel.

Lens and highlight combine to one Gaussian. If its axes are parallel to the pixel grid, its mean over a pixel is a
product of two differences of erf. Neighbouring pixels share their edges. For any other orientation, the Gaussian is the
product of a Gaussian in y and the conditional Gaussian in x, whose mean depends on y. The integral over x is again a
difference of erf. The integral over the height of the pixel is computed numerically, because its integrand is smooth.
"""

from __future__ import annotations

from functools import partial, reduce
from math import lgamma, log
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.pixel import BoxPixel
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax, jnp
from matcam.forward.integral.blur import blur_of
from matcam.lamp.lamps import checked_lamp_angles, closeness
from matcam.material.ndf.gaussian_lobe import GaussianNDF
from matcam.rigs import Rig
from matcam.sample.curved import Sphere

_ERROR = 1e-8
"""Largest error of the quadrature over the height of a pixel, relative to the density of the highlight, no unit."""
_NARROWEST = 0.2
"""Smallest total standard deviation, px, that the quadrature resolves. It is assumed for traced values."""
_LARGEST = 4096
"""Largest side of a stamp, px."""


class Highlights(NamedTuple):
    """Elliptical Gaussian highlights on the sensor.

    The values broadcast against each other, one entry per highlight.

    Attributes:
        flux: integral over each highlight, in the unit of radiance times px^2.
        x: position of the centre of each highlight to the right of the middle of the stamp, px. Pixel centres lie at
            integers if the size of the stamp is odd, and half way between integers if the size is even.
        y: position of the centre of each highlight above the middle of the stamp, px.
        std_along: standard deviation along the direction `angle`, without the blur of lens and pixel, >= 0, px.
        std_across: standard deviation perpendicular to the direction `angle`, without this blur, >= 0, px.
        angle: direction of each highlight from the x axis towards the y axis, rad. Default: None, along the rows of pixels,
            which is faster.

    Example:
        >>> matcam.forward.Highlights(flux=1.0, x=0.0, y=0.0, std_along=0.8, std_across=0.4).angle is None
        True
    """

    flux: ArrayLike
    x: ArrayLike
    y: ArrayLike
    std_along: ArrayLike
    std_across: ArrayLike
    angle: ArrayLike | None = None


def highlight_stamps(camera: Camera, size: int, highlights: Highlights) -> jax.Array:
    """Compute small images of Gaussian highlights.

    Row 0 is on top. The stamps are exact for highlights along the pixel grid. For any other direction, the error is below
    5e-7 of the peak if the total standard deviation is at least 0.2 px (tests).

    Args:
        camera: camera with a Gaussian lens, with or without a halo, and a box pixel.
        size: side of a stamp, in [1, 4096], px.
        highlights: the highlights; their broadcast shape gives the leading axes of the result.

    Returns:
        Images, (..., size, size), in units of flux per px^2. They are differentiable in all parameters, and can be computed
        inside jax.jit.

    Raises:
        ArgumentError: the lens or the pixel is of another kind, a value is out of its range or not finite, or shapes do not
            broadcast.

    Source:
        docs/model.md 2: the product of erf differences.

    Example:
        >>> camera = matcam.Camera(matcam.GaussianOptics(0.5))
        >>> pair = matcam.forward.Highlights(flux=1.0, x=[0.0, 0.3], y=0.0, std_along=0.8, std_across=0.4)
        >>> stamps = matcam.forward.highlight_stamps(camera, 9, pair)
        >>> print(stamps.shape, np.round(stamps.sum((1, 2)), 3))
        (2, 9, 9) [1. 1.]
    """
    lens = _gaussians(camera)
    checks.whole_number("size", size, 1, _LARGEST, unit="pixels")
    lights = _light_arrays(highlights)
    pixel: BoxPixel = camera.pixel  # type: ignore[assignment]
    edges = _PixelEdges(size, is_concrete(pixel.half_width) and float(pixel.half_width) == 0.5, pixel.half_width)
    draw = _aligned if lights.angle is None else partial(_rotated, _order(lens, lights))
    return reduce(jnp.add, (draw(edges, sigma, lights._replace(flux=weight * lights.flux)) for weight, sigma in lens))


def rig_highlights(
    rig: Rig, width: ArrayLike, lamp_angle: ArrayLike, azimuth: ArrayLike | None = None, *, reflectance: ArrayLike = 1.0
) -> Highlights:
    """Compute the highlights of a lobe on the sphere of a rig.

    The lobe is Gaussian, and the sphere is replaced by its tangent plane. The results include the effects of a near lamp or
    camera on irradiance and half vector. Source disc, defocus and registration jitter are each replaced by a Gaussian with
    the variance of the replaced blur. Masking is neglected.

    Args:
        rig: camera, sample and lamp; the sample is a `Sphere`. Lens and pixel do not affect the result.
        width: standard deviation of the lobe, rad, (0, 0.5].
        lamp_angle: angle between lamp and optical axis, seen from the sphere's centre, rad. The arguments `width`,
            `lamp_angle`, `azimuth` and `reflectance` broadcast.
        azimuth: azimuth of the lamp about the optical axis, in [-2 pi, 2 pi], rad. Default: None, the rig's
            `lamp_azimuth`, or 0, towards +x. Stamps of highlights with the azimuth 0 are faster to compute.
        reflectance: Fresnel term F of each highlight, no unit, >= 0. Default: 1.

    Returns:
        The highlights. Their x and y are relative to the optical axis; for `highlight_stamps`, subtract the positions of
        the centres of the stamps. Their flux is the integral of the radiance over the sensor, px^2/sr, for an irradiance
        of 1 at the sphere's centre on a surface that faces the lamp. The highlights are differentiable.

    Raises:
        ArgumentError: the sample is not a sphere, a value is out of its range, or a lamp is behind the sphere or inside
            the camera.

    Source:
        docs/model.md 4 and 10: the tangent plane.

    Example:
        >>> rig = matcam.Rig(matcam.rigs.merl().camera, matcam.Sphere(256.0, 20.0), matcam.NearLamp(28.0))
        >>> found = matcam.forward.rig_highlights(rig, 0.002, np.radians([20.0, 100.0]), np.radians(30.0))
        >>> print(np.round(found.x, 1), np.round(found.std_along, 2), np.round(found.std_across, 2))
        [ 40.1 174.5] [0.51 0.32] [0.51 0.49]
    """
    checks.instance("rig", rig, Rig, "rigs.merl()")
    sample, near = rig.sample, rig.lamp.nearness
    if not isinstance(sample, Sphere):
        raise ArgumentError(f"highlights of a rig need a Sphere, got a rig with a {type(sample).__name__}")
    lobe = checks.within("width", width, 0, GaussianNDF.largest, "rad", open_low=True)
    angle = checked_lamp_angles(lamp_angle, rig.lamp, sample.distance)
    share = checks.within("reflectance", reflectance, 0, np.inf, open_high=True)
    turn = rig.azimuths(azimuth)
    checks.broadcast_shape(width=lobe, lamp_angle=angle, azimuth=turn, reflectance=share)
    lobe, angle, share, turn = jnp.broadcast_arrays(lobe, angle, share, turn)
    u, theta_d = sample.highlight(angle, near), sample.theta_d(angle, near)
    x = sample.surface(u, jnp.zeros(())).x
    along, across = sample.px_per_rad(theta_d, near)
    # integral of the BRDF, F D / (4 cos^2), times cos and the relative irradiance, over the sensor; D cos integrates to 1
    flux = share * along * across * closeness(near, jnp.cos(theta_d)) ** 2 / (4 * jnp.cos(theta_d))
    by_lamp, by_lamp_across, _ = blur_of(rig).spread(sample, jnp.cos(u), angle, near)
    jitter = rig.jitter**2
    aligned = is_concrete(turn) and not np.any(np.asarray(turn))
    return Highlights(
        flux=flux,
        x=x * jnp.cos(turn),
        y=x * jnp.sin(turn),
        std_along=jnp.sqrt((lobe * along) ** 2 + by_lamp + jitter),
        std_across=jnp.sqrt((lobe * across) ** 2 + by_lamp_across + jitter),
        angle=None if aligned else turn,
    )


class _Lights(NamedTuple):
    """Parameters of highlights, broadcast to a common shape."""

    flux: jax.Array
    x: jax.Array
    y: jax.Array
    std_along: jax.Array
    std_across: jax.Array
    angle: jax.Array | None = None


def _light_arrays(highlights: Highlights) -> _Lights:
    if not isinstance(highlights, Highlights):
        raise ArgumentError(
            f"highlights must be Highlights(flux, x, y, std_along, std_across), got {type(highlights).__name__}"
        )
    values = {name: checks.number(name, getattr(highlights, name)) for name in ("flux", "x", "y")}
    for name in ("std_along", "std_across"):
        values[name] = checks.within(name, getattr(highlights, name), 0, np.inf, "px", open_high=True)
    if highlights.angle is not None:
        values["angle"] = checks.number("angle", highlights.angle)
    checks.broadcast_shape(**values)
    return _Lights(*jnp.broadcast_arrays(*values.values()))


class _PixelEdges(eqx.Module):
    """Edges of a row of pixels.

    Attributes:
        size: number of pixels.
        shared: True if neighbours share their edges, because the pixels are 1 px wide.
        half_width: half the width of a pixel, px.
    """

    size: int = eqx.field(static=True)
    shared: bool = eqx.field(static=True)
    half_width: jax.Array

    def positions(self) -> jax.Array:
        """Compute the edges, px from the middle: all shared edges, or all left edges followed by all right edges."""
        if self.shared:
            return jnp.arange(self.size + 1) - self.size / 2
        centres = jnp.arange(self.size) - (self.size - 1) / 2
        return jnp.concatenate([centres - self.half_width, centres + self.half_width])

    def differences(self, at_edges: jax.Array) -> jax.Array:
        """Subtract the values at the left edges of pixels from the values at their right edges, on the last axis."""
        if self.shared:
            return at_edges[..., 1:] - at_edges[..., :-1]
        return at_edges[..., self.size :] - at_edges[..., : self.size]


def _gaussians(camera: Camera) -> list[tuple[jax.Array, jax.Array]]:
    """List the weight and the standard deviation, px, of each Gaussian of the lens."""
    if not isinstance(camera, Camera):
        raise ArgumentError(f"camera must be a Camera (optics and pixel), got {type(camera).__name__}")
    if not isinstance(camera.pixel, BoxPixel):
        raise ArgumentError(f"stamps need a camera with a BoxPixel, got {type(camera.pixel).__name__}")
    parts = []
    for weight, part in camera.optics.components():
        if not isinstance(part, GaussianOptics):
            raise ArgumentError(f"stamps need GaussianOptics, with or without a halo, got {type(part).__name__}")
        parts.append((weight, part.sigma))
    return parts


def _order(lens: list[tuple[jax.Array, jax.Array]], lights: _Lights) -> int:
    """Choose the number of Gauss-Legendre nodes over the height of a pixel, for the narrowest Gaussian."""
    lengths = [jax.lax.stop_gradient(a) for a in (lights.std_along, lights.std_across, *(s for _, s in lens))]
    if all(is_concrete(a) for a in lengths) and lights.std_along.size:
        along, across, *sigmas = (np.min(np.asarray(a)) for a in lengths)
        narrowest = max(float(np.hypot(min(along, across), min(sigmas))), _NARROWEST)
    else:
        narrowest = _NARROWEST
    order = 2
    while _log_error(order, 1 / narrowest) > log(_ERROR):
        order += 1
    return order


def _log_error(order: int, length: float) -> float:
    """Compute the logarithm of the error bound of the Gauss-Legendre rule with n = `order` nodes.

    The integrand is f(t) = exp(-t^2 / 2) on an interval of `length`, and the error is relative to the length. The bound is
    length^(2n+1) n!^4 / ((2n+1) (2n)!^3) max |f^(2n)|, where f^(2n) is a derivative and max |f^(2n)| = (2n-1)!!.
    """
    n = order
    derivative = lgamma(2 * n + 1) - n * log(2) - lgamma(n + 1)
    return 2 * n * log(length) + 4 * lgamma(n + 1) - log(2 * n + 1) - 3 * lgamma(2 * n + 1) + derivative


@eqx.filter_jit
def _aligned(edges: _PixelEdges, sigma: jax.Array, lights: _Lights) -> jax.Array:
    positions = edges.positions()

    def mean(centre: jax.Array, std: jax.Array) -> jax.Array:
        unit = jnp.sqrt(2 * (std**2 + sigma**2))[..., None]
        steps = jax.scipy.special.erf((positions - centre[..., None]) / unit)
        return edges.differences(steps) / (4 * edges.half_width)

    rows = mean(-lights.y, lights.std_across)  # row 0 is on top
    return (lights.flux[..., None] * rows)[..., :, None] * mean(lights.x, lights.std_along)[..., None, :]


@eqx.filter_jit
def _rotated(order: int, edges: _PixelEdges, sigma: jax.Array, lights: _Lights) -> jax.Array:
    assert lights.angle is not None
    cos, sin = jnp.cos(lights.angle), jnp.sin(lights.angle)
    along, across = lights.std_along**2, lights.std_across**2
    yy = sigma**2 + along * sin**2 + across * cos**2
    xy = (along - across) * sin * cos
    determinant = (sigma**2 + along) * (sigma**2 + across)
    nodes, weights = (jnp.asarray(a) for a in np.polynomial.legendre.leggauss(order))
    centres = (edges.size - 1) / 2 - jnp.arange(edges.size)
    down = (centres[:, None] + edges.half_width * nodes) - lights.y[..., None, None]  # (..., rows, nodes)
    yy, slope = yy[..., None, None], (xy / yy)[..., None, None]
    share = lights.flux[..., None, None] * weights * jnp.exp(-(down**2) / (2 * yy)) / jnp.sqrt(2 * jnp.pi * yy)
    unit = jnp.sqrt(2 * determinant / yy[..., 0, 0])[..., None, None]
    middle = (lights.x[..., None, None] + slope * down) / unit
    positions = edges.positions() / unit
    steps = jax.scipy.special.erf(positions[..., None, :] - middle[..., None])  # (..., rows, nodes, edges)
    at_edges = jnp.sum(share[..., None] * steps, axis=-2)
    return edges.differences(at_edges) / (8 * edges.half_width)
