"""Format-independent reading and writing of files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from matcam.calibration.chart.chart import Chart
from matcam.calibration.chart.chart_file import read_chart, write_chart
from matcam.camera.camera import Camera
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import CORRECTED, DIMS, Sampling, check_recorded, checked_table
from matcam.core.io import check_output
from matcam.files.datasets import read_netcdf
from matcam.files.formats import CONTENTS, MEASUREMENTS, format_for, format_named, identify, suffixes_for
from matcam.files.merl import read_merl
from matcam.files.rgl import check_fields
from matcam.files.samples import checked_samples, samples_of, table_of
from matcam.material.material import Material
from matcam.material.measured import Adaptive, Tabulated


@dataclass(frozen=True)
class Contents:
    """Contents of a file.

    Attributes:
        content: kind of the data, one of `MEASUREMENTS`: "table", a BRDF on the MERL grid; "fields", a BRDF in RGL's
            parameterisation; "samples", a BRDF at other angles; "result", any other labelled data; or "picture", an
            image.
        data: an array for an image; otherwise a DataArray or a Dataset.
        format: short name of the file's format. Default: "", if the data are not from a file.
    """

    content: str
    data: Any
    format: str = ""

    @property
    def table(self) -> xr.DataArray | None:
        return self.data if self.content == "table" else None

    @property
    def brdf(self) -> xr.DataArray | None:
        """BRDF of a table, or in a result; None: there is none."""
        return self.data.get("brdf") if self.content == "result" else self.table

    @property
    def kind(self) -> str:
        brdf = self.brdf
        if brdf is not None and (self.content == "result" or brdf.attrs.get(CORRECTED)):
            return f"a {brdf.attrs.get('long_name', 'BRDF')}"
        return CONTENTS[self.content]


def read(path: str | Path, *, sampling: Sampling = "centre") -> Any:
    """Read a file of any format, recognised by its content.

    Args:
        path: file to read.
        sampling: position in a cell at which its value was sampled, "centre" or "edge" (see `read_merl`). It is used
            only for MERL files, which do not specify this position. Default: "centre".

    Returns:
        The result of the reader of the format: an `xarray.DataArray` for a table or scattered samples, an
        `xarray.Dataset` for RGL's fields or another result, an array (rows, columns, channels) for an image, a `Camera`
        for a camera profile, a `Chart` for a chart's description, or a dict for a picture sidecar.

    Raises:
        FileFormatError: the file is missing or damaged, or its format is not supported.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "picture.exr"
        ...     matcam.io.write_exr(path, np.ones((2, 3, 3)))
        ...     picture = matcam.read(path)
        >>> picture.shape
        (2, 3, 3)
    """
    name = identify(path)
    if name == "camera profile":
        return Camera.load(path)
    if name == "chart":
        return read_chart(path)
    if name == "picture sidecar":
        return format_named(name).read(path)
    return read_contents(path, sampling).data


def write(path: str | Path, thing: Any, *, force: bool = False) -> None:
    """Write an object in the format of the suffix.

    Objects are tables, results, images, cameras and charts. Values are written without resampling (see `convert`).

    Args:
        path: file to write.
        thing: object such as `read` returns, except a sidecar (see `write_sidecar`).
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: the suffix is unknown, or the format does not support the object.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "camera.json"
        ...     matcam.write(path, matcam.rigs.merl().camera)
        ...     matcam.read(path)
        Camera(...)
    """
    if isinstance(thing, Camera | Chart):
        form = format_for(path, *MEASUREMENTS, "camera")
        if form.suffixes != suffixes_for("camera"):
            raise ArgumentError(f"a {type(thing).__name__} cannot be stored in {form.suffixes[0]}: use .json")
        if isinstance(thing, Camera):
            thing.save(path, force=force)
        else:
            write_chart(path, thing, force=force)
        return
    write_contents(path, contents_of(thing), force=force)


def contents_of(thing: Any, name: str = "thing", others: str = "a Camera or a Chart") -> Contents:
    """Wrap a table, RGL's fields, samples, a result or an image as contents.

    An ArgumentError is raised for an object of another type, and for an invalid table, fields or samples. `name` is the name of
    the object in the message of the error, and `others` are the further types that the caller supports.
    """
    if isinstance(thing, Contents):
        return thing
    if isinstance(thing, xr.DataArray):
        if thing.dims == DIMS:
            return Contents("table", checked_table(thing))
        if thing.dims == ("sample", "channel"):
            return Contents("samples", checked_samples(thing))
        return Contents("result", thing.to_dataset(name=thing.name or "values"))
    if isinstance(thing, xr.Dataset):
        return Contents("fields", check_fields(thing)) if "vndf" in thing else Contents("result", thing)
    if isinstance(thing, np.ndarray) or hasattr(thing, "__jax_array__") or type(thing).__module__.startswith("jax"):
        picture = np.asarray(thing)
        if picture.ndim not in (2, 3):
            raise ArgumentError(
                f"{name} must be an image of shape (height, width) or (height, width, channels), got shape {picture.shape}: "
                "give a table as an xarray.DataArray (see read_merl)"
            )
        return Contents("picture", picture)
    raise ArgumentError(
        f"{name} must be an xarray.DataArray or Dataset, an image as an array, {others}, got {type(thing).__name__}"
    )


def write_contents(path: str | Path, contents: Contents, *, force: bool = False) -> None:
    """Write contents in the format of the suffix.

    An ArgumentError is raised if the suffix is unknown, or if the format does not support the contents.
    """
    path = Path(path)
    form = format_for(path)
    writer = form.writer(contents.content)
    check_output(path, force=force)
    data = contents.data
    if form.name == "csv" and contents.content == "table":
        data = samples_of(data)
    elif form.name in ("netcdf", "zarr") and isinstance(data, xr.DataArray):
        data = data.to_dataset(name="brdf" if contents.content == "table" else "samples")
    writer(path, data, force=force)


def read_contents(path: str | Path, sampling: Sampling = "centre") -> Contents:
    """Read a file of any format that contains measurements.

    A FileFormatError is raised for any other file.

    Args:
        path: file to read.
        sampling: position in a cell at which a MERL value was sampled, see `read_merl`. Default: "centre".

    Returns:
        The contents, with the name of the format.
    """
    form = format_named(identify(path))
    if not set(form.holds) & set(MEASUREMENTS):
        kind = "JSON" if ".json" in form.suffixes else form.title
        raise FileFormatError(
            f"{path}: the file is a {kind} document, which contains no measurement: give a file with a BRDF, a result or "
            "an image"
        )
    if form.name == "merl":
        return Contents("table", _read_merl(Path(path), sampling), form.name)
    data = form.read(path)
    if form.name == "csv":
        try:
            return Contents("table", table_of(data), form.name)
        except ArgumentError:
            return Contents("samples", data, form.name)
    if len(form.holds) > 1:
        return _labelled(Path(path), form.name, data)
    return Contents(form.holds[0], data, form.name)


def read_recorded_table(path: str | Path, sampling: Sampling = "centre") -> xr.DataArray:
    """Read a table as `read_table` does.

    An ArgumentError is raised if the table is already corrected.
    """
    table = read_table(path, sampling=sampling)
    check_recorded(table, f"{path}: the table")
    return table


def read_table(path: str | Path, sampling: Sampling = "centre") -> xr.DataArray:
    """Read a BRDF table on the MERL grid from any format.

    Args:
        path: file to read: a MERL or CSV file, or a NetCDF or Zarr file with a table or with the result of `correct`.
        sampling: position in a cell at which a MERL value was sampled, see `read_merl`. In other formats the file
            specifies the position. Default: "centre".

    Returns:
        The table, 1/sr; if the file has the results of a correction, the corrected table.

    Raises:
        FileFormatError: the file contains no table, or is damaged.
    """
    if Path(path).suffix.lower() == ".binary":  # its reader has the most specific error message
        return _read_merl(Path(path), sampling)
    contents = read_contents(path, sampling)
    if contents.table is not None:
        return contents.table
    if contents.content == "result" and "brdf" in contents.data and contents.data["brdf"].dims == DIMS:
        try:
            return checked_table(contents.data["brdf"])
        except ArgumentError as error:
            raise FileFormatError(f"{path}: {error}") from None
    raise FileFormatError(f"{path}: the file contains {contents.kind}, not a BRDF table on the MERL grid")


def _read_merl(path: Path, sampling: Sampling) -> xr.DataArray:
    """Read a MERL file, and mark the table as corrected if the NetCDF file of the same name contains the same correction.

    A MERL file has no attributes. The NetCDF file contains the same correction if the supported values in this file
    equal those of the table.
    """
    table = read_merl(path, sampling=sampling)
    try:
        result = read_netcdf(path.with_suffix(".nc"))
        brdf, supported = result["brdf"], result["supported"].values
    except (FileFormatError, KeyError):
        return table
    corrected = brdf.attrs.get(CORRECTED) and brdf.shape == supported.shape == table.shape and supported.any()
    if corrected and np.allclose(table.values[supported], brdf.values[supported], rtol=1e-5):
        return table.assign_attrs({CORRECTED: 1, "long_name": brdf.attrs.get("long_name", "BRDF")})
    return table


def _labelled(path: Path, name: str, data: xr.Dataset) -> Contents:
    try:
        if "vndf" in data:
            return Contents("fields", check_fields(data), name)
        if "brdf" in data and data["brdf"].dims == DIMS and len(data.data_vars) == 1:
            return Contents("table", checked_table(data["brdf"]), name)
    except ArgumentError as error:
        raise FileFormatError(f"{path}: {error}") from None
    return Contents("result", data, name)


def material_of(contents: Contents) -> Material:
    """Build the material from the contents of a file.

    An ArgumentError is raised if the contents do not define a material.
    """
    if contents.brdf is not None and contents.brdf.dims == DIMS:
        return Tabulated(contents.brdf)
    if contents.content == "fields":
        return Adaptive(contents.data)
    raise ArgumentError(
        f"{contents.kind} cannot be evaluated at arbitrary angles: give a BRDF table on the MERL grid, or an RGL file"
    )
