"""One table for all examples: polished chromium as the rig of the MERL database records it, with 1 % noise a pixel.

The values lie in `data/chromium.npz`, made by `data/make_chromium.py` with code that shares nothing with matcam. To be
small, it holds 13 of the 90 slices, and one cell of each pixel: what a fit uses. All else is missing (NaN).
"""

from pathlib import Path

import numpy as np
import xarray as xr

import matcam

ALPHA = 0.004  # the true roughness
WAVELENGTHS = [610e-9, 550e-9, 465e-9]  # m, of R, G, B
EVERY = 6  # the slices that it holds


def recorded() -> xr.DataArray:
    """Return the recorded table, 1/sr."""
    held = np.load(Path(__file__).parent / "data" / "chromium.npz")
    whole = matcam.forward.true_table(matcam.Microfacet(matcam.GGX(0.5), [1.0, 1.0, 1.0])).copy()
    whole[:] = np.nan
    slices = np.broadcast_to(held["theta_d"][:, None], held["valid"].shape)
    cells = held["valid"]
    whole.values[held["theta_h"][cells], slices[cells], held["phi_d"][cells]] = held["value"][cells]
    return whole
