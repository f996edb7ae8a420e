"""Largest contribution of scattered light (glare) from a highlight to each entry of a table."""

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
"""Smallest distance of glare from the highlight, px. Light that is scattered less far belongs to the kernel in the profile of
the lens.
"""
_VIEWS = 2
"""Number of views whose scattered light is stored in memory, 12 MB each."""


class FarthestGlare(NamedTuple):
    """Largest contribution of glare from the highlight to each entry of a table, for a share of glare of 1.

    The glare is a halo of any radius that contains a given share of the light of the highlight.

    Attributes:
        strength: Fresnel term F of each slice (no unit), (90, channels).
        of_mirror: contribution for F = 1 and a share of 1, 1/sr, (90, 90, 180).
    """

    strength: np.ndarray
    of_mirror: np.ndarray

    def of(self, rows: slice) -> np.ndarray:
        """Compute the contribution of glare in some rows of the table, 1/sr, (rows, 90, 180, channels)."""
        return self.strength[:, None] * self.of_mirror[rows, ..., None]


def farthest_glare(sampling: Sampling, rig: Rig, found: MaterialFit, workspace: Workspace) -> FarthestGlare:
    """Compute the largest contribution of glare from the highlight to each entry of a table.

    Args:
        sampling: sampling of the table.
        rig: rig that recorded the table.
        found: fit of the table, which determines F and the width of the highlight.
        workspace: store of results that depend only on the rig.
    """
    strength = found.curves["fresnel"].values
    there = np.isfinite(strength).all(axis=1)
    if not there.any():
        raise FitError("no slice of theta_d has a highlight in every channel: check that the table is complete")
    theta_d, seen = merl_grid(sampling).theta_d, found.theta_d[there]
    f = np.stack([np.interp(theta_d, seen, column[there]) for column in strength.T], axis=-1)
    view = sample_view(rig)
    width = min(found.hwhm, 1.0) * view.radius if np.isfinite(found.hwhm) else view.radius
    nearest = max(_NEAREST, width)
    key = view, sampling, nearest
    return FarthestGlare(
        f, workspace.remember("farthest glare", key, lambda: _of_mirror(view, sampling, nearest), most=_VIEWS)
    )


def _of_mirror(view: SampleView, sampling: Sampling, nearest: float) -> np.ndarray:
    """Compute the largest contribution of glare for F = 1 and a share of 1, 1/sr, (90, 90, 180).

    A Gaussian halo of standard deviation s adds flux exp(-d^2 / 2 s^2) / (2 pi s^2) at distance d from the highlight, where
    flux is the integral of the highlight over the sensor. The maximum over s is flux / (pi e d^2).

    nearest: smallest distance d, px. Cells at smaller distances have the contribution at this distance.
    """
    grid = merl_grid(sampling)
    th, td, ph = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d
    # the position of a cell on the side of the lamp represents both positions; their distances from the highlight are similar
    x, y = view.from_highlight(th, td, ph)
    distance2 = np.maximum(x**2 + y**2, nearest**2)
    # the integral of D over normals is about 1, so flux = F r^2 / 4 for a distant rig
    cos_i = np.maximum(np.cos(th) * np.cos(td) - np.sin(th) * np.sin(td) * np.abs(np.cos(ph)), 0.05)
    flux = view.highlight_area(grid.theta_d)[:, None] / 4 / view.irradiance(cos_i)
    return flux / (np.pi * np.e * distance2 * cos_i)
