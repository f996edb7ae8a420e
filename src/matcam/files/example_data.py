"""Example table for the tutorials: simulated record of polished chromium by the rig of the MERL database."""

from __future__ import annotations

from importlib import resources

import numpy as np
import xarray as xr

from matcam.core.grid import CHANNELS, GRID_SHAPE, brdf_table


def example_table() -> xr.DataArray:
    """Load a simulated record of a polished chromium sphere.

    The lobe is GGX of roughness alpha 0.004. The rig is that of the MERL database: a Gaussian lens with a standard
    deviation of 0.5 px, square pixels of full fill factor, and a sphere with a radius of 256 px. The standard deviation
    of the noise of a pixel is 1 %. An independent program, which uses no code of matcam, computed the values
    (`examples/make_chromium.py` in the sources). The table contains the cells that a fit uses: in 13 of the 90 slices
    of theta_d, one cell for each pixel. All other cells are missing.

    Returns:
        BRDF on the MERL grid, (90, 90, 180, 3), 1/sr; missing values are NaN.

    Example:
        >>> table = matcam.io.example_table()
        >>> table.shape, table.attrs["sample"]
        ((90, 90, 180, 3), 'sphere')
    """
    with (
        resources.files("matcam").joinpath("data/chromium.npz").open("rb") as file,
        np.load(file, allow_pickle=False) as stored,
    ):
        cells, slices = stored["valid"], np.broadcast_to(stored["theta_d"][:, None], stored["valid"].shape)
        values = np.full((*GRID_SHAPE, len(CHANNELS)), np.nan)
        values[stored["theta_h"][cells], slices[cells], stored["phi_d"][cells]] = stored["value"][cells]
    return brdf_table(values, "centre", sample="sphere", source="simulated polished chromium")
