"""The blur of a rig: a sum of Gaussians, seen through the pixel in closed form, and the lengths that it sets.

- The lens is a sum of Gaussians (`camera/optics/gaussian_sum.py`). Registration jitter adds its variance to each.
- A lens out of focus spreads light over a disc. A lamp's disc spreads the half vector over an ellipse (docs/model.md 3). Both
  are taken as Gaussians with the disc's own standard deviation, a quarter of its diameter. They vary over the picture. On
  spheres a lamp's disc is a disc instead: records are means over its points, and a fit's operator has `lamp_lines`.
- Terms of about one width share the lengths of their integral: a `BlurGroup`.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.camera.optics.gaussian import gaussian_sum
from matcam.camera.pixel import PixelResponse
from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax, jnp
from matcam.lamp.lamps import closeness
from matcam.rigs import Rig
from matcam.sample.curved import Sphere
from matcam.sample.shape import Curved

STEEPEST = 0.1
"""Least cosine of theta_d by which a lamp's ellipse is stretched: there it is as long as the sample."""
_ONE_WIDTH = 1.4
"""Largest ratio of the standard deviations in a group."""
_SHARP = 0.7
"""Standard deviation, in half widths of the pixel, below which the pixel's borders show as steps."""


class Blur(eqx.Module):
    """All that spreads the light of a piece of surface over the sensor.

    Attributes:
        pixel: response of a pixel, through which the terms are seen.
        weights: shares of the terms, (terms,), no unit.
        stds: standard deviations of the terms, (terms,), px.
        lamp_radius: angular radius of the lamp's disc, rad.
        aperture: diameter of the entrance pupil over its distance, no unit.
        focus: angle of the normals in focus from the optical axis, rad.
        varies: True where lamp or focus add to the terms; the kernel then depends on the place.
    """

    pixel: PixelResponse
    weights: jax.Array
    stds: jax.Array
    lamp_radius: jax.Array
    aperture: jax.Array
    focus: jax.Array
    varies: bool = eqx.field(static=True)

    def spread(
        self, sample: Curved, normal_z: jax.Array, lamp_angle: jax.Array, lamp_nearness: jax.Array | None = None
    ) -> tuple[jax.Array, jax.Array]:
        """Return the variances, px^2, that focus and lamp add along x and y.

        They depend on the normal's z and on the lamp.
        """
        if not self.varies:
            return jnp.zeros(()), jnp.zeros(())
        circle = sample.radius * self.aperture * (normal_z - jnp.cos(self.focus))
        theta_d = sample.theta_d(lamp_angle, lamp_nearness)
        scale_x, scale_y = sample.px_per_rad(theta_d, lamp_nearness)
        quarter = self.lamp_radius / 4 * closeness(lamp_nearness, jnp.cos(theta_d))
        along = scale_x * quarter
        across = jnp.where(jnp.isinf(scale_y), 0.0, scale_y) * quarter
        across /= jnp.maximum(jnp.cos(theta_d), STEEPEST)
        defocus = circle**2 / 16
        return defocus + along**2, defocus + across**2

    def kernel(self, offset: jax.Array, term: int, variance: jax.Array) -> jax.Array:
        """Return one term along one axis, 1/px, at `offset` px from the pixel's centre."""
        return self.pixel.of_gaussian(offset, self._std(term, variance))

    def kernel_until(self, offset: jax.Array, term: int, variance: jax.Array) -> jax.Array:
        """Return the integral of `kernel` up to an offset, no unit."""
        return self.pixel.until_gaussian(offset, self._std(term, variance))

    def turned_kernel(
        self,
        x: jax.Array,
        y: jax.Array,
        term: int,
        variances: tuple[jax.Array, jax.Array],
        turn: tuple[jax.Array, jax.Array],
        nodes: int,
    ) -> jax.Array:
        """Return one term, 1/px^2, seen by a pixel that is turned against the axes of x and y.

        What is added along x and y is correlated on the pixel's own axes: along the wider one the pixel is integrated over,
        across it the rest of the Gaussian is in closed form.

        Args:
            x: offset from the pixel's centre, px, along the first axis of the variances.
            y: the same along the second.
            term: index of the term.
            variances: px^2, that lamp and focus add along x and y.
            turn: cosine and sine of the angle of the x axis against the pixel's rows.
            nodes: count of Gauss-Legendre nodes over the pixel, where anything is added.
        """
        cosine, sine = turn
        x, y = x * cosine - y * sine, x * sine + y * cosine
        if not self.varies:
            return self.kernel(x, term, jnp.zeros(())) * self.kernel(y, term, jnp.zeros(()))
        (along, across), own = variances, self.stds[term] ** 2
        var_x, var_y = own + along * cosine**2 + across * sine**2, own + along * sine**2 + across * cosine**2
        wider = var_x >= var_y
        first, second = jnp.where(wider, x, y), jnp.where(wider, y, x)
        variance = jnp.where(wider, var_x, var_y)
        slope = (along - across) * cosine * sine / variance
        std, rest = jnp.sqrt(variance), jnp.sqrt(jnp.where(wider, var_y, var_x) - slope**2 * variance)
        total: jax.Array | float = 0.0
        for node, weight in zip(*np.polynomial.legendre.leggauss(nodes), strict=True):
            at = node * self.pixel.half_width
            off = first - at
            share = weight * self.pixel.half_width * self.pixel.response(at)
            density = jnp.exp(-0.5 * (off / std) ** 2) / (np.sqrt(2 * np.pi) * std)
            total += share * density * self.pixel.of_gaussian(second - slope * off, rest)
        return jnp.asarray(total)

    def rule(self, term: int, variance: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the five-node Gauss rule of a term along one axis.

        Its weight function is the term's kernel. It is exact for polynomials of degree 9, and so for all that is smooth
        on the kernel's scale. Offsets (px) and weights stand on a trailing axis.
        """
        m2, m4, m6, m8 = self._moments(self._std(term, variance))
        a = (m2 * m8 - m4 * m6) / (m2 * m6 - m4**2)
        b = (a * m4 - m6) / m2
        root = jnp.sqrt(a**2 / 4 - b)
        inner, outer = a / 2 - root, a / 2 + root
        w_inner = (m4 - m2 * outer) / (2 * inner * (inner - outer))
        w_outer = (m4 - m2 * inner) / (2 * outer * (outer - inner))
        x, y = jnp.sqrt(inner), jnp.sqrt(outer)
        weights = jnp.stack([w_outer, w_inner, 1 - 2 * (w_inner + w_outer), w_inner, w_outer], axis=-1)
        return jnp.stack([-y, -x, 0 * x, x, y], axis=-1), weights

    def _std(self, term: int, variance: jax.Array) -> jax.Array:
        return jnp.sqrt(self.stds[term] ** 2 + variance) if self.varies else self.stds[term]

    def _moments(self, std: jax.Array) -> tuple[jax.Array, ...]:
        """Return the second to eighth moment of Gaussian and pixel together."""
        nodes, weights = (jnp.asarray(a) for a in np.polynomial.legendre.leggauss(32))
        at = nodes * self.pixel.half_width
        share = weights * self.pixel.half_width * self.pixel.response(at)
        p2, p4, p6, p8 = (share @ at**n for n in (2, 4, 6, 8))
        g2, g4, g6, g8 = (factor * std**n for factor, n in ((1, 2), (3, 4), (15, 6), (105, 8)))
        return (
            g2 + p2,
            g4 + 6 * g2 * p2 + p4,
            g6 + 15 * g4 * p2 + 15 * g2 * p4 + p6,
            g8 + 28 * g6 * p2 + 70 * g4 * p4 + 28 * g2 * p6 + p8,
        )

    def of_point(self) -> Blur:
        """Return the blur under a lamp without a disc."""
        varies = not (is_concrete(self.aperture) and float(self.aperture) == 0)
        return dataclasses.replace(self, lamp_radius=jnp.zeros(()), varies=varies)


class BlurTerms(eqx.Module):
    """Some terms of a blur, integrated over the same nodes.

    Attributes:
        blur: the whole blur.
        terms: indices of its terms.
    """

    blur: Blur
    terms: tuple[int, ...] = eqx.field(static=True)

    @property
    def weight(self) -> jax.Array:
        """Return the share of these terms in the blur."""
        return sum((self.blur.weights[term] for term in self.terms), jnp.zeros(()))


def blur_of(rig: Rig) -> Blur:
    """Return the blur of a rig."""
    lens = gaussian_sum(rig.camera.optics)
    uniform = all(is_concrete(a) and float(a) == 0 for a in (rig.lamp_radius, rig.aperture))
    return Blur(
        pixel=rig.camera.pixel,
        weights=lens.weights,
        stds=jnp.sqrt(lens.sigmas**2 + rig.jitter**2),
        lamp_radius=rig.lamp_radius,
        aperture=rig.aperture,
        focus=rig.focus,
        varies=not uniform,
    )


def kernel_error(rig: Rig) -> float:
    """Return the largest error of the lens's transfer function.

    Its sum of Gaussians makes it; 0 for Gaussian lenses.
    """
    return float(gaussian_sum(rig.camera.optics).total_error)


class Imaging(NamedTuple):
    """Hold what turns light into a record: a sample, its rig's blur, and how near the lamp is.

    Attributes:
        sample: the sample.
        blur: the blur.
        lamp_nearness: inverse of the lamp's distance, 1/radii; None: a distant lamp.
    """

    sample: Curved
    blur: Blur
    lamp_nearness: jax.Array | None = None


def imaging_of(rig: Rig, gaussian_disc: bool = False) -> Imaging:
    """Return the imaging of a rig whose sample is curved.

    The lamp's disc on a sphere is no part of it: its record is the mean over `lamp_points`. `gaussian_disc`: it is, as a
    Gaussian.
    """
    if not isinstance(rig.sample, Curved):
        raise ArgumentError(
            f"a record needs a curved sample, a Sphere or a Cylinder, not a {type(rig.sample).__name__}"
        )
    blur = blur_of(rig)
    if isinstance(rig.sample, Sphere) and not gaussian_disc:
        blur = blur.of_point()
    return Imaging(rig.sample, blur, rig.lamp.nearness)


class BlurScale(NamedTuple):
    """Lengths on the sensor, px, that terms of about one width set.

    Attributes:
        near: half the side of the square around the highlight in which the nodes go about the half vector.
        margin: distance from the ends of the light beyond which the surroundings of a pixel are smooth.
        reach: distance to which the kernel is followed.
        finest: standard deviation of the narrowest term, without the pixel.
        spacing: step of the grid that holds a record: it has nothing finer.
        cuts: offsets inside the reach at which the kernel must be cut to be smooth in between; () where it is smooth.
    """

    near: float
    margin: float
    reach: float
    finest: float
    spacing: float
    cuts: tuple[float, ...]


class BlurGroup(NamedTuple):
    """Terms of a blur of about one width, by index, and their lengths."""

    terms: tuple[int, ...]
    scale: BlurScale


def groups_of(blur: Blur, sample: Curved, turned: bool = False) -> tuple[BlurGroup, ...]:
    """Group the terms of a blur by width. Needs concrete values: ArgumentError inside jit.

    Where the pixel is turned against the plane of camera and lamp, lengths hold its corners.
    """
    lengths = [jax.lax.stop_gradient(a) for a in (blur.stds, blur.pixel.half_width, sample.radius, blur.lamp_radius)]
    if not all(is_concrete(a) for a in lengths):
        raise ArgumentError(
            "the rig's numbers set how its picture is integrated: call this outside of jax.jit and vmap"
        )
    stds, half = np.asarray(lengths[0]), float(lengths[1])
    widened = np.sqrt(stds**2 + _widest_spread(blur, sample))
    radius = float(lengths[2])
    if np.min(stds) >= radius:
        raise ArgumentError(
            f"the sample's radius must exceed the camera's blur, of standard deviation {np.min(stds):g} px, got {radius:g} px"
        )
    groups, left = [], list(np.argsort(stds))
    while left:
        together = [j for j in left if stds[j] <= _ONE_WIDTH * stds[left[0]]]
        groups.append(
            BlurGroup(tuple(int(j) for j in together), _scale(half, stds[together], widened[together], turned))
        )
        left = left[len(together) :]
    return tuple(groups)


def _scale(half: float, stds: np.ndarray, widened: np.ndarray, turned: bool) -> BlurScale:
    widest, narrowest = float(np.max(widened)), float(np.min(stds))
    std, finest = (float(np.hypot(s, half / np.sqrt(3))) for s in (widest, narrowest))
    corner = half * (np.sqrt(2) - 1) if turned else 0.0
    reach = half + 5.2 * widest + corner
    inner = max(half - 5.2 * widest, half / 4)
    return BlurScale(
        near=10 * std,
        margin=4.8 * std + corner,
        reach=reach,
        finest=narrowest,
        spacing=min(0.4 * narrowest, 0.36 * finest),
        cuts=(-half, -inner, inner, half) if narrowest < _SHARP * half else (),
    )


def _widest_spread(blur: Blur, sample: Curved) -> float:
    """Return the largest variance, px^2, that focus and lamp add anywhere."""
    if not blur.varies:
        return 0.0
    aperture, focus, lamp, radius = (
        float(jax.lax.stop_gradient(a)) for a in (blur.aperture, blur.focus, blur.lamp_radius, sample.radius)
    )
    depth = max(np.cos(focus), 1 - np.cos(focus))
    return (radius * aperture * depth / 4) ** 2 + (radius * lamp / 4 / STEEPEST) ** 2
