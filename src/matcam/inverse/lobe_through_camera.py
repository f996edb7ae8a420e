"""A specular lobe estimated THROUGH the camera: one width for all theta_d, one strength for each (MODEL 8).

Model of a cell's value in slice j and channel c:   A_cj m_ji(width, camera) + B_c

m: record of the lobe relative to its true peak (forward/lobe.py), times cos^2 theta_d / (cos_i cos_o), the same for all channels; A: true peak value; B: the
Lambertian part. A and B are linear and solved for exactly (variable projection), so the search is over the logarithm of
the width alone. Noise lives in pixels: a cell's weight is its pixel content over the variance of a pixel, which is the
model's, V = relative^2 (A m)^2 + floor^2 (A m at the peak)^2, held fixed within an iteration; where it is not given,
its two numbers are estimated from the residuals.

The camera is NOT adjusted to the data: its uncertainty is a systematic one and is propagated. (A lobe of a slightly
different family would otherwise be blamed on the lens.)
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import equinox as eqx
import numpy as np
from scipy.optimize import least_squares, minimize

from matcam._jax import jax, jnp
from matcam.camera.noise import PixelNoise
from matcam.errors import FitError
from matcam.forward.lobe import lobe_record, tangent_offsets
from matcam.inverse import lobe_errors
from matcam.inverse.peak_cells import PeakData
from matcam.material.ndf import FAMILIES, NDF
from matcam.rigs import Rig

_NARROWEST = 0.02  # px: narrower lobes are the same point to any camera
_AT_BOUND = 0.05  # of ln width: a fit this near to _NARROWEST has not seen the lobe's width
_STEP = 3  # the search uses every third slice
_SLICES, _BLOCK = 30, 64  # slices at once, cells in multiples of this: few shapes to compile
_ROUNDS = 2
_START_NOISE = PixelNoise(0.02, 0.005)
_NOISE_BOUNDS = ((np.log(1e-4), np.log(0.05)), (np.log(1e-6), np.log(0.5)))


class LobeFit(NamedTuple):
    """A lobe, its strength in every slice, and their errors. Channels c, slices s, uncertain camera parameters p."""

    ndf: NDF
    width: float
    width_determined: bool
    """False: narrower than the camera can tell; the width is then a bound, and its error unknown."""
    amplitude: np.ndarray
    """(c, s): true peak value F D(0) G / (4 cos_i cos_o), 1/sr; NaN where the slice shows no lobe."""
    background: np.ndarray
    """(c,): Lambertian part, 1/sr."""
    noise: PixelNoise
    """Given, or estimated from the residuals."""
    log_likelihood: float
    amplitude_covariance: np.ndarray
    """(c, s, s): of the amplitudes, from the noise of pixels, the width fitted along."""
    amplitude_width_covariance: np.ndarray
    """(c, s): of the amplitudes and ln width."""
    log_width_variance: float
    amplitude_by_camera: np.ndarray
    """(p, c, s): change of the amplitudes per unit of each uncertain camera parameter, the width fitted along."""
    log_width_by_camera: np.ndarray
    """(p,)."""


def fit_lobe(data: PeakData, rig: Rig, family: str, noise: PixelNoise | None = None) -> LobeFit:
    """Fit one family of lobes to the data around a peak. FitError where the data do not hold a lobe."""
    some = data.every(_STEP)
    weights = _first_weights(some)
    if not weights.any():
        raise FitError("no highlight: the values around the peak (theta_h = 0) are missing or not positive")
    low = np.log(_NARROWEST / float(rig.sample.radius))  # type: ignore[attr-defined]
    high = np.log(min(FAMILIES[family].largest, 4 * data.half_width))
    model = _Model(some, rig, family)
    log_width = _coarse_search(model, some, weights, low, high)
    for _ in range(_ROUNDS):
        record = model(log_width)
        linear = _solve(some, record, weights)
        weights = _weights(some, record, linear, noise or _estimate_noise(some, record, linear))
        log_width = _refine(model, some, weights, log_width, low, high)
    determined = log_width > low + _AT_BOUND
    # a third of the slices has brought the width within a standard error: all of them take one Gauss-Newton step more
    model = _Model(data, rig, family)
    record, by_width = model.derivative(log_width)
    by_camera = [model.derivative(log_width, name)[1] for name in model.names]
    linear = _solve(data, record, _first_weights(data))
    assumed = noise or _START_NOISE
    for _ in range(_ROUNDS):
        weights = _weights(data, record, linear, assumed)
        linear = _solve(data, record, weights)
        assumed = noise or _estimate_noise(data, record, _without_camera_error(model, linear, weights, record, by_width, by_camera))
    weights = _weights(data, record, linear, assumed)
    if determined:
        maps = lobe_errors.sensitivity(weights, record, _derivatives(linear, by_width))
        log_width += float(np.clip(lobe_errors.reaction(maps, linear.residual)[1][0], -_AT_BOUND, _AT_BOUND))
    return _with_errors(data, model, log_width, weights, assumed, determined=determined)


class _Linear(NamedTuple):
    amplitude: np.ndarray  # (channels, slices), NaN where there is nothing
    background: np.ndarray  # (channels,)
    residual: np.ndarray  # (channels, slices, cells)
    misfit: float  # weighted sum of squares

    @property
    def positive(self) -> np.ndarray:
        """Amplitudes (channels, slices, 1), NaN where there is no lobe."""
        return np.where(self.amplitude > 0, self.amplitude, np.nan)[..., None]


@eqx.filter_jit
def _record(rig: Rig, ndf_type: type[NDF], log_width: jax.Array, theta_h: jax.Array, theta_d: jax.Array, phi_d: jax.Array) -> jax.Array:
    ndf = ndf_type(jnp.exp(log_width))  # type: ignore[call-arg]
    x, y = tangent_offsets(rig, ndf, theta_h, theta_d[:, None], phi_d)
    return lobe_record(rig, ndf, theta_d, x, jnp.broadcast_to(y, x.shape)) * ndf.flattening(theta_h)


@eqx.filter_jit
def _record_and_slope(rig, ndf_type, log_width, values, log_width_dot, values_dot, theta_h, theta_d, phi_d):  # type: ignore[no-untyped-def]
    """Record and its derivative along a direction in (ln width, camera parameters)."""

    def of(log_width: jax.Array, values: dict[str, jax.Array]) -> jax.Array:
        moved = eqx.tree_at(lambda r: r.camera, rig, rig.camera.with_parameters(values))
        return _record(moved, ndf_type, log_width, theta_h, theta_d, phi_d)

    return jax.jvp(of, (log_width, values), (log_width_dot, values_dot))


class _Model:
    """The lobe's record in the cells, as a function of ln width and of the camera's uncertain parameters."""

    def __init__(self, data: PeakData, rig: Rig, family: str):
        # the uncertainty is bookkeeping here, not an input of the forward model
        camera = rig.camera
        self.uncertainty = camera.uncertainty
        self.names = self.uncertainty.names if self.uncertainty else ()
        self.rig = eqx.tree_at(lambda r: r.camera.uncertainty, rig, None, is_leaf=lambda x: x is None)
        self.ndf_type = FAMILIES[family]
        # the lobe is the same at phi_d and pi - phi_d: half of the cells need not be computed
        distinct, self.place = np.unique(
            np.stack([data.theta_h, np.round(np.abs(np.cos(data.phi_d)), 12)]), axis=1, return_inverse=True
        )
        padding = -distinct.shape[1] % _BLOCK  # so that compiled functions are shared between data sets
        distinct = np.pad(distinct, ((0, 0), (0, padding)), mode="edge")
        theta_d = np.pad(data.theta_d, (0, -data.theta_d.size % _SLICES), mode="edge")
        self.blocks = [(distinct[0], block, np.arccos(distinct[1])) for block in theta_d.reshape(-1, _SLICES)]
        self.off_mirror = data.off_mirror
        parameters = camera.parameters() if self.names else {}
        self.values = {name: parameters[name] for name in self.names}

    def __call__(self, log_width: float) -> np.ndarray:
        return self._in_cells(_record(self.rig, self.ndf_type, np.asarray(log_width), *block) for block in self.blocks)

    def derivative(self, log_width: float, name: str | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Record, and its derivative by ln width or by the camera parameter `name`."""
        towards = {n: np.asarray(float(n == name)) for n in self.names}
        width_too = np.asarray(float(name is None))
        pairs = [
            _record_and_slope(self.rig, self.ndf_type, np.asarray(log_width), self.values, width_too, towards, *block)
            for block in self.blocks
        ]
        return self._in_cells(record for record, _ in pairs), self._in_cells(slope for _, slope in pairs)

    def _in_cells(self, distinct: Iterable[jax.Array]) -> np.ndarray:
        slices = np.concatenate([np.asarray(block) for block in distinct])
        return self.off_mirror * slices[: len(self.off_mirror), self.place]


def _solve(data: PeakData, record: np.ndarray, weights: np.ndarray) -> _Linear:
    """Amplitudes and backgrounds that fit best, given the lobe's shape."""
    wm = weights * record
    smm, sm1, s11 = (wm * record).sum(-1), wm.sum(-1), weights.sum(-1)
    sdm, sd1 = (wm * data.values).sum(-1), (weights * data.values).sum(-1)
    seen = smm > 0
    over = np.where(seen, smm, 1.0)
    free = (s11 - sm1**2 / over).sum(-1)
    background = (sd1 - sdm * sm1 / over).sum(-1) / np.where(free > 0, free, 1.0)
    amplitude = np.where(seen, (sdm - background[:, None] * sm1) / over, np.nan)
    fitted = np.nan_to_num(amplitude)[..., None] * record + background[:, None, None]
    residual = np.where(weights > 0, data.values - fitted, 0.0)
    return _Linear(amplitude, background, residual, float((weights * residual**2).sum()))


def _first_weights(data: PeakData) -> np.ndarray:
    """Weights before anything is known: each slice in units of its own peak, faint cells held back by a floor."""
    peak = np.maximum(data.values[..., :4].mean(-1, keepdims=True), 1e-300)
    usable = np.isfinite(1 / peak) & (peak > 1e-12)
    variance = (_START_NOISE.relative * data.values) ** 2 + (4 * _START_NOISE.floor * peak) ** 2
    return np.where(usable, data.content / np.maximum(variance, 1e-300), 0.0)


def _weights(data: PeakData, record: np.ndarray, linear: _Linear, noise: PixelNoise) -> np.ndarray:
    """Pixel content over the model's variance; 0 in slices where no lobe was found."""
    return np.nan_to_num(data.content / (linear.positive**2 * _relative_variance(record, noise)))


def _relative_variance(record: np.ndarray, noise: PixelNoise) -> np.ndarray:
    """Variance of a pixel in units of the true peak squared, (slices, cells)."""
    return (noise.relative * record) ** 2 + (noise.floor * record.max(-1, keepdims=True)) ** 2


def _estimate_noise(data: PeakData, record: np.ndarray, linear: _Linear) -> PixelNoise:
    """Relative noise and floor from the residuals, by maximum likelihood; each cell counts with its pixel content."""
    squared = (linear.residual / linear.positive) ** 2
    content = np.where(np.isfinite(squared), data.content, 0.0)
    squared = np.nan_to_num(squared)

    def objective(logs: np.ndarray) -> float:
        variance = _relative_variance(record, PixelNoise(*np.exp(logs)))
        # each slice's own amplitude has taken up part of its noise: leverage of one pixel
        information = content * (record**2 / variance)
        taken = np.clip((record**2 / variance) / np.maximum(information.sum(-1, keepdims=True), 1e-300), 0, 0.9)
        expected = variance * _share_of_pixel_variance(data)
        return float((content * (np.log(expected) + squared / (expected * (1 - taken)))).sum() / content.sum())

    best = minimize(objective, np.log(_START_NOISE), method="L-BFGS-B", bounds=_NOISE_BOUNDS)
    return PixelNoise(*np.exp(best.x).tolist())


def _coarse_search(model: _Model, data: PeakData, weights: np.ndarray, low: float, high: float) -> float:
    """Best of a row of widths."""
    candidates = np.linspace(low, high, 11)
    return float(min(candidates, key=lambda c: _solve(data, model(c), weights).misfit))


def _refine(model: _Model, data: PeakData, weights: np.ndarray, start: float, low: float, high: float) -> float:
    """Least squares over ln width, amplitudes and backgrounds projected out (Golub & Pereyra 1973, Kaufman's form)."""
    root = np.sqrt(weights)

    def residual(log_width: np.ndarray) -> np.ndarray:
        return (root * _solve(data, model(log_width[0]), weights).residual).ravel()

    def slope(log_width: np.ndarray) -> np.ndarray:
        record, by_width = model.derivative(log_width[0])
        # Kaufman: what the linear parameters can take up is no slope
        derivatives = _derivatives(_solve(data, record, weights), by_width)
        left = lobe_errors.sensitivity(weights, record, derivatives).rest[0]
        return -(root * left).reshape(-1, 1)

    margin = 1e-9 * (high - low)
    found = least_squares(
        residual, [np.clip(start, low + margin, high - margin)], slope, bounds=(low, high), xtol=1e-4, ftol=1e-6, max_nfev=20
    )
    return float(found.x[0])


def _derivatives(linear: _Linear, by_width: np.ndarray) -> np.ndarray:
    """Derivatives (k, c, s, n) by what all slices share: ln width, and each channel's background."""
    by_width = np.nan_to_num(linear.positive) * by_width
    channels = np.eye(len(by_width))[:, :, None, None]
    return np.concatenate([by_width[None], channels * np.ones_like(by_width)])


def _without_camera_error(
    model: _Model, linear: _Linear, weights: np.ndarray, record: np.ndarray, by_width: np.ndarray, by_camera: list[np.ndarray]
) -> _Linear:
    """The same fit with the residuals that it would have if the camera were also adjusted, within its stated
    uncertainty: an error of the camera is not noise, and is accounted for by itself."""
    if not by_camera:
        return linear
    # in units of the stated errors' principal axes, so that one that is stated as 0 stays 0
    variances, axes = np.linalg.eigh(np.asarray(model.uncertainty.covariance))  # type: ignore[union-attr]
    steps = axes * np.sqrt(np.clip(variances, 0, None))
    moved = np.einsum("pq,psn->qsn", steps, np.stack(by_camera))
    derivatives = np.concatenate([_derivatives(linear, by_width), np.nan_to_num(linear.positive) * moved[:, None]])
    known = np.diag(np.repeat([0.0, 1.0], [len(derivatives) - len(steps), len(steps)]))
    maps = lobe_errors.sensitivity(weights, record, derivatives, known)
    _, shift = lobe_errors.reaction(maps, linear.residual)
    return linear._replace(residual=linear.residual - np.einsum("k,kcsn->csn", shift, maps.rest) * (weights > 0))


def _share_of_pixel_variance(data: PeakData) -> np.ndarray:
    """A cell is the mean of two pixels, unless both ways fall into one."""
    return np.where(data.pixels.first == data.pixels.second, 1.0, 0.5)


def _with_errors(
    data: PeakData, model: _Model, log_width: float, weights: np.ndarray, noise: PixelNoise, *, determined: bool
) -> LobeFit:
    record, by_width = model.derivative(log_width)
    linear = _solve(data, record, weights)
    strength = np.nan_to_num(linear.positive)
    maps = lobe_errors.sensitivity(weights, record, _derivatives(linear, by_width * determined))
    covariance = lobe_errors.noise_covariance(maps, strength * np.sqrt(_relative_variance(record, noise)), data.pixels)
    by_camera = [lobe_errors.reaction(maps, -strength * model.derivative(log_width, name)[1]) for name in model.names]
    variance = np.where(weights > 0, (strength**2 * _relative_variance(record, noise)) * _share_of_pixel_variance(data), 1.0)
    used = np.where(weights > 0, data.content, 0.0)
    return LobeFit(
        ndf=model.ndf_type(np.exp(log_width)),  # type: ignore[call-arg]
        width=float(np.exp(log_width)),
        width_determined=determined,
        amplitude=linear.positive[..., 0],
        background=linear.background,
        noise=noise,
        log_likelihood=-0.5 * float((used * (np.log(variance) + linear.residual**2 / variance)).sum()),
        amplitude_covariance=covariance.amplitude,
        amplitude_width_covariance=covariance.cross[0],
        log_width_variance=float(covariance.shared[0, 0]) if determined else np.inf,
        amplitude_by_camera=np.array([amplitude for amplitude, _ in by_camera]).reshape(-1, *linear.amplitude.shape),
        log_width_by_camera=np.array([shared[0] for _, shared in by_camera]),
    )
