"""BSDF Data Interchange files of Zemax OpticStudio (.bsdf). Only reflection with plane symmetry is supported.

    Symmetry PlaneSymmetrical          SpectralContent Monochrome, or XYZ           ScatterType BRDF
    SampleRotation 1 / 0               AngleOfIncidence 3 / 0 30 60                 ScatterAzimuth 19 / 0 10 ... 180
    ScatterRadial 11 / 0 5 ... 80      Monochrome DataBegin
    then, for each angle of incidence, a total (TIS) and one row per azimuth

"/" marks the end of a line. Directions of view are relative to the mirror direction: radial is the angle from the
mirror direction, and azimuth 0 points towards the surface normal. RGL's files have the same suffix and are
distinguished by their content.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from matcam.core.grid import half_and_difference
from matcam.core.readers.apart import read_apart
from matcam.core.readers.texts import SMALL_TEXT
from matcam.files.samples import samples_from
from matcam.files.zemax_decoder import AXES


def read_zemax(path: str | Path) -> xr.DataArray:
    """Read a BRDF in Zemax's BSDF Data Interchange format.

    Args:
        path: file to read (.bsdf).

    Returns:
        Values in 1/sr of all directions above the surface, dims (sample, channel), channels Y, or X, Y and Z.
        Coordinates theta_h, theta_d and phi_d are in rad.

    Raises:
        FileFormatError: the file is missing or damaged, or contains transmission, several sample rotations, or a sample
            without plane symmetry.

    Source:
        Zemax OpticStudio, BSDF Data Interchange file format specification.

    Example:
        >>> matcam.io.read_zemax("no-such-file.bsdf")
        Traceback (most recent call last):
        matcam.core.errors.FileFormatError: no-such-file.bsdf: no such file
    """
    path = Path(path)
    stored = read_apart("matcam.files.zemax_decoder:decode_zemax", path, "a BSDF of Zemax", small=SMALL_TEXT)
    names, values = stored["names"], stored["values"]
    incidence, azimuth, radial = (np.radians(stored[name]) for name in AXES[1:])
    theta_i, phi, r = np.meshgrid(incidence, azimuth, radial, indexing="ij")
    # directions of view about the mirror direction, then tilted by the angle of incidence; the light is at azimuth 0
    x, y, z = np.sin(r) * np.cos(phi), np.sin(r) * np.sin(phi), np.cos(r)
    x, z = x * np.cos(theta_i) - z * np.sin(theta_i), x * np.sin(theta_i) + z * np.cos(theta_i)
    above = (z > 1e-6) & (theta_i < np.pi / 2)
    # at radial 0 all azimuths describe the same direction, which is used once
    above &= (r > 0) | (phi == phi[:, :1])
    directions = (
        theta_i[above],
        np.zeros(above.sum()),
        np.arccos(np.clip(z[above], -1, 1)),
        np.arctan2(y[above], x[above]),
    )
    half = [np.asarray(one) for one in half_and_difference(*directions)]
    return samples_from(values[:, above].T, half, names).assign_attrs(source=path.name)
