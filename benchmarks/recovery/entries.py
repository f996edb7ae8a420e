"""Entries of the benchmark: a folder of tables, one for each case.

NAME.nc holds `brdf` and may hold `brdf_std` and `supported` (NetCDF-4). NAME.binary is a MERL file; NAME.std.binary may be
beside it. NAME is that of a case. entry.json may state the name of the method and, for each case, seconds and mebibytes.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H

import matcam
from matcam.core.errors import MatcamError
from matcam.core.readers.texts import read_json

SHAPE = (90, 90, 180, 3)
DIMS = ("theta_h", "theta_d", "phi_d", "channel")
GRID = {"theta_h": THETA_H, "theta_d": THETA_D, "phi_d": PHI_D}


class EntryError(Exception):
    """Fault of an entry, in one line: file, what is wrong, what to do."""


class Answer(NamedTuple):
    """Recovered table, its standard deviation and support, (90, 90, 180, 3); None: not stated."""

    value: np.ndarray
    std: np.ndarray | None = None
    supported: np.ndarray | None = None


class Entry(NamedTuple):
    """An entry: name of the method, file of each case, and stated costs {case: value}."""

    name: str
    files: dict
    seconds: dict
    memory: dict


def find(folder, names):
    """Entry in a folder. names: of the cases.

    Raises EntryError where the folder, a file name or entry.json is wrong.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise EntryError(f"{_shown(folder)}: no such folder")
    files = {}
    for path in sorted(folder.iterdir()):
        if path.name == "entry.json" or path.name.endswith(".std.binary"):
            continue
        if path.suffix not in (".nc", ".binary"):
            raise EntryError(f"{_shown(path)}: an entry holds .nc and .binary files and entry.json; remove this file")
        if path.stem not in names:
            raise EntryError(
                f"{_shown(path)}: no case has this name; rename the file to one of {', '.join(list(names)[:3])}, ..."
            )
        if path.stem in files:
            raise EntryError(f"{_shown(path)}: {files[path.stem].name} is there, too; keep one of them")
        if not path.is_file():
            raise EntryError(f"{_shown(path)}: not a regular file")
        files[path.stem] = path
    if not files:
        raise EntryError(f"{_shown(folder)}: no tables; name them as the cases, such as {next(iter(names))}.nc")
    document = _document(folder / "entry.json")
    return Entry(
        document.get("name", folder.resolve().name),
        files,
        _costs(folder, document, "seconds", names),
        _costs(folder, document, "memory_mib", names),
    )


def read(path):
    """Answer in a file of an entry. Raises EntryError where it is wrong."""
    path = Path(path)
    try:
        return _read_netcdf(path) if path.suffix == ".nc" else _read_merl(path)
    except MatcamError as error:
        raise EntryError(" ".join(str(error).split())) from None


def _read_merl(path):
    value = matcam.read_merl(path).values
    beside = path.with_name(f"{path.stem}.std.binary")
    if not beside.exists():
        return Answer(value)
    if not beside.is_file():
        raise EntryError(f"{_shown(beside)}: not a regular file")
    return Answer(value, matcam.read_merl(beside).values)


def _read_netcdf(path):
    data = matcam.io.read_netcdf(path)
    if "brdf" not in data:
        raise EntryError(f"{_shown(path)}: no variable brdf; name the table so")
    value = _array(path, data, "brdf")
    std = _array(path, data, "brdf_std") if "brdf_std" in data else None
    if std is not None and np.nanmin(std, initial=0.0) < 0:
        raise EntryError(f"{_shown(path)}: brdf_std is negative; a standard deviation that is not known is NaN")
    supported = _array(path, data, "supported") > 0 if "supported" in data else None
    return Answer(value, std, supported)


def _array(path, data, name):
    one = data[name]
    if set(one.dims) != set(DIMS):
        raise EntryError(
            f"{_shown(path)}: {name} must have the dimensions {', '.join(DIMS)}, got {_shown(', '.join(map(str, one.dims)))}"
        )
    one = one.transpose(*DIMS)
    if one.shape != SHAPE:
        raise EntryError(f"{_shown(path)}: {name} must have shape {SHAPE}, got {one.shape}")
    if one.dtype.kind not in "fiub":
        raise EntryError(f"{_shown(path)}: {name} must hold real numbers, got {one.dtype}")
    for axis, expected in GRID.items():
        if axis in one.coords and not (
            one.coords[axis].dtype.kind == "f" and np.allclose(one.coords[axis], expected, rtol=0, atol=1e-6)
        ):
            raise EntryError(
                f"{_shown(path)}: {axis} must be that of the MERL grid at the centres of cells, rad; or leave it out"
            )
    if one.attrs.get("units", "1/sr") not in ("1/sr", "sr-1", "sr^-1") and name != "supported":
        raise EntryError(f"{_shown(path)}: {name} must be in 1/sr, got {_shown(str(one.attrs['units']))}")
    values = np.asarray(one.values, float)
    if np.isinf(values).any():
        raise EntryError(f"{_shown(path)}: {name} holds infinities; a missing value is NaN")
    if not np.isfinite(values).any() and name == "brdf":
        raise EntryError(f"{_shown(path)}: every value of {name} is missing")
    return values


def _document(path):
    if not path.exists():
        return {}
    try:
        document = read_json(path, "an entry")
    except MatcamError as error:
        raise EntryError(" ".join(str(error).split())) from None
    if not isinstance(document, dict):
        raise EntryError(f"{_shown(path)}: must be a JSON object with name, seconds and memory_mib")
    name = document.get("name", "entry")
    if not isinstance(name, str) or not 0 < len(name) <= 60 or not name.isprintable():
        raise EntryError(f"{_shown(path)}: name must be a printable text of 1 to 60 characters")
    return document


def _costs(folder, document, key, names):
    costs = document.get(key, {})
    good = isinstance(costs, dict) and all(
        case in names and isinstance(cost, int | float) and not isinstance(cost, bool) and 0 <= cost < 1e9
        for case, cost in costs.items()
    )
    if not good:
        raise EntryError(f"{_shown(folder / 'entry.json')}: {key} must be an object of cases and numbers >= 0")
    return costs


def _shown(text):
    """One printable line of at most 200 characters."""
    return "".join(c if c.isprintable() else "?" for c in str(text))[-200:]
