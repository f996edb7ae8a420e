"""Difference between a Lambertian body and a diffuse body under a dielectric surface.

A correction assumes a Lambertian body under the lobe. The light of a body under a dielectric surface passes this surface twice,
so its BRDF has the factor (1 - F(theta_i)) (1 - F(theta_o)) (Shirley et al. 1997; Burley 2012, 5.3). The data rarely
distinguish the two bodies under a lobe. Their difference is therefore included in the uncertainty of a correction.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from matcam.core.grid import Sampling, merl_grid
from matcam.inverse.correction.response_lattice import seen_cells


@cache
def other_body(sampling: Sampling) -> np.ndarray:
    """Compute the relative difference of a dielectric body from a Lambertian body.

    The bodies have the same mean over the corrected entries. Returns: absolute difference (no unit), (90, 90, 180).
    """
    grid = merl_grid(sampling)
    th, td, ph = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d
    mean, half = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(ph)
    # Schlick's F: 1 - F = (1 - f0) (1 - (1 - cos)^5); the factor 1 - f0 cancels in the relative difference
    passed = np.prod([1 - (1 - np.clip(cos, 0, 1)) ** 5 for cos in (mean - half, mean + half)], axis=0)
    return np.abs(passed / passed[seen_cells(sampling)].mean() - 1)
