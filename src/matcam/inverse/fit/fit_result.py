"""F of every picture as a fit has it, and its errors.

What a reader should know of a fit, in plain words.

What a fit hands back: numbers with errors, the material, and how well it explains the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from matcam.camera.camera import Camera
from matcam.camera.sensor import PixelNoise
from matcam.camera.uncertainty import Uncertainty
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.inverse.fit import fit_data as picture_noise
from matcam.inverse.fit import fit_parameters as parameters
from matcam.inverse.fit.fit_parameters import half_width_of
from matcam.inverse.fit.fit_problem import Problem
from matcam.inverse.operator.chosen_cells import ChosenCells
from matcam.inverse.operator.lobe_operator import radius_of
from matcam.inverse.operator.rig_axes import WIDTHS
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import NDF
from matcam.material.reflectance import Conductor, Dielectric, Reflectance, Sampled, Schlick
from matcam.rigs import Rig

if TYPE_CHECKING:
    from matcam.inverse.fit.material_fit import Solved


def strengths_of(problem: Problem, solved: Solved) -> tuple[np.ndarray, np.ndarray]:
    """F of every unit and slice and its standard deviation, the gain's share included where F is free."""
    layout = problem.layout
    strength = solved.model.strength.copy()
    if layout.fresnel != "free":
        variance = np.zeros_like(strength)
        for u in range(len(strength)):
            place = layout.unit(u)
            inner = slice(place.start, place.start + len(parameters.fresnel_names(layout.fresnel)))

            def curve(c: jax.Array) -> jax.Array:
                return parameters.reflectance_at(layout.fresnel, c).at(jnp.asarray(problem.theta_d))

            slope = np.asarray(jax.jacfwd(curve)(jnp.asarray(solved.p[inner])))
            variance[u] = np.einsum("sa,ab,sb->s", slope, solved.covariance[inner, inner], slope)
        return strength, np.sqrt(variance)
    own, taken = strength_errors(problem, solved)
    variance = own**2 + np.einsum("pus,pq,qus->us", taken, solved.covariance, taken)
    variance += (solved.noise.picture_gain * strength) ** 2
    seen = problem.data.used.any(-1)
    return np.where(seen, strength, np.nan), np.where(seen, np.sqrt(variance), np.nan)


def strength_errors(problem: Problem, solved: Solved) -> tuple[np.ndarray, np.ndarray]:
    """Of strengths that are free in every slice: (their standard deviations, all else held, (units, slices); how they fall
    when the fit's numbers rise, (numbers, units, slices)). The covariance of a unit's strengths is diag(own^2) + taken'
    covariance taken. 0 where nothing was seen."""
    weighted = np.where(problem.data.used, solved.weight, 0.0) * solved.model.lobe
    power = np.maximum((weighted * solved.model.lobe).sum(-1), 1e-300)
    taken = (weighted * solved.model.derivative).sum(-1) / power
    seen = problem.data.used.any(-1)
    return np.where(seen, solved.model.strength_std, 0.0), np.where(seen, taken, 0.0)


def conditional(covariance: np.ndarray, known: slice) -> tuple[np.ndarray, np.ndarray]:
    """(covariance if the numbers at `known` were held, what their own uncertainty adds): both of the full shape."""
    cross = covariance[:, known]
    added = cross @ np.linalg.pinv(covariance[known, known], hermitian=True) @ cross.T
    return covariance - added, added


if TYPE_CHECKING:
    from matcam.inverse.fit.material_fit import Prior, Solved

_UNSEEN = 2.0
"""Standard deviations of its square below which a width may be none at all."""


def remarks_on(
    rig: Rig | None, prior: Prior, solved: Solved, freed: slice, determined: bool, at_end: float, noise_given: bool
) -> tuple[str, ...]:
    """One sentence each. freed: place of the rig's numbers; at_end: ln of the width over the narrowest that a fit tries."""
    said = []
    if rig is None:
        said.append("no rig: fitted as if the camera were perfect")
    elif not prior.axes:
        said.append(
            "the camera is assumed exact" + ("" if rig.camera.uncertainty else ": its profile states no uncertainty")
        )
    stds = np.sqrt(np.diag(solved.covariance)[freed])
    for axis, coordinate, own in zip(prior.axes, solved.p[freed], stds, strict=True):
        square, std = axis.square(coordinate, own)
        if axis.softening and square < _UNSEEN * std:
            said.append(f"{axis.name} is compatible with 0: its square is {square:.2g} +- {std:.2g}")
    if at_end <= 0.05:
        said.append(
            "the lobe is narrower than this camera can tell, or than it could have recorded: the width is a bound; "
            "check that rig and data belong together"
        )
    elif not determined:
        said.append("the roughness is not determined: its standard deviation exceeds 5 %")
    if noise_given and solved.misfit > 1 + 5 * np.sqrt(2 / max(solved.freedom, 1)):
        said.append(f"the data miss the model by {np.sqrt(solved.misfit):.1f} times the stated noise")
    if not noise_given and max(solved.noise.relative, 20 * solved.noise.floor) > 0.05:
        said.append(
            "the data miss the model by more than any pixel's noise: the camera or the family of the lobe is wrong"
        )
    return tuple(said)


if TYPE_CHECKING:
    from matcam.inverse.fit.material_fit import Prior, Solved

DETERMINED = 0.05
"""Relative standard deviation of a roughness up to which it counts as determined."""
LINEAR = 0.15
"""Relative standard deviation of a power up to which errors are those of the linearised fit: beyond, width and power trade
along a curve, and the width's own error says too little."""

_BOUND = 0.05
"""ln of a width over the narrowest that is tried, below which the fit has run into its bound."""


@dataclass(frozen=True)
class MaterialFit:
    """A fitted material.

    params, std: numbers by name ("alpha", "n[G]", "optics.sigma_px", ...) and their standard deviations; covariance: of all
    of them in that order. half_width, half_width_std: half width at half maximum of D, rad: what stays well determined
    where a width and a power trade against each other. determined: whether the standard deviation of every roughness is
    under 5 %. resolved: whether the lobe is wider than the narrowest that this camera can tell from a point. materials: one
    `Microfacet` per table; material: the first. camera: as fitted, with its new uncertainty; None without a rig. curves:
    Dataset over (theta_d, channel) with `fresnel` and `fresnel_std`. residual: Dataset over (channel, theta_d, cell), in
    standard deviations, with theta_h and phi_d. noise: given, or estimated. misfit: sum of squared residuals per degree of
    freedom. remarks: what a reader should know, in plain words.
    """

    family: str
    params: dict[str, float]
    std: dict[str, float]
    covariance: np.ndarray
    half_width: float
    half_width_std: float
    determined: bool
    resolved: bool
    materials: tuple[Microfacet, ...]
    camera: Camera | None
    curves: xr.Dataset
    residual: xr.Dataset
    noise: PixelNoise
    misfit: float
    log_likelihood: float
    freedom: int
    remarks: tuple[str, ...]
    problem: Problem
    solved: Solved
    prior: Prior

    @property
    def material(self) -> Microfacet:
        """The first table's."""
        return self.materials[0]

    @property
    def ndf(self) -> NDF:
        """The first lobe."""
        layout = self.problem.layout
        return parameters.ndf_at(layout.family, jnp.asarray(self.solved.p[layout.lobe(0)]))

    def correlation(self, first: str, second: str) -> float:
        """Of two numbers by name."""
        names = list(self.params)
        for name in (first, second):
            if name not in names:
                raise ArgumentError(f"the fit has no number {name!r}; it has {', '.join(names)}")
        i, j = names.index(first), names.index(second)
        return float(self.covariance[i, j] / np.sqrt(self.covariance[i, i] * self.covariance[j, j]))

    def fresnel(self, theta: float, unit: int = 0) -> tuple[float, float]:
        """(F, standard deviation) at angle theta, rad, of one channel (counted through all tables)."""
        layout = self.problem.layout
        if layout.fresnel == "free":
            x = self.problem.theta_d
            f, std = self.curves["fresnel"].values[:, unit], self.curves["fresnel_std"].values[:, unit]
            there = np.isfinite(f)
            return float(np.interp(theta, x[there], f[there])), float(np.interp(theta, x[there], std[there]))
        place = layout.unit(unit)
        count = len(parameters.fresnel_names(layout.fresnel))
        at = jnp.asarray(self.solved.p[place][:count])
        curve = lambda c: parameters.reflectance_at(layout.fresnel, c).at(jnp.asarray(theta))  # noqa: E731
        slope = np.asarray(jax.jacfwd(curve)(at))
        inner = slice(place.start, place.start + count)
        return float(curve(at)), float(np.sqrt(slope @ self.solved.covariance[inner, inner] @ slope))

    def summary(self) -> dict[str, Any]:
        """Everything that fits on a page, as plain numbers and texts."""
        return {
            "ndf": self.family,
            "params": self.params,
            "std": self.std,
            "correlation": _correlation(self.covariance).tolist(),
            "half_width_rad": self.half_width,
            "half_width_std_rad": self.half_width_std,
            "determined": self.determined,
            "noise": self.noise._asdict(),
            "misfit": self.misfit,
            "log_likelihood": self.log_likelihood,
            "degrees_of_freedom": self.freedom,
            "remarks": list(self.remarks),
        }


def _correlation(covariance: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.diag(covariance))
    return covariance / np.outer(scale, scale)


def result_of(
    problem: Problem,
    solved: Solved,
    tables: list[xr.DataArray],
    rig: Rig | None,
    prior: Prior,
    channels: list[int],
    cells: ChosenCells,
    noise_given: bool,
) -> MaterialFit:
    """Gather a fit's result."""
    layout, data = problem.layout, problem.data
    names, values, slopes = _named(problem, solved, prior, channels)
    covariance = solved.covariance * np.outer(slopes, slopes)
    std = np.sqrt(np.diag(covariance))
    roughness_std = np.sqrt(
        [solved.covariance[layout.lobe(n).start, layout.lobe(n).start] for n in range(layout.lobes)]
    )
    half, half_std = half_width_of(
        layout.family, solved.p[layout.lobe(0)], solved.covariance[layout.lobe(0), layout.lobe(0)]
    )
    strength, strength_std = strengths_of(problem, solved)
    labels = ("theta_d", "channel")
    coords: dict[str, Any] = {
        "theta_d": ("theta_d", problem.theta_d, {"units": "rad"}),
        "channel": [f"{label}" if len(tables) == 1 else f"{label}{u}" for u, label in enumerate(data.labels)],
    }
    curves = xr.Dataset(
        {"fresnel": (labels, strength.T), "fresnel_std": (labels, strength_std.T)}, coords=coords
    )  # fmt: skip
    scaled = picture_noise.without_gain(
        data, problem.residual(solved.model), solved.model.value, solved.noise, problem.gain(solved.noise)
    )
    residual = xr.Dataset(
        {"residual": (("channel", "theta_d", "cell"), np.where(data.used, scaled, np.nan))},
        coords={
            **coords,
            "theta_h": (("theta_d", "cell"), tables[0]["theta_h"].values[cells.i_theta_h]),
            "phi_d": (("theta_d", "cell"), tables[0]["phi_d"].values[cells.i_phi_d]),
        },
        attrs={"units": "standard deviations of the noise"},
    )
    variance = picture_noise.variance(data, solved.model.value, solved.noise)
    likelihood = -0.5 * (np.log(variance[data.used]).sum() + (scaled[data.used] ** 2).sum())
    at_end = float(solved.p[0]) - parameters.lobe_bounds(layout.family, radius_of(rig))[0][0]
    own = len(parameters.lobe_names(layout.family))
    last = [layout.lobe(n).start + own - 1 for n in range(layout.lobes)]
    linear = own == 1 or bool(np.all(np.sqrt(np.diag(solved.covariance)[last]) < LINEAR))
    determined = linear and bool(np.all(roughness_std < DETERMINED) and at_end > _BOUND)
    materials = []
    first = 0
    for count in channels:
        lobe = layout.lobe_of[first]
        ndf = parameters.ndf_at(layout.family, jnp.asarray(solved.p[layout.lobe(lobe)]))
        materials.append(_material(problem, solved, ndf, range(first, first + count), strength))
        first += count
    return MaterialFit(
        family=layout.family,
        params=dict(zip(names, values.tolist(), strict=True)),
        std=dict(zip(names, std.tolist(), strict=True)),
        covariance=covariance,
        half_width=half,
        half_width_std=half_std,
        determined=determined,
        resolved=bool(at_end > _BOUND),
        materials=tuple(materials),
        camera=_camera(rig, prior, problem, solved),
        curves=curves,
        residual=residual,
        noise=solved.noise,
        misfit=solved.misfit,
        log_likelihood=float(likelihood),
        freedom=solved.freedom,
        remarks=remarks_on(rig, prior, solved, layout.camera, determined, at_end, noise_given),
        problem=problem,
        solved=solved,
        prior=prior,
    )


def _named(
    problem: Problem, solved: Solved, prior: Prior, channels: list[int]
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, values and derivatives by the fit's coordinates of all its numbers."""
    layout, labels = problem.layout, problem.data.labels
    several = len(channels) > 1
    table_of = np.repeat(np.arange(len(channels)), channels)
    unit_names = [f"{label}@{t}" if several else label for label, t in zip(labels, table_of, strict=True)]
    names: list[str] = []
    for lobe in range(layout.lobes):
        suffix = ""
        if layout.lobes > 1:
            mine = layout.lobe_of.index(lobe)
            suffix = f"[{table_of[mine]}]" if layout.lobes == len(channels) else f"[{unit_names[mine]}]"
        names += [f"{name}{suffix}" for name in parameters.lobe_names(layout.family, layout.bends, layout.shadows)]
    plain = [name.split("[")[0] for name in names]
    names += [axis.name for axis in prior.axes]
    plain += ["camera"] * layout.axes
    for unit in unit_names:
        own = [*parameters.fresnel_names(layout.fresnel), *(["diffuse"] if layout.diffuse else [])]
        names += [f"{name}[{unit}]" for name in own]
        plain += own
    pairs = np.array([parameters.natural(name, q) for name, q in zip(plain, solved.p, strict=True)])
    values, slopes = pairs.T if pairs.size else (np.zeros(0), np.zeros(0))
    for number, axis in enumerate(prior.axes, layout.camera.start):
        std = float(np.sqrt(solved.covariance[number, number]))
        values[number], slopes[number] = axis.value(solved.p[number]), axis.slope(solved.p[number], std)
    return names, values, slopes


def _material(problem: Problem, solved: Solved, ndf: NDF, units: range, strength: np.ndarray) -> Microfacet:
    layout = problem.layout
    diffuse: Any = 0.0
    if layout.diffuse:
        diffuse = np.clip([solved.p[layout.unit(u)][-1] for u in units], 0, 1)
    rows = [solved.p[layout.unit(u)] for u in units]
    term: Reflectance
    if layout.fresnel == "free":
        seen = np.isfinite(strength[list(units)]).all(axis=0)
        term = Sampled(problem.theta_d[seen], np.maximum(strength[list(units)][:, seen], 0.0).T)
    elif layout.fresnel == "conductor":
        term = Conductor(np.exp([r[0] for r in rows]), np.exp([r[1] for r in rows]))
    elif layout.fresnel == "schlick":
        term = Schlick(np.array([r[0] for r in rows]))
    else:
        term = Dielectric(1 + np.exp([r[0] for r in rows]))
    return Microfacet(ndf, term, diffuse, layout.masking)


def _camera(rig: Rig | None, prior: Prior, problem: Problem, solved: Solved) -> Camera | None:
    if rig is None:
        return None
    place = problem.layout.camera
    lens = [n for n, axis in enumerate(prior.axes) if axis.name not in WIDTHS]
    if not lens:
        return rig.camera
    numbers = [(prior.axes[n], float(solved.p[place][n]), n) for n in lens]
    values = {axis.name: axis.value(s) for axis, s, _ in numbers}
    covariance = solved.covariance[place, place][np.ix_(lens, lens)]
    slopes = [axis.slope(s, float(np.sqrt(covariance[m, m]))) for m, (axis, s, _) in enumerate(numbers)]
    covariance = covariance * np.outer(slopes, slopes)
    fitted = rig.camera.with_parameters(values)
    known = Uncertainty(values, (covariance + covariance.T) / 2)
    return Camera(fitted.optics, fitted.pixel, fitted.sensor, uncertainty=known, provenance=fitted.provenance)
