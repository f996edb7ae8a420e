"""Anisotropic BRDFs of the UTIA database (.bin): 3 x 288 x 288 float64, channel, light, view.

Light and view each have 6 angles to the normal (0, 15, ... 75 degrees), and 48 azimuths (0, 7.5, ... degrees) per angle.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from matcam.core.grid import CHANNELS
from matcam.core.readers.apart import read_apart
from matcam.core.results.labelled import named
from matcam.files.table_decoders import UTIA_SHAPE


def read_utia(path: str | Path) -> xr.Dataset:
    """Read an anisotropic BRDF of the UTIA database.

    Args:
        path: file to read (.bin).

    Returns:
        Dataset with `brdf` as in the file, 1/sr, dims (theta_i, phi_i, theta_o, phi_o, channel), angles in rad. The
        values cannot be converted to a table, because steps of 15 degrees do not resolve a highlight.

    Raises:
        FileFormatError: the file is missing, has a wrong size, or contains non-finite values.

    Source:
        Filip and Vavra (2014), *Template-Based Sampling of Anisotropic BRDFs*.

    Example:
        >>> import pathlib, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "a.bin")
        ...     _ = path.write_bytes(np.full(3 * 288 * 288, 0.2).tobytes())
        ...     matcam.io.read_utia(path)["brdf"].shape
        (6, 48, 6, 48, 3)
    """
    path = Path(path)
    values = read_apart("matcam.files.table_decoders:decode_utia", path, "a BRDF of UTIA")
    polar, azimuth = np.arange(UTIA_SHAPE[1]) * np.radians(15.0), np.arange(UTIA_SHAPE[2]) * 2 * np.pi / UTIA_SHAPE[2]
    dims = ("theta_i", "phi_i", "theta_o", "phi_o", "channel")
    angles = {name: (name, polar if "theta" in name else azimuth, {"units": "rad"}) for name in dims[:4]}
    brdf = (dims, np.moveaxis(values, 0, -1), {"units": "1/sr"})
    data = xr.Dataset({"brdf": brdf}, coords={**angles, "channel": list(CHANNELS)}, attrs={"source": path.name})
    return named(
        data,
        {
            "brdf": "BRDF [1/sr]",
            "theta_i": "angle between light and normal [rad]",
            "phi_i": "azimuth of the light [rad]",
            "theta_o": "angle between view and normal [rad]",
            "phi_o": "azimuth of the view [rad]",
        },
    )
