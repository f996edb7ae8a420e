"""What a rig records of D G in chosen cells: one compiled function of lobe and camera for every material.

`record` is the integral of MODEL 3 without F: a table reads F(theta_d) times it, because a picture of a distant sphere under
a distant lamp is one theta_d. What depends on the rig alone, the rule of each pixel, is made once (`polar_rule`) and kept.

Numbers of the rig that are not known move the weights of the rule. Each is followed along its own axis (`rig_axes`) through a
few values, by the polynomial through them; how two of them act together beyond their sum is left out (a product of two
small errors).
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.core import workspace as rule_cache
from matcam.core.errors import ArgumentError
from matcam.core.grid import Sampling, azimuth_difference, merl_grid
from matcam.core.jax import jax, jnp
from matcam.core.workspace import Keyed
from matcam.forward.integral.blur import blur_of, groups_of
from matcam.inverse.operator.chosen_cells import ChosenCells, chosen_cells, places
from matcam.inverse.operator.polar_rule import (
    THROUGH_SAMPLES,
    Pixels,
    filled,
    nodes_of,
    reach_of,
    sampled,
    transferred,
    window,
)
from matcam.inverse.operator.rig_axes import Axis, moved
from matcam.material.masking import Masking, cot_of, g2, interpolated_lambda
from matcam.material.ndf.beckmann import Beckmann
from matcam.material.ndf.distribution import NDF
from matcam.material.ndf.free_lobe import ShadowedNDF
from matcam.material.ndf.ggx import GGX
from matcam.numerics.interpolate import lagrange_basis
from matcam.rigs import Rig
from matcam.sample.sphere import Sphere

_STEEPEST_COSINE = 1e-4
"""Cosine that a direction keeps at least: light at the very ends of the sphere is none."""

_LAMBDA_NODES = 128
_PERFECT_RADIUS = 256.0
"""px; sphere whose pixels are told apart where no rig is given."""


class LobeOperator(eqx.Module):
    """Rule of every chosen cell. Arrays over (cells in all slices, two ways, nodes); masking is taken at fewer samples."""

    theta: jax.Array
    weight: jax.Array
    along: tuple[jax.Array, ...]
    """For each axis, by how much the weights differ at its points: (points, cells, ways, nodes)."""
    cos_i: jax.Array
    """(cells, ways, groups of nodes, samples, 2), as are the others of masking."""
    cos_o: jax.Array
    azimuth: jax.Array
    through_samples: jax.Array
    """(nodes of a group, samples)."""
    axes: tuple[Axis, ...] = eqx.field(static=True)
    shape: tuple[int, int] = eqx.field(static=True)

    def record(self, ndf: NDF, masking: Masking, shifts: jax.Array) -> jax.Array:
        """Integral of D G through the camera over cos_i, 1/sr at F = 1, mean of both ways; shape (slices, cells).

        shifts: (axes,), coordinates along them.
        """
        return jnp.sum(self._weighted(ndf, masking, shifts), axis=(-2, -1)).reshape(self.shape)

    def records(self, ndf: NDF, masking: Masking, shifts: jax.Array, factors: jax.Array) -> jax.Array:
        """The same of D times each of some functions of theta; shape (functions, slices, cells). factors: (functions,
        cells, ways, nodes), at `theta`."""
        return jnp.sum(self._weighted(ndf, masking, shifts) * factors, axis=(-2, -1)).reshape(-1, *self.shape)

    def _weighted(self, ndf: NDF, masking: Masking, shifts: jax.Array) -> jax.Array:
        """D G at the nodes with their weights."""
        weight = self.weight
        for axis, differences, shift in zip(self.axes, self.along, shifts, strict=True):
            weight = weight + jnp.tensordot(jnp.stack(lagrange_basis(np.array(axis.points), shift)), differences, 1)
        light = ndf.d(self.theta)
        if masking is not None:
            lambda_i, lambda_o = (_smith_lambda(ndf, cos) for cos in (self.cos_i, self.cos_o))
            joint = jnp.mean(g2(masking, lambda_i, lambda_o, self.azimuth), axis=-1) @ self.through_samples.T
            light *= joint.reshape(light.shape)
        return weight * light


class _Rules(NamedTuple):
    """Arrays of an operator, on their way to disk and back."""

    theta: np.ndarray
    weight: np.ndarray
    sample_theta: np.ndarray
    sample_cos_psi: np.ndarray
    along: tuple[np.ndarray, ...]

    def operator(self, cells: ChosenCells, through: np.ndarray, axes: tuple[Axis, ...]) -> LobeOperator:
        """With the angles that masking needs."""
        theta = self.sample_theta[..., None]
        theta_d = np.repeat(cells.theta_d, cells.kept.shape[1]).reshape(-1, *[1] * (theta.ndim - 1))
        mean = np.cos(theta) * np.cos(theta_d)
        half = np.sin(theta) * np.sin(theta_d) * self.sample_cos_psi
        azimuth = azimuth_difference(theta, theta_d, np.pi - np.arccos(self.sample_cos_psi))
        cos_i, cos_o = (jnp.asarray(np.maximum(c, _STEEPEST_COSINE)) for c in (mean + half, mean - half))
        slices, count = cells.kept.shape
        return LobeOperator(
            theta=jnp.asarray(self.theta),
            weight=jnp.asarray(self.weight),
            along=tuple(jnp.asarray(a) for a in self.along),
            cos_i=cos_i,
            cos_o=cos_o,
            azimuth=azimuth,
            through_samples=jnp.asarray(through),
            axes=axes,
            shape=(slices, count),
        )


def _smith_lambda(ndf: NDF, cos: jax.Array) -> jax.Array:
    """Lambda; where it is an integral, from a small table, which the operator's own accuracy allows."""
    if isinstance(ndf, GGX | Beckmann | ShadowedNDF):
        return ndf.smith_lambda(cos)

    def of_cot(cot: jax.Array) -> jax.Array:
        return ndf.smith_lambda(cot / jnp.sqrt(1 + cot**2))

    return interpolated_lambda(of_cot, ndf.roughness, cot_of(cos), _LAMBDA_NODES)


def lobe_operator(
    rig: Rig | None, sampling: Sampling, every: int = 1, axes: tuple[Axis, ...] = ()
) -> tuple[ChosenCells, LobeOperator]:
    """The chosen cells of every `every`-th slice and their rule; None: a camera that sees points. Kept for the next call
    with the same numbers."""
    if rig is None:
        return perfect_operator(sampling, every, _PERFECT_RADIUS)
    return _operator(Keyed(described(rig), rig), sampling, every, axes)


def described(rig: Rig) -> tuple:
    """All that a checked rig's pixels depend on, to the last digit."""
    check_rig(rig)
    camera = eqx.tree_at(lambda c: (c.uncertainty, c.sensor), rig.camera, (None, None), is_leaf=lambda x: x is None)
    numbers = {name: float(value) for name, value in camera.parameters().items()}
    rest = tuple(float(a) for a in (rig.sample.radius, rig.lamp_radius, rig.jitter, rig.aperture, rig.focus))  # type: ignore[attr-defined]
    return repr(camera), tuple(sorted(numbers.items())), rest


def radius_of(rig: Rig | None) -> float:
    """The sphere's, px."""
    return _PERFECT_RADIUS if rig is None else float(rig.sample.radius)  # type: ignore[attr-defined]


def check_rig(rig: Rig) -> None:
    """ArgumentError for a rig whose tables a lobe cannot be fitted to."""
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), or None, got {type(rig).__name__}")
    if not isinstance(rig.sample, Sphere):
        raise ArgumentError(f"a fit needs a table recorded from a Sphere, this rig has a {type(rig.sample).__name__}")
    if not rig.sample.distant:
        raise ArgumentError(
            "a fit needs a distant camera (Sphere(radius)): before a near one a slice is taken from pictures of many lamps"
        )
    if rig.cell_value == "mean":
        raise ArgumentError("a fit needs cells that stand for one pixel: cell_value 'centre' or 'edge', not 'mean'")


@lru_cache(maxsize=6)
def _operator(
    rig: Keyed[Rig], sampling: Sampling, every: int, axes: tuple[Axis, ...]
) -> tuple[ChosenCells, LobeOperator]:
    cells = chosen_cells(radius_of(rig.thing), sampling, every)
    return cells, operator_of(rig.thing, cells, axes, repr((rig.key, sampling, every, axes)))


def operator_of(rig: Rig, cells: ChosenCells, axes: tuple[Axis, ...], description: str) -> LobeOperator:
    """The rule of any cells; description: of all that it depends on, under which it is kept on disk."""
    stored = rule_cache.kept(description, lambda: _rules(rig, cells, axes))
    along = tuple(stored.pop(f"along{n}") for n in range(len(axes)))
    return _Rules(along=along, **stored).operator(cells, THROUGH_SAMPLES, axes)


def _rules(rig: Rig, cells: ChosenCells, axes: tuple[Axis, ...]) -> dict[str, np.ndarray]:
    """The arrays of `_Rules` by name; those of the axes as along0, along1 ..."""
    radius = radius_of(rig)
    flat = np.flatnonzero(np.repeat(cells.kept.ravel(), 2))
    theta_d = np.broadcast_to(cells.theta_d[:, None, None], cells.x.shape)
    pixels = Pixels(*(filled(a.ravel()[flat]) for a in (cells.x, cells.y, theta_d, 0.5 / cells.cos_i)))
    depth = np.sqrt(np.maximum(1 - (pixels.x**2 + pixels.y**2) / radius**2, 0))
    rigs = [rig, *(moved(rig, {a.name: a.value(point)}) for a in axes for point in a.points if point)]
    blurs = [blur_of(r) for r in rigs]
    if any(blur.varies for blur in blurs):  # one program for all
        blurs = [dataclasses.replace(blur, varies=True) for blur in blurs]
    spreads = [
        [np.broadcast_to(v, pixels.x.shape) for v in blur.spread(rig.sample, depth, 2 * pixels.theta_d)]  # type: ignore[arg-type]
        for blur in blurs
    ]

    def full(part: np.ndarray) -> np.ndarray:
        whole = np.zeros((cells.x.size, *part.shape[1:]))
        whole[flat] = part[: flat.size]
        return whole.reshape(-1, 2, *part.shape[1:])

    columns: list[list[np.ndarray]] = []
    for terms, _ in groups_of(blurs[0], rig.sample):  # type: ignore[arg-type]
        reaches = [
            reach_of(
                float(rig.camera.pixel.half_width),
                np.sqrt(np.asarray(blur.stds)[list(terms)].max() ** 2 + np.maximum(*s)),
            )
            for blur, s in zip(blurs, spreads, strict=True)
        ]
        rules = [
            nodes_of(jnp.asarray(radius), blur, tuple(spread), terms, pixels, window(radius, pixels, reach), reach)
            for blur, spread, reach in zip(blurs, spreads, reaches, strict=True)
        ]
        shown, weights = rules[0], [rules[0].weight]
        if axes:  # all on the nodes of the widest
            seen = window(radius, pixels, np.max(reaches, axis=0))
            shown = nodes_of(jnp.asarray(radius), blurs[0], tuple(spreads[0]), terms, pixels, seen, reaches[0])
            weights = [transferred(rule, seen) for rule in rules]
        weight, *others = (np.asarray(w) for w in weights)
        theta, cos_psi = np.asarray(shown.theta), np.asarray(shown.cos_psi)
        changes = (other - weight for other in others)
        along = [next(changes) if point else 0 * weight for axis in axes for point in axis.points]
        columns.append([full(part) for part in (theta, weight, *(a[:, None] for a in sampled(theta, cos_psi)), *along)])
    named = [np.concatenate(c, axis=2) for c in zip(*columns, strict=True)]
    arrays: dict[str, np.ndarray] = dict(zip(_Rules._fields[:4], named, strict=False))
    first = 4
    for n, axis in enumerate(axes):
        arrays[f"along{n}"] = np.stack(named[first : first + len(axis.points)])
        first += len(axis.points)
    return arrays


@lru_cache(maxsize=4)
def perfect_operator(sampling: Sampling, every: int, radius: float) -> tuple[ChosenCells, LobeOperator]:
    """A camera that sees points: one node, at the cell itself, in the cells that are chosen for a sphere of `radius` px."""
    cells = chosen_cells(radius, sampling, every)
    grid = merl_grid(sampling)
    theta_h, phi_d = grid.theta_h[cells.i_theta_h], grid.phi_d[cells.i_phi_d]
    _, _, cos_i, cos_o = places(radius, theta_h, cells.theta_d[:, None], phi_d)
    return cells, point_operator(cells, theta_h, phi_d, cos_i, cos_o)


def point_operator(
    cells: ChosenCells, theta_h: np.ndarray, phi_d: np.ndarray, cos_i: np.ndarray, cos_o: np.ndarray
) -> LobeOperator:
    """Rule of one node, at the cell itself. theta_h, phi_d: (slices, cells); cosines with both ways behind."""
    kept = cells.kept[..., None]
    weight = np.where(kept, 0.5 / (4 * np.where(kept, cos_i * cos_o, 1.0)), 0.0).reshape(-1, 2, 1)
    theta = np.repeat(theta_h.reshape(-1, 1, 1), 2, axis=1)
    psi = np.pi - phi_d.ravel()[:, None, None, None] + np.array([0.0, np.pi])[:, None, None]
    rules = _Rules(theta, weight, theta[:, :, None], np.cos(psi)[:, :, None], ())
    return rules.operator(cells, np.ones((1, 1)), ())
