"""BSDF Data Interchange files of Zemax OpticStudio (.bsdf): text, of which reflection that is symmetric to a plane is read.

    Symmetry PlaneSymmetrical          SpectralContent Monochrome, or XYZ           ScatterType BRDF
    SampleRotation 1 / 0               AngleOfIncidence 3 / 0 30 60                 ScatterAzimuth 19 / 0 10 ... 180
    ScatterRadial 11 / 0 5 ... 80      Monochrome DataBegin
    then of each angle of incidence a total (TIS) and one row an azimuth

Directions of view are given about the mirror direction: radial is the angle from it, azimuth 0 points to the surface normal.
RGL's files have the same suffix; content tells them apart.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import xarray as xr

from matcam.core.errors import FileFormatError
from matcam.core.grid import half_and_difference
from matcam.core.io import reading
from matcam.files.samples import samples_from

_LARGEST = 256 << 20
"""Bytes of a file; a thousand times a measurement of one wavelength."""
_AXES = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
_CHANNELS = {"Monochrome": "Y", "TristimulusX": "X", "TristimulusY": "Y", "TristimulusZ": "Z"}
_MOST = 100_000
"""Angles along one axis, at most: more are damage."""


def read_zemax(path: str | Path) -> xr.DataArray:
    """Read a BRDF in Zemax's BSDF Data Interchange format.

    Args:
        path: file to read (.bsdf).

    Returns:
        Values in 1/sr of all directions above the surface, dims (sample, channel), channels Y, or X, Y and Z. Coordinates
        theta_h, theta_d and phi_d are in rad.

    Raises:
        FileFormatError: the file is damaged, holds transmission, or a sample without plane symmetry.

    Source:
        Zemax OpticStudio, BSDF Data Interchange file format specification.

    Example:
        >>> matcam.io.read_zemax("no-such-file.bsdf")
        Traceback (most recent call last):
        matcam.core.errors.FileFormatError: no-such-file.bsdf: no such file
    """
    path = Path(path)
    with reading(path, "a BSDF of Zemax"):
        if path.stat().st_size > _LARGEST:
            raise FileFormatError(f"{path}: {path.stat().st_size} bytes is too large for a BSDF of Zemax")
        text = path.read_text(encoding="latin-1")
    words = re.sub(r"#[^\n]*", "", text).split()
    settings, axes, start = _head(path, words)
    for key, allowed in (
        ("Symmetry", ("PlaneSymmetrical",)),
        ("ScatterType", ("BRDF",)),
        ("SpectralContent", ("Monochrome", "XYZ")),
    ):
        if settings.get(key) not in allowed:
            found = settings.get(key, "nothing")
            raise FileFormatError(f"{path}: {key} {found} is not read: it must be {' or '.join(allowed)}")
    if len(axes["SampleRotation"]) > 1:
        raise FileFormatError(
            f"{path}: has {len(axes['SampleRotation'])} sample rotations: one is read, of isotropic samples"
        )
    incidence, azimuth, radial = (np.radians(axes[name]) for name in _AXES[1:])
    names, values = _blocks(path, words[start:], (len(incidence), len(azimuth), len(radial)))
    theta_i, phi, r = np.meshgrid(incidence, azimuth, radial, indexing="ij")
    # about the mirror direction, then tilted by the angle of incidence; the light stands at azimuth 0
    x, y, z = np.sin(r) * np.cos(phi), np.sin(r) * np.sin(phi), np.cos(r)
    x, z = x * np.cos(theta_i) - z * np.sin(theta_i), x * np.sin(theta_i) + z * np.cos(theta_i)
    above = (z > 1e-6) & (theta_i < np.pi / 2)
    # at radial 0 all azimuths are one direction
    above &= (r > 0) | (phi == phi[:, :1])
    directions = (
        theta_i[above],
        np.zeros(above.sum()),
        np.arccos(np.clip(z[above], -1, 1)),
        np.arctan2(y[above], x[above]),
    )
    half = [np.asarray(one) for one in half_and_difference(*directions)]
    return samples_from(values[:, above].T, half, names).assign_attrs(source=path.name)


def _head(path: Path, words: list[str]) -> tuple[dict[str, str], dict[str, np.ndarray], int]:
    """Read settings and axes up to the first block of data; also its index among the words."""
    settings: dict[str, str] = {}
    axes: dict[str, np.ndarray] = {"SampleRotation": np.zeros(1)}
    at = 0
    while at + 1 < len(words):
        key = words[at]
        if key in _CHANNELS and words[at + 1] == "DataBegin":
            break
        if key in _AXES:
            try:
                count = int(words[at + 1])
                axes[key] = np.array([float(word) for word in words[at + 2 : at + 2 + count]])
            except ValueError:
                count = -1
            if not 0 < count <= _MOST or len(axes.get(key, ())) != count or not np.isfinite(axes[key]).all():
                raise FileFormatError(f"{path}: {key} must be a count and as many angles in degrees")
            at += 2 + count
        elif key in ("Source", "Symmetry", "SpectralContent", "ScatterType"):
            settings[key] = words[at + 1]
            at += 2
        else:
            at += 1
    missing = [name for name in _AXES if name not in axes]
    if missing or at + 1 >= len(words):
        raise FileFormatError(f"{path}: is no whole BSDF of Zemax: it lacks {', '.join(missing) or 'its data'}")
    return settings, axes, at


def _blocks(path: Path, words: list[str], shape: tuple[int, int, int]) -> tuple[list[str], np.ndarray]:
    """Read the values of every channel, (channels, incidence, azimuth, radial)."""
    size = shape[1] * shape[2]
    names: list[str] = []
    blocks: list[np.ndarray] = []
    at = 0
    while at < len(words):
        key = words[at]
        if key in _CHANNELS:
            names.append(_CHANNELS[key])
        elif key == "TIS":
            try:
                values = np.array([float(word) for word in words[at + 2 : at + 2 + size]])
            except ValueError:
                values = np.zeros(0)
            if len(values) != size or not np.isfinite(values).all() or (values < 0).any():
                raise FileFormatError(
                    f"{path}: block {len(blocks) + 1} must hold {shape[1]} rows of {shape[2]} values, 0 or more"
                )
            blocks.append(values)
            at += 1 + size
        at += 1
    if len(blocks) != shape[0] * len(names) or len(set(names)) != len(names):
        raise FileFormatError(
            f"{path}: has {len(blocks)} blocks of values; {shape[0]} angles of incidence need as many a channel"
        )
    return names, np.array(blocks).reshape(len(names), *shape)
