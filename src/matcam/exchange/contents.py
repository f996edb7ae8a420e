"""What a file holds, whatever its format: a table on the MERL grid, RGL's fields, samples, any other result, or a picture."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.angles import Sampling
from matcam.errors import ArgumentError, FileFormatError
from matcam.files.exr import read_exr
from matcam.files.float_tiff import read_float_tiff
from matcam.files.merl import read_merl
from matcam.files.netcdf import read_netcdf
from matcam.files.recognition import Format, identify
from matcam.files.rgl import check_fields, read_rgl
from matcam.files.samples import read_samples, table_of
from matcam.files.zarr_store import read_zarr
from matcam.material.adaptive import Adaptive
from matcam.material.material import Material
from matcam.material.tabulated import Tabulated
from matcam.table import checked_table


class Contents(NamedTuple):
    """A file's format and what is in it; one of the others is not None."""

    format: Format
    table: xr.DataArray | None = None
    """On the MERL grid."""
    fields: xr.Dataset | None = None
    """RGL's."""
    samples: xr.DataArray | None = None
    """Of a BRDF, off the MERL grid."""
    result: xr.Dataset | None = None
    """Any other labelled result."""
    picture: np.ndarray | None = None

    @property
    def kind(self) -> str:
        """What it is, in words."""
        names = {
            "table": "a table on the MERL grid",
            "fields": "a BRDF in RGL's parameterisation",
            "samples": "scattered samples",
            "result": "a result that is no BRDF",
            "picture": "a picture",
        }
        return next(words for name, words in names.items() if getattr(self, name) is not None)


def read_contents(path: str | Path, sampling: Sampling = "centre") -> Contents:
    """Read a file of any format that holds measurements. sampling: of a MERL file, see `read_merl`. FileFormatError for
    anything else."""
    kind = identify(path)
    if kind == "merl":
        return Contents(kind, table=read_merl(path, sampling=sampling))
    if kind == "rgl":
        return Contents(kind, fields=read_rgl(path))
    if kind == "csv":
        samples = read_samples(path)
        try:
            return Contents(kind, table=table_of(samples))
        except ArgumentError:
            return Contents(kind, samples=samples)
    if kind in ("netcdf", "zarr"):
        return _labelled(Path(path), kind, read_netcdf(path) if kind == "netcdf" else read_zarr(path))
    if kind in ("exr", "tiff"):
        return Contents(kind, picture=read_exr(path) if kind == "exr" else read_float_tiff(path))
    raise FileFormatError(f"{path}: a {kind}, which holds no measurement")


def _labelled(path: Path, kind: Format, data: xr.Dataset) -> Contents:
    try:
        if "vndf" in data:
            return Contents(kind, fields=check_fields(data))
        if (
            "brdf" in data
            and data["brdf"].dims == ("theta_h", "theta_d", "phi_d", "channel")
            and len(data.data_vars) == 1
        ):
            return Contents(kind, table=checked_table(data["brdf"]))
    except ArgumentError as error:
        raise FileFormatError(f"{path}: {error}") from None
    return Contents(kind, result=data)


def material_of(contents: Contents) -> Material:
    """The material that a file describes. ArgumentError where it describes none."""
    if contents.table is not None:
        return Tabulated(contents.table)
    if contents.fields is not None:
        return Adaptive(contents.fields)
    raise ArgumentError(
        f"{contents.kind} cannot be evaluated at any angle: a table (MERL, RGL, CSV on the MERL grid) can"
    )
