"""Families of lobes that are tried where the user names none, and how: F free in every picture, a Lambertian part.

Fits that begin where another ended: in more slices, with one number of the rig left free, or with the lobe bent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core.grid import sampling_of
from matcam.inverse.fit import fit_data as picture_noise
from matcam.inverse.fit.fit_data import fit_data
from matcam.inverse.fit.fit_problem import Problem
from matcam.inverse.fit.fit_result import MaterialFit, result_of
from matcam.inverse.fit.material_fit import CameraUse, Prior, Search, fit
from matcam.inverse.operator.lobe_operator import lobe_operator, radius_of
from matcam.inverse.operator.rig_axes import free_axis
from matcam.material.masking import Masking
from matcam.material.ndf.free_lobe import KNOTS
from matcam.rigs import Rig

AUTO = "auto"
EVERY = 6
"""Slices of theta_d from one that a lobe is looked for in to the next."""

_CANDIDATES = ("ggx", "epd")


def candidate_fits(
    brdf: xr.DataArray | Sequence[xr.DataArray],
    rig: Rig,
    ndf: str,
    *,
    masking: Masking,
    noise: PixelNoise | None = None,
    camera: CameraUse | None = None,
    every: int = EVERY,
) -> list[MaterialFit]:
    """A fit for each candidate, or for the family `ndf` alone; the rest as in `fit`, with its errors."""
    return [
        fit(brdf, rig, family, fresnel="free", diffuse=True, masking=masking, noise=noise, camera=camera, every=every)
        for family in (_CANDIDATES if ndf == AUTO else (ndf,))
    ]


def likeliest(fits: Sequence[MaterialFit]) -> MaterialFit:
    """The fit whose family makes the data most probable."""
    return max(fits, key=lambda found: found.log_likelihood)


def resampled(
    found: MaterialFit, brdf: xr.DataArray, rig: Rig, noise: PixelNoise | None, every: int, bend: float
) -> MaterialFit:
    """The same fit of `brdf` alone to every `every`-th slice, which are more than it was made of. bend: as it was."""
    cells, operator = lobe_operator(rig, sampling_of(brdf), every, found.prior.axes)
    problem = Problem(fit_data(brdf, cells), operator, cells.theta_d, found.problem.layout)
    weight = 1 / picture_noise.variance(problem.data, np.abs(problem.data.values), found.noise)
    search = Search(problem, found.prior, noise, radius_of(rig), bend)
    solved = search.adjusted(found.solved.p, weight, found.noise)
    return result_of(problem, solved, [brdf], rig, found.prior, [brdf.sizes["channel"]], cells, noise is not None)


def freed(
    found: MaterialFit, brdf: xr.DataArray, rig: Rig, name: str, noise: PixelNoise | None, every: int
) -> MaterialFit:
    """The same data fitted with one number of the rig free and all others exact. found: a fit of `brdf` alone, to every
    `every`-th slice."""
    prior = Prior(np.zeros((1, 1)), (free_axis(name, rig),))
    cells, operator = lobe_operator(rig, sampling_of(brdf), every, prior.axes)
    layout, numbers = found.problem.layout, found.solved.p
    problem = Problem(found.problem.data, operator, cells.theta_d, layout._replace(axes=1))
    start = np.concatenate([numbers[: layout.camera.start], [0.0], numbers[layout.camera.stop :]])
    search = Search(problem, prior, noise, radius_of(rig))
    solved = search.continued(start, found.solved.weight, found.noise)
    return result_of(problem, solved, [brdf], rig, prior, [brdf.sizes["channel"]], cells, noise is not None)


def bent(
    found: MaterialFit, brdf: xr.DataArray, rig: Rig, bend: float, noise: PixelNoise | None, every: int
) -> MaterialFit:
    """The lobe of a fit of `brdf` alone, bent (`fit`, bend) to follow every `every`-th slice."""
    prior, layout, numbers = found.prior, found.problem.layout, found.solved.p
    cells, operator = lobe_operator(rig, sampling_of(brdf), every, prior.axes)
    problem = Problem(fit_data(brdf, cells), operator, cells.theta_d, layout._replace(bends=KNOTS))
    start = np.concatenate([numbers[layout.lobe(0)], np.zeros(KNOTS), numbers[layout.lobe(0).stop :]])
    weight = 1 / picture_noise.variance(problem.data, np.abs(problem.data.values), found.noise)
    search = Search(problem, prior, noise, radius_of(rig), bend)
    solved = search.continued(start, weight, found.noise)
    return result_of(problem, solved, [brdf], rig, prior, [brdf.sizes["channel"]], cells, noise is not None)
