"""Least-squares problem of a fit: model and residuals with their derivatives (docs/model.md 8).

The model of a cell of unit u (a channel of a table) is

    F_u(theta_d) A(cell; lobe, rig) + B_u(cell) .

F_u is the Fresnel term of the unit, and A is the record of the lobe at F = 1. The body B_u is a diffuse part, and in some fits
also a rough base (`body.py`). The blur of the diffuse part by the camera is neglected. A free strength F in every slice is
eliminated exactly (variable projection, Golub & Pereyra 1973; derivatives by Kaufman 1975).

For a near rig, A = R + M d(ln F) / d(theta_d), where R is the record of the lobe, and M is its moment (`lobe_operator.py`). The
derivative of ln F is computed from the Fresnel model, or from a smooth curve through free strengths (`strength_slopes.py`). The
derivative from free strengths is treated as independent of the parameters, because its dependence on them is of second order.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cached_property
from typing import NamedTuple

import numpy as np

from matcam.camera.sensor import PixelNoise
from matcam.core.jax import jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.inverse.fit.body import NARROWEST_PX, diffuse_and_slope, loss_in_coat, transmittance
from matcam.inverse.fit.fit_data import FitData, Whitening, whitening
from matcam.inverse.fit.fit_parameters import FresnelModel, Layout, LobeKind, reflectance_at
from matcam.inverse.fit.lobe_slopes import RecordAndSlopes, record_and_slopes
from matcam.inverse.fit.strength_slopes import StrengthSlopes
from matcam.inverse.operator.chosen_cells import ChosenCells
from matcam.inverse.operator.lobe_operator import LobeOperator
from matcam.inverse.rig.rig_axes import Axis
from matcam.material.ndf.free_lobe import KNOTS, SHADOWS, STIFFER, slope_of_knot, spline_smoothness
from matcam.numerics.approximation import smoothness

BASE = LobeKind("ggx", "smith")
"""Lobe of a base."""
_COATED_STD = 0.3
"""Standard deviation of the prior of the coated share of a diffuse part (no unit): that of a uniform distribution in
[0, 1].
"""


class Prior(NamedTuple):
    """Prior knowledge of the parameters of a fit.

    Attributes:
        axes: fitted parameters of the rig.
        root: square root R of the information matrix R' R of the coordinates of the rig, (rows, axes). The columns of
            parameters without a prior are 0.
        spline: standard deviation of the second differences of the spline coefficients of lobe and masking (no unit).
        finest: slope (no unit) below which the camera resolves no structure. The spline of the lobe is ten times stiffer at
            smaller slopes.
        learned: value of `spline` estimated from the data, for slopes at which the spline of the lobe is not stiffer. None:
            the value of `spline`.
    """

    axes: tuple[Axis, ...] = ()
    root: np.ndarray = np.zeros((0, 0))
    spline: float = 0.0
    finest: float = 0.0
    learned: float | None = None

    def rows(self, layout: Layout) -> np.ndarray:
        """Build the linear combinations of the coordinates that have prior mean 0 and unit variance, (rows, coordinates)."""
        rig = np.zeros((len(self.root), layout.size))
        rig[:, layout.rig] = self.root
        rows = [rig, np.eye(layout.size)[layout.coat] / _COATED_STD]
        kind = layout.kind
        first = len(kind.family_names)
        splines = (
            (first, kind.spline_size, self._of_spline),
            (first + kind.spline_size, kind.shadows, self._of_masking),
        )
        for start, count, rows_of in splines:
            for lobe in range(layout.lobes if count else 0):
                smooth = rows_of()
                own = np.zeros((len(smooth), layout.size))
                position = layout.lobe(lobe).start + start
                own[:, position : position + count] = smooth
                rows.append(own)
        return np.concatenate(rows)

    def _of_spline(self) -> np.ndarray:
        smooth = spline_smoothness()
        middle = np.abs(smooth) @ np.arange(KNOTS) / np.abs(smooth).sum(axis=1)
        smooth[slope_of_knot(middle) < self.finest] *= (
            STIFFER  # below the resolution of the pixels the lobe follows its family
        )
        if self.learned is not None:
            shown = (smooth == smoothness(KNOTS)).all(axis=1) & (np.arange(len(smooth)) < KNOTS - 2)
            smooth[shown] *= self.spline / self.learned
        return smooth / self.spline

    def _of_masking(self) -> np.ndarray:
        return smoothness(SHADOWS) / self.spline

    def rig_information(self) -> np.ndarray:
        """Compute the prior information matrix of the coordinates of the rig, (axes, axes).

        If no parameter has a prior, the result is 1e-6 times the identity matrix, which is not singular.
        """
        return self.root.T @ self.root if self.root.any() else np.eye(len(self.axes)) * 1e-6


class Body(NamedTuple):
    """Modelled values of the body under the lobe: BRDF of the diffuse part plus record of the rough base.

    In the shapes, u is the number of units, s of slices, n of cells in a slice, and p of coordinates.

    Attributes:
        value: values of the body in the cells, 1/sr, (u, s, n); or (u, 1, 1) without coat and base.
        derivative: derivatives of the values with respect to all coordinates of the fit, 1/sr, (p, u, s, n).
    """

    value: np.ndarray
    derivative: np.ndarray


class FitModel(NamedTuple):
    """Modelled values of the cells and their derivatives.

    In the shapes, u is the number of units, s of slices, n of cells in a slice, and p of coordinates.

    Attributes:
        value: modelled values, 1/sr, (u, s, n).
        derivative: derivatives of the values with respect to the coordinates at constant free strengths, 1/sr, (p, u, s, n).
        lobe: record of the lobe at F = 1, 1/sr, (u, s, n).
        strength: strength F, no unit, (u, s).
        strength_std: standard deviation of free strengths if all other parameters are exact, no unit, (u, s). It is infinite
            for slices without values, and 0 if F is not free in every slice.
        log_slope: derivative of ln F with respect to theta_d, 1/rad, (u, s). It describes the variation of F over the
            quadrature nodes of a cell; 0 for a distant rig.
    """

    value: np.ndarray
    derivative: np.ndarray
    lobe: np.ndarray
    strength: np.ndarray
    strength_std: np.ndarray
    log_slope: np.ndarray


@kept_program
def _reflectance(
    model: FresnelModel, coordinates: jax.Array, theta: jax.Array, rise: bool
) -> tuple[jax.Array, jax.Array]:
    """Compute F at angles `theta`, rad, and its derivatives with respect to the coordinates, for each row of coordinates.

    rise: True to compute dF/dtheta, 1/rad, and its derivatives instead.
    """

    def curve(c: jax.Array) -> jax.Array:
        at = reflectance_at(model, c).at
        return jax.jvp(at, (theta,), (jnp.ones_like(theta),))[1] if rise else at(theta)

    return jax.vmap(curve)(coordinates), jax.vmap(jax.jacfwd(curve))(coordinates)


class FitProblem:
    """Least-squares problem of a fit: data, operators, layout and prior.

    Attributes:
        data: values of the chosen cells.
        cells: the chosen cells.
        operators: operators from a lobe to its record in the chosen cells, one for each colour of the rig.
        layout: order of the coordinates.
        prior: prior of the coordinates.
        radius: radius of the sphere or cylinder, px.
        colour_of: index of the operator of each unit, (units,).
    """

    def __init__(
        self,
        data: FitData,
        cells: ChosenCells,
        operators: tuple[LobeOperator, ...],
        layout: Layout,
        prior: Prior,
        radius: float,
    ):
        self.data, self.cells, self.operators = data, cells, operators
        self.layout, self.prior, self.radius = layout, prior, radius
        # tables have one channel for each colour; an achromatic lens has one operator for all channels
        self.colour_of = [unit % len(operators) for unit in range(layout.units)]
        self._last_base: tuple[bytes, RecordAndSlopes] | None = None
        self._last: dict[tuple[int, int], tuple[bytes, list[RecordAndSlopes]]] = {}

    def with_layout(self, layout: Layout) -> FitProblem:
        return FitProblem(self.data, self.cells, self.operators, layout, self.prior, self.radius)

    def around(self, model: FitModel, noise: PixelNoise) -> FitProblem:
        """Build the same problem with the observations of clipped cells near a model (`FitData.around`)."""
        problem = copy(self)
        problem.data = self.data.around(model.value, noise)
        return problem

    @property
    def theta_d(self) -> np.ndarray:
        """Difference angles of the slices, rad, (slices,)."""
        return self.cells.theta_d

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute the lower and the upper bounds of the coordinates, (coordinates,) each."""
        layout = self.layout
        bounds = layout.kind.bounds(self.radius) * layout.lobes
        bounds += [(axis.low, axis.high) for axis in self.prior.axes]
        bounds += [(-0.5, 0.5)] * layout.coated + [(float(np.log(NARROWEST_PX / self.radius)), 0.0)] * layout.base
        low, high = np.array(bounds + layout.unit_bounds() * layout.units).T
        return low, high

    def residual(self, model: FitModel) -> np.ndarray:
        """Compute data - model, 1/sr, (u, s, n); 0 for unused cells."""
        return np.where(self.data.used, self.data.values - model.value, 0.0)

    def of_units(self, name: str, p: np.ndarray) -> np.ndarray:
        """Select one parameter of the body of every unit, (units,).

        The values are 0 if the fit does not have this part of the body.

        Args:
            name: "diffuse" for the albedo of the diffuse part, or "base" for the reflectance of the base.
            p: coordinates of the fit.
        """
        indices = self.layout.of_units(name)
        return p[indices] if indices else np.zeros(self.layout.units)

    def body(self, p: np.ndarray) -> Body:
        layout, cells = self.layout, self.cells
        albedo = self.of_units("diffuse", p)[:, None, None]
        derivative = np.zeros((layout.size, layout.units, *cells.theta_h.shape))
        lost = self._loss_in_coat if layout.coated else np.zeros((1, 1))
        diffuse, by_share = diffuse_and_slope(layout.coated_share(p), lost)
        derivative[layout.coat] = albedo * by_share
        value = albedo * diffuse
        for u, position in enumerate(layout.of_units("diffuse")):
            derivative[position, u] = diffuse
        if layout.base:
            of_base, slopes = (part[self.colour_of] for part in self._base_records(p))
            reflectance = self.of_units("base", p)[:, None, None]
            value = value + reflectance * of_base
            derivative[layout.base_width.start] = reflectance * slopes[:, 0]
            derivative[layout.rig] = reflectance * np.moveaxis(slopes[:, 1:], 1, 0)
            for u, position in enumerate(layout.of_units("base")):
                derivative[position, u] = of_base[u]
        return Body(value, derivative)

    def model(self, p: np.ndarray, weight: np.ndarray) -> FitModel:
        """Evaluate the model.

        Args:
            p: coordinates of the fit.
            weight: weights of the cells (inverse variances), from which free strengths are solved, sr^2, (u, s, n).
        """
        layout = self.layout
        pairs = list(zip(layout.lobe_of, self.colour_of, strict=True))
        found = {pair: self._records_and_slopes(*pair, p) for pair in dict.fromkeys(pairs)}
        orders = [found[pair] for pair in pairs]
        records = [np.stack([one.record for one in order]) for order in zip(*orders, strict=True)]
        body = self.body(p)
        model, by_fresnel = self._strengths(p, weight, records, body.value)
        derivative = body.derivative
        for u, index in enumerate(layout.lobe_of):
            by_lobe = _combined([one.slopes for one in orders[u]], model.log_slope[u])
            slope = model.strength[u][None, :, None] * by_lobe
            derivative[layout.lobe(index), u] = slope[: layout.kind.size]
            derivative[layout.rig, u] += slope[layout.kind.size :]
            position = layout.unit(u)
            derivative[position.start : position.start + layout.fresnel_size, u] = by_fresnel[u]
        return model._replace(derivative=derivative)

    def start_model(self, record: np.ndarray, weight: np.ndarray) -> FitModel:
        """Evaluate the model with free strengths, for the start of a search.

        The model has neither a body nor derivatives. F is constant within a cell, also in a near rig. The error of this
        approximation is smaller than the differences between the lobes from which a search starts.

        Args:
            record: record of the common lobe of all units through each operator at F = 1, 1/sr, (operators, s, n).
            weight: weights of the cells (inverse variances), sr^2, (u, s, n).
        """
        p = np.zeros(self.layout.size)
        return self._strengths(p, weight, [record[self.colour_of]], np.zeros((self.layout.units, 1, 1)))[0]

    def _strengths(
        self, p: np.ndarray, weight: np.ndarray, records: list[np.ndarray], body: np.ndarray
    ) -> tuple[FitModel, np.ndarray]:
        """Evaluate the model, and its derivatives with respect to the coordinates of F, (u, coordinates, s, n).

        `records` contains the record of the lobe of each unit at F = 1, 1/sr, (u, s, n). In a near rig it also contains the
        moment of each record, rad/sr. `body` contains the values of the body, 1/sr, which broadcast to (u, s, n).
        """
        layout, (units, slices, cells) = self.layout, records[0].shape
        log_slope = np.zeros((units, slices))
        if layout.fresnel == "free":
            lobe = records[0]
            strength, std = self._free_strengths(weight, lobe, body)
            if len(records) > 1:
                log_slope = self._slopes.log_slopes(strength, std)
                lobe = _combined(records, log_slope)
                strength, std = self._free_strengths(weight, lobe, body)
            by_fresnel = np.zeros((units, 0, slices, cells))
        else:
            rows = placed(np.stack([p[layout.unit(u)][: layout.fresnel_size] for u in range(units)]))
            curves = [
                [np.asarray(a) for a in _reflectance(layout.fresnel, rows, placed(self.theta_d), bool(order))]
                for order in range(len(records))
            ]
            strength, std = curves[0][0], np.zeros((units, slices))
            if len(records) > 1:
                log_slope = curves[1][0] / strength
            lobe = _combined(records, log_slope)
            by_curves = [np.moveaxis(by, -1, 1)[..., None] for _, by in curves]
            by_fresnel = sum(by * record[:, None] for by, record in zip(by_curves, records, strict=True))
        value = strength[..., None] * lobe + body
        return FitModel(value, np.zeros((0, *value.shape)), lobe, strength, std, log_slope), by_fresnel

    def _free_strengths(self, weight: np.ndarray, lobe: np.ndarray, body: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve for the strength of every unit and slice, and its standard deviation, (u, s) each.

        The standard deviation is conditional on the other parameters.
        """
        data = self.data
        wa = np.where(data.used, weight, 0.0) * lobe
        power = (wa * lobe).sum(-1)
        safe = np.where(power > 0, power, 1.0)
        strength = np.where(power > 0, (wa * (data.values - body)).sum(-1) / safe, 0.0)
        return strength, np.where(power > 0, 1 / np.sqrt(safe), np.inf)

    @cached_property
    def _slopes(self) -> StrengthSlopes:
        return StrengthSlopes(self.theta_d)

    def read(self, model: FitModel, of: Callable[[LobeOperator], np.ndarray]) -> np.ndarray:
        """Evaluate a linear function of the operator for every unit, (u, ..., s, n).

        The variation of F within a cell of a near rig is included.

        Args:
            model: model of the cells, which contains the derivative of ln F of each unit.
            of: linear function of an operator, with values of shape (..., s, n).
        """
        parts = [[of(order) for order in operator.orders] for operator in self.operators]
        pairs = zip(self.colour_of, model.log_slope, strict=True)
        return np.stack([_combined(parts[colour], slope) for colour, slope in pairs])

    def _base_records(self, p: np.ndarray) -> RecordAndSlopes:
        """Compute the record of a base of reflectance 1, 1/sr, and its derivatives with respect to ln roughness and the rig.

        The light crosses the coat twice. The derivatives with respect to the rig are along the axes of its parameters. The
        first axis of both arrays is that of the operators.
        """
        q = np.concatenate([p[self.layout.base_width], p[self.layout.rig]])
        if self._last_base is None or self._last_base[0] != q.tobytes():
            found = zip(*(record_and_slopes(operator, BASE, q) for operator in self.operators), strict=True)
            self._last_base = q.tobytes(), RecordAndSlopes(*(np.stack(part) * self._transmittance for part in found))
        return self._last_base[1]

    @cached_property
    def _transmittance(self) -> np.ndarray:
        return np.asarray(transmittance(*self._angles))

    @cached_property
    def _loss_in_coat(self) -> np.ndarray:
        return loss_in_coat(*self._angles)

    @property
    def _angles(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.cells.theta_h, self.cells.theta_d[:, None], self.cells.phi_d

    def _records_and_slopes(self, index: int, colour: int, p: np.ndarray) -> list[RecordAndSlopes]:
        """Compute the record of a lobe, and in a near rig also its moment, each with its derivatives, through one operator.

        The last results are cached, because an update of the weights does not change the lobe.
        """
        q = np.concatenate([p[self.layout.lobe(index)], p[self.layout.rig]])
        pair, key = (index, colour), q.tobytes()
        if pair not in self._last or self._last[pair][0] != key:
            orders = self.operators[colour].orders
            self._last[pair] = key, [record_and_slopes(one, self.layout.kind, q) for one in orders]
        return self._last[pair][1]

    def gain(self, noise: PixelNoise) -> float:
        """Select the standard deviation of the image gain (no unit), which is infinite for free strengths."""
        return np.inf if self.layout.fresnel == "free" else noise.picture_gain

    def whitening(self, model: FitModel, weight: np.ndarray, gain: float) -> Whitening:
        """Build the whitening of the residuals.

        If strengths are free, the component of the residuals along the lobe is removed. Otherwise the component along the model
        is reduced according to the image gain.

        Args:
            model: model at the coordinates of the fit.
            weight: robust weights of the cells (inverse variances), sr^2, (u, s, n).
            gain: standard deviation of the image gain (no unit).
        """
        if self.layout.fresnel == "free":
            return whitening(self.data, weight, model.lobe, np.inf)
        return whitening(self.data, weight, model.value, gain)


def _combined(orders: list[np.ndarray], log_slope: np.ndarray) -> np.ndarray:
    """Compute record + log_slope * moment; in a distant rig, only the record, (..., s, n).

    `orders` contains the record and, in a near rig, the moment. `log_slope` is the derivative of ln F with respect to theta_d,
    1/rad, (s,) or (..., s).
    """
    if len(orders) == 1:
        return orders[0]
    record, moment = orders
    return record + log_slope[..., None] * moment
