"""Joint fit of one camera to many measurements, and the test of their agreement.

Edges contribute the means of their bins, and all other targets contribute MTF values with covariance. Every edge has its own
levels, illumination and position. These parameters are eliminated for each edge (Schur complement), so that only the few
common parameters remain. The fit uses Fisher scoring: each measurement adds its information matrix and its score. The
agreement of the measurements is tested with these contributions. The variance of a pixel follows from the model
(docs/model.md 8).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from matcam.calibration.edge.edge_result import EdgeStack
from matcam.calibration.edge.geometry import EdgeCells
from matcam.calibration.edge.maximum_likelihood import LINEAR, Noise, State, edge_model
from matcam.calibration.edge.profiles import LensModel
from matcam.calibration.edge.rows import program_size
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.core.errors import FitError
from matcam.core.jax import AnyArray, jax, jnp
from matcam.core.programs import kept_program
from matcam.numerics.linalg import FLOOR, least_eigenvalue, scaled_inverse
from matcam.numerics.normal import IMPROBABLE


class EdgeMeasurements(NamedTuple):
    """Set of n edges in the form of the joint fit.

    All arrays have a leading axis of n. `LINEAR` is the number of linear parameters of an edge.

    Attributes:
        cells: cells of the edges.
        angle: direction of the normal, rad.
        noise: noise of the pixels.
        excess: factor by which the variances of the pixels of each edge were increased in its fit (no unit).
        linear: (n, LINEAR) levels, illumination and shift, as in `State.linear`.
        used: (n, LINEAR) 1 for free linear parameters, 0 for fixed ones.
        lens: lens model, whose arrays have a leading axis of n.
    """

    cells: EdgeCells
    angle: AnyArray
    noise: Noise
    excess: AnyArray
    linear: AnyArray
    used: AnyArray
    lens: LensModel


class ValueMeasurements(NamedTuple):
    """MTF values of n targets, m values for each target.

    Targets with fewer values are padded with values of weight 0.

    Attributes:
        frequency: (n, m) frequencies, cycles/px.
        direction: (n, m) directions, rad.
        mtf: (n, m) MTF, no unit.
        weight: (n, m, m) inverse covariances of the MTF values.
        lens: lens model, whose arrays have a leading axis of n.
    """

    frequency: AnyArray
    direction: AnyArray
    mtf: AnyArray
    weight: AnyArray
    lens: LensModel


class Measurements(NamedTuple):
    """All measurements of one colour.

    Attributes:
        edges: edges; None if there are no edges.
        values: MTF values of other targets; None if there are no other targets.
        groups: image and kind of every measurement, edges first.
        replaceable: groups that may be excluded: targets in images in which edges were also measured. Default: none.
    """

    edges: EdgeMeasurements | None
    values: ValueMeasurements | None
    groups: tuple[str, ...]
    replaceable: frozenset[str] = frozenset()

    def without(self, names: Collection[str]) -> Measurements:
        if self.values is None or not names:
            return self
        out = np.array([group in names for group in self.groups[len(self.groups) - len(self.values.mtf) :]])
        weight = np.where(out[:, None, None], 0.0, self.values.weight)
        return self._replace(values=self.values._replace(weight=weight))


class Shares(NamedTuple):
    """Contribution of each of n measurements to the fit.

    Attributes:
        information: (n, k, k) information matrix.
        score: (n, k) score.
        chi2: (n,) chi-square.
        degrees: (n,) degrees of freedom.
    """

    information: AnyArray
    score: AnyArray
    chi2: AnyArray
    degrees: AnyArray


class JointFit(NamedTuple):
    """Most probable parameters and the agreement of the measurements.

    The first parameter is the logarithm of the scale of the blur. Agreement is tested for this parameter.

    Attributes:
        parameters: (k,) fitted parameters.
        covariance: (k, k) covariance from the noise of the measurements and the prior.
        shares: contribution of every measurement, edges first.
        precision: (k,) precision of the prior.
    """

    parameters: np.ndarray
    covariance: np.ndarray
    shares: Shares
    precision: np.ndarray

    def observed_covariance(self) -> np.ndarray:
        """Compute the covariance of the parameters (k, k) from the scatter of the measurements.

        If noise explains the scatter, or there are fewer than four measurements, the result is the covariance from the noise.
        Otherwise the sandwich estimator is used, which treats the measurements as independent draws.
        """
        from scipy.special import chdtrc

        information, score = self.shares.information[:, 0, 0], self.shares.score
        known, count = information > 0, len(score)
        chi2 = float((score[known, 0] ** 2 / information[known]).sum())
        if chdtrc(max(int(known.sum()) - 1, 1), chi2) > IMPROBABLE or count < 4:
            return self.covariance
        score = score - score.mean(0)
        spread = score.T @ score * count / (count - 1)
        wide = self.covariance @ (spread + np.diag(self.precision)) @ self.covariance
        # The result is never smaller than the covariance from the noise.
        ratio = np.sqrt(np.maximum(np.diag(wide) / np.diag(self.covariance), 1.0))
        grown = wide if (ratio > 1).all() else self.covariance * np.outer(ratio, ratio)
        return (grown + grown.T) / 2

    def differences(self, groups: Sequence[str], trusted: Collection[str]) -> dict[str, tuple[float, float]]:
        """Compute the relative difference of the blur between each group and the trusted groups.

        A trusted group is compared with the other trusted groups. The result contains the difference and its standard
        deviation, by name of the group. `groups` contains the group of every measurement, and `trusted` the names of the
        trusted groups.
        """
        names = list(dict.fromkeys(groups))
        # The uncertainty of a group follows from its members only, because a contradiction adds to the scatter of groups.
        members = (np.array([group == name for group in groups]) for name in names)
        shift, error = (np.array(column) for column in zip(*map(self._of_group, members), strict=True))
        found = {}
        for i, name in enumerate(names):
            others = np.array([other in trusted and other != name for other in names])
            if others.any():
                weight = error[others] ** -2
                middle, std = weight @ shift[others] / weight.sum(), weight.sum() ** -0.5
                found[name] = float(shift[i] - middle), float(np.hypot(error[i], std))
        return found

    def _of_group(self, members: np.ndarray) -> tuple[float, float]:
        """Compute the relative difference between the blur of a group and that of the fit.

        The standard deviation includes the noise and the scatter of the group.
        """
        information = np.maximum(self.shares.information[members, 0, 0], 1e-300)
        score, total = self.shares.score[members, 0], float(information.sum())
        shift = float(score.sum()) / total
        chi2 = float(((score - shift * information) ** 2 / information).sum())
        return shift, float(np.sqrt(max(chi2 / max(members.sum() - 1, 1), 1.0) / total))


def fit_jointly(
    measurements: Measurements, start: np.ndarray, longest: Sequence[float], prior: np.ndarray, half_width: float
) -> JointFit:
    """Fit the most probable parameters to all measurements.

    A FitError is raised if the measurements do not determine the parameters, or the fit does not converge.

    Args:
        measurements: all measurements of one colour.
        start: initial parameters (k,).
        longest: largest step of each parameter (k,).
        prior: precision of a prior with mean 0, for each parameter (k,).
        half_width: half width of the pixel, px; lens models that fit the half width ignore this value.
    """
    theta = np.asarray(start, dtype=np.float64)
    edges, values = measurements.edges, measurements.values
    count = 0 if edges is None else len(edges.angle)
    edges = None if edges is None else _with_empty_edges(edges)
    half = np.float64(half_width)
    lowest, step = np.inf, np.zeros_like(theta)
    best, response, best_response = (theta, edges), None, None
    for _ in range(40):
        parts = []
        if edges is not None:
            of_edges, response = jax.tree.map(np.asarray, _edge_shares(edges, theta, half))
            parts.append(jax.tree.map(lambda a: a[:count], of_edges))
        if values is not None:
            parts.append(jax.tree.map(np.asarray, _value_shares(values, theta, half)))
        shares = jax.tree.map(lambda *a: np.concatenate(a), *parts)
        misfit = shares.chi2.sum() + prior @ theta**2
        if not misfit <= 1.05 * lowest:  # the step was too large, and is halved
            step = step / 2
            theta, edges = _after_step(*best, step, best_response)
            continue
        lowest, best, best_response = misfit, (theta, edges), response
        covariance = _inverse(shares.information.sum(0) + np.diag(prior))
        wanted = covariance @ (shares.score.sum(0) - prior * theta)
        step = np.clip(wanted, -np.array(longest), longest)
        theta, edges = _after_step(theta, edges, step, response)
        # The fit has converged if no parameter changes by more than 1e-3 standard deviations.
        if (np.abs(wanted) <= 1e-3 * np.sqrt(np.diag(covariance))).all():
            return JointFit(theta, covariance, shares, prior)
    raise FitError(
        "the fit of the camera did not converge: add edges or targets, so that the measurements determine the camera"
    )


def edge_measurements(stacks: Sequence[tuple[EdgeStack, LensModel]]) -> EdgeMeasurements | None:
    """Combine the edges of several stacks, each with its lens model.

    Edges with problems are excluded. The result is None if there are no stacks.
    """
    parts = []
    for result, lens in stacks:
        good = result.good
        found = jax.tree.map(lambda a, good=good: np.asarray(a)[good], result.fits)
        lenses = _stack_lenses([lens] * good.size)
        own = (found.state.linear, found.state.used)
        parts.append(EdgeMeasurements(found.cells, found.angle, found.noise, found.excess, *own, lenses))
    if not parts:
        return None
    most = max(part.cells.pixels.shape[1] for part in parts)

    def widened(part: EdgeMeasurements) -> EdgeMeasurements:
        more = (0, most - part.cells.pixels.shape[1])  # bins without pixels
        pad = lambda column: np.pad(column, [(0, 0)] * (column.ndim - 1) + [more])  # noqa: E731
        return part._replace(cells=jax.tree.map(pad, part.cells))

    return jax.tree.map(lambda *a: np.concatenate(a), *map(widened, parts))


def value_measurements(sets: Sequence[tuple[MTFSamples, LensModel]]) -> ValueMeasurements | None:
    if not sets:
        return None
    most = program_size(max(samples.frequency.size for samples, _ in sets))
    weights = []
    for samples, _ in sets:
        std = samples.mtf_std
        # A covariance with fewer independent errors than values is singular: the pseudoinverse omits its null space.
        inverse = np.linalg.pinv(samples.covariance / np.outer(std, std), rcond=1e-6, hermitian=True)
        weights.append(np.pad(inverse / np.outer(std, std), (0, most - std.size)))
    frequency, direction, mtf = (
        np.stack([np.pad(getattr(samples, name), (0, most - samples.mtf.size)) for samples, _ in sets])
        for name in ("frequency", "direction", "mtf")
    )
    return ValueMeasurements(frequency, direction, mtf, np.stack(weights), _stack_lenses([lens for _, lens in sets]))


def _after_step(
    theta: np.ndarray, edges: EdgeMeasurements | None, step: np.ndarray, response: tuple[np.ndarray, np.ndarray] | None
) -> tuple[np.ndarray, EdgeMeasurements | None]:
    if edges is not None and response is not None:
        edges = edges._replace(linear=edges.linear + response[0] - np.einsum("eij,j->ei", response[1], step))
    return theta + step, edges


@kept_program(returns=tuple[Shares, tuple[jax.Array, jax.Array]])
def _edge_shares(edges: EdgeMeasurements, theta: Any, half_width: Any) -> tuple[Shares, tuple[jax.Array, jax.Array]]:
    """Compute the contributions of the edges, and the response of the linear parameters of each edge.

    The response consists of the optimal step of the linear parameters, and of the negative derivative of the linear parameters
    with respect to the common parameters.
    """

    def one(edge: EdgeMeasurements) -> Any:
        profile = edge.lens.profile(jnp.asarray(edge.angle), half_width)
        at = edge_model(edge.cells, State(jnp.asarray(edge.linear), theta, edge.used), profile)
        weight = edge.cells.pixels / (edge.noise.variance(at.value, edge.cells.dim) * edge.excess)
        residual = edge.cells.value - at.value
        normal, score = (at.design * weight) @ at.design.T, at.design @ (weight * residual)
        inverse = scaled_inverse(normal[:LINEAR, :LINEAR])
        alone, shared = inverse @ score[:LINEAR], inverse @ normal[:LINEAR, LINEAR:]
        share = Shares(
            normal[LINEAR:, LINEAR:] - normal[LINEAR:, :LINEAR] @ shared,
            score[LINEAR:] - normal[LINEAR:, :LINEAR] @ alone,
            (weight * residual**2).sum(),
            (edge.cells.pixels > 0).sum() - edge.used.sum(),
        )
        return share, (alone, shared)

    # The number of edges that are processed together limits the memory.
    return jax.lax.map(one, edges, batch_size=16)


@kept_program(returns=Shares)
def _value_shares(values: ValueMeasurements, theta: Any, half_width: Any) -> Shares:
    def one(some: ValueMeasurements) -> Shares:
        f, direction = jnp.asarray(some.frequency), jnp.asarray(some.direction)
        mtf = partial(some.lens.mtf, f=f, angle=direction, half_width=half_width)
        by = jax.jacfwd(mtf)(theta)
        residual = some.mtf - mtf(theta)
        weighted = some.weight @ by
        return Shares(
            by.T @ weighted,
            residual @ weighted,
            residual @ some.weight @ residual,
            (jnp.diagonal(some.weight) > 0).sum(),
        )

    return jax.lax.map(one, values)


def _inverse(information: np.ndarray) -> np.ndarray:
    if not np.isfinite(information).all():
        raise FitError(
            "the fit of the camera produced non-finite values: check that the measurements and their standard deviations are "
            "finite, and omit the wrong measurements"
        )
    if (np.diag(information) <= 0).any():
        raise FitError(
            "the measurements do not determine the camera, because a parameter of the camera has no effect on them: "
            "add targets"
        )
    if least_eigenvalue(information) < FLOOR:
        raise FitError(
            "the measurements do not determine the camera, because parameters of the camera have the same effect on "
            "them: add targets"
        )
    return scaled_inverse(information)


def _stack_lenses(lenses: Sequence[LensModel]) -> LensModel:
    return jax.tree.map(lambda *a: np.stack([np.asarray(x) for x in a]), *lenses)


def _with_empty_edges(edges: EdgeMeasurements) -> EdgeMeasurements:
    """Add empty edges to reach one of a few sizes, so that one compiled program serves many calls."""
    more = program_size(len(edges.angle)) - len(edges.angle)
    full = jax.tree.map(lambda a: np.concatenate([a, np.repeat(a[:1], more, axis=0)]), edges)
    if not more:
        return full
    pixels = np.array(full.cells.pixels)
    pixels[len(edges.angle) :] = 0
    return full._replace(cells=full.cells._replace(pixels=pixels))
