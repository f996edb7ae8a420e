"""Conversion of a file to any format that supports its data.

A BRDF is resampled if its grid differs from that of the output format. The report then contains the error of the
resampled BRDF.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import Sampling, checked_table
from matcam.core.io import check_output, write_json
from matcam.core.readers.names import check_within, is_there
from matcam.core.shading import Vector, local_shading, vector
from matcam.exchange.contents import Contents, material_of, read_contents, write_contents
from matcam.exchange.materialx import fit_openpbr, write_openpbr
from matcam.exchange.parameterisation import GRID_SIZES, SQUARE, adaptive_grid, resampled_grid
from matcam.files.formats import MEASUREMENTS, Format, format_for
from matcam.files.sidecar import read_sidecar, sidecar_path
from matcam.forward.measurement import true_table
from matcam.inverse.correction.corrected_table import TABLE_ATTRIBUTES, recorded_table, supported_values
from matcam.material.material import Material, cell_values
from matcam.material.measured import Adaptive, Tabulated

_PAIRS = 4096


def convert(
    source: str | Path,
    target: str | Path,
    *,
    sampling: Sampling = "centre",
    square: int = SQUARE,
    error: float | None = None,
    force: bool = False,
) -> dict[str, Any]:
    """Convert a file to the format of the output's suffix.

    The input's format is recognised by its content. The sidecar of an image is copied, too.

    Args:
        source: input: MERL, RGL, Zemax BSDF, UTIA, BiRD JSON, CSV of samples, NetCDF-4, Zarr in a zip, OpenEXR or TIFF.
        target: output: .binary, .bsdf (RGL's), .brdf, .mtlx (a fitted OpenPBR surface), .csv, .nc, .zarr.zip, .exr,
            .tif or .tiff.
        sampling: position in a cell at which a MERL value was sampled, "centre" or "edge", see `read_merl`. If an RGL
            file is resampled to a table, the table is sampled at this position. Default: "centre".
        square: nodes along each side of the square of a new RGL file, see `adaptive_grid`. Default: 192; fewer nodes give
            a smaller file.
        error: largest relative error of a new RGL file, no unit; it replaces `square`. Eight grids (0.2 to 70 MB) are
            tried in ascending order, until the median differences at random pairs of directions and at the peak do not
            exceed `error`. The last grid is used if none satisfies this condition. Default: None, `square` is used.
        force: True to replace an existing output. Default: False.

    Returns:
        Report as plain values. `input` and `output` are the paths; `format`, `content` and `holds` (a description)
        refer to the data of the input; `sidecar` is the path of a copied sidecar. `resampled` describes the resampling;
        it is None if every value is kept. `omitted` lists the variables of a result that the format cannot contain, such
        as standard deviations.

        A report of resampled data also has `missing_share`, the share of interpolated values, and `error`, the relative
        differences of the BRDF. These are `median`, `p99` and `largest` at 4096 random pairs of directions, and `peak`,
        the median in mirror directions. A difference is relative to the value or to 1e-6 of the peak, whichever is larger.
        `known` is the share of pairs with a positive value.

    Raises:
        ArgumentError: the suffix of the output is unknown, its format does not support the data, or an argument is out
            of range.
        FileFormatError: the input is damaged, or its format is not supported.
        OutputError: the output exists, or cannot be written.

    Source:
        docs/exchange.md.

    Example:
        >>> import tempfile, pathlib
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     picture = pathlib.Path(folder, "picture.exr")
        ...     matcam.io.write_exr(picture, np.ones((4, 5)))
        ...     report = matcam.convert(picture, picture.with_suffix(".tif"))
        >>> report["holds"], report["resampled"]
        ('an image', None)
    """
    source, target = Path(source), Path(target)
    form = format_for(target, *MEASUREMENTS, "surface")
    check_output(target, force=force, inputs=[source])
    contents = read_contents(source, sampling)
    report: dict[str, Any] = {
        "input": str(source),
        "output": str(target),
        "format": contents.format,
        "content": contents.content,
        "holds": contents.kind,
    }
    if form.name == "materialx":
        return {**report, **_write_surface(target, contents, force)}
    omitted: dict[str, Any] = {}
    if contents.content == "result" and contents.brdf is not None and "result" not in form.written:
        omitted["omitted"] = [str(name) for name in contents.data.data_vars if name != "brdf"]
        contents = Contents("table", _table_of(contents.data), contents.format)
    contents, details = _resample(contents, form, sampling, square, error)
    form.writer(contents.content)
    if contents.content == "picture":
        details |= _write_sidecar(source, target, force)
    write_contents(target, contents, force=force)
    return {**report, "resampled": None, **omitted, **details}


def resampling_error(before: Material, after: Material) -> dict[str, float]:
    """Compare the BRDFs of two materials at random pairs of directions.

    There are 4096 pairs up to 80 degrees from the normal. A difference is relative to the value of the first material,
    or to 1e-6 of the peak of this material, whichever is larger. A sharp lobe decreases below 1e-300 1/sr, where a
    difference relative to the value has no meaning. The peak is the largest value of a channel in mirror directions up
    to 45 degrees. The difference of a pair is the largest one among the channels in which the first material has a
    positive value.

    Returns:
        Values without unit: the `median`, `p99` (exceeded by 1 % of the pairs) and `largest` difference; `known`, the
        share of pairs with a positive value; and `peak`, the median difference in the mirror directions, because random
        pairs miss a sharp highlight. A difference is NaN if no value is positive.
    """
    random = np.random.default_rng(1)
    light, view = (_directions(random) for _ in range(2))
    at_peak, at_peak_after = (_brdf(material, *_mirrored()) for material in (before, after))
    # smaller values are not used as divisors; a camera of 16 bits resolves 1.5e-5 of the peak
    floor = 1e-6 * np.max(at_peak, axis=0, where=np.isfinite(at_peak), initial=0.0)
    relative = _differences(_brdf(before, light, view), _brdf(after, light, view), floor)
    peak = _differences(at_peak, at_peak_after, floor)
    median, p99, largest = np.quantile(relative, [0.5, 0.99, 1]) if relative.size else [np.nan] * 3
    return {
        "median": float(median),
        "p99": float(p99),
        "largest": float(largest),
        "known": relative.size / _PAIRS,
        "peak": float(np.median(peak)) if peak.size else np.nan,
    }


def _table_of(result: xr.Dataset) -> xr.DataArray:
    """Select the table of a result. The table of a correction has recorded values where it is not supported."""
    if not set(TABLE_ATTRIBUTES) <= set(result):
        return checked_table(result["brdf"])
    return supported_values(result, recorded_table(result))


def _differences(first: np.ndarray, second: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Compute the largest relative difference among the channels of each pair.

    Pairs are omitted if no channel of the first BRDF is positive.
    """
    above = first > 0  # measured tables are negative where data are missing; NaN is not positive
    scale = np.where(above, np.maximum(first, floor), 1.0)
    relative = np.max(np.abs(second - first) / scale, axis=1, where=above, initial=-np.inf)
    return relative[np.isfinite(relative)]


def _brdf(material: Material, light: Vector, view: Vector) -> np.ndarray:
    """Compute the BRDF of pairs of directions, (pairs, channels), 1/sr."""
    seen = local_shading(light, view)
    both = np.asarray(material.reflected(seen))
    return both.reshape(len(both), -1) / np.asarray(seen.cos_i * seen.cos_o)[:, None]


def _mirrored() -> tuple[Vector, Vector]:
    count = 46  # one direction per degree, which is the width of a cell of a table
    angle = np.linspace(0, np.pi / 4, count)
    azimuth = np.linspace(0, 2 * np.pi, count, endpoint=False)
    along, across, up = np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)
    return vector(along, across, up), vector(-along, -across, up)


def _directions(random: np.random.Generator) -> Vector:
    cos, phi = random.uniform(np.cos(np.radians(80)), 1, _PAIRS), random.uniform(0, 2 * np.pi, _PAIRS)
    sin = np.sqrt(1 - cos**2)
    return vector(sin * np.cos(phi), sin * np.sin(phi), cos)


def _resample(
    contents: Contents, form: Format, sampling: Sampling, square: int, error: float | None
) -> tuple[Contents, dict[str, Any]]:
    """Resample a BRDF if the format requires another grid.

    Returns:
        The contents on the grid of the format, and details for the report. Other contents are unchanged and have no
        details.
    """
    if contents.content == "table" and form.holds == ("fields",):
        material, source = material_of(contents), str(contents.data.attrs.get("source", ""))
        if error is None:
            fields = adaptive_grid(material, description=source, square=square)
            found = resampling_error(material, Adaptive(fields))
        else:
            fields, found = _smallest_grid(material, error, source)
        side = fields.sizes["row"]
        note = f"to RGL's parameterisation, {fields.sizes['theta_i']} angles of light, {side} x {side} values each"
        if error is not None and not max(found["median"], found["peak"]) <= error:
            note += f"; no grid has an error of at most {error:.2%}"
        details = {"missing_share": fields.attrs["missing_share"], "error": found}
        return Contents("fields", fields, contents.format), {"resampled": note, **details}
    if contents.content == "fields" and "table" in form.holds and "fields" not in form.holds:
        return _as_table(contents, sampling)
    return contents, {}


def _smallest_grid(material: Material, error: float, description: str) -> tuple[Any, dict[str, float]]:
    """Resample a material to the smallest grid that satisfies an error, otherwise to the finest grid.

    `error` is the largest error, no unit, as in `convert`.

    Returns:
        Fields of the grid, and their `resampling_error`.
    """
    checks.within("error", error, 0, 1, open_low=True)
    for size in GRID_SIZES:
        fields = resampled_grid(material, size, description, peak_error=error)
        found = resampling_error(material, Adaptive(fields))
        if max(found["median"], found["peak"]) <= error:
            break
    return fields, found


def _write_surface(target: Path, contents: Contents, force: bool) -> dict[str, Any]:
    material = material_of(contents)
    surface = fit_openpbr(material)
    error = resampling_error(material, surface.material)
    kind = "metal" if surface.metalness else f"dielectric of index {surface.specular_ior:.3g}"
    note = (
        f"fitted as a {kind}, specular_roughness {surface.specular_roughness:.4g} (the square root of alpha): the measured "
        "values are not kept"
    )
    residual = f"Residual: {error['peak']:.1%} at the peak, {error['median']:.1%} at random directions (median)."
    write_openpbr(target, surface, note=residual, force=force)
    return {"resampled": note, "missing_share": 0.0, "error": error}


def _as_table(contents: Contents, sampling: Sampling) -> tuple[Contents, dict[str, Any]]:
    material = material_of(contents)
    if isinstance(material, Adaptive) and material.mirrored:
        raise ArgumentError(
            "the BRDF in RGL's parameterisation is anisotropic, but a table on the MERL grid is isotropic: give an isotropic "
            "BRDF, or another output format"
        )
    table = true_table(material, sampling)  # without negative values
    negative = float(
        (np.asarray(cell_values(material, sampling)) < 0).mean()
    )  # as in tables of RGL where data are missing
    note = f"to the MERL grid at each cell's {sampling}; negative values set to zero: {negative:.2%}"
    details = {"resampled": note, "missing_share": 0.0, "error": resampling_error(material, Tabulated(table))}
    return Contents("table", table, contents.format), details


def _write_sidecar(source: Path, target: Path, force: bool) -> dict[str, Any]:
    beside = sidecar_path(source)
    if not is_there(beside) or beside == sidecar_path(target):
        return {}
    check_within(beside, source.resolve().parent)
    document = read_sidecar(beside)
    document["picture"]["file"] = target.name
    write_json(sidecar_path(target), document, force=force)
    return {"sidecar": str(sidecar_path(target))}
