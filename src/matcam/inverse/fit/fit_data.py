"""Values to which a material is fitted, and the likelihood of their noise (docs/model.md 8).

Noise is a property of pixels. Each slice of theta_d is one image, whose exposure error multiplies all values of the slice by
the same gain. Let m be the modelled values of the cells of a slice, V the diagonal matrix of their variances due to pixel
noise, and g the standard deviation of the gain. The covariance of the cells is V + g^2 m m'. The inverse of its square root
has a closed form: division by sqrt V, then multiplication of the component along a = m / sqrt V by
1 / sqrt(1 + g^2 |a|^2). An unknown strength of each slice is the limit of an infinite g, in which this component vanishes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.optimize import minimize

from matcam.camera.sensor import PixelNoise
from matcam.core.errors import FitError
from matcam.core.grid import sampling_of
from matcam.forward.pixel_grid import grid_of
from matcam.inverse.fit.clipped_values import as_normal, clipped_values, inverse_mills_ratio, log_probability
from matcam.inverse.operator.chosen_cells import ChosenCells, chosen_cells
from matcam.inverse.operator.sample_view import sample_view
from matcam.rigs import Rig

INITIAL_NOISE = PixelNoise(0.02, 2e-3, 0.01)
"""Assumed noise of a pixel until it is estimated from residuals: 2 % of the value, 0.2 % of the peak and a gain of 1 %."""

SEARCH_STEP = 6
"""Spacing of the slices of theta_d in the first search for a lobe, which is then fitted to more slices."""

_FEWEST = 0.2
"""Smallest share of the chosen cells of a channel that must have a value."""
_FEWEST_SLICES = 3
_PEAKS = (1e-9, 1e12)
"""Limits of the brightest value of a channel, 1/sr. Black velvet and the narrowest lobe of a mirror are far inside them."""

LEAST_FLOOR = 3e-6
"""Smallest noise floor of a pixel, as a share of the peak of the slice. The quadrature of the record has an error of 1e-6 of
the peak, which is correlated over about ten neighbouring cells, so its effect is sqrt(10) times larger. With this floor, the
faint surroundings of a peak do not dominate the fit.
"""
MOST_NOISE = 0.2
"""Largest estimate of the noise of a pixel, as a share of its value."""
_NOISE_BOUNDS = ((np.log(1e-4), np.log(MOST_NOISE)), (np.log(LEAST_FLOOR), np.log(0.5)))
_LEAST_LEFT = 0.02
_HUBER = 3.0
"""Standardised residual above which the weight of a cell decreases (Huber 1964). 0.3 % of normal residuals exceed it."""


def at_largest_noise(noise: PixelNoise) -> bool:
    """Check whether an estimate of the noise has its largest allowed value, so that the noise may be larger."""
    return bool(np.isclose(noise.relative, MOST_NOISE, rtol=1e-6))


def noise_text(noise: PixelNoise, digits: int = 1) -> str:
    """Format an estimate of the noise of a pixel, as a share of its value.

    An estimate with the largest allowed value is a lower limit.

    Args:
        noise: estimated noise.
        digits: decimal places of the percentage. Default: 1.

    Example:
        >>> from matcam.inverse.fit.fit_data import noise_text
        >>> noise_text(matcam.camera.PixelNoise(0.012)), noise_text(matcam.camera.PixelNoise(0.2), 0)
        ('1.2%', 'at least 20%')
    """
    return f"{'at least ' if at_largest_noise(noise) else ''}{noise.relative:.{digits}%}"


class FitData(NamedTuple):
    """Values to which a material is fitted.

    In the shapes, u is the number of units, s is the number of slices, and n is the number of cells in a slice. A unit is one
    channel of one table.

    Attributes:
        values: values of the cells, 1/sr, (u, s, n); 0 for unused cells. The value of a clipped cell depends on the model
            (`around`).
        used: True for cells that are used in the fit, (u, s, n).
        share: variance of a cell divided by the variance of a pixel, (s, n). It is 1/2 for the mean of two pixels, 1 if both
            positions of the cell lie in the same pixel, and the sum of the squared weights for interpolated pixels.
        peak: largest value of each slice, 1/sr, (u, s); 1 if no value of the slice is positive.
        labels: names of the channels, (u,).
        table_of: index of the table of each unit, (u,).
        clipped: True for cells that are 0 because negative noise was clipped, (u, s, n).
        information: information about the value of a cell, as a share of the information of a cell that is not clipped
            (no unit), (u, s, n).
    """

    values: np.ndarray
    used: np.ndarray
    share: np.ndarray
    peak: np.ndarray
    labels: tuple[str, ...]
    table_of: tuple[int, ...]
    clipped: np.ndarray
    information: np.ndarray

    @property
    def tables(self) -> int:
        return max(self.table_of) + 1

    def units_of(self, table: int) -> list[int]:
        return [unit for unit, owner in enumerate(self.table_of) if owner == table]

    def around(self, model: np.ndarray, noise: PixelNoise) -> FitData:
        """Replace clipped cells by the normal observations that have the same likelihood near modelled values.

        Args:
            model: modelled values, 1/sr, (u, s, n).
            noise: noise of a pixel.
        """
        if not self.clipped.any():
            return self
        std = np.sqrt(pixel_variance(self, model, noise))
        residual, information = as_normal(model / std)
        return self._replace(
            values=np.where(self.clipped, model + residual * std, self.values),
            information=np.where(self.clipped, information, 1.0),
        )


def fit_data(tables: tuple[xr.DataArray, ...], cells: ChosenCells) -> FitData:
    """Collect the values of checked tables of one rig.

    The units are ordered by table, then by channel. A FitError is raised if the values of a channel do not suffice for a fit.
    """
    parts = [_table_data(table, cells, index) for index, table in enumerate(tables)]
    labels = tuple(label for part in parts for label in part.labels)
    fields = ("values", "used", "peak", "clipped", "information")
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in fields}
    return parts[0]._replace(**joined, labels=labels, table_of=tuple(t for part in parts for t in part.table_of))


def check_values(tables: tuple[xr.DataArray, ...], rig: Rig | None, slice_step: int = SEARCH_STEP) -> None:
    """Raise FitError if checked tables do not suffice for a fit.

    The check takes much less time than the computation of the operator.

    Args:
        tables: tables of one rig.
        rig: rig of the tables; None: a distant camera and lamp.
        slice_step: spacing of the slices of theta_d. Default: SEARCH_STEP.
    """
    pixels = None if rig is None else grid_of(rig)
    fit_data(tables, chosen_cells(sample_view(rig), sampling_of(tables[0]), slice_step, pixels))


def _table_data(brdf: xr.DataArray, cells: ChosenCells, index: int) -> FitData:
    values = brdf.values[cells.i_theta_h, cells.slices[:, None], cells.i_phi_d].transpose(2, 0, 1)
    slices = brdf.values[:, cells.slices]
    peak = np.nanmax(np.where(np.isfinite(slices), slices, -np.inf), axis=(0, 2)).T
    used = np.isfinite(values) & cells.valid & (peak > 0)[..., None]
    used &= used.sum(-1, keepdims=True) >= 4
    labels = tuple(str(c) for c in (brdf["channel"].values if "channel" in brdf.coords else range(brdf.shape[3])))
    for label, whole, there, bright in zip(labels, np.moveaxis(brdf.values, 3, 0), used, peak, strict=True):
        if not np.isfinite(whole).any():
            raise FitError(f"channel {label}: every value is missing; give a table with values in this channel")
        if not (whole > 0).any():
            raise FitError(
                f"channel {label}: no value is above 0, so there is no highlight to fit; give a table with positive values"
            )
        share, seen = there.sum() / cells.valid.sum(), int(there.any(-1).sum())
        if share < _FEWEST or seen < _FEWEST_SLICES:
            raise FitError(
                f"channel {label}: the table contains {share:.0%} of the required values, in {seen} of {cells.slices.size} "
                f"slices of theta_d: give a table with at least {_FEWEST:.0%} of them, in at least {_FEWEST_SLICES} slices, or "
                "a slice_step that selects the slices with values"
            )
        if not _PEAKS[0] < bright.max() < _PEAKS[1]:
            raise FitError(
                f"channel {label}: the brightest value, {bright.max():.3g}, is impossible for a BRDF: give the table in 1/sr"
            )
    return FitData(
        np.where(used, values, 0.0),
        used,
        cells.noise_share,
        np.where(peak > 0, peak, 1.0),
        labels,
        (index,) * len(labels),
        clipped_values(values, used, cells.theta_h),
        np.ones(values.shape),
    )


class Whitening(NamedTuple):
    """Linear transformation of the residuals of a fit to independent residuals of unit variance.

    The shapes are those of `FitData`, and the symbols those of the module docstring.

    Attributes:
        root: 1 / sqrt V, sr, (u, s, n); 0 for unused cells.
        direction: unit vector a / |a| of each slice, (u, s, n).
        remainder: factor of the component along `direction`, (u, s, 1).
    """

    root: np.ndarray
    direction: np.ndarray
    remainder: np.ndarray

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Whiten residuals, 1/sr, (..., u, s, n)."""
        u = residual * self.root
        return u - (1 - self.remainder) * self.direction * (u * self.direction).sum(-1, keepdims=True)


def pixel_variance(data: FitData, model: np.ndarray, noise: PixelNoise) -> np.ndarray:
    """Compute the variance of each cell before clipping, without the image gain, 1/sr^2, (u, s, n); 1 for unused cells.

    Args:
        data: values of the cells.
        model: modelled values, 1/sr, (u, s, n).
        noise: noise of a pixel.
    """
    variance = data.share * ((noise.relative * model) ** 2 + (noise.floor * data.peak[..., None]) ** 2)
    return np.where(data.used, variance, 1.0)


def cell_variance(data: FitData, model: np.ndarray, noise: PixelNoise) -> np.ndarray:
    """Compute the variance of the observation of each cell (`FitData.around`), without the image gain, 1/sr^2, (u, s, n).

    The arguments are those of `pixel_variance`.
    """
    return pixel_variance(data, model, noise) / data.information


def whitening(data: FitData, weight: np.ndarray, along: np.ndarray, gain: float) -> Whitening:
    """Build the whitening of residuals from robust weights.

    Args:
        data: values of the cells.
        weight: robust weights 1 / V, sr^2, (u, s, n).
        along: modelled values that the image gain multiplies, 1/sr, (u, s, n).
        gain: standard deviation of the image gain (no unit); infinite for free strengths.
    """
    root = np.sqrt(np.where(data.used, weight, 0.0))
    a = along * root
    length = np.sqrt((a**2).sum(-1, keepdims=True))
    remainder = np.zeros_like(length) if np.isinf(gain) else 1 / np.sqrt(1 + (gain * length) ** 2)
    return Whitening(root, a / np.where(length > 0, length, 1.0), remainder)


def standardised_residual(data: FitData, model: np.ndarray, noise: PixelNoise, gain: float) -> np.ndarray:
    """Compute residuals in standard deviations of the noise, (u, s, n).

    The effect of the most probable image gain of each slice is subtracted.

    Args:
        data: values of the cells.
        model: modelled values, 1/sr, (u, s, n).
        noise: noise of a pixel.
        gain: standard deviation of the image gain (no unit); infinite for free strengths.
    """
    data = data.around(model, noise)
    root = np.sqrt(np.where(data.used, 1 / cell_variance(data, model, noise), 0.0))
    u, a = (data.values - model) * root, model * root
    power = (a**2).sum(-1, keepdims=True) + 1 / max(gain, 1e-12) ** 2
    likeliest = (a * u).sum(-1, keepdims=True) / np.where(power > 0, power, 1.0)
    return u - a * likeliest


def huber_weights(u: np.ndarray) -> np.ndarray:
    return np.minimum(1.0, _HUBER / np.maximum(np.abs(u), 1e-300))


def log_likelihood(data: FitData, model: np.ndarray, noise: PixelNoise, cost: np.ndarray) -> float:
    """Compute the logarithm of the likelihood of the cells, up to a constant.

    Args:
        data: values of the cells.
        model: modelled values, 1/sr, (u, s, n).
        noise: noise of a pixel.
        cost: squared `standardised_residual`, or a robust function of it, (u, s, n).
    """
    variance = pixel_variance(data, model, noise)
    terms = np.log(variance) + cost
    if data.clipped.any():
        terms = np.where(data.clipped, -2 * log_probability(model / np.sqrt(variance)), terms)
    return -0.5 * float(terms[data.used].sum())


def estimate_noise(
    data: FitData, residual: np.ndarray, model: np.ndarray, fitted: int, start: PixelNoise
) -> PixelNoise:
    """Estimate the noise of a pixel and the image gain from residuals.

    The relative noise and the noise floor maximise the likelihood. The variance of the image gain is estimated from the moments
    of the gains of the slices.

    Args:
        data: values of the cells.
        residual: data - model, 1/sr, (u, s, n).
        model: modelled values, 1/sr, (u, s, n).
        fitted: number of fitted parameters.
        start: first estimate of the noise.
    """
    used = data.used
    slices = model / np.sqrt(cell_variance(data, model, start)) * used
    power = np.maximum((slices**2).sum(-1, keepdims=True), 1e-300)
    gains = (slices * residual / np.sqrt(cell_variance(data, model, start))).sum(-1, keepdims=True) / power
    seen = used.any(-1, keepdims=True)
    gain = float(np.sqrt(max((gains[seen] ** 2).mean() - (1 / power[seen]).mean(), 0.0)))
    # the estimated gain reduces the residuals of the cells that determine it; the variance is corrected for this
    left = np.maximum(1 - slices**2 / power, _LEAST_LEFT)
    chi2 = ((residual - gains * model) ** 2 / left)[used]
    chi2 *= used.sum() / max(used.sum() - fitted, 1)
    value2 = (data.share * model**2)[used]
    peak2 = np.broadcast_to(data.share * data.peak[..., None] ** 2, model.shape)[used]
    clipped, model_clipped = data.clipped[used], model[data.clipped & used]

    def objective(logs: np.ndarray) -> tuple[float, np.ndarray]:
        relative, floor = np.exp(2 * logs)
        total = relative * value2 + floor * peak2
        slope = (1 - chi2 / total) / total
        cost = np.log(total) + chi2 / total
        if model_clipped.size:
            z = model_clipped / np.sqrt(total[clipped])
            cost[clipped] = -2 * log_probability(z)
            slope[clipped] = -z * inverse_mills_ratio(z) / total[clipped]
        return float(cost.mean()), np.array(
            [2 * relative * (slope * value2).mean(), 2 * floor * (slope * peak2).mean()]
        )

    best = minimize(objective, np.log(start[:2]), jac=True, method="L-BFGS-B", bounds=_NOISE_BOUNDS)
    relative, floor = np.exp(best.x).tolist()
    return PixelNoise(relative, floor, gain)
