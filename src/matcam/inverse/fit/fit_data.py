"""Values that a material is fitted to, and the likelihood of their noise (docs/model.md 8).

Noise is a property of pixels, and each slice of theta_d is one image with its own exposure. Let V be the variance of a
cell according to the model, and g the standard deviation of the image gain common to a slice m. The covariance of the
cells of the slice is V + g^2 m m'. Its inverse root has a closed form: divide by sqrt V, then multiply the component
along a = m / sqrt V by 1 / sqrt(1 + g^2 |a|^2). An unknown strength of each slice is the limit of an infinite g, in
which this component vanishes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.optimize import minimize

from matcam.camera.sensor import PixelNoise
from matcam.core.errors import FitError
from matcam.inverse.operator.chosen_cells import ChosenCells

INITIAL_NOISE = PixelNoise(0.02, 2e-3, 0.01)
"""Assumed noise before the first estimate."""

_FEWEST = 0.2
"""Smallest share of the chosen cells with a value that a fit requires."""
_FEWEST_SLICES = 3
_PEAKS = (1e-9, 1e12)
"""Limits of the brightest value of a channel, 1/sr. Black velvet and the narrowest lobe of a mirror lie far inside."""

# Larger residuals are misfit; as a share of the peak they do not make the faint surroundings of the peak dominate the
# fit
LEAST_FLOOR = 3e-6
"""Least noise floor of a pixel, share of the peak: the error of a rule, 1e-6 of the peak, which about ten neighbouring cells
share."""
_NOISE_BOUNDS = ((np.log(1e-4), np.log(0.2)), (np.log(LEAST_FLOOR), np.log(0.5)))
_LEAST_LEFT = 0.02
_HUBER = 3.0
"""Standardised residual beyond which the weight of a cell decreases (Huber 1964). Normal residuals exceed it in 0.3 %."""


class FitData(NamedTuple):
    """Values of a fit. Shapes: u units (a channel of a table), s slices, n cells.

    Attributes:
        values: (u, s, n), 1/sr; 0 where unused.
        used: (u, s, n) bool.
        share: (s, n), variance of a cell over that of one of its pixels: half, unless both positions share a pixel.
        peak: (u, s), brightest value of the slice, 1/sr; 1 where there is none.
        labels: (u,), names of the channels.
        table_of: (u,), index of each unit's table.
    """

    values: np.ndarray
    used: np.ndarray
    share: np.ndarray
    peak: np.ndarray
    labels: tuple[str, ...]
    table_of: tuple[int, ...]

    @property
    def tables(self) -> int:
        """Count the tables."""
        return max(self.table_of) + 1

    def units_of(self, table: int) -> list[int]:
        """Return the indices of a table's units."""
        return [unit for unit, owner in enumerate(self.table_of) if owner == table]


def fit_data(tables: tuple[xr.DataArray, ...], cells: ChosenCells) -> FitData:
    """Collect the values of checked tables of one rig, one table after the other.

    FitError names the channel that cannot be fitted, and the reason.
    """
    parts = [_table_data(table, cells, index) for index, table in enumerate(tables)]
    values, used, peak = (np.concatenate(c) for c in zip(*((p.values, p.used, p.peak) for p in parts), strict=True))
    labels = tuple(label for part in parts for label in part.labels)
    return FitData(values, used, parts[0].share, peak, labels, tuple(t for part in parts for t in part.table_of))


def _table_data(brdf: xr.DataArray, cells: ChosenCells, index: int) -> FitData:
    values = brdf.values[cells.i_theta_h, cells.slices[:, None], cells.i_phi_d].transpose(2, 0, 1)
    slices = brdf.values[:, cells.slices]
    peak = np.nanmax(np.where(np.isfinite(slices), slices, -np.inf), axis=(0, 2)).T
    used = np.isfinite(values) & cells.valid & (peak > 0)[..., None]
    used &= used.sum(-1, keepdims=True) >= 4
    labels = tuple(str(c) for c in (brdf["channel"].values if "channel" in brdf.coords else range(brdf.shape[3])))
    for label, one, there, bright in zip(labels, values, used, peak, strict=True):
        if not np.isfinite(one[cells.valid]).any():
            raise FitError(f"channel {label}: every value is missing")
        if not (bright > 0).any():
            raise FitError(f"channel {label}: no value is above 0: there is no highlight to fit")
        if not _PEAKS[0] < bright.max() < _PEAKS[1]:
            raise FitError(
                f"channel {label}: its brightest value, {bright.max():.3g}, is not that of a BRDF: give the table in 1/sr"
            )
        share, seen = there.sum() / cells.valid.sum(), int(there.any(-1).sum())
        if share < _FEWEST or seen < _FEWEST_SLICES:
            raise FitError(
                f"channel {label}: {share:.0%} of the values that a fit needs exist, in {seen} of {cells.slices.size} "
                f"slices of theta_d; at least {_FEWEST:.0%} in {_FEWEST_SLICES} slices are needed"
            )
    return FitData(
        np.where(used, values, 0.0),
        used,
        cells.noise_share,
        np.where(peak > 0, peak, 1.0),
        labels,
        (index,) * len(labels),
    )


class Whitening(NamedTuple):
    """Transformation of residuals (u, s, n) to independent ones of variance 1.

    Attributes:
        root: (u, s, n), 1 / sqrt V; 0 where unused.
        direction: (u, s, n), a / |a|.
        remainder: (u, s, 1), factor of the part along `direction`.
    """

    root: np.ndarray
    direction: np.ndarray
    remainder: np.ndarray

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Whiten residuals of shape (u, s, n) and any axes before."""
        u = residual * self.root
        return u - (1 - self.remainder) * self.direction * (u * self.direction).sum(-1, keepdims=True)


def cell_variance(data: FitData, model: np.ndarray, noise: PixelNoise) -> np.ndarray:
    """Compute the variance of each cell without the gain of the image, (u, s, n); 1 for unused cells."""
    variance = data.share * ((noise.relative * model) ** 2 + (noise.floor * data.peak[..., None]) ** 2)
    return np.where(data.used, variance, 1.0)


def whitening(data: FitData, weight: np.ndarray, along: np.ndarray, gain: float) -> Whitening:
    """Build the whitening from robust weights 1 / V.

    along: the model that the gain of the image multiplies. gain: standard deviation of the image gain; infinite for
        free strengths.
    """
    root = np.sqrt(np.where(data.used, weight, 0.0))
    a = along * root
    length = np.sqrt((a**2).sum(-1, keepdims=True))
    remainder = np.zeros_like(length) if np.isinf(gain) else 1 / np.sqrt(1 + (gain * length) ** 2)
    return Whitening(root, a / np.where(length > 0, length, 1.0), remainder)


def standardised_residual(
    data: FitData, residual: np.ndarray, model: np.ndarray, noise: PixelNoise, gain: float
) -> np.ndarray:
    """Compute residuals in standard deviations, (u, s, n), after removal of the most probable gain of each slice.

    gain: standard deviation of the image gain; infinite for free strengths.
    """
    root = np.sqrt(np.where(data.used, 1 / cell_variance(data, model, noise), 0.0))
    u, a = residual * root, model * root
    power = (a**2).sum(-1, keepdims=True) + 1 / max(gain, 1e-12) ** 2
    likeliest = (a * u).sum(-1, keepdims=True) / np.where(power > 0, power, 1.0)
    return u - a * likeliest


def huber_weights(u: np.ndarray) -> np.ndarray:
    """Compute Huber's weights of standardised residuals."""
    return np.minimum(1.0, _HUBER / np.maximum(np.abs(u), 1e-300))


def estimate_noise(
    data: FitData, residual: np.ndarray, model: np.ndarray, fitted: int, start: PixelNoise
) -> PixelNoise:
    """Estimate relative noise, floor and image gain from the residuals, by maximum likelihood.

    fitted: number of fitted parameters.
    """
    used = data.used
    slices = model / np.sqrt(cell_variance(data, model, start)) * used
    power = np.maximum((slices**2).sum(-1, keepdims=True), 1e-300)
    gains = (slices * residual / np.sqrt(cell_variance(data, model, start))).sum(-1, keepdims=True) / power
    seen = used.any(-1, keepdims=True)
    gain = float(np.sqrt(max((gains[seen] ** 2).mean() - (1 / power[seen]).mean(), 0.0)))
    # a gain absorbs more of the noise of the cells that determine it
    left = np.maximum(1 - slices**2 / power, _LEAST_LEFT)
    chi2 = ((residual - gains * model) ** 2 / left)[used]
    chi2 *= used.sum() / max(used.sum() - fitted, 1)
    value2 = (data.share * model**2)[used]
    peak2 = np.broadcast_to(data.share * data.peak[..., None] ** 2, model.shape)[used]

    def objective(logs: np.ndarray) -> tuple[float, np.ndarray]:
        relative, floor = np.exp(2 * logs)
        total = relative * value2 + floor * peak2
        slope = (1 - chi2 / total) / total
        return float((np.log(total) + chi2 / total).mean()), np.array(
            [2 * relative * (slope * value2).mean(), 2 * floor * (slope * peak2).mean()]
        )

    best = minimize(objective, np.log(start[:2]), jac=True, method="L-BFGS-B", bounds=_NOISE_BOUNDS)
    relative, floor = np.exp(best.x).tolist()
    return PixelNoise(relative, floor, gain)
