"""Blur of a rig: a sum of Gaussians, integrated over the pixel in closed form, and a residual.

- The lens is a sum of Gaussians (`camera/optics/gaussian.py`) and a residual (`kernel_residual.py`). Registration jitter
  adds its variance to each Gaussian.
- A lens out of focus spreads light over a disc. A source disc spreads the half vector over an ellipse (docs/model.md
  3). Both effects vary over the image. In records of pixels and cells, defocus is integrated over chords of the disc.
  The kernel of a chord is a product of functions of x and y. A record is the mean over the points of the source disc. The
  operator of a fit represents the source disc by `lamp_lines`. Elsewhere, each disc is replaced by a Gaussian with the
  same standard deviation, a quarter of the diameter of the disc.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.camera.optics.gaussian import GaussianSum, few_gaussians, gaussian_sum, round_gaussians
from matcam.camera.optics.optics import Optics
from matcam.camera.pixel import PIXELS_SHARE, PixelResponse
from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax, jnp
from matcam.core.programs import kept_program
from matcam.forward.integral.kernel_residual import KernelResidual, kernel_residual
from matcam.lamp.lamps import STEEPEST, closeness
from matcam.numerics.blocks import in_blocks, in_calls
from matcam.numerics.disc_chords import COUNTS, Chords, chord_rule, chords_of, half_of
from matcam.rigs import Rig
from matcam.sample.curved import Sphere
from matcam.sample.shape import Curved

Line = Callable[[jax.Array], jax.Array]
"""Kernel along one axis, 1/px, as a function of the offset from the pixel's centre, px."""


class Spread(NamedTuple):
    """Contribution of defocus and source disc to a blur at a surface element.

    Attributes:
        along: variance along x, px^2.
        across: variance along y, px^2.
        disc: radius of the defocus disc, px; 0 if the variances include defocus.
    """

    along: jax.Array
    across: jax.Array
    disc: jax.Array


class Blur(eqx.Module):
    """Blur of a surface element on the sensor by lens, pixel, registration jitter, defocus and source disc.

    Attributes:
        pixel: response of a pixel, included in the terms.
        weights: shares of the Gaussians, (Gaussians,), no unit.
        stds: standard deviations of the Gaussians, (Gaussians,), px.
        lamp_radius: angular radius of the source disc, rad.
        aperture: diameter of the entrance pupil over its distance, no unit.
        focus: angle between the optical axis and the normals of the surface elements in focus, rad.
        varies: True if source disc or defocus contributes to the terms; the kernel then depends on the position.
        chords: number of chords of the defocus disc, one of `disc_chords.COUNTS`; 0: the disc is a Gaussian.
        residual: residual of the lens beyond its Gaussians, the last term; None: no residual.
    """

    pixel: PixelResponse
    weights: jax.Array
    stds: jax.Array
    lamp_radius: jax.Array
    aperture: jax.Array
    focus: jax.Array
    varies: bool = eqx.field(static=True)
    chords: int = eqx.field(static=True, default=0)
    residual: KernelResidual | None = None

    @property
    def terms(self) -> tuple[int, ...]:
        return tuple(range(self.stds.size + (self.residual is not None)))

    @property
    def std_of_half(self) -> float:
        """Standard deviation, px, of the Gaussian that the function `std_of_half` finds for the Gaussians of the blur."""
        return std_of_half(np.asarray(self.weights), np.asarray(self.stds))

    @property
    def even(self) -> bool:
        """True if the kernel is symmetric about the x axis."""
        return self.residual is None or self.residual.even

    def is_residual(self, term: int) -> bool:
        return term == self.stds.size

    def share(self, term: int) -> jax.Array:
        return jnp.ones(()) if self.is_residual(term) else self.weights[term]

    def only(self, terms: tuple[int, ...]) -> Blur:
        """Restrict the blur to some of the terms. Results with the same number of Gaussians share a compiled program."""
        index = np.array([term for term in terms if not self.is_residual(term)], dtype=int)
        residual = self.residual if any(map(self.is_residual, terms)) else None
        return dataclasses.replace(self, weights=self.weights[index], stds=self.stds[index], residual=residual)

    def spread(
        self, sample: Curved, normal_z: jax.Array, lamp_angle: jax.Array, lamp_nearness: jax.Array | None = None
    ) -> Spread:
        """Compute the contribution of defocus and source disc at a surface element.

        Args:
            sample: the sample.
            normal_z: z component of the normal of the element.
            lamp_angle: angle between lamp and optical axis, rad.
            lamp_nearness: inverse of the lamp's distance, 1/radii. Default: None, a distant lamp.
        """
        if not self.varies:
            return Spread(jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))
        disc = jnp.abs(self.defocus(sample.radius, normal_z))
        theta_d = sample.theta_d(lamp_angle, lamp_nearness)
        scale_x, scale_y = sample.px_per_rad(theta_d, lamp_nearness)
        quarter = self.lamp_radius / 4 * closeness(lamp_nearness, jnp.cos(theta_d))
        along = scale_x * quarter
        across = jnp.where(jnp.isinf(scale_y), 0.0, scale_y) * quarter
        across /= jnp.maximum(jnp.cos(theta_d), STEEPEST)
        if self.chords:
            return Spread(along**2, across**2, disc)
        return Spread(disc**2 / 4 + along**2, disc**2 / 4 + across**2, jnp.zeros(()))

    def defocus(self, radius: ArrayLike, normal_z: ArrayLike) -> jax.Array:
        """Compute the radius of the disc of a lens out of focus, px; negative behind the plane in focus.

        radius: radius of the sample, px. normal_z: z component of the normal of the surface element.
        """
        return jnp.asarray(radius) * self.aperture * (jnp.asarray(normal_z) - jnp.cos(self.focus)) / 2

    def at(self, term: int, spread: Spread, x: jax.Array, y: jax.Array) -> jax.Array:
        """Evaluate one term of the kernel without its weight, 1/px^2.

        x, y: offset of the pixel from the image of a surface element, px.
        """
        if self.residual is not None and self.is_residual(term):
            return self.residual.at(x, y, self._residual_variances(spread))
        return self.through_disc(term, spread, lambda along, across: along(x) * across(y))

    def across(self, term: int, spread: Spread, x: jax.Array) -> jax.Array:
        """Evaluate the integral along y of one term of the kernel without its weight, 1/px.

        x: offset of the pixel from the image of a surface element, px.
        """
        return self.through_disc(term, spread, lambda along, _: along(x))

    def through_disc(self, term: int, spread: Spread, of: Callable[[Line, Line], jax.Array]) -> jax.Array:
        """Sum a function over the separable kernels that make up one term of the kernel.

        Args:
            term: index of the term.
            spread: contribution of defocus and source disc.
            of: function of two one-dimensional kernels, along x and along y.
        """
        if self.is_residual(term):
            return self._through_residual(spread, of)
        if not self.chords:
            return of(lambda x: self.kernel(x, term, spread.along), lambda y: self.kernel(y, term, spread.across))
        # the difference over a chord of the smallest disc has 12 digits
        disc = jnp.maximum(spread.disc, 1e-4 * self.stds[term])

        def of_chord(chord: Chords) -> jax.Array:
            at, half, share = chord
            reach = half * disc

            def rows(y: jax.Array) -> jax.Array:
                ends = (self.kernel_until(y + side * reach, term, spread.across) for side in (1, -1))
                return (next(ends) - next(ends)) / (2 * reach)

            def columns(x: jax.Array) -> jax.Array:
                left, right = (self.kernel(x + side * at * disc, term, spread.along) for side in (1, -1))
                return left + right

            return jnp.asarray(share) * of(columns, rows)

        chords = jax.tree.map(jnp.asarray, half_of(chords_of(self.chords)))
        first = of_chord(jax.tree.map(lambda a: a[0], chords))
        others = jax.tree.map(lambda a: a[1:], chords)
        return jax.lax.scan(lambda total, chord: (total + of_chord(chord), None), first, others)[0]

    def _through_residual(self, spread: Spread, of: Callable[[Line, Line], jax.Array]) -> jax.Array:
        """Sum a function over the separable kernels of the residual.

        Discs are replaced by Gaussians, because the residual is small.
        """
        residual, (along, across) = self.residual, self._residual_variances(spread) or (None, None)
        assert residual is not None

        def of_product(lines: jax.Array) -> jax.Array:
            return of(lambda x: residual.line(lines[0], x, along), lambda y: residual.line(lines[1], y, across))

        first = of_product(residual.lines[0])
        return jax.lax.scan(lambda total, lines: (total + of_product(lines), None), first, residual.lines[1:])[0]

    def _residual_variances(self, spread: Spread) -> tuple[jax.Array, jax.Array] | None:
        if not self.varies:
            return None
        return spread.along + spread.disc**2 / 4, spread.across + spread.disc**2 / 4

    def kernel(self, offset: jax.Array, term: int, variance: jax.Array) -> jax.Array:
        """Evaluate one term along one axis, 1/px, at `offset` px from the centre of the pixel.

        variance: variance of source disc and defocus along the axis, px^2.
        """
        return self.pixel.of_gaussian(offset, self._std(term, variance))

    def kernel_until(self, offset: jax.Array, term: int, variance: jax.Array) -> jax.Array:
        return self.pixel.until_gaussian(offset, self._std(term, variance))

    def turned_kernel(
        self,
        x: jax.Array,
        y: jax.Array,
        term: int,
        spread: Spread,
        turn: tuple[jax.Array, jax.Array],
        nodes: int,
    ) -> jax.Array:
        """Evaluate one term, 1/px^2, for a pixel that is rotated relative to the axes of x and y.

        The variances that a source disc adds along x and y result in a covariance along the axes of the pixel. The
        integral over the pixel is computed numerically along the axis with the larger variance. Along the other axis,
        the conditional Gaussian has a closed form. The disc of a lens out of focus is the same on all axes.

        Args:
            x: offset from the pixel's centre along the first axis of the variances, px.
            y: offset from the pixel's centre along the second axis of the variances, px.
            term: index of the term.
            spread: contribution of defocus and source disc. If the blur has chords, the variances must be 0.
            turn: cosine and sine of the angle between the x axis and the rows of pixels.
            nodes: number of Gauss-Legendre nodes over the pixel.
        """
        cosine, sine = turn
        x, y = x * cosine - y * sine, x * sine + y * cosine
        if self.chords or not self.varies:
            return self.at(term, spread, x, y)
        along, across, own = spread.along, spread.across, self.stds[term] ** 2
        var_x, var_y = own + along * cosine**2 + across * sine**2, own + along * sine**2 + across * cosine**2
        wider = var_x >= var_y
        first, second = jnp.where(wider, x, y), jnp.where(wider, y, x)
        variance = jnp.where(wider, var_x, var_y)
        slope = (along - across) * cosine * sine / variance
        std, other_std = jnp.sqrt(variance), jnp.sqrt(jnp.where(wider, var_y, var_x) - slope**2 * variance)
        total: jax.Array | float = 0.0
        for node, weight in zip(*np.polynomial.legendre.leggauss(nodes), strict=True):
            at = node * self.pixel.half_width
            off = first - at
            share = weight * self.pixel.half_width * self.pixel.response(at)
            density = jnp.exp(-0.5 * (off / std) ** 2) / (np.sqrt(2 * np.pi) * std)
            total += share * density * self.pixel.of_gaussian(second - slope * off, other_std)
        return jnp.asarray(total)

    def plane_rule(self, term: int, spread: Spread) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Compute a quadrature rule for smooth radiance times a term.

        The results are offsets along x and y, px, and weights, (..., nodes).
        """
        if self.residual is not None and self.is_residual(term):
            return self.residual.nodes()
        (dx, x_weight), (dy, y_weight) = (self.rule(term, added) for added in (spread.along, spread.across))
        shape = (*jnp.broadcast_shapes(dx.shape[:-1], dy.shape[:-1]), -1)
        dx, dy = (a.reshape(shape) for a in jnp.broadcast_arrays(dx[..., None, :], dy[..., :, None]))
        return dx, dy, (y_weight[..., :, None] * x_weight[..., None, :]).reshape(shape)

    def rule(self, term: int, variance: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Compute the five-node Gauss rule of a term along one axis.

        The weight function of the rule is the kernel of the term. The rule is exact for polynomials of degree 9, and
        therefore accurate for radiance that is smooth on the scale of the kernel. The results are offsets, px, and
        weights, (..., 5). variance: additional variance, px^2.
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
        """Compute the moments of orders 2, 4, 6 and 8 of the convolution of Gaussian and pixel, px^order."""
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
        """Build the blur without the source disc."""
        varies = self.chords > 0 or not (is_concrete(self.aperture) and float(self.aperture) == 0)
        return dataclasses.replace(self, lamp_radius=jnp.zeros(()), varies=varies)


def variances_at(
    blur: Blur, sample: Curved, normal_z: np.ndarray, lamp_angle: np.ndarray, lamp_nearness: jax.Array | None
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the variances of `Blur.spread` along x and y at many elements, px^2.

    The other arguments are those of `spread`.
    """
    if not blur.varies:
        return np.zeros(normal_z.shape), np.zeros(normal_z.shape)
    along, across = in_calls(_variance_blocks, (normal_z, lamp_angle), blur.only(()), sample, lamp_nearness)
    return along, across


@kept_program
def _variance_blocks(
    used: jax.Array, rows: tuple[jax.Array, ...], blur: Blur, sample: Curved, lamp_nearness: jax.Array | None
) -> tuple[jax.Array, jax.Array]:
    def block(elements: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, ...]:
        normal_z, angle = elements
        variances = blur.spread(sample, normal_z, angle, lamp_nearness)[:2]
        return tuple(jnp.broadcast_to(one, angle.shape) for one in variances)

    return in_blocks(block, used, rows)


def std_of_half(weights: np.ndarray, stds: np.ndarray) -> float:
    """Compute the standard deviation of the Gaussian with the same half-value frequency as a sum of Gaussians, px.

    At the half-value frequency, the transfer function is one half. The variance of the sum is an unsuitable measure of the
    width, because the faint tails of an ideal lens dominate it.
    """
    if stds.size == 1:
        return float(stds[0])
    frequency = np.geomspace(0.01 / stds.max(), 2 / stds.min(), 2000)
    passed = np.exp(-2 * (np.pi * frequency[:, None] * stds) ** 2) @ weights / weights.sum()
    return float(np.sqrt(np.log(2) / 2) / (np.pi * frequency[np.argmax(passed < 0.5)]))


def blur_of(rig: Rig, *, in_discs: bool = False, whole: bool = False, residual: KernelResidual | None = None) -> Blur:
    """Build the blur of a rig.

    Args:
        rig: the rig.
        in_discs: True if defocus is described by discs. Default: False, by Gaussians.
        whole: True to include the residual of the lens beyond its Gaussians as a term. The lens then need not be isotropic.
            Default: False.
        residual: residual to include; it may belong to a lens with slightly different parameters. Default: None, the
            residual of the lens of the rig.
    """
    optics = rig.camera.optics
    lens = _with_residual(optics) if whole else gaussian_sum(optics)
    uniform = all(is_concrete(a) and float(a) == 0 for a in (rig.lamp_radius, rig.aperture))
    return Blur(
        pixel=rig.camera.pixel,
        weights=lens.weights,
        stds=jnp.sqrt(lens.sigmas**2 + rig.jitter**2),
        lamp_radius=rig.lamp_radius,
        aperture=rig.aperture,
        focus=rig.focus,
        varies=not uniform,
        chords=_chords(rig, lens) if in_discs else 0,
        residual=(residual or kernel_residual(optics, rig.camera.pixel, lens, rig.jitter)) if whole else None,
    )


def _with_residual(optics: Optics) -> GaussianSum:
    """Approximate a lens by Gaussians, for a blur that adds the residual of this approximation.

    More Gaussians are used if parameters are traced, because derivatives neglect the residual.
    """
    known = all(map(is_concrete, jax.tree.leaves(optics)))
    return few_gaussians(optics) if known else round_gaussians(optics)


def _chords(rig: Rig, lens: GaussianSum) -> int:
    """Choose the number of chords of the disc out of focus; 0 if the aperture is 0 or parameters are traced."""
    sample: Any = rig.sample
    own = rig.aperture, rig.focus, sample.radius, lens.sigmas, rig.jitter, rig.camera.pixel.half_width
    numbers = [jax.lax.stop_gradient(a) for a in own]
    if not all(is_concrete(a) for a in numbers) or float(numbers[0]) == 0:
        return 0
    aperture, focus, radius, sigmas, jitter, half = (np.asarray(a) for a in numbers)
    widest = radius * aperture * max(np.cos(focus), 1 - np.cos(focus)) / 2
    ratio = widest / np.hypot(np.hypot(sigmas.min(), jitter), PIXELS_SHARE * half)
    return COUNTS[int(chord_rule(ratio, ratio))]


def kernel_error(rig: Rig) -> float:
    """Compute the largest error of the transfer function of a record, no unit; 0 for Gaussian lenses."""
    if not isinstance(rig.sample, Sphere):
        return float(gaussian_sum(rig.camera.optics).total_error)
    residual = blur_of(rig, whole=True).residual
    return 0.0 if residual is None else float(residual.error)


class Imaging(NamedTuple):
    """Sample, blur and lamp distance of a record.

    Attributes:
        sample: the sample.
        blur: the blur.
        lamp_nearness: inverse of the lamp's distance, 1/radii; None: a distant lamp.
    """

    sample: Curved
    blur: Blur
    lamp_nearness: jax.Array | None = None


def imaging_of(rig: Rig, gaussian_disc: bool = False) -> Imaging:
    """Build the imaging of a rig whose sample is curved.

    By default, the blur does not include the source disc, because the record is the mean over `lamp_points`.

    gaussian_disc: True to include the source disc, and the disc of a lens out of focus, as Gaussians in the blur.
    """
    if not isinstance(rig.sample, Curved):
        raise ArgumentError(
            f"a record needs a curved sample, a Sphere or a Cylinder, got a {type(rig.sample).__name__}"
        )
    blur = blur_of(rig, in_discs=not gaussian_disc, whole=not gaussian_disc and isinstance(rig.sample, Sphere))
    if not gaussian_disc:
        blur = blur.of_point()
    return Imaging(rig.sample, blur, rig.lamp.nearness)
