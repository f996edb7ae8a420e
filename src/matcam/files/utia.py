"""Anisotropic BRDFs of the UTIA database (.bin): 3 x 288 x 288 float64, channel, light, view.

Light and view each run over 6 angles to the normal (0, 15, ... 75 degrees) and, within each, 48 azimuths (0, 7.5, ... degrees).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from matcam.core.errors import FileFormatError
from matcam.core.grid import CHANNELS
from matcam.core.io import reading

_POLAR, _AZIMUTHS = 6, 48
_STEP = np.radians(15.0)
_SHAPE = (len(CHANNELS), _POLAR, _AZIMUTHS, _POLAR, _AZIMUTHS)
SIZE = 8 * int(np.prod(_SHAPE))
"""Bytes of a file: it has no other mark."""


def read_utia(path: str | Path) -> xr.Dataset:
    """Read an anisotropic BRDF of the UTIA database.

    Args:
        path: file to read (.bin).

    Returns:
        Dataset with `brdf` as the file states it, dims (theta_i, phi_i, theta_o, phi_o, channel), angles in rad. The values are
        not resampled: 15 degrees from one angle to the next cannot hold a highlight, so there is no way from here to a table.

    Raises:
        FileFormatError: the file has another size, or holds values that are not finite.

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
    with reading(path, "a BRDF of UTIA"):
        size = path.stat().st_size
        if size != SIZE:
            raise FileFormatError(f"{path}: has {size} bytes; a BRDF of UTIA has {SIZE}")
        values = np.fromfile(path, "<f8").reshape(_SHAPE)
    if not np.isfinite(values).all():
        raise FileFormatError(f"{path}: holds {np.count_nonzero(~np.isfinite(values))} values that are not finite")
    polar, azimuth = np.arange(_POLAR) * _STEP, np.arange(_AZIMUTHS) * 2 * np.pi / _AZIMUTHS
    dims = ("theta_i", "phi_i", "theta_o", "phi_o", "channel")
    angles = {name: (name, polar if "theta" in name else azimuth, {"units": "rad"}) for name in dims[:4]}
    brdf = (dims, np.moveaxis(values, 0, -1), {"units": "1/sr"})
    return xr.Dataset({"brdf": brdf}, coords={**angles, "channel": list(CHANNELS)}, attrs={"source": path.name})
