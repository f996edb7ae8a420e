"""The response at the peak of an EPD lobe, from a table (announced by Holzschuch & Pacanowski 2017).

EPD is no mixture of Gaussians, so its response has no closed form. In the tangent plane, through Gaussian optics and a box
pixel, it depends on four parameters only (docs/model.md 4):

- size: of the lobe on the sensor over the kernel's width, max(s_x, s_y) sqrt(Gamma(1 + 1/p)) / width, with
  s = beta px_per_rad and width^2 = sigma^2 + half_width^2 / 3. Whatever the power, the loss begins at a size of about 1.
- ratio: the lobe's smaller over its larger size, cos theta_o on a sphere.
- share: of the pixel in the kernel's variance, half_width^2 / (half_width^2 + 3 sigma^2).
- power: p.

Tabulated is G = logit(response) - ln(narrow limit), where the limit is the response of a point of light. G is a cubic B-spline
in ln size, and a sum of Chebyshev polynomials in ln ratio, share and ln p. One dimension, and a cylinder, along whose axis
nothing changes, have a table of their own, without the ratio. `build_peak_tables` makes both; the file states their errors.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np

from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.pixel import BoxPixel
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.material.ndf.power_lobes import EPD
from matcam.rigs import Rig

FILE = "data/epd_peak.npz"

SIZES = {"plane": (0.004, 7000.0), "line": (6e-6, 7000.0)}
RATIOS = (float(np.cos(np.radians(89.9))), 1.0)
HALF_WIDTHS = (0.0, 2.5)
"""Range of half_width / sigma."""
POWERS = (0.3, 3.0)
_ROUNDING = 1e-12


class EPDOnSensor(NamedTuple):
    """An EPD lobe on the sensor, in units of the kernel; arrays that broadcast.

    Attributes:
        along: size towards the limb, in widths of the kernel.
        across: size across, in widths of the kernel.
        half_widths: the pixel's half width over the lens's standard deviation.
        power: the lobe's power p.
        peak: the kernel's peak times its width, in one dimension.
    """

    along: jax.Array
    across: jax.Array
    half_widths: jax.Array
    power: jax.Array
    peak: jax.Array

    @property
    def plane_size(self) -> jax.Array:
        """Return the table's size in two dimensions."""
        return jnp.maximum(self.along, self.across) * jnp.exp(jax.scipy.special.gammaln(1 + 1 / self.power) / 2)

    @property
    def line_size(self) -> jax.Array:
        """Return the table's size in one dimension: half the integral of the lobe."""
        return self.along * jnp.exp(jax.scipy.special.gammaln(1 + 1 / (2 * self.power)))

    @property
    def ratio(self) -> jax.Array:
        """Return the smaller over the larger size."""
        return jnp.minimum(self.along, self.across) / jnp.maximum(self.along, self.across)

    @property
    def share(self) -> jax.Array:
        """Return the pixel's share in the kernel's variance."""
        return self.half_widths**2 / (3 + self.half_widths**2)

    @property
    def narrow_plane(self) -> jax.Array:
        """Return ln of the response of a point of light.

        It is the lobe's integral times the kernel's peak.
        """
        ln_integral = jnp.log(jnp.pi * self.along * self.across) + jax.scipy.special.gammaln(1 + 1 / self.power)
        return ln_integral + 2 * jnp.log(self.peak)

    @property
    def narrow_line(self) -> jax.Array:
        """Return the same in one dimension."""
        return jnp.log(2 * self.line_size * self.peak)


def tabulated_peak(rig: Rig, ndf: EPD, theta_o: jax.Array, dims: int) -> jax.Array:
    """Return the response at an EPD lobe's peak in the tangent plane.

    Its error is below 1e-4.

    Args:
        rig: a rig with Gaussian optics in focus, box pixel and point lamp.
        ndf: the lobe.
        theta_o: viewing angle, rad, any shape.
        dims: 2, or 1 for the direction towards the limb alone.

    Returns:
        Response, of theta_o's shape; NaN where a traced value lies outside the table.

    Raises:
        ArgumentError: the rig is another, or a value lies outside the table; the message names it.
    """
    optics, pixel = rig.camera.optics, rig.camera.pixel
    if not (isinstance(optics, GaussianOptics) and isinstance(pixel, BoxPixel)):
        raise ArgumentError(
            "the peak of an EPD lobe is tabulated only for GaussianOptics and BoxPixel, this camera has "
            f"{type(optics).__name__} and {type(pixel).__name__}"
        )
    discs = _in_range("lamp_radius with an EPD lobe", rig.lamp_radius, (0, 0))
    discs += _in_range("aperture with an EPD lobe", rig.aperture, (0, 0))
    sigma = jnp.hypot(optics.sigma, rig.jitter)
    scale_x, scale_y = rig.px_per_rad(theta_o)
    if dims == 1:
        scale_y = jnp.full_like(scale_x, jnp.inf)
    # a size that is infinite is none: a line's response is left, or a flat sample's, which is 1
    plane, line = jnp.isfinite(scale_x) & jnp.isfinite(scale_y), jnp.isfinite(scale_x) & jnp.isinf(scale_y)
    width = jnp.sqrt(sigma**2 + pixel.half_width**2 / 3)
    along = ndf.beta * jnp.where(plane | line, scale_x, width) / width
    lobe = EPDOnSensor(
        along=along,
        across=jnp.where(plane, ndf.beta * jnp.where(plane, scale_y, width) / width, along),
        half_widths=_in_range("half_width / sigma with an EPD lobe", pixel.half_width / sigma, HALF_WIDTHS),
        power=_in_range("power of an EPD lobe whose peak is tabulated", ndf.power, POWERS),
        peak=width * pixel.of_gaussian(0.0, sigma),
    )
    size = "size of an EPD lobe on the sensor, in widths of the kernel,"
    plane_size = _in_range(size, jnp.where(plane, lobe.plane_size, 1.0), SIZES["plane"])
    line_size = _in_range(size, jnp.where(line, lobe.line_size, 1.0), SIZES["line"])
    ratio = _in_range("foreshortening (cos theta) of an EPD lobe", lobe.ratio, RATIOS)
    shared = lobe.share, jnp.log(lobe.power)
    in_plane = jax.nn.sigmoid(_table("plane").at(jnp.log(plane_size), jnp.log(ratio), shared) + lobe.narrow_plane)
    in_line = jax.nn.sigmoid(_table("line").at(jnp.log(line_size), None, shared) + lobe.narrow_line)
    return jnp.where(plane, in_plane, jnp.where(line, in_line, 1.0)) + discs


class PeakTable(NamedTuple):
    """G: a cubic B-spline in the first variable, Chebyshev polynomials in the others.

    Attributes:
        coefficients: (splines, degrees of each other variable).
        limits: ends of every variable's interval, (variables, 2).
    """

    coefficients: np.ndarray
    limits: np.ndarray

    def at(self, ln_size: jax.Array, ln_ratio: jax.Array | None, shared: tuple[jax.Array, ...]) -> jax.Array:
        """Return G; ln_size and ln_ratio have one shape, the shared variables are scalars."""
        table = jnp.asarray(self.coefficients)
        for variable, (low, high) in zip(shared[::-1], self.limits[:0:-1], strict=False):
            table = table @ chebyshev((2 * variable - low - high) / (high - low), table.shape[-1])
        (low, high), last = self.limits[0], table.shape[0] - 4
        place = (ln_size - low) / (high - low) * (last + 1)
        cell = jax.lax.stop_gradient(jnp.clip(jnp.floor(place), 0, last))
        x = place - cell
        spline = jnp.stack([(1 - x) ** 3, (3 * x - 6) * x**2 + 4, ((3 - 3 * x) * x + 3) * x + 1, x**3], axis=-1) / 6
        near = table[cell.astype(int)[..., None] + np.arange(4)]
        if ln_ratio is None:
            return jnp.sum(spline * near, axis=-1)
        low, high = self.limits[1]
        basis = chebyshev((2 * ln_ratio - low - high) / (high - low), table.shape[-1])
        return jnp.einsum("...k,...kn,...n->...", spline, near, basis)


def chebyshev(x: jax.Array, count: int) -> jax.Array:
    """Return T_0 to T_(count - 1) at x, on a last axis.

    The recurrence has a finite derivative at the ends.
    """
    basis = [jnp.ones_like(x), x]
    while len(basis) < count:
        basis.append(2 * x * basis[-1] - basis[-2])
    return jnp.stack(basis[:count], axis=-1)


def _in_range(name: str, value: jax.Array, allowed: tuple[float, float]) -> jax.Array:
    """Refuse a value outside `allowed`; a traced one is NaN there.

    Beyond an end by rounding, it is the end.
    """
    low, high = allowed
    value = jnp.where((value < low) & (value > low - _ROUNDING), low, value)
    value = checks.within(name, jnp.where((value > high) & (value < high + _ROUNDING), high, value), low, high)
    return jnp.where((value >= low) & (value <= high), value, jnp.nan)


@cache
def _table(name: str) -> PeakTable:
    with resources.files("matcam").joinpath(FILE).open("rb") as file, np.load(file, allow_pickle=False) as stored:
        return PeakTable(stored[name].astype(np.float64), stored[f"{name}_limits"])
