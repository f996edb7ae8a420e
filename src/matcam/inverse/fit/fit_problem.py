"""Least-squares problem of a fit: model and residuals with their derivatives (docs/model.md 8).

The model of a cell of unit u (a channel of a table) in slice s is  F_u(theta_d) A(cell; lobe, rig) + B_u.  The body B_u is
diffuse_u / pi, and in some fits light of a rough base, which no camera blurs. A strength F that is free in every slice is
solved for exactly (variable projection, Golub & Pereyra 1973; derivatives by Kaufman 1975).

For a near rig A is the record of D G at F = 1 plus the slope of ln F times the moment of the record
(`lobe_operator.py`). The slope is that of the Fresnel model, or of a smooth curve through free strengths
(`strength_slopes.py`). The latter is constant in derivatives, because its dependence on the parameters is of second
order.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np

from matcam.camera.sensor import PixelNoise
from matcam.core.jax import jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.inverse.fit.base_lobe import NARROWEST_PX, base_and_slope
from matcam.inverse.fit.fit_data import FitData, Whitening, whitening
from matcam.inverse.fit.fit_parameters import FresnelModel, Layout, reflectance_at
from matcam.inverse.fit.lobe_slopes import RecordAndSlopes, record_and_slopes
from matcam.inverse.fit.strength_slopes import StrengthSlopes
from matcam.inverse.operator.chosen_cells import ChosenCells
from matcam.inverse.operator.lobe_operator import LobeOperator
from matcam.inverse.operator.rig_axes import Axis
from matcam.material.ndf.free_lobe import KNOTS, SHADOWS, STIFFER, slope_of_knot, spline_smoothness
from matcam.numerics.approximation import smoothness


class Prior(NamedTuple):
    """Prior knowledge of the parameters of a fit.

    Attributes:
        axes: fitted parameters of the rig.
        root: (rows, axes), root of the information matrix of their coordinates; 0 for unknown parameters.
        spline: standard deviation of the second differences of the coefficients of a spline.
        finest: slope below which the camera resolves no structure, so that the spline is ten times stiffer.
        learned: value of `spline` estimated from the data where the spline is not stiff; None: `spline`.
    """

    axes: tuple[Axis, ...] = ()
    root: np.ndarray = np.zeros((0, 0))
    spline: float = 0.0
    finest: float = 0.0
    learned: float | None = None

    def rows(self, layout: Layout) -> np.ndarray:
        """Build (rows, parameters): linear combinations of the parameters with prior mean 0 and unit variance."""
        rig = np.zeros((len(self.root), layout.size))
        rig[:, layout.rig] = self.root
        rows = [rig]
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
        """Return the information matrix of the coordinates of the rig; almost 0 for free parameters."""
        return self.root.T @ self.root if self.root.any() else np.eye(len(self.axes)) * 1e-6


class Body(NamedTuple):
    """Light from below the lobe. Shapes: u units, s slices, n cells, p parameters.

    Attributes:
        value: (u, s, n) or (u, 1, 1), 1/sr.
        derivative: (p, u, s, n), with respect to all parameters.
    """

    value: np.ndarray
    derivative: np.ndarray


class FitModel(NamedTuple):
    """Model and its derivatives. Shapes: u units, s slices, n cells, p parameters.

    Attributes:
        value: (u, s, n), 1/sr.
        derivative: (p, u, s, n), at constant strengths.
        lobe: (u, s, n), A of each unit.
        strength: (u, s), F.
        strength_std: (u, s), standard deviation of free strengths with all other parameters exact; 0 otherwise.
        log_slope: (u, s), slope of ln F, 1/rad, by which F varies over the nodes of A; 0 for a distant rig.
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
    """Compute F and its derivatives for each row of coordinates. rise: compute the slope of F with theta instead."""

    def curve(c: jax.Array) -> jax.Array:
        at = reflectance_at(model, c).at
        return jax.jvp(at, (theta,), (jnp.ones_like(theta),))[1] if rise else at(theta)

    return jax.vmap(curve)(coordinates), jax.vmap(jax.jacfwd(curve))(coordinates)


class FitProblem:
    """Data, operator, layout and prior of a fit.

    Attributes:
        data: values of the chosen cells.
        cells: the chosen cells.
        operator: operator from a lobe to its record in the chosen cells.
        layout: order of the parameters.
        prior: prior of the parameters.
        radius: radius of the sphere, px.
    """

    def __init__(
        self,
        data: FitData,
        cells: ChosenCells,
        operator: LobeOperator,
        layout: Layout,
        prior: Prior,
        radius: float,
    ):
        self.data, self.cells, self.operator = data, cells, operator
        self.layout, self.prior, self.radius = layout, prior, radius
        self._last: dict[int, tuple[bytes, list[RecordAndSlopes]]] = {}

    def with_layout(self, layout: Layout) -> FitProblem:
        """Return the same problem with other parameters."""
        return FitProblem(self.data, self.cells, self.operator, layout, self.prior, self.radius)

    @property
    def theta_d(self) -> np.ndarray:
        """Return the slices' theta_d, rad."""
        return self.cells.theta_d

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest value of each coordinate."""
        layout = self.layout
        bounds = layout.kind.bounds(self.radius) * layout.lobes
        bounds += [(axis.low, axis.high) for axis in self.prior.axes]
        bounds += [(float(np.log(NARROWEST_PX / self.radius)), 0.0)] * layout.base
        low, high = np.array(bounds + layout.unit_bounds() * layout.units).T
        return low, high

    def residual(self, model: FitModel) -> np.ndarray:
        """Return data - model, (u, s, n); 0 where unused."""
        return np.where(self.data.used, self.data.values - model.value, 0.0)

    def of_units(self, name: str, p: np.ndarray) -> np.ndarray:
        """Return a parameter of each unit, (u,): "diffuse", the albedo of its Lambertian part, or "base"; 0 without one."""
        indices = self.layout.of_units(name)
        return p[indices] if indices else np.zeros(self.layout.units)

    def body(self, p: np.ndarray) -> Body:
        """Evaluate the light from below the lobe in the chosen cells."""
        layout, cells = self.layout, self.cells
        value = self.of_units("diffuse", p)[:, None, None] / np.pi
        derivative = np.zeros((layout.size, layout.units, *cells.theta_h.shape))
        for u, position in enumerate(layout.of_units("diffuse")):
            derivative[position, u] = 1 / np.pi
        if layout.base:
            of_base, slope = base_and_slope(p[layout.base_width][0], cells.theta_h, cells.theta_d[:, None], cells.phi_d)
            reflectance = self.of_units("base", p)[:, None, None]
            value = value + reflectance * of_base
            derivative[layout.base_width.start] = reflectance * slope
            for u, position in enumerate(layout.of_units("base")):
                derivative[position, u] = of_base
        return Body(value, derivative)

    def model(self, p: np.ndarray, weight: np.ndarray) -> FitModel:
        """Evaluate the model at parameters. weight: (u, s, n), 1 / V, for the solution of free strengths."""
        layout = self.layout
        orders = [self._records_and_slopes(index, p) for index in range(layout.lobes)]
        records = [np.stack([orders[index][n].record for index in layout.lobe_of]) for n in range(len(orders[0]))]
        body = self.body(p)
        model, by_fresnel = self._strengths(p, weight, records, body.value)
        derivative = body.derivative
        for u, index in enumerate(layout.lobe_of):
            by_lobe = _combined([one.slopes for one in orders[index]], model.log_slope[u])
            slope = model.strength[u][None, :, None] * by_lobe
            derivative[layout.lobe(index), u] = slope[: layout.kind.size]
            derivative[layout.rig, u] = slope[layout.kind.size :]
            position = layout.unit(u)
            derivative[position.start : position.start + layout.fresnel_size, u] = by_fresnel[u]
        return model._replace(derivative=derivative)

    def start_model(self, record: np.ndarray, weight: np.ndarray) -> FitModel:
        """Evaluate the model with free strengths and without derivatives, for the start of a search.

        F is constant in a cell, also in a near rig, because the lobes of the lattice differ by more.

        record: record of the common lobe of all units, (s, n).
        """
        p = np.zeros(self.layout.size)
        records = [np.broadcast_to(record, (self.layout.units, *record.shape))]
        return self._strengths(p, weight, records, np.zeros((self.layout.units, 1, 1)))[0]

    def _strengths(
        self, p: np.ndarray, weight: np.ndarray, records: list[np.ndarray], body: np.ndarray
    ) -> tuple[FitModel, np.ndarray]:
        """Evaluate the model, and its derivatives with respect to Fresnel terms, (u, parameters, s, n).

        records: records of each unit's lobe at F = 1, (u, s, n), and in a near rig their moments. body: light from below the
            lobe, 1/sr, which broadcasts to the records.
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
        """Solve for the strength of every unit and slice, with its standard deviation for exact other parameters."""
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
        """Evaluate a linear function of the operator with the slope of F of each unit, (u, ..., s, n).

        of: function of an operator that returns values (..., s, n). model: model with F.
        """
        parts = [of(operator) for operator in self.operator.orders]
        return np.stack([_combined(parts, slope) for slope in model.log_slope])

    def _records_and_slopes(self, index: int, p: np.ndarray) -> list[RecordAndSlopes]:
        """Compute the record of a lobe, and in a near rig its moment; both are cached.

        The weights change more often than the lobe.
        """
        q = np.concatenate([p[self.layout.lobe(index)], p[self.layout.rig]])
        key = q.tobytes()
        if index not in self._last or self._last[index][0] != key:
            self._last[index] = key, [record_and_slopes(one, self.layout.kind, q) for one in self.operator.orders]
        return self._last[index][1]

    def gain(self, noise: PixelNoise) -> float:
        """Return the standard deviation of the gain of a slice: infinite for free strengths."""
        return np.inf if self.layout.fresnel == "free" else noise.picture_gain

    def whitening(self, model: FitModel, weight: np.ndarray, gain: float) -> Whitening:
        """Build the whitening of the residuals.

        Free strengths remove the component along the lobe; a known gain of the image reduces the component along the slice.
        """
        if self.layout.fresnel == "free":
            return whitening(self.data, weight, model.lobe, np.inf)
        return whitening(self.data, weight, model.value, gain)


def _combined(orders: list[np.ndarray], log_slope: np.ndarray) -> np.ndarray:
    """Add the moment, if there is one, to a record, (..., s, n). log_slope: slope of ln F, 1/rad, (..., s)."""
    if len(orders) == 1:
        return orders[0]
    record, moment = orders
    return record + log_slope[..., None] * moment
