"""From any file format to any other that can hold the data. What is resampled says so, and by how much it errs."""

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
from matcam.material.material import Material
from matcam.material.tabulated import Tabulated

SUFFIXES = (".binary", ".bsdf", ".csv", ".nc", ".zarr.zip", ".exr", ".tif", ".tiff")
"""Of the outputs, which say their format."""

_PAIRS, _FARTHEST = 4096, np.radians(80)


def convert(
    source: str | Path,
    target: str | Path,
    *,
    sampling: Sampling = "centre",
    square: int = SQUARE,
    force: bool = False,
) -> dict[str, Any]:
    """Read `source`, write `target` in the format that its name ends in; a report as plain numbers.

    sampling: of a MERL file, see `read_merl`, and of the table that an RGL file is resampled to. square: resolution of an RGL
    file that is made, see `adaptive_grid`. Report: `input`, `output`, `holds`, `resampled` (None where every value is kept),
    and where resampled `error` (see `resampling_error`) and `missing_share` of what had to be made up. ArgumentError where
    the target's format cannot hold the data; OutputError where it cannot go.
    """
    source, target = Path(source), Path(target)
    suffix = output_suffix(target)
    check_output(target, force=force, inputs=[source])
    held = read_contents(source, sampling)
    report: dict[str, Any] = {"input": str(source), "output": str(target), "format": held.format, "holds": held.kind}
    write, more = _writer(held, suffix, sampling, square)
    if held.picture is not None:
        more |= _move_sidecar(source, target, force)
    write(target, force)
    return {**report, "resampled": None, **more}


def output_suffix(target: Path) -> str:
    """The ending of a name that says its format; ArgumentError for another."""
    for suffix in SUFFIXES:
        if target.name.lower().endswith(suffix):
            return suffix
    raise ArgumentError(f"{target}: the name must end in one of {', '.join(SUFFIXES)}")


def resampling_error(before: Material, after: Material) -> dict[str, float]:
    """Relative difference of two materials' BRDFs at 4096 pairs of random directions up to 80 degrees from the normal, the
    largest of their channels: `median`, `p99` (exceeded by 1 %), `largest`; `known` is the share of pairs where the first
    has a value."""
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


def _writer(held: Contents, suffix: str, sampling: Sampling, square: int) -> tuple[Write, dict[str, Any]]:
    """What writes the file, and what the report has to say besides."""
    if held.picture is not None:
        return _picture_writer(held.picture, suffix), {}
    if suffix in (".exr", ".tif", ".tiff"):
        raise ArgumentError(f"{held.kind} is not a picture: it goes into {', '.join(SUFFIXES[:5])}")
    if held.result is not None or held.samples is not None:
        return _result_writer(held, suffix), {}
    if suffix == ".bsdf" and held.fields is None:
        material = material_of(held)
        fields = adaptive_grid(material, description=str(_source(held)), square=square)
        said = f"to RGL's parameterisation, {fields.sizes['theta_i']} angles of light, {square} x {square} values each"
        more = {"missing_share": fields.attrs["missing_share"], "error": resampling_error(material, Adaptive(fields))}
        return lambda path, force: write_rgl(path, fields, force=force), {"resampled": said, **more}
    if suffix in (".binary", ".csv") and held.fields is not None:
        return _as_table(held, suffix, sampling)
    if held.table is not None:
        return _table_writer(held.table, suffix), {}
    assert held.fields is not None
    return _fields_writer(held.fields, suffix), {}


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


def _as_table(held: Contents, suffix: str, sampling: Sampling) -> tuple[Write, dict[str, Any]]:
    """RGL's fields on the MERL grid."""
    material = material_of(held)
    if isinstance(material, Adaptive) and material.mirrored:
        raise ArgumentError("this RGL file is anisotropic: a table on the MERL grid cannot hold it")
    table = true_table(material, sampling)
    negative = float((table < 0).mean())  # RGL's tables go below zero where nothing was measured
    table = table.clip(min=0).assign_attrs(table.attrs)
    said = f"to the MERL grid at each cell's {sampling}; below zero, set to it: {negative:.2%}"
    more = {"resampled": said, "missing_share": 0.0, "error": resampling_error(material, Tabulated(table))}
    return _table_writer(table, suffix), more


def _result_writer(held: Contents, suffix: str) -> Write:
    data = held.result if held.result is not None else held.samples
    assert data is not None
    if suffix in (".binary", ".bsdf"):
        raise ArgumentError(f"{held.kind} has no place in {suffix}: {', '.join(SUFFIXES[2:5])} can hold it")
    if suffix == ".csv":
        if held.samples is not None:
            samples = held.samples
            return lambda path, force: write_samples(path, samples, force=force)
        result = held.result
        assert result is not None
        return lambda path, force: write_columns(path, result, force=force)
    labelled = data if isinstance(data, xr.Dataset) else data.to_dataset(name="samples")
    return lambda path, force: _labelled_writer(suffix)(path, labelled, force=force)


def _picture_writer(picture: np.ndarray, suffix: str) -> Write:
    writers = {".exr": write_exr, ".tif": write_float_tiff, ".tiff": write_float_tiff}
    if suffix not in writers:
        raise ArgumentError(f"a picture goes into {', '.join(writers)}, not into {suffix}")
    return lambda path, force: writers[suffix](path, picture, force=force)


def _move_sidecar(source: Path, target: Path, force: bool) -> dict[str, Any]:
    """The sidecar goes along, with the picture's new name in it."""
    beside = sidecar_path(source)
    if not beside.exists() or beside == sidecar_path(target):
        return {}
    document = read_sidecar(beside)
    document["picture"]["file"] = target.name
    write_json(sidecar_path(target), document, force=force)
    return {"sidecar": str(sidecar_path(target))}


def _source(held: Contents) -> str:
    data = held.table if held.table is not None else held.fields
    return "" if data is None else str(data.attrs.get("source", ""))
