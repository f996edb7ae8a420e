"""Opened tables, results, and materials of a run. Each material is read when it is first displayed.

Only paths from the user are read. In the folder of a run, only the files that belong to its records are read. References to
other files are not followed.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from matcam.app.exploring.fitted_pictures import FittedPicture, fitted_pictures, is_capture
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.readers.names import check_within, is_file, is_folder
from matcam.core.readers.texts import read_json


@dataclass(frozen=True)
class OpenedTable:
    """Recorded and corrected table of a material.

    Attributes:
        name: label.
        recorded: recorded table (theta_h, theta_d, phi_d, channel), 1/sr; for a reconstruction the pinhole table. None:
            unknown.
        corrected: corrected table of the same shape, 1/sr; None: missing.
        std: standard deviation of `corrected`, 1/sr, same shape; None: unknown.
        supported: mask of the supported entries of `corrected`, same shape; None: unknown.
        record: record of the material in a run; {}: the material is not from a run.
        curve: Fresnel term over theta_d, from `matcam fresnel`; None: missing.
        pictures: images of a reconstruction, with outlines, highlights and windows; empty for other files.
    """

    name: str
    recorded: xr.DataArray | None = None
    corrected: xr.DataArray | None = None
    std: xr.DataArray | None = None
    supported: xr.DataArray | None = None
    record: dict[str, Any] = field(default_factory=dict)
    curve: xr.Dataset | None = None
    pictures: tuple[FittedPicture, ...] = ()

    @property
    def best(self) -> xr.DataArray | None:
        return self.recorded if self.corrected is None else self.corrected


@dataclass(frozen=True)
class Openable:
    """Material that can be displayed.

    Attributes:
        label: name in a list.
        read: function that reads the material.
    """

    label: str
    read: Callable[[], OpenedTable]


def entries_of(path: Path) -> list[Openable]:
    """List the materials of a path. The files of the materials are not read, except for the records of a run.

    Args:
        path: a file, the folder or the Zarr store of a run, or the folder of a capture, which may contain results.

    Raises:
        FileFormatError: a folder has no records of a run, or a file in it is a link to another folder.
    """
    if not is_folder(path):
        table = path.with_suffix(".nc")
        if path.suffix.lower() == ".json" and is_file(table):  # record and table of one result
            check_within(table, path.parent)
            return [_of_run(table, path)]
        return [Openable(path.name, lambda: read_opened(path))]
    if is_file(path / "zarr.json"):
        return _rows(path)
    found = []
    for record in sorted(path.glob("*.json")):
        table = record.with_suffix(".nc")
        if is_file(table):
            check_within(record, path)
            check_within(table, path)
            found.append(_of_run(table, record))
    if not found and not is_capture(path):  # its photographs belong to a result that is also open
        if is_folder(path / "run.zarr"):
            return _rows(path / "run.zarr")
        raise FileFormatError(
            f"{path}: the folder contains no record of a run (NAME.json with NAME.nc): open a file, or the folder of a run"
        )
    return found


def read_opened(path: Path, record: dict[str, Any] | None = None) -> OpenedTable:
    """Read a file with a material.

    Raises:
        ArgumentError: the content of the file cannot be displayed.
        FileFormatError: the file is damaged, or its format is not supported.
    """
    from matcam.exchange.contents import material_of, read_contents
    from matcam.forward.measurement import true_table

    contents = read_contents(path)
    name = path.name
    result = contents.data
    if contents.content == "table":
        return OpenedTable(name, recorded=result)
    if contents.content == "fields":
        return OpenedTable(name, recorded=true_table(material_of(contents), "centre"))
    of_result = contents.content == "result"
    if of_result and "brdf" in result and result["brdf"].ndim == 4:
        return _of_correction(name, result, record or {})
    if of_result and {"raw", "corrected", "theta_d"} <= set(result.variables):
        return OpenedTable(name, curve=result)
    raise ArgumentError(
        f"{name}: the file contains {contents.kind}, which cannot be shown: open a table, a correction, an RGL "
        "file or a Fresnel term"
    )


def _of_correction(name: str, data: xr.Dataset, record: dict[str, Any]) -> OpenedTable:
    from matcam.core.grid import checked_table
    from matcam.inverse.correction.corrected_table import TABLE_ATTRIBUTES, recorded_table

    try:
        corrected = checked_table(data["brdf"])
        parts = {key: data[key] for key in ("brdf_std", "supported") if key in data}
        if any(part.shape != corrected.shape for part in parts.values()):
            raise ArgumentError("brdf_std and supported must have the same shape as brdf")
        if "pinhole" in data:  # a reconstruction, whose record without blur is shown as recorded
            pinhole = checked_table(data["pinhole"].assign_attrs(corrected.attrs))
            return OpenedTable(
                name, pinhole, corrected, parts.get("brdf_std"), parts.get("supported"), record,
                pictures=tuple(fitted_pictures(name, data)),
            )  # fmt: skip
        if not parts:
            return OpenedTable(name, recorded=corrected, record=record)
        recorded = recorded_table(data) if set(TABLE_ATTRIBUTES) <= set(data.data_vars) else None
    except (ArgumentError, ValueError) as error:  # inconsistent shapes
        raise FileFormatError(f"{name}: the table in the file is damaged: {error}; write the file again") from None
    return OpenedTable(name, recorded, corrected, parts.get("brdf_std"), parts.get("supported"), record)


def _of_run(table: Path, record: Path) -> Openable:
    about = _record(record)
    return Openable(_label(record.stem, about), lambda: read_opened(table, _record(record)))


def _record(path: Path) -> dict[str, Any]:
    # records of more than 4 MiB are not read
    if path.stat().st_size > (4 << 20):
        return {}
    try:
        document = read_json(path, "a material's record")
    except FileFormatError:
        return {}
    return document if isinstance(document, dict) else {}


def _label(name: str, record: dict[str, Any]) -> str:
    fit = record.get("fit")
    params = (
        fit.get("params") if isinstance(fit, dict) else record.get("parameters")
    )  # keys of a run and of a reconstruction
    numbers = (
        {key: one[0] if isinstance(one, list) and one else one for key, one in params.items()}
        if isinstance(params, dict)
        else {}
    )
    widths = {
        key: numbers[key] for key in ("alpha", "beta", "width", "hwhm_rad") if isinstance(numbers.get(key), int | float)
    }
    # an integer may be larger than any float
    width = next((f"{key} {value:.3g}" for key, value in widths.items() if abs(value) < 1e300), "")
    share = record.get("supported_share")
    supported = f"{share:.0%} of its values supported" if isinstance(share, float) and np.isfinite(share) else ""
    return " · ".join(part for part in (name, width, supported) if part)


def _rows(store: Path) -> list[Openable]:
    from matcam.batch.store import read_row, row_names

    def reader(row: int, name: str) -> Callable[[], OpenedTable]:
        return lambda: _of_correction(name, read_row(store, row), {})

    return [Openable(name, reader(row, name)) for row, name in enumerate(row_names(store))]


def parameters(table: OpenedTable) -> str:
    fit = table.record.get("fit")
    return json.dumps(fit, indent=2) if isinstance(fit, dict) else ""
