"""Reflectance of a smooth interface (microfacet) as a function of the angle of incidence."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import equinox as eqx
import numpy as np
import numpy.typing as npt
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.arrays import has_jax, xp
from matcam.core.arrays.elementary import cosine
from matcam.core.arrays.module import constructor_call
from matcam.core.errors import ArgumentError
from matcam.core.grid import CHANNEL_WAVELENGTHS
from matcam.core.jax import is_concrete, jax, jnp
from matcam.material.optical_constants import metal

_LARGEST_INDEX = 1e6  # exceeds the index of any material at any wavelength; its fourth power is still accurate
_LEAST_SQUARE = 1e-60  # prevents 0 / 0 where a ray in a medium with k = 0 is refracted to 90 degrees


def fresnel_conductor(theta: ArrayLike, n: ArrayLike, k: ArrayLike) -> jax.Array:
    """Compute the unpolarised reflectance of a metal surface in air.

    The arguments broadcast.

    Args:
        theta: angle of incidence, rad, [0, pi/2].
        n: real part of the complex index n + i k, no unit, (0, 1e6].
        k: extinction coefficient, no unit, [0, 1e6]; 0 for a dielectric.

    Returns:
        Reflectance in [0, 1], shape of the broadcast arguments.

    Raises:
        ArgumentError: an argument is out of range, or the shapes do not broadcast.

    Source:
        Complex Snell's law and Fresnel's equations (Born & Wolf, 14.2).

    Example:
        >>> round(float(matcam.fresnel_conductor(0.0, 1.5, 0.0)), 6)
        0.04
    """
    theta = checks.within("theta", theta, 0, np.pi / 2, "rad")
    n, k = checks.within("n", n, 0, _LARGEST_INDEX, open_low=True), checks.within("k", k, 0, _LARGEST_INDEX)
    checks.broadcast_shape(theta=theta, n=n, k=k)
    return (_compiled if has_jax(theta, n, k) else _at_angle)(theta, n, k)


def reflectance_at_cosine(cos_i: Any, n: Any, k: Any) -> Any:
    """Compute `fresnel_conductor` from the cosine of the angle of incidence, without checks of the arguments.

    Real numbers take a third of the time of complex numbers.
    """
    real, imaginary = (n - k) * (n + k), 2 * n * k  # of the squared index
    # real and imaginary part, both positive, of the index times the cosine of the refracted ray
    square = real - (1 - cos_i) * (1 + cos_i)
    larger = xp.sqrt(xp.maximum((xp.sqrt(square**2 + imaginary**2) + xp.abs(square)) / 2, _LEAST_SQUARE))
    smaller = imaginary / (2 * larger)
    a, b = xp.where(square > 0, larger, smaller), xp.where(square > 0, smaller, larger)
    r_s = ((cos_i - a) ** 2 + b**2) / ((cos_i + a) ** 2 + b**2)
    real, imaginary = real * cos_i, imaginary * cos_i
    r_p = ((real - a) ** 2 + (imaginary - b) ** 2) / ((real + a) ** 2 + (imaginary + b) ** 2)
    return (r_s + r_p) / 2


def _at_angle(theta: jax.Array, n: jax.Array, k: jax.Array) -> jax.Array:
    return reflectance_at_cosine(cosine(theta), n, k)


_compiled = jax.jit(_at_angle)


class Reflectance(eqx.Module):
    """Reflectance of a microfacet.

    The reflectance is the same in all channels, or has one value per channel.
    """

    def __repr__(self) -> str:
        return constructor_call(self)

    @abstractmethod
    def at(self, theta: jax.Array) -> jax.Array:
        """Compute the reflectance at an angle of incidence.

        Args:
            theta: angle between the light and the normal of the facet (theta_d), rad, [0, pi/2].

        Returns:
            Reflectance, no unit; shape of `theta`, followed by (channels,) if it has one value per channel.
        """


class Conductor(Reflectance):
    """Reflectance of a metal with complex refractive index n + i k.

    Args:
        n: real part of the index, no unit, (0, 1e6]; shape () or (channels,).
        k: extinction coefficient, no unit, [0, 1e6]; shape () or (channels,).

    Raises:
        ArgumentError: a parameter is out of range or has several axes, or the shapes of n and k do not match.

    Source:
        Born & Wolf, 14.2; `from_metal` uses published values.

    Example:
        >>> chromium = matcam.Conductor(3.1, 3.3)
        >>> 0.5 < float(chromium.at(0.0)) < float(chromium.at(1.5))
        True
    """

    n: jax.Array
    k: jax.Array

    def __init__(self, n: ArrayLike, k: ArrayLike):
        n, k = checks.within("n", n, 0, _LARGEST_INDEX, open_low=True), checks.within("k", k, 0, _LARGEST_INDEX)
        if n.ndim and k.ndim and n.shape != k.shape and 1 not in (n.size, k.size):
            raise ArgumentError(
                f"n and k must have the same shape, or one of them must be a number, got shapes {n.shape} and {k.shape}"
            )
        self.n, self.k = jnp.broadcast_arrays(per_channel("n", n), per_channel("k", k))

    @classmethod
    def from_metal(
        cls, name: str, wavelengths: npt.ArrayLike = CHANNEL_WAVELENGTHS, source: str | None = None
    ) -> Conductor:
        """Build the Fresnel term of a metal from published optical constants.

        Args:
            name: name of the metal, one of `matcam.material.metals()`, such as "Cr" or "brass".
            wavelengths: wavelength in vacuum of each channel, m, shape (channels,) or (). Default: 610e-9, 550e-9 and
                465e-9, for R, G and B.
            source: name of the table, as in `metal`. Default: None, the first table.

        Raises:
            ArgumentError: the metal or the source is unknown, a wavelength is not a number or lies outside the table, or
                the wavelengths have several axes.

        Source:
            refractiveindex.info database (Polyanskiy 2024), CC0; `metal` returns the citation of each table.

        Example:
            >>> copper = matcam.Conductor.from_metal("Cu", [650e-9, 450e-9])
            >>> bool(copper.at(0.0)[0] > copper.at(0.0)[1])  # it reflects red light best
            True
        """
        index = metal(name, wavelengths, source)
        return cls(index.n, index.k)

    def at(self, theta: jax.Array) -> jax.Array:
        """Evaluate `fresnel_conductor` at theta."""
        return fresnel_conductor(_beside_channels(theta, self.n), self.n, self.k)


class Dielectric(Reflectance):
    """Reflectance of a transparent medium for light from outside.

    Args:
        eta: refractive index divided by the index of the surrounding medium, no unit, (1, 1e6]; shape () or (channels,).
            It is about 1.5 for glass in air.

    Raises:
        ArgumentError: eta is out of range, or has several axes.

    Source:
        Fresnel's equations, unpolarised (Born & Wolf, 1.5.2).

    Example:
        >>> round(float(matcam.Dielectric(1.5).at(0.0)), 6)
        0.04
    """

    eta: jax.Array

    def __init__(self, eta: ArrayLike):
        self.eta = per_channel("eta", checks.within("eta", eta, 1, _LARGEST_INDEX, open_low=True))

    def at(self, theta: jax.Array) -> jax.Array:
        """Compute the unpolarised reflectance: `fresnel_conductor` with k = 0."""
        return fresnel_conductor(_beside_channels(theta, self.eta), self.eta, 0.0)


class Schlick(Reflectance):
    """Schlick's approximation of a Fresnel term.

    The reflectance is f0 + (1 - f0) (1 - cos theta)^5 at the angle of incidence theta.

    Args:
        f0: reflectance at normal incidence, no unit, [0, 1]; shape () or (channels,).

    Raises:
        ArgumentError: f0 is out of range, or has several axes.

    Source:
        Schlick (1994), (15).

    Example:
        >>> float(matcam.Schlick(0.5).at(np.pi / 2)) > 0.99
        True
    """

    f0: jax.Array

    def __init__(self, f0: ArrayLike):
        self.f0 = per_channel("f0", checks.within("f0", f0, 0, 1))

    def at(self, theta: jax.Array) -> jax.Array:
        """Evaluate Schlick's approximation at theta."""
        return self.f0 + (1 - self.f0) * (1 - cosine(_beside_channels(theta, self.f0))) ** 5


class Constant(Reflectance):
    """Reflectance that is constant over all angles.

    Args:
        value: reflectance, no unit, [0, 1]; shape () or (channels,).

    Raises:
        ArgumentError: `value` is out of range, or has several axes.

    Example:
        >>> float(matcam.material.Constant(0.5).at(1.0))
        0.5
    """

    value: jax.Array

    def __init__(self, value: ArrayLike):
        self.value = per_channel("reflectance", checks.within("reflectance", value, 0, 1))

    def at(self, theta: jax.Array) -> jax.Array:
        """Return the constant reflectance at each theta."""
        return self.value + 0 * _beside_channels(theta, self.value)


class Sampled(Reflectance):
    """Fresnel term that is tabulated at some angles.

    The reflectance is linear between these angles and constant beyond them.

    Args:
        theta: angles of incidence, rad, [0, pi/2], strictly increasing, shape (angles,).
        values: reflectance at these angles, no unit, >= 0; shape (angles,) or (angles, channels). Fitted values may
            exceed 1, because they have the scale of the data.

    Raises:
        ArgumentError: the shapes do not match, an entry is out of range, or theta does not increase strictly.

    Example:
        >>> float(matcam.material.Sampled([0.0, 1.0], [0.5, 1.0]).at(0.5))
        0.75
    """

    theta: jax.Array
    values: jax.Array

    def __init__(self, theta: ArrayLike, values: ArrayLike):
        self.theta = checks.within("theta", theta, 0, np.pi / 2, "rad")
        self.values = checks.within("values", values, 0, np.inf, open_high=True)
        fits = self.theta.ndim == 1 and self.theta.size and self.values.shape[:1] == self.theta.shape
        if not fits or self.values.ndim > 2:
            raise ArgumentError(
                "theta must have shape (angles,) with at least one angle, and values (angles,) or (angles, channels), "
                f"got shapes {self.theta.shape} and {self.values.shape}"
            )
        if is_concrete(self.theta) and bool(np.any(np.diff(self.theta) <= 0)):
            raise ArgumentError("theta must increase strictly: sort the angles, and give each angle once")

    def at(self, theta: jax.Array) -> jax.Array:
        """Interpolate linearly at theta."""
        theta = jnp.asarray(theta)
        if self.values.ndim == 1:
            return jnp.interp(theta, self.theta, self.values)
        return jnp.stack([jnp.interp(theta, self.theta, column) for column in self.values.T], axis=-1)


def as_reflectance(value: Reflectance | ArrayLike) -> Reflectance:
    return value if isinstance(value, Reflectance) else Constant(value)


def per_channel(name: str, value: jax.Array) -> jax.Array:
    """Check that `value` is a number or has one entry per channel.

    Otherwise an ArgumentError with its shape is raised.
    """
    if value.ndim > 1 or value.size == 0:
        raise ArgumentError(f"{name} must be a number or a list with one entry per channel, got shape {value.shape}")
    return value


def _beside_channels(theta: jax.Array, parameter: jax.Array) -> jax.Array:
    theta = jnp.asarray(theta)
    return theta[..., None] if parameter.ndim else theta
