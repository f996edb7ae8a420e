"""Universal BRDF data format (JSON) of the metrology institutes (EMPIR 16NRM08 BiRD, schemas of version 1.0).

A document has "metadata" (laboratory, sample, instrument) and "data": arrays of equal length with units, one entry per
reading. The arrays are BRDF and the angles of light (theta_i, phi_i) and view (theta_r, phi_r). Optional arrays are the
uncertainty uBRDF, wavelength_i, polarization_i and others.

The reader arranges readings of one pair of directions as channels. A channel has one wavelength, polarisation and name.
If every channel is named by its wavelength ("550 nm"), the writer stores the wavelengths. Otherwise it stores the names of
several channels in the ad hoc variable "channel". It does not store another name of a single channel.
"""

from __future__ import annotations

import json
import math
import uuid
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import azimuth_difference, cosines, half_and_difference
from matcam.core.io import write_json
from matcam.core.readers.texts import read_json
from matcam.files.samples import checked_samples, samples_from

SCHEMA = "urn:bird-project:brdf_json_schema_v1.0"
"""Name of the schema, which the format requires in its documents."""
_ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")
_MOST = 2_000_000
"""Largest number of readings that are written; each takes about 100 bytes."""
_NOT_STATED = "not stated"


def read_bird(path: str | Path) -> xr.DataArray:
    r"""Read BRDF readings from a BiRD JSON file.

    Args:
        path: file to read (.brdf, .json).

    Returns:
        Values in 1/sr, dims (sample, channel), NaN where a channel has no reading of a pair of directions. Coordinates
        theta_h, theta_d and phi_d are in rad. Channels are named by wavelength, polarisation and ad hoc channel ("550
        nm s"), or "BRDF" if the file has none of these.

    Raises:
        FileFormatError: the file is missing or not a BiRD document, an array has a wrong length, unit or value, or
            several readings have the same directions and channel.

    Example:
        >>> import tempfile, pathlib
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     text = pathlib.Path(folder, "a.csv")
        ...     _ = text.write_text("theta_h_deg,theta_d_deg,phi_d_deg,Y_per_sr\n0,30,90,0.25\n")
        ...     path = pathlib.Path(folder, "a.brdf")
        ...     matcam.io.write_bird(path, matcam.io.read_samples(text))
        ...     matcam.io.read_bird(path).values
        array([[0.25]])
    """
    path = Path(path)
    document = read_json(path, "a BRDF in BiRD's format")
    data = document.get("data") if isinstance(document, dict) else None
    if not isinstance(data, dict):
        raise FileFormatError(
            f'{path}: the file has no object "data", which BiRD\'s format requires: give a BRDF in this format'
        )
    angles = [_column(path, data, name, {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180}) for name in _ANGLES]
    values = _column(path, data, "BRDF", dict.fromkeys(("1/sr", "sr^-1"), 1.0))
    for name, angle in zip(_ANGLES, angles, strict=True):
        if len(angle) != len(values):
            raise FileFormatError(
                f"{path}: data.{name} has {len(angle)} values, but data.BRDF has {len(values)}: give one angle for each value"
            )
        if name.startswith("theta") and not ((angle >= 0) & (angle <= math.pi / 2 + 1e-6)).all():
            raise FileFormatError(f"{path}: data.{name} must lie in [0, 90] degrees")
    channel = _channels(path, data, len(values))
    names = list(dict.fromkeys(channel))
    if max(map(len, names)) > 60:  # as in CSV; each name takes as much memory as the longest
        raise FileFormatError(f"{path}: the name of a channel must have at most 60 characters")
    pairs = np.stack([np.mod(a, 2 * np.pi) for a in angles], axis=1).round(9)
    unique, first, position = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))  # pairs of directions in the order of the file
    # At most 1000 cells of the resulting table per reading are accepted. The table grows with the square of the number of
    # readings if each reading has its own pair of directions and its own channel. The 50,000 readings of the largest
    # document then take 400 MB.
    if len(unique) * len(names) > 1000 * len(values):
        raise FileFormatError(
            f"{path}: {len(values)} readings are too few for {len(unique)} pairs of directions in {len(names)} channels: "
            "store the channels in separate files"
        )
    table = np.full((len(unique), len(names)), np.nan)
    number = {name: k for k, name in enumerate(names)}
    column = np.array([number[one] for one in channel])
    row = order[position.reshape(-1)]
    if len(set(zip(row.tolist(), column.tolist(), strict=True))) < len(values):
        raise FileFormatError(
            f"{path}: several readings have the same pair of directions and the same channel: keep one of them"
        )
    table[row, column] = values
    kept = [a[np.sort(first)] for a in angles]
    return samples_from(table, [np.asarray(a) for a in half_and_difference(*kept)], names).assign_attrs(
        source=path.name
    )


def write_bird(path: str | Path, samples: xr.DataArray, *, force: bool = False) -> None:
    r"""Write BRDF samples as a BiRD JSON file.

    Required fields that the samples do not contain, such as the laboratory, are written as "not stated".

    Args:
        path: file to write (.brdf).
        samples: values in 1/sr, such as those returned by `read_samples`, dims (sample, channel), with
            coordinates theta_h, theta_d, phi_d in rad.
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: `samples` has wrong dims, units or labels, or more than two million values.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile, pathlib
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     text = pathlib.Path(folder, "a.csv")
        ...     _ = text.write_text("theta_h_deg,theta_d_deg,phi_d_deg,Y_per_sr\n0,30,90,0.25\n")
        ...     matcam.io.write_bird(pathlib.Path(folder, "a.brdf"), matcam.io.read_samples(text))
    """
    samples = checked_samples(samples)
    known = np.isfinite(samples.values)
    if known.sum() > _MOST:
        raise ArgumentError(
            f"samples have {known.sum()} values, but at most {_MOST} are written as JSON: use .nc or .csv"
        )
    half = [np.asarray(samples[name].values, np.float64) for name in ("theta_h", "theta_d", "phi_d")]
    theta_i, theta_r = (np.arccos(np.clip(np.asarray(one), 0, 1)) for one in cosines(*half))
    phi_r = np.asarray(azimuth_difference(*half)) * np.where(np.sin(half[2]) >= 0, -1.0, 1.0)
    row, column = np.nonzero(known)
    largest = 90 - 1e-9  # the schema excludes 90 degrees
    degrees = {
        "theta_i": np.minimum(np.degrees(theta_i), largest),
        "phi_i": np.zeros(len(theta_i)),
        "theta_r": np.minimum(np.degrees(theta_r), largest),
        "phi_r": np.mod(np.degrees(phi_r), 360.0),
    }
    data: dict[str, Any] = {name: {"unit": "°", "values": angle[row].tolist()} for name, angle in degrees.items()}
    data["BRDF"] = {"unit": "1/sr", "values": samples.values[row, column].tolist()}
    names = [str(name) for name in samples["channel"].values]
    lengths = [_wavelength(name) for name in names]
    if all(one is not None for one in lengths):
        data["wavelength_i"] = {"unit": "nm", "values": [lengths[k] for k in column]}
    elif len(names) > 1:
        about = {"description": "Colour channel of the reading.", "unit": "NA", "type": "string"}
        data["adhoc_variables"] = {"channel": {**about, "values": [names[k] for k in column]}}
    write_json(path, {"metadata": _metadata(samples, data), "data": data}, force=force)


def _column(path: Path, data: dict[str, Any], name: str, units: dict[str, float]) -> np.ndarray:
    one = data.get(name)
    if not isinstance(one, dict) or "values" not in one:
        raise FileFormatError(f"{path}: data.{name} is missing, or has no list of values: add unit and values")
    if not isinstance(one.get("unit"), str) or one["unit"] not in units:
        raise FileFormatError(
            f"{path}: data.{name}.unit must be one of {', '.join(units)}, got {one.get('unit')!r:.40}"
        )
    try:
        values = np.asarray(one["values"])
    except ValueError:  # rows of different lengths
        values = np.empty((1, 1))
    if values.dtype.kind not in "iuf" or values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise FileFormatError(f"{path}: data.{name}.values must be a list of one or more finite numbers")
    return values * units[one["unit"]]


def _channels(path: Path, data: dict[str, Any], count: int) -> list[str]:
    parts: list[list[str]] = []
    nano = {"nm": 1.0, "μm": 1e3, "µm": 1e3, "um": 1e3}
    if "wavelength_i" in data:
        parts.append([f"{one:g} nm" for one in _column(path, data, "wavelength_i", nano)])
    for name in ("polarization_i", "polarization_r"):
        states = data.get(name, {}).get("values") if isinstance(data.get(name, {}), dict) else None
        if isinstance(states, list):
            parts.append([f"{name[-1]}:{json.dumps(one)}" if isinstance(one, list) else str(one) for one in states])
    own = data.get("adhoc_variables")
    own = own.get("channel") if isinstance(own, dict) else None
    if isinstance(own, dict) and isinstance(own.get("values"), list):
        parts.append([str(one) for one in own["values"]])
    if any(len(part) != count for part in parts):
        raise FileFormatError(
            f"{path}: wavelengths, polarisations and channels must have {count} values each, as many as data.BRDF"
        )
    return [" ".join(one) for one in zip(*parts, strict=True)] if parts else ["BRDF"] * count


def _wavelength(name: str) -> float | None:
    number, _, unit = name.partition(" ")
    try:
        return float(number) if unit == "nm" else None
    except ValueError:
        return None


def _metadata(samples: xr.DataArray, data: dict[str, Any]) -> dict[str, Any]:
    address = dict.fromkeys(("country", "city", "street", "building_nr", "postal_code"), _NOT_STATED)
    person = {"organization": _NOT_STATED, "location": address, "email": "not@stated", "contact_person": _NOT_STATED}
    version = metadata.version("matcam")
    return {
        "schema": SCHEMA,
        "id": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(data))}",
        "type": "BRDF",
        "timestamp": datetime.now(UTC).isoformat(timespec="seconds"),
        "provenance": person,
        "description": f"BRDF from {samples.attrs.get('source', 'a file')}, converted by matcam {version}",
        "method": "measurement",
        "instrumentation": "NA",
        "software": {"name": "matcam", "version": version},
        "sample": {
            "name": str(samples.attrs.get("source", _NOT_STATED)),
            "type": _NOT_STATED,
            "dimensions": {},
            "shape": _NOT_STATED,
            "zero_azimuth_location": "plane of incidence",
        },
        "environment": "NA",
    }
