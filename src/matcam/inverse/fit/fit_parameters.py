"""The numbers that a fit frees, as one vector: where each lobe, camera number and Fresnel term lies in it.

How wide a lobe is to the eye, whatever its family's numbers are.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.material.ndf.distribution import NDF
from matcam.material.ndf.free_lobe import KNOTS, BentNDF, ShadowedNDF
from matcam.material.reflectance import Conductor, Dielectric, Reflectance, Schlick
from matcam.material.registry import FAMILIES, WITH_POWER

FresnelModel = Literal["conductor", "schlick", "dielectric", "free"]
FRESNEL_MODELS: tuple[FresnelModel, ...] = ("conductor", "schlick", "dielectric", "free")

NARROWEST_PX = 0.02
"""Lobes narrower than this on the sensor are the same point to any camera."""

_POWER_BOUNDS = {"epd": (0.25, 4.0), "sgd": (0.02, 2.0)}
_FRESNEL_NAMES: dict[str, tuple[str, ...]] = {
    "conductor": ("n", "k"), "schlick": ("f0",), "dielectric": ("eta",), "free": (),
}  # fmt: skip
_FRESNEL_BOUNDS = {"n": (-5.0, 4.0), "k": (-7.0, 4.0), "f0": (1e-4, 1.0), "eta": (-6.0, 3.0)}


def lobe_names(family: str, bends: int = 0, shadows: int = 0) -> tuple[str, ...]:
    """What the family's numbers are called: its constructor's arguments; then those of its bend and of a free masking."""
    own = (field.name for field in dataclasses.fields(FAMILIES[family]))
    return (*own, *(f"bend{k}" for k in range(bends)), *(f"shadow{k}" for k in range(shadows)))


def ndf_at(family: str, logs: jax.Array) -> NDF:
    """The NDF whose numbers have these logarithms; what comes behind them bends it, and sets its masking free."""
    own = len(lobe_names(family))
    ndf = FAMILIES[family](*(jnp.exp(q) for q in logs[:own]))
    bends, shadows = logs[own : own + KNOTS], logs[own + KNOTS :]
    if len(bends):
        ndf = BentNDF(ndf, bends)
    return ShadowedNDF(ndf, shadows) if len(shadows) else ndf


def lobe_bounds(family: str, radius: float, smooth: int = 0) -> list[tuple[float, float]]:
    """Bounds of the logarithms, and of `smooth` numbers behind them."""
    bounds = [(float(np.log(NARROWEST_PX / radius)), float(np.log(0.999 * FAMILIES[family].largest)))]
    if family in WITH_POWER:
        low, high = _POWER_BOUNDS[family]
        bounds.append((float(np.log(low)), float(np.log(high))))
    return bounds + [(-25.0, 25.0)] * smooth


def fresnel_names(model: FresnelModel) -> tuple[str, ...]:
    """Numbers of a Fresnel model, per channel."""
    return _FRESNEL_NAMES[model]


def fresnel_bounds(model: FresnelModel) -> list[tuple[float, float]]:
    """Bounds of its coordinates in the vector."""
    return [_FRESNEL_BOUNDS[name] for name in _FRESNEL_NAMES[model]]


def reflectance_at(model: FresnelModel, coordinates: jax.Array) -> Reflectance:
    """The Fresnel term at coordinates (ln n, ln k), (f0,) or (ln(eta - 1),)."""
    if model == "conductor":
        return Conductor(jnp.exp(coordinates[0]), jnp.exp(coordinates[1]))
    if model == "schlick":
        return Schlick(coordinates[0])
    return Dielectric(1 + jnp.exp(coordinates[0]))


def natural(name: str, coordinate: float) -> tuple[float, float]:
    """(value, its derivative by the coordinate) of a number that users read."""
    if name in ("f0", "diffuse") or name.startswith(("bend", "shadow")):
        return coordinate, 1.0
    value = float(np.exp(coordinate))
    return (1 + value, value) if name == "eta" else (value, value)


def fresnel_start(model: FresnelModel, theta: np.ndarray, f: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Coordinates near a curve F(theta): the best of a lattice. f, weight: (slices,)."""
    lattice: dict[str, list[tuple[float, ...]]] = {
        "conductor": [
            (float(np.log(n)), float(np.log(k)))
            for n in (0.15, 0.3, 0.6, 1.0, 1.6, 2.5, 4.0)
            for k in (0.05, 0.5, 1.5, 2.5, 3.5, 5.0, 7.0)
        ],
        "schlick": [(f0,) for f0 in np.linspace(0.01, 0.99, 40)],
        "dielectric": [(float(np.log(eta - 1)),) for eta in np.linspace(1.02, 3.5, 40)],
    }
    points = lattice[model]
    curves = [np.asarray(reflectance_at(model, jnp.asarray(p)).at(jnp.asarray(theta))) for p in points]
    misfit = [(weight * (f - curve) ** 2).sum() for curve in curves]
    return np.array(points[int(np.argmin(misfit))])


def half_width_of(family: str, logs: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Half width at half maximum of D, rad, and its standard deviation, by bisection and by its implicit derivative."""

    def ratio(log_angle: jax.Array, q: jax.Array) -> jax.Array:
        ndf = ndf_at(family, q)
        return jnp.log(2 * ndf.d(jnp.exp(log_angle)) / ndf.d(1e-9))

    q, f = jnp.asarray(logs), jax.jit(ratio)
    low, high = np.log(1e-9), np.log(1.5)
    if float(f(high, q)) > 0:
        return float("nan"), float("nan")
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if float(f(middle, q)) > 0 else (low, middle)
    slope = jax.grad(ratio, argnums=(0, 1))(jnp.asarray(low), q)
    by_q = -np.asarray(slope[1]) / float(slope[0])
    angle = float(np.exp(low))
    return angle, angle * float(np.sqrt(by_q @ covariance @ by_q))
