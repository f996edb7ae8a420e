"""A specular lobe estimated THROUGH the camera: one width for all theta_d, one strength for each (MODEL 8).

Strengths and backgrounds are linear and solved for exactly (variable projection, Golub & Pereyra 1973), so the search is
over the logarithm of the width alone. Weights are held fixed within an iteration.

The camera is NOT adjusted to the data: its uncertainty is a systematic one and is propagated. (A lobe of a slightly
different family would otherwise be blamed on the lens.)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from matcam.camera.noise import PixelNoise
from matcam.errors import FitError
from matcam.inverse import lobe_errors
from matcam.inverse.amplitudes import (
    START_NOISE,
    Amplitudes,
    estimate_noise,
    first_weights,
    log_likelihood,
    relative_variance,
    solve,
    weights_of,
)
from matcam.inverse.lobe_model import LobeModel
from matcam.inverse.peak_cells import PeakData
from matcam.material.families import ONE_WIDTH
from matcam.material.ndf import MixtureNDF
from matcam.rigs import Rig

_NARROWEST = 0.02  # px: narrower lobes are the same point to any camera
_AT_BOUND = 0.05  # of ln width: a fit this near to _NARROWEST has not seen the lobe's width
_STEP = 6  # the search uses every sixth slice
_CANDIDATES = 11
_BRACKETS = (0.6, 0.2)  # half widths, in ln width, of the two rounds of the search
_TOLERANCE = 2e-3
_STEPS, _LONGEST_STEP = 5, 0.1


class LobeFit(NamedTuple):
    """A lobe, its strength in every slice, and their errors. Channels c, slices s, uncertain camera parameters p."""

    ndf: MixtureNDF
    width: float
    width_determined: bool
    """False: narrower than the camera can tell; the width is then a bound, and its error unknown."""
    amplitude: np.ndarray
    """(c, s): true peak value F D(0) G / (4 cos_i cos_o), 1/sr; NaN where the slice shows no lobe."""
    noise: PixelNoise
    """Given, or estimated from the residuals."""
    log_likelihoods: dict[str, float]
    """Of every family that was tried, on the slices of the search."""
    amplitude_covariance: np.ndarray
    """(c, s, s): of the amplitudes, from the noise of pixels, the width fitted along."""
    amplitude_width_covariance: np.ndarray
    """(c, s): of the amplitudes and ln width."""
    log_width_variance: float
    amplitude_by_camera: np.ndarray
    """(p, c, s): change of the amplitudes per unit of each uncertain camera parameter, the width fitted along."""
    log_width_by_camera: np.ndarray
    """(p,)."""


def fit_lobe(data: PeakData, rig: Rig, families: Sequence[str], noise: PixelNoise | None = None) -> LobeFit:
    """Fit the likeliest of some families of lobes to the data around a peak. FitError where the data hold no lobe."""
    some = data.every(_STEP)
    if not first_weights(some).any():
        raise FitError("no highlight: the values around the peak (theta_h = 0) are missing or not positive")
    found = {family: _search(some, rig, family, noise) for family in families}
    family = max(found, key=lambda name: found[name].log_likelihood)
    log_width = found[family].log_width
    determined = log_width > _narrowest(rig) + _AT_BOUND
    model = LobeModel(data, rig, family)
    at = _Linearised(data, model, log_width, noise)
    for _ in range(_STEPS if determined else 0):
        # a sixth of the slices has brought the width near its best value: Gauss-Newton steps on all of them do the rest
        _, shared = lobe_errors.reaction(at.maps(), at.fitted.residual)
        log_width += float(np.clip(shared[0], -_LONGEST_STEP, _LONGEST_STEP))
        at = _Linearised(data, model, log_width, noise)
        if abs(shared[0]) < _TOLERANCE:
            break
    maps = at.maps(hold_width=not determined)
    strength = np.nan_to_num(at.fitted.amplitude)
    covariance = lobe_errors.noise_covariance(
        maps, strength * np.sqrt(relative_variance(at.record, at.noise)), data.pixels
    )
    by_camera = [lobe_errors.reaction(maps, -strength * slope) for slope in at.by_camera]
    return LobeFit(
        ndf=model.ndf(log_width),
        width=float(np.exp(log_width)),
        width_determined=determined,
        amplitude=at.fitted.amplitude[..., 0],
        noise=at.noise,
        log_likelihoods={name: result.log_likelihood for name, result in found.items()},
        amplitude_covariance=covariance.amplitude,
        amplitude_width_covariance=covariance.cross[0],
        log_width_variance=float(covariance.shared[0, 0]) if determined else np.inf,
        amplitude_by_camera=np.array([amplitude for amplitude, _ in by_camera]).reshape(-1, *strength.shape[:2]),
        log_width_by_camera=np.array([shared[0] for _, shared in by_camera]),
    )


class _Found(NamedTuple):
    log_width: float
    log_likelihood: float


def _narrowest(rig: Rig) -> float:
    return float(np.log(_NARROWEST / float(rig.sample.radius)))  # type: ignore[attr-defined]


def _search(data: PeakData, rig: Rig, family: str, noise: PixelNoise | None) -> _Found:
    """Best width of one family: a row of candidates, then two rounds of a bounded search with better weights."""
    model = LobeModel(data, rig, family)
    low, high = _narrowest(rig), float(np.log(min(ONE_WIDTH[family].largest, 4 * data.half_width)))
    weights = first_weights(data)

    def misfit(log_width: float) -> float:
        return float((weights * solve(data, model.record(log_width), weights).residual ** 2).sum())

    best = min(np.linspace(low, high, _CANDIDATES), key=misfit)
    for half_width in _BRACKETS:
        record = model.record(best)
        fitted = solve(data, record, weights)
        weights = weights_of(data, record, fitted, noise or estimate_noise(data, record, fitted))
        bracket = max(low, best - half_width), min(high, best + half_width)
        best = minimize_scalar(misfit, bounds=bracket, method="bounded", options={"xatol": _TOLERANCE}).x
    record = model.record(best)
    fitted = solve(data, record, weights)
    assumed = noise or estimate_noise(data, record, fitted)
    return _Found(float(best), log_likelihood(data, record, fitted, assumed))


class _Linearised:
    """The model and the best strengths at one width, with everything that depends on them."""

    def __init__(self, data: PeakData, model: LobeModel, log_width: float, noise: PixelNoise | None):
        self._uncertainty = model.uncertainty
        self.record, self.by_width = model.record(log_width), model.derivative(log_width)
        self.by_camera = [model.derivative(log_width, name) for name in model.names]
        self.fitted = solve(data, self.record, first_weights(data))
        self.noise = noise or START_NOISE
        for _ in _BRACKETS:
            self.weights = weights_of(data, self.record, self.fitted, self.noise)
            self.fitted = solve(data, self.record, self.weights)
            self.noise = noise or estimate_noise(data, self.record, self._without_camera_error())
        self.weights = weights_of(data, self.record, self.fitted, self.noise)
        self.fitted = solve(data, self.record, self.weights)

    def maps(self, *, hold_width: bool = False) -> lobe_errors.Sensitivity:
        """How the fit reacts to its data."""
        return lobe_errors.sensitivity(self.weights, self.record, self._derivatives(hold_width))

    def _derivatives(self, hold_width: bool = False) -> np.ndarray:
        """(k, c, s, n) by what all slices share: ln width, and each channel's background."""
        by_width = np.nan_to_num(self.fitted.amplitude) * self.by_width * (not hold_width)
        channels = np.eye(len(by_width))[:, :, None, None]
        return np.concatenate([by_width[None], channels * np.ones_like(by_width)])

    def _without_camera_error(self) -> Amplitudes:
        """The same fit with the residuals that it would have if the camera were also adjusted, within its stated
        uncertainty: an error of the camera is not noise, and is accounted for by itself."""
        if self._uncertainty is None:
            return self.fitted
        # in units of the stated errors' principal axes, so that one that is stated as 0 stays 0
        variances, axes = np.linalg.eigh(np.asarray(self._uncertainty.covariance))
        steps = axes * np.sqrt(np.clip(variances, 0, None))
        moved = np.einsum("pq,psn->qsn", steps, np.stack(self.by_camera))
        derivatives = np.concatenate([self._derivatives(), np.nan_to_num(self.fitted.amplitude) * moved[:, None]])
        known = np.diag(np.repeat([0.0, 1.0], [len(derivatives) - len(steps), len(steps)]))
        maps = lobe_errors.sensitivity(self.weights, self.record, derivatives, known)
        _, shift = lobe_errors.reaction(maps, self.fitted.residual)
        explained = np.einsum("k,kcsn->csn", shift, maps.rest) * (self.weights > 0)
        return self.fitted._replace(residual=self.fitted.residual - explained)
