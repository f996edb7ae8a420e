"""Evidence of the explanations of a table: marginal likelihood of each, on one scale.

The variance of a cell is the sum of pixel noise, V0, and model error, tau^2 m^2 + tau_f^2 P^2 (m the model, P the peak
of the slice). The misfit t, its root mean square over the cells relative to m and 1e-2 P, has an exponential prior.
Laplace's approximation gives

    ln E = kappa ln L + ln p(t) + ln p(theta) + k/2 ln 2 pi - 1/2 ln |kappa H + Q| + sum_s 1/2 ln(2 pi / (kappa q_s)) ,

H the information of the data about the k parameters theta, Q that of their prior, q_s the information about the free strength
of slice s (MacKay 2003, chapter 28). Misfit is correlated between cells, so cells count only by the share of pixel noise in the
variance of the best explanation: kappa = min(1, 1 / chi^2), chi^2 the mean squared residual of that explanation in standard
deviations of pixel noise. This is a tempered likelihood (Gruenwald 2012).

V0 is estimated without a model of the lobe: from cells that mirror each other, or from the differences between channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.camera.sensor import PixelNoise
from matcam.core.grid import merl_grid, sampling_of
from matcam.inverse.correction.spline_lobe import TRIED_SPLINES
from matcam.inverse.fit.fit_data import (
    FitData,
    cell_variance,
    estimate_noise,
    huber_weights,
    standardised_residual,
    whitening,
)
from matcam.inverse.fit.fit_parameters import BASE_WIDTH, STUDENT, TWO_LOBES, Layout
from matcam.inverse.fit.fit_setup import FitSetup
from matcam.inverse.fit.material_fit import MaterialFit

LEAST_NOISE = PixelNoise(5e-3, 1e-6, 0.0)
"""Least noise of a pixel that is assumed: shot noise of a full well of 40,000 electrons, and the accuracy of a modelled
record. Mirrored cells of a symmetrised table agree exactly, although they have noise.
"""
UNKNOWN_SHARE = 0.1
"""kappa where nothing distinguishes pixel noise from misfit, as in a table of one channel whose cells have no mirror images:
about ten cells, those of two rings, then share one error."""
_MISFIT_SCALE = 1e-2
"""Mean of the exponential prior of the misfit, over the value of a cell: models with much larger errors do not explain
a table.
"""
_FAINT = 1e-2
"""Share of the peak of a slice below which misfit is relative to that share, not to the cell."""
_TYPICAL = PixelNoise(1e-2, 1e-4, 0.0)
"""Noise of a pixel from which its estimate starts."""
_MOSTLY_MISFIT = 2.0
"""chi^2 from which more than half of the residual variance is misfit."""
_FEWEST_PAIRS = 100
"""Smallest number of pairs of cells; it determines the noise to 7 %."""
_PRIORS = {
    "width": (-4.5, 2.5), "power": (0.0, 0.7), STUDENT: (0.0, 1.0), "share": (0.0, 1.5), "tail": (0.5, 0.5),
    "spline": (0.0, 10.0), "rig": (0.0, 0.5), "fresnel": (0.0, 3.0), "diffuse": (0.2, 0.3),
    "base": (0.2, 0.3), BASE_WIDTH: (-2.0, 1.0),
}  # fmt: skip
"""Mean and standard deviation of each kind of parameter, in the coordinates of a fit: widths from 0.001 to 0.1 rad, powers
from 1/2 to 2, any share, corrections of ln D up to 10, albedos of a diffuse part and reflectances of a base up to 0.5,
roughnesses of a base from 0.05 to 0.4. Differences of evidence depend on their logarithm only.
"""


def noise_without_model(setup: FitSetup, found: MaterialFit) -> PixelNoise | None:
    """Estimate the noise of a pixel without a model of the lobe; None if the data do not determine it.

    Each of two estimates is an upper bound: mirrored cells differ through an aberrated lens, too, and channels in what only
    one of them shows. The one with the smaller variance is returned.

    setup: whose cells are compared with their mirror images. found: a fit, whose residuals are compared between channels.
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
    """Estimate noise from cells at phi_d and pi - phi_d, which an isotropic lens records equally (docs/model.md 3)."""
    problem = setup.problem
    cells, data, (table,) = problem.cells, problem.data, setup.tables
    if cells.real is not None or (setup.rig is not None and not setup.rig.camera.optics.isotropic):
        return None
    mirrored = merl_grid(sampling_of(table)).index(phi_d=np.mod(np.pi - cells.phi_d, np.pi))[2]
    others = table.values[cells.i_theta_h, cells.slices[:, None], mirrored].transpose(2, 0, 1)
    apart = (np.abs(cells.y) >= 0.5).all(axis=-1)  # two pixels
    used = data.used & np.isfinite(others) & apart
    if used.sum() < _FEWEST_PAIRS:
        return None
    others = np.where(used, others, 0.0)
    return _of_pairs(data._replace(used=used), data.values - others, (data.values + others) / 2)


def _channel_noise(found: MaterialFit) -> PixelNoise | None:
    """Estimate noise from the differences of residuals between channels, in which model errors of the lobe cancel."""
    problem, model = found._solution.problem, found._solution.model
    data, residual = problem.data, problem.residual(model)
    units = len(data.labels)
    if units < 2:
        return None
    other = np.roll(np.arange(units), 1)
    strong = (model.strength > 0) & (model.strength[other] > 0)
    used = data.used & data.used[other] & strong[..., None]
    if used.sum() < _FEWEST_PAIRS:
        return None
    scale = np.where(strong, model.strength / np.where(strong, model.strength[other], 1.0), 0.0)
    difference = np.where(used, residual - scale[..., None] * residual[other], 0.0)
    return _of_pairs(data._replace(used=used), difference, model.value)


def _of_pairs(data: FitData, difference: np.ndarray, value: np.ndarray) -> PixelNoise:
    """Estimate noise from the differences within pairs of cells of equal true value."""
    noise = _TYPICAL
    for _ in range(2):  # the weights of the start take gains out
        noise = estimate_noise(data, difference / np.sqrt(2), value, 0, noise)
    return noise


class OtherLobe(NamedTuple):
    """Another lobe through the same camera.

    Attributes:
        fit: fit of the lobe.
        setup: setup of the fit.
        probability: probability of this lobe among all lobes (no unit).
    """

    fit: MaterialFit
    setup: FitSetup
    probability: float


class Explained(NamedTuple):
    """Likelihood, prior and information of a fit before its cells are weighed.

    Attributes:
        log_likelihood: logarithm of the likelihood with its misfit as noise.
        log_misfit: logarithm of the prior of that misfit.
        log_prior: logarithm of the prior of the parameters, without powers of 2 pi; the scale of a spline modification
            is one of those tried.
        information: (parameters, parameters), of the data.
        prior: (parameters, parameters), information of the prior.
        of_strengths: (strengths,), information about each free strength.
    """

    log_likelihood: float
    log_misfit: float
    log_prior: float
    information: np.ndarray
    prior: np.ndarray
    of_strengths: np.ndarray

    def log_evidence(self, kappa: float) -> float:
        """Compute the logarithm of the evidence. kappa: share of pixel noise in the variance."""
        posterior = kappa * self.information + self.prior
        strengths = 0.5 * np.log(2 * np.pi / (kappa * self.of_strengths)).sum()
        volume = 0.5 * (np.linalg.slogdet(self.prior)[1] - np.linalg.slogdet(posterior)[1])
        return kappa * self.log_likelihood + self.log_misfit + self.log_prior + float(volume + strengths)


def mean_squared_residual(found: MaterialFit, noise: PixelNoise) -> float:
    """Compute the mean squared residual (robust) of a fit with free strengths, in standard deviations of pixel noise."""
    solution = found._solution
    data, model = solution.problem.data, solution.model
    u = standardised_residual(data, solution.problem.residual(model), model.value, noise, np.inf)[data.used]
    return float(_robust(u).sum() / max(solution.freedom, 1))


def explained(found: MaterialFit, noise: PixelNoise) -> Explained:
    """Compute the terms of the evidence of a fit with free strengths. noise: noise of a pixel."""
    solution = found._solution
    problem, model = solution.problem, solution.model
    data, residual = problem.data, problem.residual(model)
    whole = _at_least(found.noise, noise)
    u = standardised_residual(data, residual, model.value, whole, np.inf)[data.used]
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
        log_likelihood=-0.5 * float(np.log(variance[data.used]).sum() + _robust(u).sum()),
        log_misfit=-float(np.sqrt(misfit)) / _MISFIT_SCALE,
        log_prior=-0.5 * distance - (np.log(TRIED_SPLINES) if problem.layout.kind.spline_size else 0.0),
        information=flat @ flat.T,
        prior=prior,
        of_strengths=power[power > 0],
    )


class Weighing(NamedTuple):
    """Weights of the residuals of a table's explanations.

    Attributes:
        noise: noise of a pixel.
        kappa: share of pixel noise in the variance of the best explanation.
        chi2: mean squared residual of the best explanation over the variance of pixel noise; of a typical camera if
            that noise is not known.
        known: whether the data determine the noise of a pixel without a model.
    """

    noise: PixelNoise
    kappa: float
    chi2: float
    known: bool

    @classmethod
    def of(cls, fits: Sequence[MaterialFit], noise: PixelNoise | None) -> Weighing:
        """Weigh the residuals of some fits of the same cells.

        noise: noise of a pixel; None: the smallest estimate of the fits.
        """
        if noise is None:
            left = [fit.noise for fit in fits]
            least = PixelNoise(min(one.relative for one in left), min(one.floor for one in left), 0.0)
            chi2 = min(mean_squared_residual(fit, _TYPICAL) for fit in fits)
            return cls(_at_least(least, LEAST_NOISE), UNKNOWN_SHARE, chi2, known=False)
        chi2 = min(mean_squared_residual(fit, noise) for fit in fits)
        return cls(noise, min(1.0, 1 / max(chi2, 1e-12)), chi2, known=True)

    def at_most(self, other: Weighing) -> Weighing:
        """Choose the weighing with the smaller residuals."""
        return self if self.chi2 < other.chi2 else other

    @property
    def unexplained(self) -> bool:
        """Check whether most of the residual variance of the best explanation is misfit."""
        return self.chi2 > _MOSTLY_MISFIT

    def complete(self, fit: MaterialFit) -> bool:
        """Check whether a fit leaves no more than pixel noise, so that a richer model cannot improve it."""
        # three standard deviations of a mean of chi squared
        return self.known and mean_squared_residual(fit, self.noise) < 1 + 3 * np.sqrt(2 / max(fit.freedom, 1))

    def log_likelihood(self, fit: MaterialFit) -> float:
        """Compute the logarithm of the tempered likelihood of a fit."""
        return self.kappa * explained(fit, self.noise).log_likelihood

    def log_evidence(self, fit: MaterialFit) -> float:
        """Compute the logarithm of the evidence of a fit."""
        return explained(fit, self.noise).log_evidence(self.kappa)

    def probabilities(self, fits: Sequence[MaterialFit]) -> np.ndarray:
        """Compute the posterior probability of each fit of the same cells; all are equally probable before the data."""
        logs = np.array([self.log_evidence(fit) for fit in fits])
        shares = np.exp(logs - logs.max())
        return shares / shares.sum()


def _robust(u: np.ndarray) -> np.ndarray:
    """Limit squared residuals to linear growth where a fit gives them less weight (Huber 1964)."""
    weight = huber_weights(u)
    return weight * (2 - weight) * u**2


def _priors(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Return prior mean and standard deviation of every parameter of a fit."""
    kind = layout.kind
    if kind.family == TWO_LOBES:
        own = ["width", "width", "share", "tail", "tail"]
    else:
        second = STUDENT if kind.family == STUDENT else "power"
        own = ["width", *[second] * (len(kind.family_names) - 1)]
    lobe = own + ["spline"] * (kind.spline_size + kind.shadows)
    unit = ["fresnel"] * layout.fresnel_size + ["diffuse"] * layout.diffuse + ["base"] * layout.base
    names = lobe * layout.lobes + ["rig"] * layout.axes + [BASE_WIDTH] * layout.base + unit * layout.units
    mean, std = np.array([_PRIORS[name] for name in names]).T
    return mean, std
