"""A material estimated THROUGH the camera: every theta_d at once, the camera's own uncertainty among the data (MODEL 8)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import xarray as xr
from scipy.optimize import least_squares

from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError
from matcam.core.grid import checked_table, sampling_of
from matcam.inverse.fit import fit_data as picture_noise
from matcam.inverse.fit import fit_parameters as parameters
from matcam.inverse.fit.fit_data import fit_data, joined
from matcam.inverse.fit.fit_parameters import FRESNEL_MODELS, FresnelModel
from matcam.inverse.fit.fit_problem import Layout, Model, Problem
from matcam.inverse.fit.fit_result import MaterialFit, result_of
from matcam.inverse.operator.lobe_operator import check_rig, lobe_operator, radius_of
from matcam.inverse.operator.rig_axes import Axis, free_axis, known_axis
from matcam.material.masking import MASKINGS, Masking
from matcam.material.ndf.free_lobe import KNOTS
from matcam.material.registry import FAMILIES, WITH_POWER
from matcam.numerics.interpolate import smoothness
from matcam.rigs import Rig

CameraUse = Literal["fixed", "prior", "free"]

_STARTS = np.log(np.geomspace(1.5e-4, 0.7, 18))
_ROUNDS = 6
_SETTLED = 0.02
"""Change of the numbers, in their standard deviations, below which weights need no further round."""


class Prior(NamedTuple):
    """What is known of the rig's free numbers besides: root of the information matrix of their coordinates."""

    root: np.ndarray
    axes: tuple[Axis, ...]


def fit(
    brdf: xr.DataArray | Sequence[xr.DataArray],
    rig: Rig | None,
    ndf: str = "ggx",
    *,
    fresnel: FresnelModel = "conductor",
    diffuse: bool = False,
    per_channel: bool = False,
    masking: Masking = "smith",
    camera: CameraUse | None = None,
    free: Sequence[str] = ("optics.sigma_px",),
    bend: float = 0.0,
    noise: PixelNoise | None = None,
    every: int = 1,
) -> MaterialFit:
    """Fit a microfacet material to a table through the camera that recorded it, all theta_d jointly (MODEL 8).

    brdf: table as from `read_merl`, or several tables of one rig (one camera, a material each). rig: a distant camera and
    lamp and a sphere; None fits as if the camera were perfect. ndf: a family, "ggx", "epd", "sgd", "beckmann" or
    "gaussian". fresnel: "conductor" (n, k), "schlick" or "dielectric" (per channel), or "free" in every theta_d. diffuse:
    add a Lambertian part. per_channel: a lobe for each channel instead of one for all.

    camera: "fixed" as the rig says; "prior": its uncertain numbers are fitted, with their covariance as what is known of
    them; "free": the numbers named in `free` are fitted with nothing known. None: "prior" if the camera states an
    uncertainty, else "fixed", and the result says that it is assumed exact. A free width - "optics.sigma_px", or the rig's
    "lamp_radius", "jitter" or "aperture" - may come down to 0.

    bend: how far D may depart from the family, smoothly: standard deviation of the second differences of ln D between knots
    that are half a power of e apart; 0 keeps the family, 1 is as good as no family (a non-parametric D).

    noise: of a pixel and of a picture's gain; None: estimated from the residuals, misfit and all. every: use every n-th
    slice of theta_d.

    The data are chosen cells, of every pixel one (`inverse/chosen_cells.py`): their errors are independent but for the
    picture's gain, and the stated covariance is the inverse of their Fisher information with the camera's prior. Outliers
    beyond 3 standard deviations count less (Huber). ArgumentError for a wrong argument, FitError for data that hold
    nothing to fit.
    """
    tables = [checked_table(table) for table in ([brdf] if isinstance(brdf, xr.DataArray) else brdf)]
    if not tables:
        raise ArgumentError("brdf must be a table or a list of at least one, got none")
    if len({sampling_of(table) for table in tables}) > 1:
        raise ArgumentError("tables that are fitted together must have the same attrs['sampling']")
    checks.choice("ndf", ndf, tuple(FAMILIES))
    checks.choice("fresnel", fresnel, FRESNEL_MODELS)
    checks.choice("masking", masking, MASKINGS)
    if type(every) is not int or not 1 <= every <= 30:
        raise ArgumentError(f"every must be a whole number in [1, 30], got {every!r}")
    prior = _prior(rig, camera, free)
    cells, operator = lobe_operator(rig, sampling_of(tables[0]), every, prior.axes)
    data = joined([fit_data(table, cells) for table in tables])
    channels = [table.sizes["channel"] for table in tables]
    lobes = range(sum(channels)) if per_channel else np.repeat(np.arange(len(tables)), channels)
    checks.within("bend", bend, 0, 10)
    layout = Layout(ndf, masking, fresnel, diffuse, tuple(int(n) for n in lobes), len(prior.axes), KNOTS if bend else 0)
    problem = Problem(data, operator, cells.theta_d, layout)
    solved = Search(problem, prior, noise, radius_of(rig), bend).best()
    return result_of(problem, solved, tables, rig, prior, channels, cells, noise is not None)


def _prior(rig: Rig | None, camera: CameraUse | None, free: Sequence[str]) -> Prior:
    if rig is None:
        if camera not in (None, "fixed"):
            raise ArgumentError("without a rig there is no camera to fit: camera must be None or 'fixed'")
        return Prior(np.zeros((0, 0)), ())
    check_rig(rig)
    known = rig.camera.uncertainty
    if camera is None:
        camera = "prior" if known is not None and known.names else "fixed"
    checks.choice("camera", camera, ("fixed", "prior", "free"))
    if camera == "fixed":
        return Prior(np.zeros((0, 0)), ())
    if camera == "free":
        return Prior(np.zeros((len(free), len(free))), tuple(free_axis(name, rig) for name in free))
    if known is None or not known.names:
        raise ArgumentError("camera='prior' needs a camera that states an uncertainty (Camera(..., uncertainty=...))")
    numbers = rig.camera.parameters()
    value = np.array([float(numbers[name]) for name in known.names])
    covariance = np.asarray(known.covariance)
    felt = (np.diag(covariance) > 0) & (value > 0)
    names = [name for name, f in zip(known.names, felt, strict=True) if f]
    relative = covariance[np.ix_(felt, felt)] / np.outer(value[felt], value[felt])
    variances, axes = np.linalg.eigh(relative)
    root = (axes / np.sqrt(np.maximum(variances, 1e-12))).T
    stds = np.sqrt(np.diag(relative))
    return Prior(root, tuple(known_axis(*one) for one in zip(names, value[felt].tolist(), stds.tolist(), strict=True)))


class Solved(NamedTuple):
    """The best numbers, and everything at them."""

    p: np.ndarray
    model: Model
    covariance: np.ndarray
    noise: PixelNoise
    misfit: float
    """Weighted sum of squares over the degrees of freedom."""
    freedom: int
    weight: np.ndarray


class Search:
    """From a row of widths to the best fit."""

    def __init__(self, problem: Problem, prior: Prior, noise: PixelNoise | None, radius: float, bend: float = 0.0):
        self.problem, self.prior, self.given = problem, prior, noise and noise.checked()
        layout = problem.layout
        self.known = prior_rows(layout, prior, bend)
        bounds = parameters.lobe_bounds(layout.family, radius, layout.bends + layout.shadows) * layout.lobes
        bounds += [(axis.low, axis.high) for axis in prior.axes]
        unit = parameters.fresnel_bounds(layout.fresnel) + ([(-0.05, 1.0)] if layout.diffuse else [])
        bounds += unit * len(layout.lobe_of)
        self.low, self.high = np.array(bounds).T

    def best(self) -> Solved:
        """Lattice of starts, then the best two to the end."""
        data = self.problem.data
        noise = self.given or picture_noise.START
        # to begin with, each value's own variance; from then on the model's
        weight = 1 / picture_noise.variance(
            data, np.abs(data.values), picture_noise.START._replace(picture_gain=noise.picture_gain)
        )
        starts = self._starts(weight)
        tried = [self._refined(start, weight, noise, rounds=1) for start in starts[:2]]
        first = min(tried, key=lambda solved: solved.misfit)
        return self._refined(first.p, first.weight, first.noise, rounds=_ROUNDS)

    def continued(self, start: np.ndarray, weight: np.ndarray, noise: PixelNoise) -> Solved:
        """From numbers and weights that another fit has found."""
        inside = np.clip(start, self.low + 1e-9, self.high - 1e-9)
        return self._refined(inside, weight, self.given or noise, rounds=_ROUNDS)

    def adjusted(self, start: np.ndarray, weight: np.ndarray, noise: PixelNoise) -> Solved:
        """From numbers that a fit of fewer of the same data has found: within their errors, a few linear steps are a fit."""
        return self._refined(start, weight, self.given or noise, rounds=2, steps=(2, 2))

    def _starts(self, weight: np.ndarray) -> list[np.ndarray]:
        """Starts in order of their misfit, no two neighbours on the lattice."""
        layout, problem = self.problem.layout, self.problem
        lattice: list[tuple[float, ...]] = [(q,) for q in _STARTS]
        if layout.family in WITH_POWER:
            powers = np.log([0.5, 1.0, 1.8] if layout.family == "epd" else [0.3, 0.8, 1.5])
            lattice = [(q, power) for power in powers for q in _STARTS[::2]]
        plain = layout._replace(fresnel="free", diffuse=False, bends=0, shadows=0)
        free = Problem(problem.data, problem.operator, problem.theta_d, plain)
        found = []
        for lobe in lattice:
            inside = np.clip(lobe, self.low[: len(lobe)], self.high[: len(lobe)])
            p = np.zeros(free.layout.size)
            for number in range(layout.lobes):
                p[free.layout.lobe(number)] = inside
            model = free.model(p, weight, slopes=False)
            u = free.whitening(model, weight, 0.0)(problem.data.values - model.value)
            found.append(((picture_noise.huber(u) * u**2).sum(), inside, model))
        order = np.argsort([misfit for misfit, *_ in found])
        picked: list[np.ndarray] = []
        for index in order:
            _, lobe, _ = found[index]
            if all(np.abs(lobe[0] - other[0]) > 1.2 or np.abs(lobe - other)[1:].any() for other in picked):
                picked.append(lobe)
        best = found[order[0]][2]
        return [self._vector(lobe, best) for lobe in picked[:2]]

    def _vector(self, lobe: np.ndarray, free: Model) -> np.ndarray:
        """A whole start around a lobe: Fresnel terms from the strengths that it was given."""
        layout = self.problem.layout
        p = np.zeros(layout.size)
        for number in range(layout.lobes):
            p[layout.lobe(number)][: lobe.size] = lobe
        if layout.fresnel != "free":
            for u, strength in enumerate(free.strength):
                weight = np.where(
                    np.isfinite(free.strength_std[u]) & (strength > 0), 1 / np.maximum(strength, 1e-6) ** 2, 0
                )
                weight *= self.problem.theta_d < np.radians(80)
                start = parameters.fresnel_start(layout.fresnel, self.problem.theta_d, strength, weight)
                p[layout.unit(u)][: start.size] = start
        return np.clip(p, self.low + 1e-9, self.high - 1e-9)

    def _refined(
        self, p: np.ndarray, weight: np.ndarray, noise: PixelNoise, rounds: int, steps: tuple[int, int] = (12, 5)
    ) -> Solved:
        """Least squares with weights held, then better weights, until nothing moves. steps: at most, in the first round and
        in others."""
        problem, data = self.problem, self.problem.data
        for turn in range(rounds):
            before = p
            p = self._least_squares(p, weight, noise, steps=steps[turn > 0])
            model = problem.model(p, weight)
            residual = problem.residual(model)
            if self.given is None:
                noise = picture_noise.estimated(data, residual, model.value, p.size, noise)
            off = picture_noise.without_gain(data, residual, model.value, noise, problem.gain(noise))
            robust = picture_noise.huber(off)
            weight = robust / picture_noise.variance(data, model.value, noise)
            model = problem.model(p, weight)
            white = problem.whitening(model, weight, noise.picture_gain)
            flat = white(model.derivative).reshape(p.size, -1)
            covariance = _inverse(flat @ flat.T + self.known.T @ self.known)
            std = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
            if np.all(np.abs(p - before) < _SETTLED * std):
                break
        if not np.all(np.isfinite(p)):
            raise FitError("the fit ran into numbers that are none: the data do not look like a lobe of this family")
        u = white(problem.residual(model))
        taken = data.used.any(-1).sum() if problem.layout.fresnel == "free" else 0
        freedom = int(data.used.sum() - p.size - taken)
        return Solved(p, model, covariance, noise, float((u**2).sum() / max(freedom, 1)), freedom, weight)

    def _least_squares(self, p: np.ndarray, weight: np.ndarray, noise: PixelNoise, steps: int) -> np.ndarray:
        problem = self.problem
        start = problem.model(p, weight)
        held = None if problem.layout.fresnel == "free" else problem.whitening(start, weight, noise.picture_gain)
        last: dict[bytes, np.ndarray] = {}

        def triangle(p: np.ndarray) -> np.ndarray:
            """R of the slopes and residuals together: the same squares and products in as many rows as there are numbers."""
            key = p.tobytes()
            if key not in last:
                model = problem.model(p, weight)
                white = held or problem.whitening(model, weight, np.inf)
                u = white(problem.data.values - model.value).reshape(1, -1)
                columns = np.concatenate([-white(model.derivative).reshape(p.size, -1), u])
                rows = np.concatenate([columns.T, np.column_stack([self.known, self.known @ p])])
                last.clear()
                last[key] = np.asarray(np.linalg.qr(rows, mode="r"))
            return last[key]

        inside = np.clip(p, self.low + 1e-9, self.high - 1e-9)
        found = least_squares(
            lambda p: triangle(p)[:, -1], inside, lambda p: triangle(p)[:, :-1], bounds=(self.low, self.high),
            x_scale="jac", ftol=1e-7, xtol=1e-6, max_nfev=steps,
        )  # fmt: skip
        return found.x


def prior_rows(layout: Layout, prior: Prior, bend: float) -> np.ndarray:
    """(rows, numbers): what is known of the numbers besides the data, as rows that are 0 +- 1 times them. bend: how smooth what
    leaves a family has to be."""
    camera = np.zeros((len(prior.root), layout.size))
    camera[:, layout.camera] = prior.root
    rows = [camera]
    first = len(parameters.lobe_names(layout.family))
    for start, count in ((first, layout.bends), (first + layout.bends, layout.shadows)):
        for number in range(layout.lobes if count else 0):
            own = np.zeros((len(smoothness(count)), layout.size))
            place = layout.lobe(number).start + start
            own[:, place : place + count] = smoothness(count) / bend
            rows.append(own)
    return np.concatenate(rows)


def _inverse(information: np.ndarray) -> np.ndarray:
    """Covariance; numbers that the data do not feel get an endless variance."""
    scale = np.sqrt(np.clip(np.diag(information), 0, None))
    unit = np.where(scale > 0, 1 / np.where(scale > 0, scale, 1.0), 0.0)
    values, axes = np.linalg.eigh(information * np.outer(unit, unit))
    inverse = (axes / np.maximum(values, 1e-12)) @ axes.T
    covariance = inverse * np.outer(unit, unit)
    covariance[np.diag_indices_from(covariance)] += np.where(scale > 0, 0.0, 1e12)
    return covariance
