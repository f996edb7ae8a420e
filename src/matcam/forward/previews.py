"""Previews of records by an approximation that is much faster than the exact computation.

- The radiance at the centres of pixels is the image of the sphere without a camera.
- The highlight is a sum of Gaussians in the tangent plane (docs/model.md 4). The lens is also a sum of Gaussians.
- The effect of the camera is the difference between recorded and true lobe, multiplied by the radiance at the peak. The
  effect is added to the image of the sphere.

Limb and terminator are therefore not blurred in a preview. The shape of the lobe on the sensor is that at the highlight. A
source disc is replaced by a Gaussian of the same variance, and the aperture of a rig is neglected. A program is compiled
once for all rigs with the same kinds of lens and pixel.
"""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from matcam.camera.camera import Camera
from matcam.camera.optics.halo import HaloOptics
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.core.results.labelled import named
from matcam.forward.integral.blur import blur_of
from matcam.forward.integral.scene import Scene, highlight_x
from matcam.lamp.lamps import NearLamp
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import NDF, MixtureNDF
from matcam.rigs import Rig
from matcam.sample.curved import Sphere

_MARGIN = 1.03
"""Half the side of a sphere's preview, in radii of the sphere."""
_STEEPEST = 1.56
"""Largest theta_d of a preview, rad. At pi / 2 no visible surface is lit."""
_LARGEST = 4096
"""Largest number of values along the side of a preview."""
_FAR = 1e8
"""Distance that replaces an infinite distance, in radii, so that near and distant rigs share a program."""


def response_preview(rig: Rig, ndf: NDF, theta: ArrayLike) -> jax.Array:
    """Compute an approximate response at the peak, for interactive use.

    `peak_response` is evaluated in the tangent plane, with the lens approximated by a sum of Gaussians. The error is
    1e-6 for a Gaussian lens with or without a halo, and 0.5 % for other lenses. A source disc is approximated by a
    Gaussian, with an error of 2 % for a disc as wide as the blur.

    Args:
        rig: camera, `Sphere` and lamp.
        ndf: the lobe, such as `GGX(0.01)`.
        theta: viewing angle of the highlight, in [0, pi/2), rad, (n,).

    Returns:
        Recorded peak divided by true peak, (n,), no unit.

    Raises:
        ArgumentError: an argument is out of its range or of the wrong kind.

    Source:
        docs/model.md 4.

    Example:
        >>> rig = matcam.rigs.merl()
        >>> fast = matcam.forward.response_preview(rig, matcam.GGX(0.01), np.array([0.0, 1.0]))
        >>> bool(np.allclose(fast, matcam.peak_response(rig, matcam.GGX(0.01), np.array([0.0, 1.0])), rtol=1e-6))
        True
    """
    rig = _checked_rig(rig, ndf)
    assert isinstance(ndf, MixtureNDF)
    angles: Any = np.ravel(checks.viewing_angle("theta", theta))
    return _responses(rig, ndf, angles)


def highlight_preview(
    material: Microfacet, rig: Rig, theta_d: float, half_side: float | None = None, points: int = 96
) -> xr.Dataset:
    """Simulate a close-up of the highlight, with and without the camera.

    The lobe is computed in the tangent plane. On a sphere of 60 px radius, the error is 1 % of the peak for lobes up to 0.05
    rad and angles up to 60 degrees. The error is larger if limb or terminator is in the image.

    Args:
        material: a metal or dielectric whose lobe is a sum of Gaussians, such as `GGX`, `Beckmann` or `GaussianNDF`.
        rig: camera, `Sphere` and lamp.
        theta_d: difference angle at the highlight, in [0, 1.56], rad.
        half_side: distance from the highlight to the border of the image, px. Default: None, four times the half width at
            half maximum of the recorded lobe.
        points: number of values along each side. Default: 96.

    Returns:
        Dataset over y and x, px from the highlight, x towards the lamp: `true` and `recorded` radiance of the middle
        channel, 1/sr, and `difference`, recorded minus true. `recorded` at a point is the value of a pixel that is
        centred at the point.

    Raises:
        ArgumentError: an argument is out of its range or of the wrong kind.

    Source:
        docs/model.md 3 and 4.

    Example:
        >>> metal = matcam.Microfacet(matcam.GGX(0.01), 0.9)
        >>> closeup = matcam.forward.highlight_preview(metal, matcam.rigs.merl(), theta_d=0.8, points=33)
        >>> float(closeup["recorded"].max()) < float(closeup["true"].max())
        True
    """
    rig, angle = _checked(material, rig, theta_d)
    given: Any = np.asarray(np.nan if half_side is None else float(checks.positive("half_side", half_side, "px")))
    # arrays of NumPy: each conversion by JAX would require a program
    positions: Any = np.linspace(-1, 1, _count("points", points, 3))
    side, true, recorded = (np.asarray(part) for part in _closeup(material, rig, angle, positions, given))
    offsets = positions * float(side)
    return _dataset(true, recorded, offsets, offsets, theta_d=float(theta_d))


def sphere_preview(material: Microfacet, rig: Rig, theta_d: float, side: int = 192) -> xr.Dataset:
    """Simulate a sphere under the lamp, with and without the camera.

    On a sphere of 60 px radius, the error away from limb and terminator is 1 % of the peak for lobes up to 0.1 rad and
    angles up to 60 degrees. For lobes of 0.3 rad the error is 3 %. A halo of 2 % of the light spreads limb and terminator
    far into the image; the error is then 1.5 %.

    Args:
        material: a metal or dielectric whose lobe is a sum of Gaussians, such as `GGX`, `Beckmann` or `GaussianNDF`.
        rig: camera, `Sphere` and lamp.
        theta_d: difference angle at the highlight, in [0, 1.56], rad.
        side: largest number of values along each side. If the sphere is wider than `side` pixels, a value covers several
            pixels. Default: 192.

    Returns:
        Dataset over y and x, px from the optical axis, x towards the lamp: `true` and `recorded` radiance of the middle
        channel, 1/sr, and `difference`, recorded minus true. A value is the mean over a square of `pixels_per_value` x
        `pixels_per_value` pixels. The attributes `largest` and `largest_difference` are the largest radiance and the
        largest absolute difference, 1/sr.

    Raises:
        ArgumentError: an argument is out of its range or of the wrong kind.

    Source:
        docs/model.md 3 and 4.

    Example:
        >>> metal = matcam.Microfacet(matcam.GGX(0.1), 0.9)
        >>> sphere = matcam.forward.sphere_preview(metal, matcam.rigs.merl(), theta_d=0.8, side=64)
        >>> sphere["recorded"].shape, sphere.attrs["pixels_per_value"]
        ((59, 59), 9)
    """
    rig, angle = _checked(material, rig, theta_d)
    side = _count("side", side, 8)
    width = 2 * float(rig.sample.radius) * _MARGIN  # type: ignore[attr-defined]
    block = int(np.ceil(width / side))
    block += 1 - block % 2  # an odd number, so that a value is centred on the optical axis
    count = 2 * int(np.ceil(width / block / 2 - 0.5)) + 1
    # a grid of one size for spheres of all sizes, because each size requires a program
    whole = np.arange(2 * (side // 2) + 1)
    at: Any = (whole - side // 2) * float(block)
    shown = slice((whole.size - count) // 2, (whole.size + count) // 2)
    size: Any = np.asarray(block)
    at, pair = at[shown], _sphere(material, rig, angle, at, size)
    true, recorded = (np.asarray(part)[shown, shown] for part in pair)
    return _dataset(true, recorded, at, at, theta_d=float(theta_d), pixels_per_value=block)


def _checked_rig(rig: Rig, ndf: object) -> Rig:
    """Check rig and lobe, and convert the rig to a near rig whose lens has a halo, so that all rigs share a program."""
    checks.instance("rig", rig, Rig, "rigs.merl()")
    if not isinstance(rig.sample, Sphere):
        raise ArgumentError(f"a preview needs a Sphere, got a {type(rig.sample).__name__}")
    if not isinstance(ndf, MixtureNDF):
        raise ArgumentError(
            f"a preview needs a lobe that is a sum of Gaussians, such as GGX(0.1), got {type(ndf).__name__}"
        )
    if rig.lamp_azimuth:
        raise ArgumentError(
            f"a preview needs a lamp towards +x, got the azimuth {rig.lamp_azimuth:g} rad: omit lamp_azimuth, or use "
            "peak_response or picture"
        )
    if float(rig.aperture) > 0:
        raise ArgumentError(
            f"a preview needs a rig without defocus over the depth of the sample, got aperture {float(rig.aperture):g}: omit "
            "aperture, or use peak_response or picture"
        )
    optics, sphere = rig.camera.optics, rig.sample
    if not isinstance(optics, HaloOptics):
        optics = HaloOptics(optics, 0.0, 1.0)
    lamp = rig.lamp
    if not isinstance(lamp, NearLamp):
        lamp = NearLamp(_FAR, math.tan(float(rig.lamp_radius)) * _FAR)
    camera = Camera(optics, rig.camera.pixel)
    return Rig(camera, Sphere(sphere.radius, _FAR if sphere.distant else sphere.distance), lamp, jitter=rig.jitter)


def _checked(material: Microfacet, rig: Rig, theta_d: float) -> tuple[Rig, Any]:
    checks.instance("material", material, Microfacet, "Microfacet(GGX(0.1), 0.9)")
    return _checked_rig(rig, material.ndf), np.asarray(float(checks.within("theta_d", theta_d, 0, _STEEPEST, "rad")))


def _mixture(material: Microfacet) -> MixtureNDF:
    ndf = material.ndf
    assert isinstance(ndf, MixtureNDF)
    return ndf


_NAMES = {
    "true": "BRDF of the material [1/sr]",
    "recorded": "BRDF as recorded [1/sr]",
    "difference": "recorded minus true [1/sr]",
}


def _dataset(true: np.ndarray, recorded: np.ndarray, x: np.ndarray, y: np.ndarray, **attributes: float) -> xr.Dataset:
    difference = recorded - true
    most = {"largest": max(true.max(), recorded.max()), "largest_difference": np.abs(difference).max()}
    values = {"true": true, "recorded": recorded, "difference": difference}
    data = xr.Dataset(
        {name: (("y", "x"), value) for name, value in values.items()},
        coords={"x": x, "y": y},
        attrs={**attributes, **{name: float(value) for name, value in most.items()}},
    )
    return named(data, _NAMES)


def _count(name: str, value: int, low: int) -> int:
    if not isinstance(value, int) or not low <= value <= _LARGEST:
        raise ArgumentError(f"{name} must be a whole number in [{low}, {_LARGEST}], got {value!r:.40}")
    return value


class _SumOfGaussians(eqx.Module):
    """Highlight on the sensor, as a sum over all pairs of a Gaussian of the lobe and a Gaussian of the lens.

    Attributes:
        weights: weights of the Gaussians of the lobe, (n,), no unit.
        std: standard deviations of these Gaussians along x and y, (n,) each, px.
        lens_weights: weights of the Gaussians of the lens, (k,), no unit.
        spread: combined standard deviations of lens, jitter and lamp along x and y, (k,) each, px.
    """

    weights: jax.Array
    std: tuple[jax.Array, jax.Array]
    lens_weights: jax.Array
    spread: tuple[jax.Array, jax.Array]


def _sum_of_gaussians(rig: Rig, ndf: MixtureNDF, theta: jax.Array) -> _SumOfGaussians:
    weights, widths = ndf.mixture()
    blur = blur_of(rig)
    scales, lamp = rig.px_per_rad(theta), rig.lamp_spread(theta)
    return _SumOfGaussians(
        weights,
        (scales[0] * widths, scales[1] * widths),
        blur.weights,
        (jnp.hypot(blur.stds, lamp[0] * scales[0]), jnp.hypot(blur.stds, lamp[1] * scales[1])),
    )


def _recorded_lines(rig: Rig, std: jax.Array, spread: jax.Array, at: jax.Array) -> jax.Array:
    """Compute the one-dimensional records of the Gaussians of a lobe, (..., k, n).

    The lens has k Gaussians, and the lobe has n Gaussians. Each Gaussian of the lobe has the peak 1.

    Args:
        rig: the rig.
        std: standard deviations of the Gaussians of the lobe, (n,), px.
        spread: combined standard deviations of lens, jitter and lamp, (k,), px.
        at: positions, px, (...).
    """
    total = jnp.hypot(std, spread[:, None])
    return jnp.sqrt(2 * jnp.pi) * std * rig.camera.pixel.of_gaussian(at[..., None, None], total)


@eqx.filter_jit
def _responses(rig: Rig, ndf: MixtureNDF, theta: jax.Array) -> jax.Array:
    def one(angle: jax.Array) -> jax.Array:
        lobe = _sum_of_gaussians(rig, ndf, angle)
        along, across = (
            _recorded_lines(rig, std, spread, jnp.zeros(())) for std, spread in zip(lobe.std, lobe.spread, strict=True)
        )
        return lobe.lens_weights @ (along * across) @ lobe.weights

    return jax.vmap(one)(theta)


@eqx.filter_jit
def _closeup(
    material: Microfacet, rig: Rig, theta: jax.Array, positions: jax.Array, half_side: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Compute half the side, px, and the true and the recorded lobe, (y, x), 1/sr.

    half_side: half the side, px; NaN: the default.
    """
    lobe = _sum_of_gaussians(rig, _mixture(material), theta)
    half_side = jnp.where(jnp.isnan(half_side), 4 * _recorded_width(rig, lobe), half_side)
    scene, position = _scene(material, rig, theta)
    peak = _middle(scene.sent(scene.sample.at(position, jnp.zeros(()))[0]))
    at = positions * half_side
    true = _product(lobe.weights, _lines(lobe.std[1], at), _lines(lobe.std[0], at))
    return half_side, peak * true, peak * _recorded(rig, lobe, at, at)


def _recorded_width(rig: Rig, lobe: _SumOfGaussians) -> jax.Array:
    """Estimate the half width at half maximum of the record along y, px, from the curvature of the lobe at the peak."""
    own = 1 / (lobe.weights @ (1 / lobe.std[1] ** 2))
    pixel = rig.camera.pixel.half_width**2 / 3
    return 1.18 * jnp.sqrt(own + jnp.min(lobe.spread[1]) ** 2 + pixel)


def _lines(std: jax.Array, at: jax.Array) -> jax.Array:
    return jnp.exp(-((at[:, None] / std) ** 2) / 2)


def _product(weights: jax.Array, down: jax.Array, across: jax.Array) -> jax.Array:
    return (down * weights) @ across.T


def _recorded(rig: Rig, lobe: _SumOfGaussians, x: jax.Array, y: jax.Array) -> jax.Array:
    across, down = (
        _recorded_lines(rig, std, spread, at) for std, spread, at in zip(lobe.std, lobe.spread, (x, y), strict=True)
    )
    return _sum(lobe, down, across)


def _sum(lobe: _SumOfGaussians, down: jax.Array, across: jax.Array) -> jax.Array:
    """Sum the products of one-dimensional records, (y, k, n) and (x, k, n), over the Gaussians of lens and lobe."""
    weighted = down * (lobe.lens_weights[:, None] * lobe.weights)
    return weighted.reshape(len(down), -1) @ across.reshape(len(across), -1).T


def _scene(material: Microfacet, rig: Rig, theta: jax.Array) -> tuple[Scene, jax.Array]:
    """Build the scene, and compute the position of its highlight on the x axis, px."""
    sample, near = rig.sample, rig.lamp.nearness
    assert isinstance(sample, Sphere)
    scene = Scene(material, sample, sample.lamp_angle(theta, near), near)
    return scene, highlight_x(sample, scene.lamp_angle, near)


def _middle(channels: jax.Array) -> jax.Array:
    return channels[..., channels.shape[-1] // 2]


@eqx.filter_jit
def _sphere(
    material: Microfacet, rig: Rig, theta: jax.Array, at: jax.Array, block: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Compute the true and the recorded image of the sphere, 1/sr, at the positions `at` along both axes, px.

    block: side of the square block of pixels whose mean is one value, px.
    """
    scene, position = _scene(material, rig, theta)
    x, y = at[None, :], at[:, None]
    element, lit = scene.shown(x, y)
    points = jnp.where(lit, _middle(scene.sent(element)), 0.0)
    peak = _middle(scene.sent(scene.sample.at(position, jnp.zeros(()))[0]))
    lobe = _sum_of_gaussians(rig, _mixture(material), theta)
    down, across = (at, at - position)
    centre = _product(lobe.weights, _lines(lobe.std[1], down), _lines(lobe.std[0], across))

    def add(pixel: jax.Array, sums: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        inside = pixel - (block - 1) / 2
        of_y, of_x = (
            _recorded_lines(rig, std, spread, where + inside)
            for std, spread, where in zip(lobe.std[::-1], lobe.spread[::-1], (down, across), strict=True)
        )
        return sums[0] + of_y, sums[1] + of_x

    # the mean over a block of pixels is separable, because the Gaussians are separable
    nothing = jnp.zeros((at.size, lobe.lens_weights.size, lobe.weights.size))
    mean_down, mean_across = (one / block for one in jax.lax.fori_loop(0, block, add, (nothing, nothing)))
    recorded = _sum(lobe, mean_down, mean_across)
    means = (_mean_lines(std, where, block) for std, where in zip(lobe.std[::-1], (down, across), strict=True))
    true = _product(lobe.weights, *means)
    left = points - peak * centre

    def sphere(changed: jax.Array) -> jax.Array:
        # the error of the tangent plane is assumed to be proportional to the lobe
        share = jnp.minimum(1.0, changed / jnp.maximum(centre, 1e-300))
        return jnp.maximum(left * share + peak * changed, 0.0)

    return jnp.where(lit, sphere(true), 0.0), sphere(recorded)


def _mean_lines(std: jax.Array, at: jax.Array, width: jax.Array) -> jax.Array:
    """Average Gaussians of peak 1 over intervals about positions, shape (positions, n). width: length of an interval, px."""
    ends = [jax.scipy.special.ndtr((at[:, None] + side * width / 2) / std) for side in (1, -1)]
    return jnp.sqrt(2 * jnp.pi) * std / width * (ends[0] - ends[1])
