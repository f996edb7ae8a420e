"""Which explains a table better: its camera, or a surface that shadows itself as no roughness would?

Both are given a lobe of any smooth shape and F free in every picture. One sees it through the camera, with Smith's masking,
which follows from the lobe; the other sees it as it is, with masking free: Bagher, Snyder & Nowrouzezahrai (2016). Same cells,
same data; each estimates its own noise, and numbers that the data determine are counted against it (Akaike 1974).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.core import checks
from matcam.core.grid import checked_table, sampling_of
from matcam.inverse.fit.candidates import bent
from matcam.inverse.fit.fit_data import fit_data
from matcam.inverse.fit.fit_problem import Layout, Problem
from matcam.inverse.fit.fit_result import MaterialFit, result_of
from matcam.inverse.fit.material_fit import Prior, Search, fit, prior_rows
from matcam.inverse.operator.lobe_operator import perfect_operator, radius_of
from matcam.material.ndf.free_lobe import KNOTS, SHADOWS
from matcam.material.registry import FAMILIES
from matcam.rigs import Rig

_SMOOTH = 1.0
_CLEAR = 10.0
"""Difference of Akaike's criterion beyond which the worse of two models has no support (Burnham & Anderson 2002)."""


class Rival(NamedTuple):
    """One explanation."""

    fit: MaterialFit
    numbers: float
    """How many the data determine; those that smoothness holds do not count."""
    akaike: float
    """2 numbers - 2 ln likelihood."""


class Rivals(NamedTuple):
    """Both explanations of a table, and what follows."""

    camera: Rival
    shadowing: Rival

    @property
    def difference(self) -> float:
        """Akaike's criterion of shadowing minus camera's: positive for the camera."""
        return self.shadowing.akaike - self.camera.akaike

    @property
    def verdict(self) -> str:
        """In plain words."""
        noise = (
            f"a pixel's noise would be {self.camera.fit.noise.relative:.2%} with the camera, "
            f"{self.shadowing.fit.noise.relative:.2%} with free shadowing"
        )
        if abs(self.difference) < _CLEAR:
            return f"camera and free shadowing explain the data equally well: {noise}"
        better = "the camera" if self.difference > 0 else "free shadowing"
        return f"{better} explains the data better (Akaike's criterion differs by {abs(self.difference):.0f}): {noise}"


def rivals(brdf: xr.DataArray, rig: Rig, ndf: str = "ggx", *, every: int = 6) -> Rivals:
    """Fit a table once through its camera and once with free shadowing instead.

    brdf, rig, every: as `fit`'s. ndf: the family that both lobes are bent away from. Errors as `fit`'s.
    """
    brdf = checked_table(brdf)
    checks.choice("ndf", ndf, tuple(FAMILIES))
    plain = fit(brdf, rig, ndf, fresnel="free", diffuse=True, every=every)
    camera = bent(plain, brdf, rig, _SMOOTH, None, every)
    return Rivals(_rival(camera), _rival(_shadowed(brdf, rig, ndf, every)))


def _shadowed(brdf: xr.DataArray, rig: Rig, ndf: str, every: int) -> MaterialFit:
    sampling, channels, prior = sampling_of(brdf), brdf.sizes["channel"], Prior(np.zeros((0, 0)), ())
    cells, operator = perfect_operator(sampling, every, radius_of(rig))
    data = fit_data(brdf, cells)
    layout = Layout(ndf, "smith-separable", "free", True, (0,) * channels, 0)
    plain = Search(Problem(data, operator, cells.theta_d, layout), prior, None, radius_of(rig)).best()
    free = layout._replace(bends=KNOTS, shadows=SHADOWS)
    problem = Problem(data, operator, cells.theta_d, free)
    start = np.concatenate([plain.p[layout.lobe(0)], np.zeros(KNOTS + SHADOWS), plain.p[layout.lobe(0).stop :]])
    solved = Search(problem, prior, None, radius_of(rig), _SMOOTH).continued(start, plain.weight, plain.noise)
    return result_of(problem, solved, [brdf], None, prior, [channels], cells, noise_given=False)


def _rival(found: MaterialFit) -> Rival:
    known = prior_rows(found.problem.layout, found.prior, _SMOOTH)
    held = float(np.einsum("rp,pq,rq->", known, found.solved.covariance, known))
    strengths = int(found.problem.data.used.any(-1).sum())
    numbers = found.solved.p.size - held + strengths
    return Rival(found, numbers, 2 * numbers - 2 * found.log_likelihood)
