"""Conversion of a file from any format to any other that can hold the data.

Each kind of contents has a writer. Where a format cannot hold the values themselves they are resampled, and the report says so
and by how much the result errs.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from matcam.core.errors import ArgumentError
from matcam.core.grid import Sampling
from matcam.core.io import check_output, write_columns
from matcam.core.json import write_json
from matcam.core.shading import Vector, local_shading, vector
from matcam.exchange.contents import Contents, material_of, read_contents
from matcam.exchange.parameterisation import SQUARE, adaptive_grid
from matcam.files.datasets import write_netcdf, write_zarr
from matcam.files.float_pictures import write_exr, write_float_tiff
from matcam.files.merl import write_merl
from matcam.files.rgl import write_rgl
from matcam.files.samples import samples_of, write_samples
from matcam.files.sidecar import read_sidecar, sidecar_path
from matcam.forward.measurement import true_table
from matcam.material.adaptive import Adaptive
from matcam.material.material import Material, Tabulated

SUFFIXES = (".binary", ".bsdf", ".csv", ".nc", ".zarr.zip", ".exr", ".tif", ".tiff")
"""Endings of the output's name, which say its format."""

_PAIRS, _FARTHEST = 4096, np.radians(80)


def convert(
    source: str | Path,
    target: str | Path,
    *,
    sampling: Sampling = "centre",
    square: int = SQUARE,
    force: bool = False,
) -> dict[str, Any]:
    """Convert a file to the format that the output's name ends in.

    The input's format is recognised by its content. A picture's sidecar goes along.

    Args:
        source: input: MERL, RGL, CSV of samples, NetCDF-4, Zarr in a zip, OpenEXR or TIFF.
        target: output: .binary, .bsdf, .csv, .nc, .zarr.zip, .exr, .tif or .tiff.
        sampling: point of its cell, "centre" or "edge", at which a MERL file's values are sampled, and those of the
            table that an RGL file is resampled to. Default: "centre"; loaders of MERL files disagree, see
            `read_merl`.
        square: nodes along each side of the square of an RGL file that is made, see `adaptive_grid`. Default: 192; fewer
            make a smaller file.
        force: True to replace an existing output. Default: False.

    Returns:
        Report as plain values: `input`, `output`, `format` and `holds` of the input, and `resampled`, None where every value is
        kept. Where resampled: `missing_share` of the values that were made up, and `error`, the relative difference at 4096
        random pairs of directions.

    Raises:
        ArgumentError: the output's format cannot hold the data.
        FileFormatError: the input is damaged or of no known format.
        OutputError: the output exists, or cannot be written.

    Source:
        docs/exchange.md.

    Example:
        >>> import tempfile, pathlib
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     picture = pathlib.Path(folder, "picture.exr")
        ...     matcam.write_exr(picture, np.ones((4, 5)))
        ...     report = matcam.convert(picture, picture.with_suffix(".tif"))
        >>> report["holds"], report["resampled"]
        ('a picture', None)
    """
    source, target = Path(source), Path(target)
    suffix = output_suffix(target)
    check_output(target, force=force, inputs=[source])
    contents = read_contents(source, sampling)
    report: dict[str, Any] = {
        "input": str(source),
        "output": str(target),
        "format": contents.format,
        "holds": contents.kind,
    }
    write, details = _writer(contents, suffix, sampling, square)
    if contents.picture is not None:
        details |= _write_sidecar(source, target, force)
    write(target, force)
    return {**report, "resampled": None, **details}


def output_suffix(target: Path) -> str:
    """Return the ending of a name that says its format; ArgumentError for another."""
    for suffix in SUFFIXES:
        if target.name.lower().endswith(suffix):
            return suffix
    raise ArgumentError(f"{target}: the name must end in one of {', '.join(SUFFIXES)}")


def resampling_error(before: Material, after: Material) -> dict[str, float]:
    """Compare two materials' BRDFs at 4096 pairs of random directions up to 80 degrees from the normal.

    The relative difference is the largest of the channels. Returned are its `median`, `p99` (exceeded by 1 %) and
    `largest`, and `known`, the share of pairs where the first material has a value.
    """
    random = np.random.default_rng(1)
    light, view = (_directions(random) for _ in range(2))
    seen = local_shading(light, view)
    first, second = (np.asarray(m.reflected(seen)).reshape(_PAIRS, -1) for m in (before, after))
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.max(np.abs(second - first) / np.abs(first), axis=1)
    known = np.isfinite(relative)
    if not known.any():
        return {"median": np.nan, "p99": np.nan, "largest": np.nan, "known": 0.0}
    median, p99, largest = np.quantile(relative[known], [0.5, 0.99, 1])
    return {"median": float(median), "p99": float(p99), "largest": float(largest), "known": float(known.mean())}


def _directions(random: np.random.Generator) -> Vector:
    cos, phi = random.uniform(np.cos(_FARTHEST), 1, _PAIRS), random.uniform(0, 2 * np.pi, _PAIRS)
    sin = np.sqrt(1 - cos**2)
    return vector(sin * np.cos(phi), sin * np.sin(phi), cos)


Write = Callable[[Path, bool], None]


def _writer(contents: Contents, suffix: str, sampling: Sampling, square: int) -> tuple[Write, dict[str, Any]]:
    """Return the function that writes the file, and the details that the report adds."""
    if contents.picture is not None:
        return _picture_writer(contents.picture, suffix), {}
    if suffix in (".exr", ".tif", ".tiff"):
        raise ArgumentError(f"{contents.kind} is not a picture: it goes into {', '.join(SUFFIXES[:5])}")
    if contents.result is not None or contents.samples is not None:
        return _result_writer(contents, suffix), {}
    if suffix == ".bsdf" and contents.fields is None:
        material = material_of(contents)
        fields = adaptive_grid(material, description=str(_source(contents)), square=square)
        note = f"to RGL's parameterisation, {fields.sizes['theta_i']} angles of light, {square} x {square} values each"
        details = {
            "missing_share": fields.attrs["missing_share"],
            "error": resampling_error(material, Adaptive(fields)),
        }
        return lambda path, force: write_rgl(path, fields, force=force), {"resampled": note, **details}
    if suffix in (".binary", ".csv") and contents.fields is not None:
        return _as_table(contents, suffix, sampling)
    if contents.table is not None:
        return _table_writer(contents.table, suffix), {}
    assert contents.fields is not None
    return _fields_writer(contents.fields, suffix), {}


def _table_writer(table: xr.DataArray, suffix: str) -> Write:
    if suffix == ".binary":
        return lambda path, force: write_merl(path, table, force=force)
    if suffix == ".csv":
        return lambda path, force: write_samples(path, samples_of(table), force=force)
    labelled = table.to_dataset(name="brdf")
    return lambda path, force: _labelled_writer(suffix)(path, labelled, force=force)


def _fields_writer(fields: xr.Dataset, suffix: str) -> Write:
    writer = write_rgl if suffix == ".bsdf" else _labelled_writer(suffix)
    return lambda path, force: writer(path, fields, force=force)


def _labelled_writer(suffix: str) -> Callable[..., None]:
    return write_netcdf if suffix == ".nc" else write_zarr


def _as_table(contents: Contents, suffix: str, sampling: Sampling) -> tuple[Write, dict[str, Any]]:
    """Resample RGL's fields to the MERL grid."""
    material = material_of(contents)
    if isinstance(material, Adaptive) and material.mirrored:
        raise ArgumentError("this RGL file is anisotropic: a table on the MERL grid cannot hold it")
    table = true_table(material, sampling)
    negative = float((table < 0).mean())  # RGL's tables go below zero where nothing was measured
    table = table.clip(min=0).assign_attrs(table.attrs)
    note = f"to the MERL grid at each cell's {sampling}; below zero, set to it: {negative:.2%}"
    details = {"resampled": note, "missing_share": 0.0, "error": resampling_error(material, Tabulated(table))}
    return _table_writer(table, suffix), details


def _result_writer(contents: Contents, suffix: str) -> Write:
    data = contents.result if contents.result is not None else contents.samples
    assert data is not None
    if suffix in (".binary", ".bsdf"):
        raise ArgumentError(f"{contents.kind} has no place in {suffix}: {', '.join(SUFFIXES[2:5])} can hold it")
    if suffix == ".csv":
        if contents.samples is not None:
            samples = contents.samples
            return lambda path, force: write_samples(path, samples, force=force)
        result = contents.result
        assert result is not None
        return lambda path, force: write_columns(path, result, force=force)
    labelled = data if isinstance(data, xr.Dataset) else data.to_dataset(name="samples")
    return lambda path, force: _labelled_writer(suffix)(path, labelled, force=force)


def _picture_writer(picture: np.ndarray, suffix: str) -> Write:
    writers = {".exr": write_exr, ".tif": write_float_tiff, ".tiff": write_float_tiff}
    if suffix not in writers:
        raise ArgumentError(f"a picture goes into {', '.join(writers)}, not into {suffix}")
    return lambda path, force: writers[suffix](path, picture, force=force)


def _write_sidecar(source: Path, target: Path, force: bool) -> dict[str, Any]:
    """Write the picture's sidecar beside the output, with its new name in it."""
    beside = sidecar_path(source)
    if not beside.exists() or beside == sidecar_path(target):
        return {}
    document = read_sidecar(beside)
    document["picture"]["file"] = target.name
    write_json(sidecar_path(target), document, force=force)
    return {"sidecar": str(sidecar_path(target))}


def _source(contents: Contents) -> str:
    data = contents.table if contents.table is not None else contents.fields
    return "" if data is None else str(data.attrs.get("source", ""))
