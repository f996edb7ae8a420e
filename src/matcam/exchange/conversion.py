"""From any file format to any other that can hold the data. What is resampled says so, and by how much it errs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.grid import Sampling
from matcam.core.io import check_output
from matcam.core.json import write_json
from matcam.core.shading import Vector, local_shading, vector
from matcam.exchange.contents import Contents, material_of, read_contents, write_contents
from matcam.exchange.parameterisation import SQUARE, adaptive_grid
from matcam.files.formats import Format, format_for
from matcam.files.sidecar import read_sidecar, sidecar_path
from matcam.forward.measurement import true_table
from matcam.material.adaptive import Adaptive
from matcam.material.material import Material, Tabulated

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
    form = format_for(target)
    check_output(target, force=force, inputs=[source])
    held = read_contents(source, sampling)
    report: dict[str, Any] = {"input": str(source), "output": str(target), "format": held.format, "holds": held.kind}
    held, more = _resampled(held, form, sampling, square)
    form.writer(held.content)
    if held.picture is not None:
        more |= _move_sidecar(source, target, force)
    write_contents(target, held, force=force)
    return {**report, "resampled": None, **more}


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


def _resampled(held: Contents, form: Format, sampling: Sampling, square: int) -> tuple[Contents, dict[str, Any]]:
    """Resample a BRDF whose grid the format does not have. Return the contents, and what the report says of it."""
    if held.table is not None and form.holds == ("fields",):
        material = material_of(held)
        fields = adaptive_grid(material, description=str(_source(held)), square=square)
        said = f"to RGL's parameterisation, {fields.sizes['theta_i']} angles of light, {square} x {square} values each"
        more = {"missing_share": fields.attrs["missing_share"], "error": resampling_error(material, Adaptive(fields))}
        return Contents(held.format, fields=fields), {"resampled": said, **more}
    if held.fields is not None and "table" in form.holds and "fields" not in form.holds:
        return _as_table(held, sampling)
    return held, {}


def _as_table(held: Contents, sampling: Sampling) -> tuple[Contents, dict[str, Any]]:
    """Return RGL's fields on the MERL grid."""
    material = material_of(held)
    if isinstance(material, Adaptive) and material.mirrored:
        raise ArgumentError("this RGL file is anisotropic: a table on the MERL grid cannot hold it")
    table = true_table(material, sampling)
    negative = float((table < 0).mean())  # RGL's tables go below zero where nothing was measured
    table = table.clip(min=0).assign_attrs(table.attrs)
    said = f"to the MERL grid at each cell's {sampling}; below zero, set to it: {negative:.2%}"
    more = {"resampled": said, "missing_share": 0.0, "error": resampling_error(material, Tabulated(table))}
    return Contents(held.format, table=table), more


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
