"""Sensitivity of a fit to exact parameters of the rig, and to the shape of the lobe.

Rig: the fit is repeated with one exact parameter free. If rig and data agree, the result does not change. Otherwise
lens, lamp or family is wrong, not necessarily the free parameter. The change of the correction then counts several
times as uncertainty.

Lobe: the record is linear in D. After a fit, D (1 + sum_k b_k B_k(theta)) with smooth B_k is therefore a linear
least-squares problem (docs/model.md 8). It is solved together with small changes of the parameters of the fit, with
strengths free in every slice. The evidence of the linear model determines the variance of the b_k. The part of the b_k
that the pixels do not resolve is uncertainty. The lobe itself stays that of its family, because a modified lobe is an
explanation of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from matcam.camera.sensor import PixelNoise
from matcam.core.jax import jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.core.remark import Remark
from matcam.inverse.fit.fit_data import cell_variance, estimate_noise, huber_weights, standardised_residual, whitening
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.fit_readings import LinearisedFit
from matcam.inverse.fit.fit_setup import FitSetup
from matcam.inverse.fit.fit_statements import SMOOTH_LOBE, fit_statements, rig_statements
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.lobe_operator import LobeOperator
from matcam.inverse.operator.rig_axes import LAMP, LENS, Axis, is_guess, known_lens, widths_of
from matcam.material.lambda_table import quick_table
from matcam.material.ndf.free_lobe import KNOTS, bend_smoothness, bend_sums
from matcam.numerics.approximation import smoothness
from matcam.numerics.fit_budget import Statement
from matcam.numerics.linalg import scaled_inverse
from matcam.rigs import Rig

CONTRADICTION_WEIGHT = 3.0
"""Factor of the change as uncertainty where rig and data contradict each other."""

DOUBTED = (LENS, LAMP)
"""Exact parameters of a rig that are tested: the width of the lens and the radius of the lamp."""

_INSIDE = 0.8
"""Share of the half range of an axis up to which a nearby solution is accepted; beyond it the optimum may lie outside."""
_SIGNIFICANT = 4.0
"""Standard deviations by which a free parameter must move to contradict the rig."""
_LEAST = 0.002
"""Smallest relative change of the width of the blur that contradicts the rig."""


class Doubt(NamedTuple):
    """Refit with one parameter of the rig free.

    Attributes:
        axis: the parameter.
        coordinate: fitted coordinate; 0 is the value of the rig.
        value: the parameter there, in its own unit.
        std: standard deviation of `value`.
        contradicts: whether rig and data contradict each other.
        fit: the fit with the parameter free.
        weight: factor of its change as uncertainty; 0 where the covariance of the fit includes it.
    """

    axis: Axis
    coordinate: float
    value: float
    std: float
    contradicts: bool
    fit: MaterialFit
    weight: float

    @property
    def counted(self) -> float:
        """Return the factor of the change as uncertainty."""
        return self.weight * (CONTRADICTION_WEIGHT if self.contradicts else 1.0)

    @property
    def remark(self) -> Remark:
        """State the fitted value, and whether it contradicts the rig."""
        if self.axis.name == LENS:
            code = "lens-contradicts-data"
            found = (
                f"left free, the lens would be {self.value:.3f} +- {self.std:.1g} px instead of {self.axis.base:.3f} px"
            )
        else:
            code = "lamp-contradicts-data"
            radius, std, base = (float(np.degrees(v)) for v in (self.value, self.std, self.axis.base))
            found = f"left free, the lamp's radius would be {radius:.3f} +- {std:.1g} degrees instead of {base:.3f}"
        return Remark(
            code,
            f"{found}: camera, lamp or family contradict the data; {CONTRADICTION_WEIGHT:g} times the difference counts "
            "as uncertainty",
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the fit as numbers and texts, with its contradiction flag."""
        return {**self.fit.to_dict(), "contradicts": self.contradicts}


class OtherLobe(NamedTuple):
    """Another lobe through the same camera.

    Attributes:
        fit: of it.
        setup: of `fit`.
        probability: that it, of all lobes, made the table (no unit).
    """

    fit: MaterialFit
    setup: FitSetup
    probability: float


def rig_doubts(setup: FitSetup, rig: Rig, found: MaterialFit, names: Sequence[str] = DOUBTED) -> tuple[Doubt, ...]:
    """Fit with parameters of the rig free, one after the other. found: the solution of `setup`.

    For a width with a prior, the fit that exists is used.
    """
    doubts = []
    for name in names:
        if name in [axis.name for axis in found.coordinates.axes]:
            doubts.append(_fitted_doubt(found, name, rig))
        elif name in widths_of(rig) or name in rig.camera.parameters():
            doubts.append(_followed_doubt(setup.with_(also=(name,)), found, name))
    if not found.resolved:  # a lobe at its bound biases the lens
        return tuple(doubt._replace(contradicts=doubt.contradicts and doubt.axis.name != LENS) for doubt in doubts)
    return tuple(doubts)


def _followed_doubt(free: FitSetup, found: MaterialFit, name: str) -> Doubt:
    """Refit with a parameter free near its value, and over its whole range if the data require it."""
    doubt = _free_doubt(free.with_(nearby=True).solve(start=found, weights="start"), name)
    axis, whole = doubt.axis, next(axis for axis in free.prior.axes if axis.name == name)
    ends = [own for own, far in ((axis.low, whole.low), (axis.high, whole.high)) if own != far]
    if all(abs(doubt.coordinate) < _INSIDE * abs(end) or doubt.coordinate * end < 0 for end in ends):
        return doubt
    return _free_doubt(free.solve(start=found, weights="start"), name)


def _free_doubt(fit: MaterialFit, name: str) -> Doubt:
    """Refit with a parameter free that the rig gives as exact."""
    at = fit.coordinates
    place = [axis.name for axis in at.axes].index(name)
    own = len(at.lobe) + place
    coordinate, std = float(at.rig[place]), float(np.sqrt(at.covariance[own, own]))
    contradicts = bool(abs(coordinate) > max(_SIGNIFICANT * std, _LEAST))
    return Doubt(at.axes[place], coordinate, fit.params[name], fit.std[name], contradicts, fit, weight=1.0)


def _fitted_doubt(fit: MaterialFit, name: str, rig: Rig) -> Doubt:
    """Compare a parameter that has a prior with its estimate from the data alone."""
    at = fit.coordinates
    place = [axis.name for axis in at.axes].index(name)
    own = len(at.lobe) + place
    axis, coordinate, variance = at.axes[place], float(at.rig[place]), float(at.covariance[own, own])
    known = known_lens(rig.camera).uncertainty
    relative = (known.std()[name] if known else 0.0) / axis.base
    if is_guess(name, relative):  # no exact value that the data could contradict
        return Doubt(axis, coordinate, fit.params[name], fit.std[name], False, fit, weight=0.0)
    by_data = 1 / max(1 / variance - 1 / relative**2, 1e-9)
    likeliest = coordinate * by_data / variance
    contradicts = abs(likeliest) > _SIGNIFICANT * np.hypot(np.sqrt(by_data), relative)
    return Doubt(axis, coordinate, fit.params[name], fit.std[name], bool(contradicts), fit, weight=0.0)


FAMILY_FAILS = 0.05
"""Scale of the shape correction above which the family does not explain the data."""

_SCALES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
_ROUNDS = 3


class ShapeUncertainty(NamedTuple):
    """Uncertainty of the shape of a lobe, as a factor 1 + sum b_k B_k.

    Attributes:
        covariance: of (lobe, rig, b), the first two in the fit's coordinates.
        scale: estimated standard deviation of the second differences of b.
        noise: of a pixel, as estimated with b free, or as given.
        statements: prior knowledge of (lobe, rig, b). Default: none.
    """

    covariance: np.ndarray
    scale: float
    noise: PixelNoise
    statements: tuple[Statement, ...] = ()

    @property
    def family_fails(self) -> bool:
        """Check whether the family of the lobe fails to explain the data."""
        return self.scale > FAMILY_FAILS

    def remark(self, family: str) -> Remark:
        """State that a family does not explain the data and its lobe was corrected."""
        return Remark(
            "family-fails",
            f"no {family} lobe explains the data (scale {self.scale:g}): its shape was corrected by a smooth factor, and what "
            "the pixels do not resolve of that shape counts as uncertainty",
        )


@kept_program
def shape_records(
    operator: LobeOperator, kind: LobeKind, q: jax.Array, shifts: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Compute the record of a lobe, (slices, cells), and the contribution of each B_k, (k, slices, cells)."""
    ndf = kind.ndf(q)
    table = None if kind.masking is None else quick_table(ndf)

    def one(slice_: LobeOperator) -> jax.Array:
        lobe = slice_.weighted(ndf, kind.masking, shifts, table)
        return jnp.concatenate([jnp.sum(lobe, axis=(-2, -1))[None], bend_sums(slice_.slope2, lobe, axes=2)])

    both = jnp.moveaxis(operator.slice_by_slice(one), 0, 1)
    return both[0], both[1:]


def shape_uncertainty(found: MaterialFit, noise: PixelNoise | None, kappa: float = 1.0) -> ShapeUncertainty:
    """Estimate the uncertainty of the shape of a fit with free strengths and one lobe.

    noise: None: estimated anew. kappa: power of the likelihood (`evidence`). Default: 1.
    """
    linear = found.linearised()
    solution, at = linear.solution, linear.coordinates
    data, model = solution.problem.data, solution.model
    columns = _columns(linear)
    count, shapes = len(columns), slice(len(linear.by_coordinates), len(linear.by_coordinates) + KNOTS)
    rig = slice(len(at.lobe), len(linear.by_coordinates))
    # a tail that departs from a stiff prior would enlarge the scale and leave the peak free
    even, differences = smoothness(KNOTS), bend_smoothness()
    assumed = solution.noise
    result = np.zeros(count)
    scale, covariance = _SCALES[0], np.zeros((count, count))
    for _ in range(_ROUNDS):
        value = np.maximum(model.value + np.tensordot(result, columns, 1), 1e-3 * model.value)
        rest = linear.residual - np.tensordot(result, columns, 1)
        if noise is None:
            assumed = estimate_noise(data, np.where(data.used, rest, 0), value, count, assumed)
        robust = huber_weights(standardised_residual(data, rest, value, assumed, np.inf))
        white = whitening(data, robust / cell_variance(data, value, assumed), model.lobe, np.inf)
        flat, target = white(columns).reshape(count, -1), white(linear.residual).ravel()
        information, right = kappa * flat @ flat.T, kappa * flat @ target
        information[rig, rig] += linear.rig_information
        scale = max(_SCALES, key=lambda one: linear_evidence(information, right, shapes, even / one))
        penalty = np.zeros((count, count))
        penalty[shapes, shapes] = differences.T @ differences / scale**2
        covariance = scaled_inverse(information + penalty)
        result = covariance @ right
    inner = slice(0, shapes.stop)
    statements = rig_statements(at.axes, linear.rig_information, rig.start, shapes.stop)
    smooth = Statement(SMOOTH_LOBE, penalty[inner, inner])
    return ShapeUncertainty(covariance[inner, inner], scale, assumed, (*statements, smooth))


def known_shape(found: MaterialFit, scale: float) -> ShapeUncertainty:
    """Compute the uncertainty of the parameters of a fit that includes its shape. scale: estimated for its family."""
    covariance = found.coordinates.covariance
    own = slice(0, len(covariance))
    statements = tuple(
        one._replace(information=np.pad(one.information[own, own], (0, KNOTS)))
        for one in fit_statements(found._solution)
    )
    return ShapeUncertainty(np.pad(covariance, (0, KNOTS)), scale, found.noise, statements)


def _columns(linear: LinearisedFit) -> np.ndarray:
    """Compute the derivatives of the model by lobe, rig, b and the parameters of the units."""
    at, solution = linear.coordinates, linear.solution
    q, shifts = placed(at.lobe), placed(at.rig)
    added = solution.problem.read(solution.model, lambda one: np.asarray(shape_records(one, at.kind, q, shifts)[1]))
    by_shape = np.nan_to_num(solution.model.strength)[None, :, :, None] * np.moveaxis(added, 0, 1)
    return np.concatenate([linear.by_coordinates, by_shape, linear.by_units])


def linear_evidence(information: np.ndarray, right: np.ndarray, shapes: slice, rows: np.ndarray) -> float:
    """Compute the log evidence of a scale, up to a constant; all parameters but the b_k are integrated out.

    information, right: of the linear model by all its parameters, without the prior of the scale. shapes: indices of
    the b_k. rows: combinations of the b_k that are 0 +- 1.
    """
    others = np.r_[0 : shapes.start, shapes.stop : len(right)]
    cross = information[shapes, others]
    inner = scaled_inverse(information[np.ix_(others, others)])
    data = information[shapes, shapes] - cross @ inner @ cross.T
    pull = right[shapes] - cross @ inner @ right[others]
    prior = rows.T @ rows
    total = data + prior
    return 0.5 * float(pull @ scaled_inverse(total) @ pull - np.linalg.slogdet(total)[1] + np.linalg.slogdet(prior)[1])
