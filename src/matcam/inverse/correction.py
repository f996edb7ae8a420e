"""A whole table as a perfect camera would have measured it, with what is known of every entry (MODEL 8)."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
import xarray as xr

from matcam import checks
from matcam._jax import jax, jnp
from matcam.angles import merl_grid
from matcam.camera.noise import PixelNoise
from matcam.camera.uncertainty import Uncertainty
from matcam.errors import FitError
from matcam.inverse import fit_parameters as parameters
from matcam.inverse.fit_result import MaterialFit
from matcam.inverse.lobe_operator import Axis, check_rig
from matcam.inverse.material_fit import fit
from matcam.inverse.response_lattice import Lattice, lattice, on_table, seen_cells
from matcam.inverse.shape_correction import ShapeCorrection, shape_correction, shape_records, unshaped
from matcam.material.families import FAMILIES
from matcam.material.masking import MASKINGS, Masking
from matcam.rigs import Rig
from matcam.table import checked_table, sampling_of

SUPPORTED = 0.05
"""Relative standard deviation up to which an entry is supported."""

BENT = 0.05
"""Strength of a shape's correction beyond which its family does not explain the data."""

DOUBT = 3.0
"""How often a change that a free lens would make counts, where rig and data contradict each other: the lens need not be what
is wrong."""

_CANDIDATES = ("ggx", "epd")
_EVERY = 6
_LENS = "optics.sigma_px"
_NEAREST_GLARE = 8.0
"""px; a halo closer to the highlight than this is the lens's core, and told by its profile."""


class Correction(NamedTuple):
    """`table`: Dataset of `correct`. fit: of the lobe through the camera. other: the same with the lens free, None where
    the lens has no single width. shape: what was changed of the family's lobe."""

    table: xr.Dataset
    fit: MaterialFit
    other: MaterialFit | None
    shape: ShapeCorrection


def correct(
    brdf: xr.DataArray,
    rig: Rig,
    ndf: str = "auto",
    *,
    masking: Masking = "smith",
    noise: PixelNoise | None = None,
    glare: float = 1e-3,
) -> xr.Dataset:
    """The table that a perfect camera would have measured: `correction(...)`'s table alone."""
    return correction(brdf, rig, ndf, masking=masking, noise=noise, glare=glare).table


def correction(
    brdf: xr.DataArray,
    rig: Rig,
    ndf: str = "auto",
    *,
    masking: Masking = "smith",
    noise: PixelNoise | None = None,
    glare: float = 1e-3,
) -> Correction:
    """Correct a whole table for the camera that recorded it, and say of every entry how well it is known.

    brdf: table as from `read_merl`. rig: a distant camera and lamp and a sphere. ndf: a family, or "auto": the likelier of
    "ggx" and "epd". noise: of a pixel; None: estimated. glare: share of light that the lens may scatter far beyond what its
    profile says; it limits what is supported beside a highlight.

    A lobe is fitted through the camera (F free in every picture, a Lambertian part), then bent as far as the data ask
    (`shape_correction`). Each entry's part above the Lambertian one is multiplied by true over recorded lobe: the ratio
    carries the measurement's own detail. Dataset over the table's dims:
      brdf        1/sr; missing stays missing, negative noise becomes 0; reciprocal as the table is
      brdf_std    standard deviation: pixel noise, fitted numbers, camera's stated uncertainty, shape, what a lens left free
                  would change, glare. NaN where the sphere's last pixels show the entry: there it is left as it was
      supported   whether brdf_std is under 5 % of brdf
      response    recorded / true lobe, over the first three dims

    Errors as `fit`'s.
    """
    brdf = checked_table(brdf)
    check_rig(rig)
    checks.choice("ndf", ndf, ("auto", *FAMILIES))
    checks.choice("masking", masking, MASKINGS)
    checks.within("glare", glare, 0, 0.5)
    options: dict[str, Any] = {"fresnel": "free", "diffuse": True, "masking": masking, "noise": noise, "every": _EVERY}
    fits = []
    for family in _CANDIDATES if ndf == "auto" else (ndf,):
        fits.append(fit(brdf, rig, family, **options))
    best = max(fits, key=lambda found: found.log_likelihood)
    other = None
    axes = tuple(Axis(name, float(half)) for name, half in _axes(best))
    if _LENS in rig.camera.parameters():
        exact = eqx.tree_at(lambda r: r.camera.uncertainty, rig, None, is_leaf=lambda x: x is None)
        other = fit(brdf, exact, best.family, camera="free", **options)
    shape = shape_correction(best, noise)
    if shape.strength > BENT:  # too far for what is linear: the lobe itself is bent
        best = fit(brdf, rig, best.family, bend=1.0, **{**options, "every": 3 * _EVERY})
        shape = unshaped(best, shape.strength)
    where = lattice(rig, sampling_of(brdf), axes)
    ratio = _Ratio(where, best, shape, axes)
    log_ratio = on_table(ratio.value, where)
    model_std = np.sqrt(np.maximum(on_table(ratio.variance, where), 0))
    if other is not None:
        there = lattice(_with_lens(rig, other.params[_LENS]), sampling_of(brdf), ())
        change = on_table(_of_fit(there, other) - ratio.plain, where)
        model_std = np.hypot(model_std, (DOUBT if contradicts(best, other) else 1.0) * change)
    table = _assembled(brdf, rig, best, shape, log_ratio, model_std, glare)
    table.attrs.update(
        ndf=best.family, masking=masking or "none", glare=glare, sampling=sampling_of(brdf),
        source=str(brdf.attrs.get("source", "")), remarks="; ".join(remarks(best, other, shape)),
        camera_uncertainty="stated" if rig.camera.uncertainty else "none stated: taken as exact",
    )  # fmt: skip
    return Correction(table, best, other, shape)


def _axes(found: MaterialFit) -> list[tuple[str, float]]:
    """Names and ranges of the camera numbers that a fit freed."""
    operator = found.problem.operator
    return [(name, max(values)) for name, values in zip(found.axis_names, operator.values, strict=True)]


class _Ratio:
    """ln(true / recorded) on the lattice: shape corrected, its variance, and without the shape's correction."""

    def __init__(self, where: Lattice, found: MaterialFit, shape: ShapeCorrection, axes: tuple[Axis, ...]):
        layout, p = found.problem.layout, found.solved.p
        q, own = jnp.asarray(p[layout.lobe(0)]), jnp.asarray(p[layout.camera])
        names = [axis.name for axis in axes]
        place = np.array([[name == n for n in names] for name in found.axis_names], dtype=float)
        place = place.reshape(len(found.axis_names), len(names))
        lobe = (layout.family, layout.masking)
        recorded, parts = shape_records(where.recorded, *lobe, q, own @ place)
        true, true_parts = shape_records(where.true, *lobe, q, jnp.zeros(0))
        slopes = _log_slopes(where, *lobe, q, own, jnp.asarray(place))
        ok = where.cells.kept
        safe = [np.where(ok, np.asarray(a), 1.0) for a in (recorded, true)]
        share = [np.asarray(a) / s for a, s in zip((parts, true_parts), safe, strict=True)]
        lift = [np.maximum(1 + np.tensordot(shape.b, s, 1), 1e-3) for s in share]
        self.plain = np.where(ok, np.log(safe[1] / safe[0]), 0.0)
        self.value = self.plain + np.where(ok, np.log(lift[1] / lift[0]), 0.0)
        by_shape = share[1] / lift[1] - share[0] / lift[0]
        columns = np.concatenate([np.where(ok, np.asarray(slopes), 0.0), np.where(ok, by_shape, 0.0)])
        self.variance = np.einsum("psn,pq,qsn->sn", columns, shape.covariance, columns)


@eqx.filter_jit
def _log_slopes(
    where: Lattice, family: str, masking: Masking, q: jax.Array, own: jax.Array, place: jax.Array
) -> jax.Array:
    """Derivatives of ln(true / recorded) by the lobe's and the camera's numbers, (numbers, slices, cells)."""

    def log_ratio(v: jax.Array) -> jax.Array:
        ndf = parameters.ndf_at(family, v[: q.size])
        recorded = where.recorded.record(ndf, masking, v[q.size :] @ place)
        true = where.true.record(ndf, masking, jnp.zeros(0))
        ok = where.cells.kept
        return jnp.log(jnp.where(ok, true, 1.0)) - jnp.log(jnp.where(ok, recorded, 1.0))

    return jnp.moveaxis(jax.jacfwd(log_ratio)(jnp.concatenate([q, own])), -1, 0)


def _with_lens(rig: Rig, sigma: float) -> Rig:
    return eqx.tree_at(lambda r: r.camera, rig, rig.camera.with_parameters({_LENS: sigma}))


def _of_fit(where: Lattice, found: MaterialFit) -> np.ndarray:
    """ln(true / recorded) of another fit, on the lattice of its own lens."""
    layout, p = found.problem.layout, found.solved.p
    q = jnp.asarray(p[layout.lobe(0)])
    recorded, _ = shape_records(where.recorded, layout.family, layout.masking, q, jnp.zeros(0))
    true, _ = shape_records(where.true, layout.family, layout.masking, q, jnp.zeros(0))
    ok = where.cells.kept
    return np.where(ok, np.log(np.where(ok, np.asarray(true), 1.0) / np.where(ok, np.asarray(recorded), 1.0)), 0.0)


def _assembled(
    brdf: xr.DataArray,
    rig: Rig,
    found: MaterialFit,
    shape: ShapeCorrection,
    log_ratio: np.ndarray,
    model_std: np.ndarray,
    glare: float,
) -> xr.Dataset:
    data = brdf.values
    layout, p = found.problem.layout, found.solved.p
    channels = range(data.shape[3])
    body = np.array([p[layout.unit(u)][-1] for u in channels]) / np.pi
    known = seen_cells(sampling_of(brdf))[..., None]
    ratio = np.where(known, np.exp(log_ratio)[..., None], 1.0)
    above = data - body
    lobe = above > 0
    corrected = np.maximum(np.where(lobe, body + above * ratio, data), 0.0)

    noise = shape.noise
    peak = np.nanmax(np.where(np.isfinite(data), data, 0), axis=(0, 2))[None, :, None, :]
    variance = (noise.relative**2 + noise.gain**2) * data**2 + (noise.floor * peak) ** 2
    variance = variance * np.where(lobe, ratio, 1.0) ** 2
    variance += np.where(lobe, above * ratio * model_std[..., None], 0.0) ** 2
    scattered = glare * _farthest_glare(brdf, rig, found)
    variance += (scattered**2 + (glare * data) ** 2) * np.where(lobe, ratio, 1.0) ** 2
    std = np.where(known & np.isfinite(data), np.sqrt(variance), np.nan)
    bent = bool(layout.bends)  # then the shape's own uncertainty says it
    good = bent or found.determined or found.half_width_std < SUPPORTED * found.half_width
    with np.errstate(invalid="ignore"):
        supported = known & (std < SUPPORTED * corrected) & good
    first = brdf.dims[:3]
    return xr.Dataset(
        {
            "brdf": (brdf.dims, corrected, {**brdf.attrs, "units": "1/sr", "long_name": "BRDF freed from the camera"}),
            "brdf_std": (brdf.dims, std, {"units": "1/sr", "long_name": "standard deviation of brdf"}),
            "supported": (brdf.dims, supported, {"long_name": "standard deviation under 5 %"}),
            "response": (first, np.exp(-log_ratio), {"long_name": "recorded / true lobe"}),
        },
        coords=brdf.coords,
    )


def _farthest_glare(brdf: xr.DataArray, rig: Rig, found: MaterialFit) -> np.ndarray:
    """The most that a halo of any radius, holding all of the highlight's light, could add to an entry, 1/sr: a Gaussian of
    std s adds flux exp(-d^2 / 2 s^2) / (2 pi s^2) at distance d, whose maximum over s is flux / (pi e d^2)."""
    grid = merl_grid(sampling_of(brdf))
    strength = found.curves["fresnel"].values
    there = np.isfinite(strength).all(axis=1)
    if not there.any():
        raise FitError("no picture shows a highlight")
    seen = found.problem.theta_d[there]
    f = np.stack([np.interp(grid.theta_d, seen, column[there]) for column in strength.T], axis=-1)
    radius = float(rig.sample.radius)  # type: ignore[attr-defined]
    th, td, ph = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d
    x = radius * (np.sin(td) * (np.cos(th) - 1) - np.sin(th) * np.cos(ph) * np.cos(td))
    distance2 = np.maximum(x**2 + (radius * np.sin(th) * np.sin(ph)) ** 2, _NEAREST_GLARE**2)
    # integral of D over normals is about 1: flux = F r^2 / 4
    cos_i = np.maximum(np.cos(th) * np.cos(td) - np.sin(th) * np.sin(td) * np.abs(np.cos(ph)), 0.05)
    return f[None, :, None, :] * (radius**2 / 4 / (np.pi * np.e * distance2 * cos_i))[..., None]


def remarks(found: MaterialFit, other: MaterialFit | None, shape: ShapeCorrection) -> list[str]:
    """What a reader should know of a correction, in plain words."""
    said = list(found.remarks)
    if shape.strength > BENT:
        said.append(
            f"a {found.family} lobe does not explain the data: its shape was bent (strength {shape.strength:g}), and what "
            "the pixels do not resolve of that shape counts as uncertainty"
        )
    if other is not None and found.camera and contradicts(found, other):
        lens, std = other.params[_LENS], other.std[_LENS]
        assumed = float(found.camera.parameters()[_LENS])
        said.append(
            f"left free, the lens would be {lens:.3f} +- {std:.1g} px instead of {assumed:.3f} px: camera, lamp or family "
            f"contradict the data; {DOUBT:g} times the difference counts as uncertainty"
        )
    return said


def contradicts(found: MaterialFit, other: MaterialFit) -> bool:
    """Whether a lens left free moves by more than 4 standard deviations of both, and by more than 0.2 %."""
    if found.camera is None:
        return False
    known = found.camera.uncertainty
    assumed = float(found.camera.parameters()[_LENS])
    spread = np.hypot(other.std[_LENS], known.std().get(_LENS, 0.0) if isinstance(known, Uncertainty) else 0.0)
    return bool(abs(other.params[_LENS] - assumed) > 4 * max(spread, 0.002 * assumed / 4))
