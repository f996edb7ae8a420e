"""One camera for many measurements: edges by their own samples, everything else by its MTF values and their covariance.

Every edge keeps its own levels, light and place; they are eliminated edge by edge (Schur's complement), so that the fit is
one of the few numbers that all share. Fisher scoring: what an edge adds is its information and its score, which also say
whether the measurements agree with one another. The variance of a pixel is its model's (MODEL 8).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from matcam.calibration.edge.edge_result import EdgeMTF
from matcam.calibration.edge.geometry import Cells
from matcam.calibration.edge.maximum_likelihood import LINEAR, Noise, State, model
from matcam.calibration.edge.profiles import LensModel
from matcam.calibration.photograph.region import padded
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.core.errors import FitError
from matcam.core.jax import AnyArray, jax, jnp
from matcam.numerics.linalg import FLOOR, least_eigenvalue, scaled_inverse

_ROUNDS, _DONE, _WORSE = 40, 1e-3, 1.05  # steps at most; standard deviations; of chi2, that a step may cost
_AT_ONCE = 16  # edges side by side


class Edges(NamedTuple):
    """n edges as they enter the fit: arrays with a leading axis of n."""

    cells: Cells
    angle: AnyArray
    noise: Noise
    excess: AnyArray
    linear: AnyArray
    """(n, 5) levels, light, shift: `State.linear`."""
    lens: LensModel
    """Its arrays have leading axes, too."""


class Values(NamedTuple):
    """n sets of MTF values, filled up to m each with values of no weight."""

    frequency: AnyArray
    direction: AnyArray
    mtf: AnyArray
    weight: AnyArray
    """(n, m, m) inverse of their covariances."""
    lens: LensModel


class Share(NamedTuple):
    """What each measurement adds."""

    information: AnyArray
    """(n, k, k)"""
    score: AnyArray
    """(n, k)"""
    chi2: AnyArray
    degrees: AnyArray


class JointFit(NamedTuple):
    """The fitted numbers of k parameters, and every measurement's share in them."""

    parameters: np.ndarray
    covariance: np.ndarray
    """(k, k) from the measurements' own noise, and the priors."""
    shares: Share
    """Edges first, in the order in which they were given."""


def edges_of(result: EdgeMTF, lenses: Sequence[LensModel]) -> tuple[Edges, np.ndarray]:
    """The edges of a stack that could be measured, and which those are. lenses: one for each edge of the stack."""
    good = np.flatnonzero([not problem for problem in result.problems])
    found = jax.tree.map(lambda a: np.asarray(a)[good], result._found)
    some = [lenses[int(i)] for i in good]
    return Edges(found.cells, found.angle, found.noise, found.excess, found.state.linear, _stacked(some)), good


def joined(parts: Sequence[Edges]) -> Edges:
    """Several sets of edges as one; sets with fewer cells to an edge get empty ones."""
    most = max(part.cells.pixels.shape[1] for part in parts)

    def widened(part: Edges) -> Edges:
        more = ((0, 0), (0, most - part.cells.pixels.shape[1]))
        return part._replace(cells=jax.tree.map(lambda column: np.pad(column, more), part.cells))

    return jax.tree.map(lambda *a: np.concatenate(a), *map(widened, parts))


def values_of(samples: Sequence[MTFSamples], lenses: Sequence[LensModel]) -> Values:
    """MTF values as the fit takes them."""
    most = padded(max(s.frequency.size for s in samples))
    fill = lambda values: np.pad(values, (0, most - values.size))  # noqa: E731
    weights = []
    for one in samples:
        std = one.mtf_std
        # a covariance of fewer independent errors than values has no inverse: directions that have none are left out
        inverse = np.linalg.pinv(one.covariance / np.outer(std, std), rcond=1e-6, hermitian=True) / np.outer(std, std)
        weights.append(np.pad(inverse, (0, most - std.size)))
    frequency, direction, mtf = (
        np.stack([fill(getattr(s, name)) for s in samples]) for name in ("frequency", "direction", "mtf")
    )
    return Values(frequency, direction, mtf, np.stack(weights), _stacked(lenses))


def fit(
    edges: Edges | None, values: Values | None, start: np.ndarray, longest: Sequence[float], half_width: float,
    prior: np.ndarray,
) -> JointFit:  # fmt: skip
    """Most likely parameters (k,) for everything. prior: (k,) precision of parameters about 0. FitError where the measurements
    do not determine them, or no end is found."""
    theta = np.asarray(start, dtype=np.float64)
    count = 0 if edges is None else len(edges.angle)
    edges = None if edges is None else _filled(edges)
    half = np.float64(half_width)
    best, short = np.inf, np.zeros_like(theta)
    held, back, held_back = (theta, edges), None, None
    for _ in range(_ROUNDS):
        parts = []
        if edges is not None:
            of_edges, back = jax.tree.map(np.asarray, _edge_shares(edges, theta, half))
            parts.append(jax.tree.map(lambda a: a[:count], of_edges))
        if values is not None:
            parts.append(jax.tree.map(np.asarray, _value_shares(values, theta, half)))
        shares = jax.tree.map(lambda *a: np.concatenate(a), *parts)
        misfit = shares.chi2.sum() + prior @ theta**2
        if not misfit <= _WORSE * best:  # too far: half of the last step
            short = short / 2
            theta, edges = _moved(*held, short, held_back)
            continue
        best, held, held_back = misfit, (theta, edges), back
        covariance = _inverse(shares.information.sum(0) + np.diag(prior))
        step = covariance @ (shares.score.sum(0) - prior * theta)
        short = np.clip(step, -np.array(longest), longest)
        theta, edges = _moved(theta, edges, short, back)
        if (np.abs(step) <= _DONE * np.sqrt(np.diag(covariance))).all():
            return JointFit(theta, covariance, shares)
    raise FitError("the measurements do not determine the camera: no best fit was found")


def in_units(lens: LensModel, parameters: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lens's numbers, in the units of its names, and their covariance."""
    at = jnp.asarray(parameters)
    by = np.asarray(jax.jacfwd(lens.numbers)(at))
    return np.asarray(lens.numbers(at)), by @ covariance @ by.T


def _moved(
    theta: np.ndarray, edges: Edges | None, step: np.ndarray, back: tuple[np.ndarray, np.ndarray] | None
) -> tuple[np.ndarray, Edges | None]:
    """Parameters after a step, and every edge's own numbers as they follow."""
    if edges is not None and back is not None:
        edges = edges._replace(linear=edges.linear + back[0] - np.einsum("eij,j->ei", back[1], step))
    return theta + step, edges


@jax.jit
def _edge_shares(edges: Edges, theta: jax.Array, half_width: jax.Array) -> tuple[Share, tuple[jax.Array, jax.Array]]:
    """Shares, and how each edge's own five numbers move: by themselves, and with the parameters."""

    def one(edge: Edges) -> Any:
        profile = edge.lens.profile(jnp.asarray(edge.angle), half_width)
        at = model(edge.cells, State(jnp.asarray(edge.linear), theta), profile)
        weight = edge.cells.pixels / (edge.noise.variance(at.value) * edge.excess)
        residual = edge.cells.value - at.value
        normal, score = (at.design * weight) @ at.design.T, at.design @ (weight * residual)
        inverse = scaled_inverse(normal[:LINEAR, :LINEAR])
        alone, shared = inverse @ score[:LINEAR], inverse @ normal[:LINEAR, LINEAR:]
        share = Share(
            normal[LINEAR:, LINEAR:] - normal[LINEAR:, :LINEAR] @ shared,
            score[LINEAR:] - normal[LINEAR:, :LINEAR] @ alone,
            (weight * residual**2).sum(),
            (edge.cells.pixels > 0).sum() - LINEAR,
        )
        return share, (alone, shared)

    return jax.lax.map(one, edges, batch_size=_AT_ONCE)


@jax.jit
def _value_shares(values: Values, theta: jax.Array, half_width: jax.Array) -> Share:
    def one(some: Values) -> Share:
        f, direction = jnp.asarray(some.frequency), jnp.asarray(some.direction)
        mtf = partial(some.lens.mtf, f=f, angle=direction, half_width=half_width)
        by = jax.jacfwd(mtf)(theta)
        residual = some.mtf - mtf(theta)
        weighted = some.weight @ by
        return Share(
            by.T @ weighted,
            residual @ weighted,
            residual @ some.weight @ residual,
            (jnp.diagonal(some.weight) > 0).sum(),
        )

    return jax.lax.map(one, values)


def _inverse(information: np.ndarray) -> np.ndarray:
    if not np.isfinite(information).all() or (np.diag(information) <= 0).any():
        raise FitError("the measurements do not determine the camera: they say nothing of one of its numbers")
    if least_eigenvalue(information) < FLOOR:
        raise FitError("the measurements do not determine the camera: two of its numbers do the same to them")
    return scaled_inverse(information)


def _stacked(lenses: Sequence[LensModel]) -> LensModel:
    return jax.tree.map(lambda *a: np.stack([np.asarray(x) for x in a]), *lenses)


def _filled(edges: Edges) -> Edges:
    """With empty edges, up to a number that other calls have, too: one compiled program serves them all."""
    more = padded(len(edges.angle)) - len(edges.angle)
    full = jax.tree.map(lambda a: np.concatenate([a, np.repeat(a[:1], more, axis=0)]), edges)
    if not more:
        return full
    pixels = np.array(full.cells.pixels)
    pixels[len(edges.angle) :] = 0
    return full._replace(cells=full.cells._replace(pixels=pixels))
