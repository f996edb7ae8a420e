"""Decoder of Zemax's BSDF Data Interchange files, which runs in a separate process (core/readers/apart.py).

zemax.py describes the format. This file imports neither xarray nor JAX, so that the process starts quickly.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core.errors import FileFormatError

AXES = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
_CHANNELS = {"Monochrome": "Y", "TristimulusX": "X", "TristimulusY": "Y", "TristimulusZ": "Z"}


def decode_zemax(path: Path) -> dict[str, Any]:
    """Decode a BSDF file of Zemax.

    The result has the angles of each axis (degrees), the names of the channels, and `values` (1/sr) of shape (channels,
    incidence, azimuth, radial).
    """
    # the limit is a thousand times the size of a measurement at one wavelength
    size, largest = path.stat().st_size, 256 << 20
    if size > largest:
        raise FileFormatError(
            f"{path}: the file has {size} bytes, but at most {largest} are allowed for a BSDF of Zemax: give a "
            "smaller file"
        )
    words = re.sub(r"#[^\n]*", "", path.read_text(encoding="latin-1")).split()
    settings, axes, start = _head(path, words)
    for key, allowed in (
        ("Symmetry", ("PlaneSymmetrical",)),
        ("ScatterType", ("BRDF",)),
        ("SpectralContent", ("Monochrome", "XYZ")),
    ):
        if settings.get(key) not in allowed:
            found = settings.get(key, "nothing")
            raise FileFormatError(f"{path}: {key} must be {' or '.join(allowed)}, got {found}")
    if len(axes["SampleRotation"]) > 1:
        raise FileFormatError(
            f"{path}: the file has {len(axes['SampleRotation'])} sample rotations, but only isotropic samples "
            "with one rotation are supported"
        )
    shape = (len(axes["AngleOfIncidence"]), len(axes["ScatterAzimuth"]), len(axes["ScatterRadial"]))
    names, values = _blocks(path, words[start:], shape)
    return {**axes, "names": names, "values": values}


def _head(path: Path, words: list[str]) -> tuple[dict[str, str], dict[str, np.ndarray], int]:
    settings: dict[str, str] = {}
    axes: dict[str, np.ndarray] = {"SampleRotation": np.zeros(1)}
    at = 0
    while at + 1 < len(words):
        key = words[at]
        if key in _CHANNELS and words[at + 1] == "DataBegin":
            break
        if key in AXES:
            try:
                count = int(words[at + 1])
                axes[key] = np.array([float(word) for word in words[at + 2 : at + 2 + count]])
            except ValueError:
                count = -1
            # more than 100,000 angles along one axis indicate damage
            if not 0 < count <= 100_000 or len(axes.get(key, ())) != count or not np.isfinite(axes[key]).all():
                raise FileFormatError(f"{path}: {key} must have a count, followed by as many angles in degrees")
            at += 2 + count
        elif key in ("Source", "Symmetry", "SpectralContent", "ScatterType"):
            settings[key] = words[at + 1]
            at += 2
        else:
            at += 1
    missing = [name for name in AXES if name not in axes]
    if missing or at + 1 >= len(words):
        raise FileFormatError(
            f"{path}: the file is not a complete BSDF of Zemax: it lacks {', '.join(missing) or 'its data'}"
        )
    return settings, axes, at


def _blocks(path: Path, words: list[str], shape: tuple[int, int, int]) -> tuple[list[str], np.ndarray]:
    """Parse the names of the channels and their values, (channels, incidence, azimuth, radial)."""
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
                    f"{path}: block {len(blocks) + 1} must have {shape[1]} rows of {shape[2]} non-negative values"
                )
            blocks.append(values)
            at += 1 + size
        at += 1
    if len(blocks) != shape[0] * len(names) or len(set(names)) != len(names):
        raise FileFormatError(
            f"{path}: the file has {len(blocks)} blocks of values, but each channel must occur once, with one block for each "
            f"of the {shape[0]} angles of incidence"
        )
    return names, np.array(blocks).reshape(len(names), *shape)
