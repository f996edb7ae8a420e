"""Lenses: point spread functions before integration over a pixel (docs/model.md 2).

A kernel without a closed form is the inverse Fourier transform of a band-limited transfer function. It is computed by
Gauss-Legendre quadrature on panels. Kernels are real, so the positive half of the frequencies suffices. The kernels of
isotropic lenses are also even, so cosines suffice. With 16 nodes per panel and at most one period per panel, the error is
below 1e-12 of the peak of the kernel.
"""

from __future__ import annotations

import inspect
from abc import abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from matcam.camera.parameters import fields_of
from matcam.core import checks
from matcam.core.arrays import compiled_by_jax, first_axis_map, is_concrete, xp
from matcam.core.arrays.elementary import plane_length
from matcam.core.arrays.module import Module, constructor_call
from matcam.core.errors import ArgumentError
from matcam.numerics.approximation import nodes_between, nodes_in_panels

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import AnyArray, jax

ORDER = 16
"""Number of nodes per panel: for at most one period per panel the error is below 1e-12 of the peak of the kernel."""


Transfer = Callable[["jax.Array", "jax.Array"], "jax.Array"]


class Wave(NamedTuple):
    """Factors with which the real part (`even`) and the imaginary part (`odd`) of a transfer function enter a kernel.

    Both are functions of the frequency, cycles/px, and of the position, px.
    """

    even: Callable[[jax.Array, jax.Array], jax.Array]
    odd: Callable[[jax.Array, jax.Array], jax.Array]


class Rule(NamedTuple):
    """Nodes f (cycles/px, >= 0) and weights of a quadrature over the band of a transfer function."""

    frequency: AnyArray
    weight: AnyArray


def piecewise_rule(edges: np.ndarray) -> Rule:
    """Build a Gauss-Legendre rule with `ORDER` nodes on each panel between consecutive edges."""
    return Rule(*nodes_in_panels(edges, ORDER))


def split_rule(borders: np.ndarray, knots: np.ndarray) -> Rule:
    """Build a Gauss-Legendre rule on panels that are split at knots.

    The number of nodes of a piece is `ORDER` times its share of the panel, rounded up, plus 3, but at most `ORDER`.
    """
    edges = np.union1d(borders, knots)
    left, right, widths = edges[:-1], edges[1:], np.diff(edges)
    panel = np.clip(np.searchsorted(borders, left, side="right") - 1, 0, borders.size - 2)
    orders = np.clip(np.ceil(ORDER * widths / np.diff(borders)[panel]) + 3, 0, ORDER).astype(int)
    parts = [nodes_between(left[orders == n], right[orders == n], n) for n in np.unique(orders)]
    return Rule(*(np.concatenate([a.ravel() for a in arrays]) for arrays in zip(*parts, strict=True)))


def panels_for(reach: float, band: float) -> int:
    """Compute the number of panels over [0, band] that resolve a kernel.

    reach: largest distance of a position, px. band: band of the lens, cycles/px.
    """
    return 6 + int(np.ceil(reach * band))


def reach_of(*positions: jax.Array) -> float:
    """Compute the largest modulus of coordinates, px.

    It is assumed to be 64 px if a coordinate is traced.
    """
    if not all(is_concrete(p) for p in positions):
        return 64.0
    return float(max((np.max(np.abs(p)) for p in positions if p.size), default=0.0))


def line_kernel(rule: Rule, transfer: Transfer, x: jax.Array, angle: jax.Array) -> jax.Array:
    """Compute the kernel on a line, 1/px.

    It is the integral of transfer(f, angle) exp(2 pi i f x) df over all frequencies f. x: positions, px; broadcasts with
    angle. angle: directions, rad.
    """
    return _over_frequencies(_LINE, rule, transfer, x, angle)


def step_response(rule: Rule, transfer: Transfer, x: jax.Array, angle: jax.Array) -> jax.Array:
    """Integrate `line_kernel` from -infinity to x, no unit."""
    return 0.5 + _over_frequencies(_STEP, rule, transfer, x, angle)


def plane_kernel(rule: Rule, transfer: Transfer, x: jax.Array, y: jax.Array, turns: int) -> jax.Array:
    """Compute an even kernel in the plane, 1/px^2.

    transfer(f, angle) must be even in both components of the frequency. The nodes form a polar grid with `turns` angles in
    a quarter turn.
    """
    # the trapezoidal rule on a full period is exact to rounding; over a quarter its two ends have half the weight
    angle = xp.linspace(0, xp.pi / 2, turns + 1)
    ends = np.ones(turns + 1)
    ends[[0, -1]] = 0.5
    frequency = xp.asarray(rule.frequency)[:, None]
    area = (rule.weight * rule.frequency)[:, None] * ends * (xp.pi / 2 / turns)
    amplitude = 4 * area * transfer(frequency, angle)
    return _plane_sum(frequency * xp.cos(angle), frequency * xp.sin(angle), amplitude, *xp.broadcast_arrays(x, y))


def directed_plane_kernel(rule: Rule, transfer: Transfer, x: jax.Array, y: jax.Array, turns: int) -> jax.Array:
    """Compute a real kernel in the plane, which need not be even, 1/px^2.

    The arguments are those of `plane_kernel`, but transfer(f, angle) need not be even.
    """
    angle = xp.arange(2 * turns) * (xp.pi / 2 / turns)  # half a turn; the other half is its complex conjugate
    frequency = xp.asarray(rule.frequency)[:, None]
    amplitude = rule.weight[:, None] * frequency * (xp.pi / turns) * transfer(frequency, angle)
    waves = frequency * xp.cos(angle), frequency * xp.sin(angle)
    return _directed_plane_sum(*waves, amplitude, *xp.broadcast_arrays(x, y))


def turns_for(reach: float, band: float) -> int:
    """Compute the number of angles per quarter turn that resolve a kernel.

    reach: largest distance of a position, px. band: band of the lens, cycles/px. According to the Jacobi-Anger
    expansion, the number of angles in a full turn must exceed 2 pi band reach.
    """
    return 16 + int(np.ceil((2 * np.pi * band * reach) / 4 * 1.1))


def _step_even(f: jax.Array, x: jax.Array) -> jax.Array:
    # sin(2 pi f x) / (pi f), in a form that is regular at f = 0
    return 2 * x * xp.sinc(2 * f * x)


_LINE = Wave(lambda f, x: 2 * xp.cos(2 * xp.pi * f * x), lambda f, x: -2 * xp.sin(2 * xp.pi * f * x))
_STEP = Wave(_step_even, lambda f, x: xp.cos(2 * xp.pi * f * x) / (xp.pi * f))  # no node lies at f = 0


def _over_frequencies(wave: Wave, rule: Rule, transfer: Transfer, x: jax.Array, angle: jax.Array) -> jax.Array:
    frequency, weight = xp.asarray(rule.frequency), xp.asarray(rule.weight)
    if angle.ndim == 0:
        return _line_sum(wave, frequency, weight * transfer(frequency, angle), x)

    def at(x: jax.Array, angle: jax.Array) -> jax.Array:
        return _summed(wave, frequency, weight * transfer(frequency, angle[:, None]), x)

    return _at_each(at, *xp.broadcast_arrays(x, angle))


def _summed(wave: Wave, frequency: jax.Array, amplitude: jax.Array, x: jax.Array) -> jax.Array:
    """Sum the contributions of all frequencies to a kernel at positions x, px, (n,).

    amplitude: weighted transfer function in one direction, (frequencies,), or in a direction for each position,
    (n, frequencies).
    """
    total = xp.sum(wave.even(frequency, x[:, None]) * amplitude.real, axis=-1)
    if not xp.iscomplexobj(amplitude):
        return total
    return total + xp.sum(wave.odd(frequency, x[:, None]) * amplitude.imag, axis=-1)


# The sums are functions of arrays alone, so that lenses share compiled programs.


@partial(compiled_by_jax, static=(0,))
def _line_sum(wave: Wave, frequency: jax.Array, amplitude: jax.Array, x: jax.Array) -> jax.Array:
    return _at_each(lambda x: _summed(wave, frequency, amplitude, x), x)


@compiled_by_jax
def _plane_sum(fx: jax.Array, fy: jax.Array, amplitude: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    def at(x: jax.Array, y: jax.Array) -> jax.Array:
        waves = (xp.cos(2 * xp.pi * f * at[:, None, None]) for f, at in ((fx, x), (fy, y)))
        return xp.sum(next(waves) * next(waves) * amplitude, axis=(1, 2))

    return _at_each(at, x, y)


@compiled_by_jax
def _directed_plane_sum(fx: jax.Array, fy: jax.Array, amplitude: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    def at(x: jax.Array, y: jax.Array) -> jax.Array:
        turn = 2 * xp.pi * (fx * x[:, None, None] + fy * y[:, None, None])
        return xp.sum(xp.cos(turn) * amplitude.real - xp.sin(turn) * amplitude.imag, axis=(1, 2))

    return _at_each(at, x, y)


def _at_each(function: Callable[..., jax.Array], *positions: jax.Array) -> jax.Array:
    """Apply a function whose positions have the shape (n,) to positions of any shape."""
    flat = tuple(p.ravel() for p in positions)
    # 64 positions are evaluated at once, which limits memory
    return first_axis_map(function, flat, 64).reshape(positions[0].shape)


class Optics(Module):
    """Lens without the pixel.

    Most lenses blur isotropically and without shift, so that an MTF, a function of one frequency, describes them. For
    other lenses `isotropic` is false, and the transfer function `otf` is complex. Positions are relative to the image
    of the point, x to the right and y upwards.

    Three kernels are called PSF: the *optical* kernel (this type), the *pixel response* (`PixelResponse`) and their
    combination, the *effective* kernel (`Camera`). They are different types so that no blur can be applied twice.

    Attributes:
        profile_fields: path of the attribute for each field in a camera profile, such as {"radius_px": "halo.sigma"}.
            The fields are in the order of the constructor's arguments.
    """

    profile_fields: ClassVar[Mapping[str, str]]

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Compute the optical point spread function, 1/px^2, without the pixel.

        It is the irradiance on the sensor due to a point source of unit flux, and integrates to 1. It is computed by
        quadrature, unless the lens has a closed form. `Camera.psf` includes the pixel.

        Args:
            x: position to the right of the image of the point, px; broadcasts with y.
            y: position above the image of the point, px.

        Raises:
            ArgumentError: a position is not finite.
        """
        x, y = checks.broadcastable(x=x, y=y)
        reach, band = reach_of(xp.hypot(x, y)), self.band()
        rule = self.frequency_rule(panels_for(reach, band))
        return plane_kernel(rule, lambda f, _: self.mtf(f), x, y, turns_for(reach, band))

    def lsf(self, x: ArrayLike) -> jax.Array:
        """Compute the optical line spread function, 1/px, without the pixel.

        It is the integral of the point spread function along a line, and integrates to 1. It is computed by quadrature,
        unless the lens has a closed form.

        Args:
            x: distance from the image of the line, px, any shape.

        Raises:
            ArgumentError: x is not finite.
        """
        x = checks.number("x", x)
        rule = self.frequency_rule(panels_for(reach_of(x), self.band()))
        return line_kernel(rule, lambda f, _: self.mtf(f), x, xp.zeros(()))

    @abstractmethod
    def mtf(self, f: ArrayLike) -> jax.Array:
        """Compute the signed optical transfer function, without the pixel.

        Args:
            f: frequency, cycles/px, any shape. At f = 0 the transfer function is 1.

        Raises:
            ArgumentError: f is not finite.
        """

    @property
    def isotropic(self) -> bool:
        """True if the lens is isotropic, achromatic and uniform."""
        return True

    def otf(self, fx: ArrayLike, fy: ArrayLike) -> jax.Array:
        """Compute the optical transfer function in the plane, without the pixel.

        It is complex for anisotropic lenses, and otherwise `mtf` at the modulus of the frequency.

        Args:
            fx: component of the frequency to the right, cycles/px; broadcasts with fy.
            fy: component of the frequency upwards, cycles/px.

        Raises:
            ArgumentError: a frequency is not finite.
        """
        return self.mtf(plane_length(*checks.broadcastable(fx=fx, fy=fy)))

    @abstractmethod
    def band(self) -> float:
        """Compute the frequency above which the MTF is 0 to rounding, cycles/px."""

    def resolved_share(self) -> float:
        """Compute the share of the band that the lens resolves, no unit.

        Above this share the MTF is below 1e-4. The scale of the PSF is inversely proportional to the resolved band.
        """
        return 1.0

    @abstractmethod
    def rule_on(self, borders: np.ndarray) -> Rule:
        """Build a quadrature over the band.

        The MTF is smooth on each panel of the quadrature.

        Args:
            borders: limits of panels as shares of the band, no unit, increasing from 0 to 1. The quadrature may divide
                these panels further.
        """

    def components(self) -> tuple[tuple[jax.Array, Optics], ...]:
        """List the components of this lens, each as (weight, lens).

        The kernel of this lens is the weighted sum of the kernels of its components. A lens without components is
        represented by itself, with weight 1.
        """
        return ((xp.ones(()), self),)

    def frequency_rule(self, panels: int) -> Rule:
        """Build a quadrature over [0, band] on panels of equal width.

        The lens may divide these panels further.

        Args:
            panels: number of panels before they are divided.
        """
        return self.rule_on(np.linspace(0, 1, panels + 1))

    def __repr__(self) -> str:
        arguments = zip(inspect.signature(type(self)).parameters.values(), fields_of(self).values(), strict=True)
        return constructor_call(
            self,
            {p.name: v for p, v in arguments if not is_concrete(v) or not np.array_equal(v, p.default)},
        )


def checked_isotropic(optics: Optics, what: str) -> Optics:
    """Check that a lens is isotropic, achromatic and uniform.

    Args:
        optics: the lens.
        what: feature that requires an isotropic lens, for the message.

    Raises:
        ArgumentError: the blur depends on direction, colour or position; the message names alternatives.
    """
    if optics.isotropic:
        return optics
    raise ArgumentError(
        f"{what} requires a lens whose blur does not depend on direction, colour or position, got {type(optics).__name__}: "
        "approximate this lens by an isotropic one, such as DefocusOptics, or MeasuredOptics with the mean MTF; only "
        "predictions, textures, `picture` and tables of a sphere support other lenses"
    )
