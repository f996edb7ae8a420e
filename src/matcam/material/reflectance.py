"""Reflectance of a single facet: how much light a smooth interface sends back at each angle."""

from __future__ import annotations

from abc import abstractmethod

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax, jnp


def fresnel_conductor(theta: ArrayLike, n: ArrayLike, k: ArrayLike) -> jax.Array:
    """Unpolarised reflectance of an interface from air to a medium of complex index n + i k (complex Snell's law;
    Born & Wolf, 14.2). theta: angle of incidence, rad, [0, pi/2]. Arguments broadcast.
    """
    theta = checks.within("theta", theta, 0, np.pi / 2, "rad")
    return _unpolarised(theta, checks.positive("n", n), checks.within("k", k, 0, np.inf, open_high=True))


@jax.jit
def _unpolarised(theta: jax.Array, n: jax.Array, k: jax.Array) -> jax.Array:
    index = n + 1j * k
    cos_i, sin2 = jnp.cos(theta), jnp.sin(theta) ** 2
    inside = jnp.sqrt(index**2 - sin2)  # index times the cosine of the refracted ray
    r_s = (cos_i - inside) / (cos_i + inside)
    r_p = (index**2 * cos_i - inside) / (index**2 * cos_i + inside)
    return (_squared(r_s) + _squared(r_p)) / 2


def _squared(z: jax.Array) -> jax.Array:
    return z.real**2 + z.imag**2


class Reflectance(eqx.Module):
    """A Fresnel term; its parameters are single numbers, or lists with one entry per colour channel."""

    @abstractmethod
    def at(self, theta: jax.Array) -> jax.Array:
        """Reflectance at angle of incidence theta, rad: shape theta.shape, and (channels,) behind it if there are any."""


class Conductor(Reflectance):
    """A metal of complex index n + i k. n > 0, k >= 0: numbers, or shape (channels,)."""

    n: jax.Array
    k: jax.Array

    def __init__(self, n: ArrayLike, k: ArrayLike):
        n, k = checks.positive("n", n), checks.within("k", k, 0, np.inf, open_high=True)
        self.n, self.k = jnp.broadcast_arrays(per_channel("n", n), per_channel("k", k))

    def at(self, theta: jax.Array) -> jax.Array:
        """`fresnel_conductor`."""
        return fresnel_conductor(_beside_channels(theta, self.n), self.n, self.k)


class Dielectric(Reflectance):
    """A transparent medium of relative index eta > 1, seen from outside. A number, or shape (channels,)."""

    eta: jax.Array

    def __init__(self, eta: ArrayLike):
        self.eta = per_channel("eta", checks.within("eta", eta, 1, np.inf, open_low=True, open_high=True))

    def at(self, theta: jax.Array) -> jax.Array:
        """Fresnel's equations, unpolarised: `fresnel_conductor` with k = 0."""
        return fresnel_conductor(_beside_channels(theta, self.eta), self.eta, 0.0)


class Schlick(Reflectance):
    """f0 + (1 - f0) (1 - cos theta)^5 (Schlick 1994, (15)). f0 in [0, 1]: a number, or shape (channels,)."""

    f0: jax.Array

    def __init__(self, f0: ArrayLike):
        self.f0 = per_channel("f0", checks.within("f0", f0, 0, 1))

    def at(self, theta: jax.Array) -> jax.Array:
        """Schlick's approximation."""
        return self.f0 + (1 - self.f0) * (1 - jnp.cos(_beside_channels(theta, self.f0))) ** 5


class Constant(Reflectance):
    """The same reflectance at every angle, in [0, 1]: a number, or shape (channels,)."""

    value: jax.Array

    def __init__(self, value: ArrayLike):
        self.value = per_channel("reflectance", checks.within("reflectance", value, 0, 1))

    def at(self, theta: jax.Array) -> jax.Array:
        """The value."""
        return self.value + 0 * _beside_channels(theta, self.value)


class Sampled(Reflectance):
    """A Fresnel term known at some angles: linear in between, constant beyond. theta: rad, ascending, shape (angles,);
    values: >= 0, shape (angles,) or (angles, channels). A free estimate may exceed 1: it carries the scale of its data."""

    theta: jax.Array
    values: jax.Array

    def __init__(self, theta: ArrayLike, values: ArrayLike):
        self.theta = checks.within("theta", theta, 0, np.pi / 2, "rad")
        self.values = checks.within("values", values, 0, np.inf, open_high=True)
        fits = self.theta.ndim == 1 and self.theta.size and self.values.shape[:1] == self.theta.shape
        if not fits or self.values.ndim > 2:
            raise ArgumentError(
                f"values must have shape (angles,) or (angles, channels), got {self.values.shape} for theta "
                f"of shape {self.theta.shape}"
            )
        if is_concrete(self.theta) and bool(np.any(np.diff(self.theta) <= 0)):
            raise ArgumentError("theta must ascend")

    def at(self, theta: jax.Array) -> jax.Array:
        """Linear interpolation."""
        theta = jnp.asarray(theta)
        if self.values.ndim == 1:
            return jnp.interp(theta, self.theta, self.values)
        return jnp.stack([jnp.interp(theta, self.theta, column) for column in self.values.T], axis=-1)


def as_reflectance(value: Reflectance | ArrayLike) -> Reflectance:
    """A `Reflectance` as it is; numbers as `Constant`."""
    return value if isinstance(value, Reflectance) else Constant(value)


def per_channel(name: str, value: jax.Array) -> jax.Array:
    """`value` if it is a number or one per channel; ArgumentError with its shape otherwise."""
    if value.ndim > 1:
        raise ArgumentError(f"{name} must be a number or a list with one entry per channel, got shape {value.shape}")
    return value


def _beside_channels(theta: jax.Array, parameter: jax.Array) -> jax.Array:
    theta = jnp.asarray(theta)
    return theta[..., None] if parameter.ndim else theta
