"""The least-squares problem of a fit: model, residuals and their derivatives, at any numbers (MODEL 8).

Model of a cell of unit u (a channel of a table) in slice s:  F_u(theta_d) A(cell; lobe, camera) + diffuse_u / pi. Strengths
that are free in every slice are solved for exactly (variable projection, Golub & Pereyra 1973; derivatives by Kaufman 1975).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.camera.sensor import PixelNoise
from matcam.core.jax import jax, jnp
from matcam.inverse.fit import fit_parameters as parameters
from matcam.inverse.fit.fit_data import FitData, Whitening, whitening
from matcam.inverse.fit.fit_parameters import FresnelModel
from matcam.inverse.fit.lobe_slopes import recorded
from matcam.inverse.operator.lobe_operator import LobeOperator
from matcam.material.masking import Masking


class Layout(NamedTuple):
    """Where everything lies in the vector: lobes, then the rig, then each unit's Fresnel term and diffuse part."""

    family: str
    masking: Masking
    fresnel: FresnelModel
    diffuse: bool
    lobe_of: tuple[int, ...]
    """Of each unit, the number of its lobe."""
    axes: int
    """Camera numbers that are free."""
    bends: int = 0
    """Numbers that bend each lobe away from its family."""
    shadows: int = 0
    """Numbers of each lobe's masking, where that is free."""

    @property
    def lobe_size(self) -> int:
        """Numbers of a lobe."""
        return len(parameters.lobe_names(self.family, self.bends, self.shadows))

    @property
    def lobes(self) -> int:
        """How many different lobes there are."""
        return max(self.lobe_of) + 1

    @property
    def unit_size(self) -> int:
        """Numbers of a unit."""
        return len(parameters.fresnel_names(self.fresnel)) + self.diffuse

    @property
    def size(self) -> int:
        """Numbers altogether."""
        return self.lobes * self.lobe_size + self.axes + len(self.lobe_of) * self.unit_size

    def lobe(self, number: int) -> slice:
        """A lobe's place."""
        return slice(number * self.lobe_size, (number + 1) * self.lobe_size)

    @property
    def camera(self) -> slice:
        """The camera's place."""
        first = self.lobes * self.lobe_size
        return slice(first, first + self.axes)

    def unit(self, number: int) -> slice:
        """A unit's place."""
        first = self.camera.stop + number * self.unit_size
        return slice(first, first + self.unit_size)


class Model(NamedTuple):
    """Shapes: u units, s slices, n cells, p numbers."""

    value: np.ndarray
    """(u, s, n)."""
    derivative: np.ndarray
    """(p, u, s, n), strengths held."""
    lobe: np.ndarray
    """(u, s, n): A of each unit."""
    strength: np.ndarray
    """(u, s): F."""
    strength_std: np.ndarray
    """(u, s): of free strengths, all else held; 0 otherwise."""


@eqx.filter_jit
def _lobe(operator: LobeOperator, family: str, masking: Masking, q: jax.Array, size: int) -> jax.Array:
    return operator.record(parameters.ndf_at(family, q[:size]), masking, q[size:])


@partial(jax.jit, static_argnums=0)
def _reflectance(model: FresnelModel, coordinates: jax.Array, theta: jax.Array) -> tuple[jax.Array, jax.Array]:
    """F and its derivatives, for each row of coordinates."""

    def curve(c: jax.Array) -> jax.Array:
        return parameters.reflectance_at(model, c).at(theta)

    return jax.vmap(curve)(coordinates), jax.vmap(jax.jacfwd(curve))(coordinates)


class Problem:
    """Data, operator and layout together."""

    def __init__(self, data: FitData, operator: LobeOperator, theta_d: np.ndarray, layout: Layout):
        self.data, self.operator, self.theta_d, self.layout = data, operator, theta_d, layout
        self._last: dict[int, tuple[bytes, np.ndarray, np.ndarray]] = {}

    def residual(self, model: Model) -> np.ndarray:
        """Data - model, (u, s, n); 0 where unused."""
        return np.where(self.data.used, self.data.values - model.value, 0.0)

    def lobe_record(self, q: np.ndarray) -> np.ndarray:
        """A of one lobe, (slices, cells); q: its logarithms and the camera's shifts."""
        layout = self.layout
        return np.asarray(_lobe(self.operator, layout.family, layout.masking, jnp.asarray(q), layout.lobe_size))

    def model(self, p: np.ndarray, weight: np.ndarray, *, slopes: bool = True) -> Model:
        """weight: (u, s, n), 1 / V, that free strengths are solved with."""
        layout, data = self.layout, self.data
        units, slices, cells = data.values.shape
        camera = p[layout.camera]
        lobes, by_lobe = [], []
        for number in range(layout.lobes):
            q = np.concatenate([p[layout.lobe(number)], camera])
            if slopes:
                _, value, slope = self._recorded(number, q)
                lobes.append(value)
                by_lobe.append(slope)
            else:
                lobes.append(self.lobe_record(q))
        lobe = np.stack([lobes[number] for number in layout.lobe_of])
        diffuse = np.zeros(units)
        if layout.diffuse:
            diffuse = np.array([p[layout.unit(u)][-1] for u in range(units)])
        body = diffuse[:, None, None] / np.pi
        std = np.zeros((units, slices))
        by_fresnel = np.zeros((units, slices, 0))
        if layout.fresnel == "free":
            wa = np.where(data.used, weight, 0.0) * lobe
            power = (wa * lobe).sum(-1)
            safe = np.where(power > 0, power, 1.0)
            strength = np.where(power > 0, (wa * (data.values - body)).sum(-1) / safe, 0.0)
            std = np.where(power > 0, 1 / np.sqrt(safe), np.inf)
        else:
            count = len(parameters.fresnel_names(layout.fresnel))
            rows = np.stack([p[layout.unit(u)][:count] for u in range(units)])
            pair = _reflectance(layout.fresnel, jnp.asarray(rows), jnp.asarray(self.theta_d))
            strength, by_fresnel = (np.asarray(a) for a in pair)
        value = strength[..., None] * lobe + body
        derivative = np.zeros((layout.size if slopes else 0, units, slices, cells))
        if slopes:
            for u, number in enumerate(layout.lobe_of):
                slope = strength[u][None, :, None] * by_lobe[number]
                derivative[layout.lobe(number), u] = slope[: layout.lobe_size]
                derivative[layout.camera, u] = slope[layout.lobe_size :]
                place = layout.unit(u)
                for n in range(by_fresnel.shape[-1]):
                    derivative[place.start + n, u] = by_fresnel[u, :, n, None] * lobe[u]
                if layout.diffuse:
                    derivative[place.stop - 1, u] = 1 / np.pi
        return Model(value, derivative, lobe, strength, std)

    def _recorded(self, number: int, q: np.ndarray) -> tuple[bytes, np.ndarray, np.ndarray]:
        """A of a lobe and its slopes, kept for the next call: weights change more often than lobes."""
        key = q.tobytes()
        if number not in self._last or self._last[number][0] != key:
            layout = self.layout
            pair = recorded(self.operator, layout.family, layout.masking, q, layout.lobe_size)
            self._last[number] = key, *pair
        return self._last[number]

    def gain(self, noise: PixelNoise) -> float:
        """Standard deviation of a picture's strength beside its model: endless where strengths are free."""
        return np.inf if self.layout.fresnel == "free" else noise.picture_gain

    def whitening(self, model: Model, weight: np.ndarray, gain: float) -> Whitening:
        """Free strengths drop what lies along the lobe; known gains shorten what lies along the picture."""
        if self.layout.fresnel == "free":
            return whitening(self.data, weight, model.lobe, np.inf)
        return whitening(self.data, weight, model.value, gain)
