"""Glare: the largest amount of light of a highlight that the lens can scatter to each entry of a table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.errors import FitError
from matcam.core.grid import Sampling, merl_grid
from matcam.core.workspace import Workspace
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.sample_view import SampleView, sample_view
from matcam.rigs import Rig

_NEAREST = 8.0
"""px; a halo closer to the highlight belongs to the core of the lens, which its profile describes."""
_VIEWS = 2
"""Views whose scattered light is kept in memory, 12 MB each."""


class FarthestGlare(NamedTuple):
    """Largest contribution of a halo of any radius, with a given share of the light of the highlight, to each entry.

    Attributes:
        strength: (90, channels), reflectance of the highlight of each theta_d times the share.
        of_mirror: (90, 90, 180), the contribution if all light were reflected, 1/sr.
    """

    strength: np.ndarray
    of_mirror: np.ndarray

    def of(self, rows: slice) -> np.ndarray:
        """Compute the contribution in some rows of the table, (rows, 90, 180, channels), 1/sr."""
        return self.strength[:, None] * self.of_mirror[rows, ..., None]


def farthest_glare(
    glare: float, sampling: Sampling, rig: Rig, found: MaterialFit, workspace: Workspace
) -> FarthestGlare:
    """Compute the largest glare of a highlight.

    glare: share of the light that the lens scatters. found: gives the brightness of the highlights. workspace: keeps
        what depends on the rig alone.
    """
    strength = found.curves["fresnel"].values
    there = np.isfinite(strength).all(axis=1)
    if not there.any():
        raise FitError("no slice of theta_d shows a highlight: check that the table is complete")
    theta_d, seen = merl_grid(sampling).theta_d, found.theta_d[there]
    f = np.stack([np.interp(theta_d, seen, column[there]) for column in strength.T], axis=-1)
    view = sample_view(rig)
    width = min(found.hwhm, 1.0) * view.radius if np.isfinite(found.hwhm) else view.radius
    nearest = max(_NEAREST, width)
    key = view, sampling, nearest
    return FarthestGlare(
        glare * f, workspace.remember("farthest glare", key, lambda: _of_mirror(view, sampling, nearest), most=_VIEWS)
    )


def _of_mirror(view: SampleView, sampling: Sampling, nearest: float) -> np.ndarray:
    """Compute the light that a perfectly reflecting surface would scatter to each entry, (90, 90, 180).

    nearest: distance from the highlight, px, within which its light is spread; a halo adds a share of that light there.

    A Gaussian of std s adds flux exp(-d^2 / 2 s^2) / (2 pi s^2) at distance d. Its maximum over s is flux / (pi e d^2).
    """
    grid = merl_grid(sampling)
    th, td, ph = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d
    # the position of each cell on the lamp's side represents both positions, whose distances from the highlight are similar
    x, y = view.from_highlight(th, td, ph)
    distance2 = np.maximum(x**2 + y**2, nearest**2)
    # integral of D over normals is about 1: flux = F r^2 / 4 of a distant rig
    cos_i = np.maximum(np.cos(th) * np.cos(td) - np.sin(th) * np.sin(td) * np.abs(np.cos(ph)), 0.05)
    flux = view.highlight_area(grid.theta_d)[:, None] / 4 / view.irradiance(cos_i)
    return flux / (np.pi * np.e * distance2 * cos_i)
