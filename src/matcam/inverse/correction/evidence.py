"""Evidence of the explanations of a table: their marginal likelihoods on a common scale.

An explanation is a model of the table. The variance of a cell is the sum of the variance V0 of pixel noise, and of the variance
tau^2 m^2 + tau_f^2 P^2 of the model error. Here m is the modelled value, and P is the peak of the slice. The factors tau and
tau_f are estimated from the residuals. The misfit t is the root mean square of the model error of the cells, relative to
sqrt(m^2 + (1e-2 P)^2). It has an exponential prior. Laplace's approximation of the evidence E is

    ln E = kappa ln L + ln p(t) + ln p(theta) + k/2 ln 2 pi - 1/2 ln |kappa H + Q| + sum_s 1/2 ln(2 pi / (kappa q_s)) ,

where L is the likelihood, and p is a prior density. H is the information matrix of the data for the k parameters theta, Q
is the information matrix of the prior, and q_s is the information about the free strength of slice s (MacKay 2003, chapter
28). Misfit is correlated between cells, so the likelihood is tempered (Gruenwald 2012). Its exponent is
kappa = min(1, 1 / chi^2), the share of pixel noise in the variance of the best explanation. Here chi^2 is the mean squared
residual of this explanation relative to the variance of pixel noise.

V0 is estimated without a model of the lobe, from cells at mirrored positions, or from the differences between channels. If
neither determines V0, kappa is the share of independent cells, computed from the correlation of the residuals of neighbouring
cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.camera.sensor import PixelNoise
from matcam.core.grid import merl_grid, sampling_of
from matcam.inverse.correction.spline_lobe import TRIED_SPLINES
from matcam.inverse.fit.clipped_values import inside_clipped
from matcam.inverse.fit.fit_data import (
    FitData,
    cell_variance,
    estimate_noise,
    huber_weights,
    log_likelihood,
    standardised_residual,
    whitening,
)
from matcam.inverse.fit.fit_parameters import BASE_WIDTH, COATED, STUDENT, TWO_LOBES, Layout, LobeKind
from matcam.inverse.fit.fit_setup import FitSetup
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.numerics.linalg import log_volume_ratio

LEAST_NOISE = PixelNoise(5e-3, 1e-6, 0.0)
"""Smallest assumed noise of a pixel: shot noise of a full well of 40,000 electrons, and the accuracy of a modelled record."""
MISFIT_SCALE = 1e-2
"""Mean of the exponential prior of the misfit, relative to the value of a cell. Models with much larger errors do not explain a
table.
"""
_FAINT = 1e-2
"""Share of the peak of a slice. For fainter cells, misfit is relative to this share instead of the value of the cell."""
_TYPICAL = PixelNoise(1e-2, 1e-4, 0.0)
"""Noise of a pixel of a typical camera, from which an estimate of the noise starts."""
_AS_NOISE = 2.0
"""Variance of the differences between channels that is attributed to noise, in variances of the noise of a pixel. It exceeds 1,
because both are estimates.
"""
_MOSTLY_MISFIT = 2.0
"""Value of chi^2 above which misfit is more than half of the residual variance."""
_EQUAL = 1e-6
"""Relative difference below which two values are equal. It exceeds the rounding of 32-bit floats and is below any noise."""
_FEWEST_PAIRS = 100
"""Smallest number of pairs of cells for an estimate of the noise. 100 pairs determine the noise to 7 %."""
_AZIMUTH_BIN = 36
"""Number of azimuths of a table within which cells of one ring in two slices are neighbours. A ring has about five cells."""
_PRIORS = {
    "width": (-4.5, 2.5), "power": (0.0, 0.7), STUDENT: (0.0, 1.0), "share": (0.0, 1.5), "tail": (0.5, 0.5),
    "spline": (0.0, 10.0), "rig": (0.0, 0.5), "fresnel": (0.0, 3.0), "diffuse": (0.2, 0.3),
    "base": (0.2, 0.3), BASE_WIDTH: (-2.0, 1.0), COATED: (0.0, 10.0),
}  # fmt: skip
"""Prior mean and standard deviation of each kind of parameter, in the coordinates of a fit. They correspond to widths from
0.001 to 0.1 rad, powers from 1/2 to 2, any share, modifications of ln D up to 10, albedos of a diffuse part and reflectances of
a base up to 0.5, and roughnesses of a base from 0.05 to 0.4. A fit has its own prior of the coated share. Differences of log
evidence depend only on the logarithms of the standard deviations.
"""


def noise_without_model(setup: FitSetup, found: MaterialFit) -> PixelNoise | None:
    """Estimate the noise of a pixel without a model of the lobe.

    Noise is estimated from the differences between mirrored cells, and from the differences between channels. Both estimates
    are upper bounds. Mirrored cells also differ because of lens aberrations, and channels also differ because of structure
    that only one channel has. The result is the estimate with the smaller variance.

    Args:
        setup: setup of a fit. If its noise is specified, the result is this noise. Otherwise its cells are compared with
            mirrored cells.
        found: fit whose residuals are compared between channels.

    Returns:
        Noise of a pixel; None if the data do not determine the noise.
    """
    if setup.noise is not None:
        return setup.noise
    estimates = [one for one in (_mirrored_noise(setup), _channel_noise(found)) if one is not None]
    if not estimates:
        return None
    data, value = found._solution.problem.data, found._solution.model.value

    def mean_log_variance(noise: PixelNoise) -> float:
        return float(np.log(cell_variance(data, value, noise)[data.used]).mean())

    return _at_least(min(estimates, key=mean_log_variance), LEAST_NOISE)


def _at_least(noise: PixelNoise, least: PixelNoise) -> PixelNoise:
    return noise._replace(relative=max(noise.relative, least.relative), floor=max(noise.floor, least.floor))


def _mirrored_noise(setup: FitSetup) -> PixelNoise | None:
    """Estimate noise from the differences between cells at phi_d and pi - phi_d.

    An isotropic lens records the same value in both cells (docs/model.md 3). Cells of a symmetrised table have equal values
    although they have noise, so the result is None if most pairs are equal.
    """
    problem = setup.problem
    cells, data, (table,) = problem.cells, problem.data, setup.tables
    isotropic = setup.rig is None or all(one.camera.optics.isotropic for one in setup.rig.colours)
    if cells.real is not None or not isotropic:
        return None
    mirrored = merl_grid(sampling_of(table)).index(phi_d=np.mod(np.pi - cells.phi_d, np.pi))[2]
    others = table.values[cells.i_theta_h, cells.slices[:, None], mirrored].transpose(2, 0, 1)
    apart = (np.abs(cells.y) >= 0.5).all(axis=-1)  # a cell and its mirrored cell are in two pixels
    used = data.used & np.isfinite(others) & apart & inside_clipped(data.clipped, cells.theta_h)
    if used.sum() < _FEWEST_PAIRS:
        return None
    others = np.where(used, others, 0.0)
    difference, mean = data.values - others, (data.values + others) / 2
    if (np.abs(difference) <= _EQUAL * np.abs(mean))[used].mean() > 0.5:
        return None
    return _of_pairs(data._replace(used=used), difference, mean)


def _channel_noise(found: MaterialFit) -> PixelNoise | None:
    """Estimate noise from the differences between the residuals of channels.

    Errors of the lobe model cancel in these differences.
    """
    problem, model = found._solution.problem, found._solution.model
    data, residual = problem.data, problem.residual(model)
    units = len(data.labels)
    if units < 2:
        return None
    other = np.roll(np.arange(units), 1)
    strong = (model.strength > 0) & (model.strength[other] > 0)
    inside = inside_clipped(data.clipped, problem.cells.theta_h)
    used = data.used & data.used[other] & strong[..., None] & inside & inside[other]
    if used.sum() < _FEWEST_PAIRS:
        return None
    scale = np.where(strong, model.strength / np.where(strong, model.strength[other], 1.0), 0.0)
    difference = np.where(used, residual - scale[..., None] * residual[other], 0.0)
    return _of_pairs(data._replace(used=used), difference, model.value)


def channel_misfit(found: MaterialFit, noise: PixelNoise) -> float:
    """Compute the difference between the lobes of the channels that noise does not explain, relative to the lobe (no unit).

    Args:
        found: fit with free strengths and one lobe for all channels.
        noise: noise of a pixel.
    """
    apart = _channel_noise(found)
    return 0.0 if apart is None else float(np.sqrt(max(apart.relative**2 - _AS_NOISE * noise.relative**2, 0.0)))


def _of_pairs(data: FitData, difference: np.ndarray, value: np.ndarray) -> PixelNoise:
    """Estimate noise from pairs of cells whose true values are equal.

    `difference` is the difference of the two values, and `value` an estimate of the true value, 1/sr, (u, s, n) each.
    """
    noise = _TYPICAL
    for _ in range(2):  # the estimate of the image gain depends on the noise
        noise = estimate_noise(data, difference / np.sqrt(2), value, 0, noise)
    return noise


class OtherLobe(NamedTuple):
    """Fit of a lobe other than the most probable lobe, through the camera, with the probability of the lobe.

    Attributes:
        fit: fit of the lobe.
        setup: setup of the fit.
        probability: posterior probability of this lobe (no unit); the sum over all lobes is 1.
    """

    fit: MaterialFit
    setup: FitSetup
    probability: float


class Explained(NamedTuple):
    """Terms of the evidence of a fit that do not depend on kappa.

    Attributes:
        log_likelihood: logarithm of the likelihood, with misfit treated as noise.
        log_misfit: logarithm of the prior density of the misfit.
        log_prior: logarithm of the prior density of the coordinates, without powers of 2 pi. For a spline modification it
            includes the prior probability 1 / TRIED_SPLINES of the selected scale.
        information: information matrix of the data, (coordinates, coordinates).
        prior: information matrix of the prior, (coordinates, coordinates).
        of_strengths: information of the data about each free strength, (strengths,).
    """

    log_likelihood: float
    log_misfit: float
    log_prior: float
    information: np.ndarray
    prior: np.ndarray
    of_strengths: np.ndarray

    def log_evidence(self, kappa: float) -> float:
        strengths = 0.5 * np.log(2 * np.pi / (kappa * self.of_strengths)).sum()
        volume = log_volume_ratio(self.prior, kappa * self.information)
        return kappa * self.log_likelihood + self.log_misfit + self.log_prior + float(volume + strengths)


def mean_squared_residual(found: MaterialFit, noise: PixelNoise) -> float:
    """Compute the robust mean squared residual of a fit, relative to the variance of pixel noise.

    The strengths of the fit must be free.
    """
    solution = found._solution
    data, model = solution.problem.data, solution.model
    u = standardised_residual(data, model.value, noise, np.inf)[data.used]
    return float(_robust(u).sum() / max(solution.freedom, 1))


def independent_share(found: MaterialFit) -> float:
    """Compute the share of independent cells from the correlation of the residuals.

    Misfit is similar in neighbouring cells, and pixel noise is not. If neighbours have the correlation r, n residuals contain
    as much information as n (1 - r) / (1 + r) independent residuals (Bayley & Hammersley 1946). The share is the product of
    this factor for neighbours in azimuth and of this factor for neighbours in theta_d.
    """
    solution = found._solution
    data, model, cells = solution.problem.data, solution.model, solution.problem.cells
    u = standardised_residual(data, model.value, found.noise, np.inf)
    u *= huber_weights(u)
    at_slice = np.broadcast_to(np.arange(cells.slices.size)[:, None], cells.i_theta_h.shape)
    part = cells.i_phi_d // _AZIMUTH_BIN
    in_azimuth = _correlation(u, data.used, (at_slice, cells.i_theta_h), cells.i_phi_d)
    in_theta_d = _correlation(u, data.used, (cells.i_theta_h, part), at_slice)
    return float(np.prod([(1 - r) / (1 + r) for r in (in_azimuth, in_theta_d)]))


def _correlation(u: np.ndarray, used: np.ndarray, same: Sequence[np.ndarray], along: np.ndarray) -> float:
    """Compute the correlation of standardised residuals of neighbouring cells; negative values are set to zero.

    Two cells are neighbours if their indices in `same`, (s, n) each, are equal, and their indices in `along`, (s, n), are
    consecutive. A cell has at most one neighbour on each side. `u` contains the standardised residuals, and `used` is True
    for the cells to compare, (u, s, n) each.
    """
    order = np.lexsort([along.ravel(), *(one.ravel() for one in same)])
    sorted_u, there = (a.reshape(len(u), -1)[:, order] for a in (u, used))
    group = np.stack([one.ravel()[order] for one in same])
    pairs = there[:, 1:] & there[:, :-1] & (group[:, 1:] == group[:, :-1]).all(0) & (np.diff(along.ravel()[order]) > 0)
    first, second = sorted_u[:, :-1][pairs], sorted_u[:, 1:][pairs]
    power = float((first**2 + second**2).sum()) / 2
    return max(float(first @ second) / power, 0.0) if power > 0 else 0.0


def explained(found: MaterialFit, noise: PixelNoise) -> Explained:
    """Compute the terms of the evidence of a fit with free strengths.

    noise: noise of a pixel, without misfit.
    """
    solution = found._solution
    problem, model = solution.problem, solution.model
    whole = _at_least(found.noise, noise)
    data = problem.data.around(model.value, whole)
    cost = _robust(standardised_residual(data, model.value, whole, np.inf))
    variance = cell_variance(data, model.value, whole)
    scale = cell_variance(data, model.value, PixelNoise(1.0, _FAINT, 0.0))
    misfit = ((variance - cell_variance(data, model.value, noise)) / scale)[data.used].mean()
    white = whitening(data, 1 / variance, model.lobe, np.inf)
    flat = white(model.derivative).reshape(solution.p.size, -1)
    mean, std = _priors(problem.layout)
    rows = problem.prior.rows(problem.layout)
    prior = rows.T @ rows + np.diag(1 / std**2)
    off = solution.p - mean
    distance = float(((rows @ solution.p) ** 2).sum() + (off**2 / std**2).sum())
    power = (np.where(data.used, 1 / variance, 0.0) * model.lobe**2).sum(-1)
    return Explained(
        log_likelihood=log_likelihood(data, model.value, whole, cost),
        log_misfit=-float(np.sqrt(misfit)) / MISFIT_SCALE,
        log_prior=-0.5 * distance - (np.log(TRIED_SPLINES) if problem.layout.kind.spline_size else 0.0),
        information=flat @ flat.T,
        prior=prior,
        of_strengths=power[power > 0],
    )


class Weighing(NamedTuple):
    """Noise model that weights the residuals of the fits of a table.

    Attributes:
        noise: noise of a pixel.
        kappa: exponent of the likelihood: the share of pixel noise in the variance of the best fit. If the noise is not known,
            it is the share of independent cells.
        chi2: mean squared residual of the best fit divided by the variance of pixel noise. The noise of a typical camera is
            assumed if the noise is not known.
        known: True if the noise of a pixel is specified, or determined by the data without a model.
    """

    noise: PixelNoise
    kappa: float
    chi2: float
    known: bool

    @classmethod
    def of(cls, fits: Sequence[MaterialFit], noise: PixelNoise | None) -> Weighing:
        """Build the noise model from fits of the same cells.

        noise: noise of a pixel; None: the smallest estimate of the fits is used.
        """
        if noise is None:
            left = [fit.noise for fit in fits]
            least = PixelNoise(min(one.relative for one in left), min(one.floor for one in left), 0.0)
            chi2, best = min(((mean_squared_residual(fit, _TYPICAL), fit) for fit in fits), key=lambda pair: pair[0])
            return cls(_at_least(least, LEAST_NOISE), independent_share(best), chi2, known=False)
        chi2 = min(mean_squared_residual(fit, noise) for fit in fits)
        return cls(noise, min(1.0, 1 / max(chi2, 1e-12)), chi2, known=True)

    def at_most(self, other: Weighing) -> Weighing:
        return self if self.chi2 < other.chi2 else other

    @property
    def unexplained(self) -> bool:
        return self.chi2 > _MOSTLY_MISFIT

    def complete(self, fit: MaterialFit) -> bool:
        """Check whether the residuals of a fit are pixel noise only, so that no other model can improve the fit."""
        # the limit is three standard deviations above the expected mean of chi squared
        return self.known and mean_squared_residual(fit, self.noise) < 1 + 3 * np.sqrt(2 / max(fit.freedom, 1))

    def log_likelihood(self, fit: MaterialFit) -> float:
        return self.kappa * explained(fit, self.noise).log_likelihood

    def log_evidence(self, fit: MaterialFit) -> float:
        return explained(fit, self.noise).log_evidence(self.kappa)

    def probabilities(self, fits: Sequence[MaterialFit]) -> np.ndarray:
        """Compute the posterior probabilities of fits of the same cells, for equal prior probabilities."""
        logs = np.array([self.log_evidence(fit) for fit in fits])
        shares = np.exp(logs - logs.max())
        return shares / shares.sum()


def _robust(u: np.ndarray) -> np.ndarray:
    """Compute twice Huber's cost, which is quadratic for small and linear for large residuals (Huber 1964)."""
    weight = huber_weights(u)
    return weight * (2 - weight) * u**2


def lobe_priors(kind: LobeKind) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of the prior of each coordinate of a lobe, (coordinates,) each."""
    if kind.family == TWO_LOBES:
        own = ["width", "width", "share", "tail", "tail"]
    else:
        second = STUDENT if kind.family == STUDENT else "width" if kind.stretched else "power"
        own = ["width", *[second] * (len(kind.family_names) - 1)]
    mean, std = np.array([_PRIORS[name] for name in own + ["spline"] * (kind.spline_size + kind.shadows)]).T
    return mean, std


def _priors(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    unit = ["fresnel"] * layout.fresnel_size + ["diffuse"] * layout.diffuse + ["base"] * layout.base
    names = ["rig"] * layout.axes + [COATED] * layout.coated + [BASE_WIDTH] * layout.base + unit * layout.units
    lobes = np.tile(np.array(lobe_priors(layout.kind)), layout.lobes)
    mean, std = np.concatenate([lobes, np.array([_PRIORS[name] for name in names]).reshape(-1, 2).T], axis=1)
    return mean, std
