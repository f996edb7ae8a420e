"""The values that a material is fitted to, and what makes a table unfit for it.

Likelihood of cells whose noise belongs to pixels and whose pictures have an exposure each (MODEL 8).

With a cell's variance V the model's, and a gain of standard deviation g common to a picture m, the covariance of a
picture's cells is V + g^2 m m'. Its inverse root is known in closed form: divide by sqrt V, then shorten the part along
a = m / sqrt V by 1 / sqrt(1 + g^2 |a|^2). An unknown strength of each picture is the limit of endless g: that part is dropped.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.optimize import minimize

from matcam.camera.sensor import PixelNoise
from matcam.core.errors import FitError
from matcam.inverse.operator.chosen_cells import ChosenCells

_FEWEST = 0.2
"""Share of the chosen cells that must be there."""
_FEWEST_SLICES = 3


class FitData(NamedTuple):
    """Shapes: u units (a channel of a table), s slices, n cells."""

    values: np.ndarray
    """(u, s, n), 1/sr; 0 where unused."""
    used: np.ndarray
    """(u, s, n) bool."""
    share: np.ndarray
    """(s, n): variance of a cell over that of one of its pixels: half, unless both places are one pixel."""
    peak: np.ndarray
    """(u, s): brightest value of the picture, 1/sr; 1 where there is none."""
    labels: tuple[str, ...]
    """(u,): the channels' names."""


def fit_data(brdf: xr.DataArray, cells: ChosenCells) -> FitData:
    """Collect them from a checked table. FitError naming the channel that cannot be fitted, and why."""
    values = brdf.values[cells.i_theta_h, cells.slices[:, None], cells.i_phi_d].transpose(2, 0, 1)
    pictures = brdf.values[:, cells.slices]
    peak = np.nanmax(np.where(np.isfinite(pictures), pictures, -np.inf), axis=(0, 2)).T
    used = np.isfinite(values) & cells.kept & (peak > 0)[..., None]
    used &= used.sum(-1, keepdims=True) >= 4
    labels = tuple(str(c) for c in (brdf["channel"].values if "channel" in brdf.coords else range(brdf.shape[3])))
    for label, one, there, bright in zip(labels, values, used, peak, strict=True):
        if not np.isfinite(one[cells.kept]).any():
            raise FitError(f"channel {label}: every value is missing")
        if not (bright > 0).any():
            raise FitError(f"channel {label}: no value is above 0: there is no highlight to fit")
        share, slices = there.sum() / cells.kept.sum(), int(there.any(-1).sum())
        if share < _FEWEST or slices < _FEWEST_SLICES:
            raise FitError(
                f"channel {label}: {share:.0%} of the values that a fit needs are there, in {slices} of {cells.slices.size} "
                f"slices of theta_d; at least {_FEWEST:.0%} in {_FEWEST_SLICES} slices are needed"
            )
    return FitData(
        np.where(used, values, 0.0),
        used,
        np.where(cells.one_pixel, 1.0, 0.5),
        np.where(peak > 0, peak, 1.0),
        labels,
    )


def joined(parts: list[FitData]) -> FitData:
    """The units of several tables of one rig, one after the other."""
    first = parts[0]
    values, used, peak = (np.concatenate(c) for c in zip(*((p.values, p.used, p.peak) for p in parts), strict=True))
    return FitData(values, used, first.share, peak, tuple(label for p in parts for label in p.labels))


START = PixelNoise(0.02, 2e-3, 0.01)
"""Assumed while nothing better is known."""

# What exceeds these is misfit; as a share of the peak it does not make the faint surroundings of the peak govern the fit
_BOUNDS = ((np.log(1e-4), np.log(0.2)), (np.log(1e-7), np.log(0.5)))
_LEAST_LEFT = 0.02
_HUBER = 3.0
"""Standardised residual beyond which a cell counts less (Huber 1964); a Gaussian one reaches it in 0.3 % of the cases."""


class Whitening(NamedTuple):
    """Turns residuals (u, s, n) into independent ones of variance 1."""

    root: np.ndarray
    """(u, s, n): 1 / sqrt V, 0 where unused."""
    direction: np.ndarray
    """(u, s, n): a / |a|."""
    kept: np.ndarray
    """(u, s, 1): what the part along it is multiplied by."""

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """residual: (u, s, n) and any axes before."""
        u = residual * self.root
        return u - (1 - self.kept) * self.direction * (u * self.direction).sum(-1, keepdims=True)


def variance(data: FitData, model: np.ndarray, noise: PixelNoise) -> np.ndarray:
    """Of each cell without the gain, (u, s, n)."""
    return data.share * ((noise.relative * model) ** 2 + (noise.floor * data.peak[..., None]) ** 2)


def whitening(data: FitData, weight: np.ndarray, along: np.ndarray, gain: float) -> Whitening:
    """weight: 1 / V, robust; along: the picture that the gain multiplies; gain: infinite for free strengths."""
    root = np.sqrt(np.where(data.used, weight, 0.0))
    a = along * root
    length = np.sqrt((a**2).sum(-1, keepdims=True))
    kept = np.zeros_like(length) if np.isinf(gain) else 1 / np.sqrt(1 + (gain * length) ** 2)
    return Whitening(root, a / np.where(length > 0, length, 1.0), kept)


def without_gain(data: FitData, residual: np.ndarray, model: np.ndarray, noise: PixelNoise, gain: float) -> np.ndarray:
    """Standardised residuals after each picture's likeliest gain, (u, s, n). gain: its standard deviation; infinite for free
    strengths."""
    root = np.sqrt(np.where(data.used, 1 / variance(data, model, noise), 0.0))
    u, a = residual * root, model * root
    power = (a**2).sum(-1, keepdims=True) + 1 / max(gain, 1e-12) ** 2
    likeliest = (a * u).sum(-1, keepdims=True) / np.where(power > 0, power, 1.0)
    return u - a * likeliest


def huber(u: np.ndarray) -> np.ndarray:
    """Weights of standardised residuals."""
    return np.minimum(1.0, _HUBER / np.maximum(np.abs(u), 1e-300))


def estimated(data: FitData, residual: np.ndarray, model: np.ndarray, fitted: int, start: PixelNoise) -> PixelNoise:
    """Relative noise, floor and gain from the residuals, by maximum likelihood. fitted: how many numbers took up noise."""
    used = data.used
    picture = model / np.sqrt(np.where(used, variance(data, model, start), 1.0)) * used
    strength = np.maximum((picture**2).sum(-1, keepdims=True), 1e-300)
    gains = (picture * residual / np.sqrt(variance(data, model, start))).sum(-1, keepdims=True) / strength
    seen = used.any(-1, keepdims=True)
    gain = float(np.sqrt(max((gains[seen] ** 2).mean() - (1 / strength[seen]).mean(), 0.0)))
    # a gain takes up more of the noise of the cells that say most about it
    left = np.maximum(1 - picture**2 / strength, _LEAST_LEFT)
    rest = ((residual - gains * model) ** 2 / left)[used]
    rest *= used.sum() / max(used.sum() - fitted, 1)
    value2 = (data.share * model**2)[used]
    peak2 = np.broadcast_to(data.share * data.peak[..., None] ** 2, model.shape)[used]

    def objective(logs: np.ndarray) -> tuple[float, np.ndarray]:
        relative, floor = np.exp(2 * logs)
        total = relative * value2 + floor * peak2
        slope = (1 - rest / total) / total
        return float((np.log(total) + rest / total).mean()), np.array(
            [2 * relative * (slope * value2).mean(), 2 * floor * (slope * peak2).mean()]
        )

    best = minimize(objective, np.log(start[:2]), jac=True, method="L-BFGS-B", bounds=_BOUNDS)
    relative, floor = np.exp(best.x).tolist()
    return PixelNoise(relative, floor, gain)
