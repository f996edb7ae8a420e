"""Contents of a file of any format, or of a result in memory, as plain values."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Any

from matcam.calibration.chart.chart import Chart
from matcam.calibration.chart.chart_file import read_chart
from matcam.camera.camera import Camera
from matcam.camera.kernel import mtf50
from matcam.core import checks
from matcam.core.grid import Sampling
from matcam.core.readers.names import is_folder
from matcam.exchange.overviews import (
    columns_overview,
    folder_overview,
    is_photograph,
    layers_overview,
    photograph_overview,
    result_overview,
)
from matcam.files.formats import identify


def inspect(source: Any, *, sampling: Sampling = "centre", radius: float = 256.0) -> dict[str, Any]:
    """Report the contents of a file or a result.

    `matcam inspect` prints the same report.

    Args:
        source: path or object. A path is that of a file of any format that matcam reads, of a photograph, or of a
            folder with a capture, the results of a run, tables or photographs. An object is a table, a result, an image
            or a `Camera`.
        sampling: position in a cell at which a MERL value was sampled, "centre" or "edge" (see `read_merl`).
            Default: "centre".
        radius: radius of the sphere from which a table was recorded, px. Default: 256, as in the MERL rig.

    Returns:
        Plain values that JSON can represent; names of quantities end in their unit. The report of a file has `file` and
        `format`. The report of a BRDF has the grid, missing shares, range, reciprocity, albedo, lobe widths and the
        trace of a camera. The report of a camera has its parameters and MTF50. The report of a photograph has its size,
        range and share of saturated values.

    Raises:
        FileFormatError: the file is missing or damaged, its format is not supported, or the folder contains none of
            the contents that are listed at `source`.
        ArgumentError: `source` is of another type, an image has no values, or the radius is not positive.

    Example:
        >>> report = matcam.inspect(matcam.rigs.merl().camera)
        >>> report["parameters"], round(report["mtf50_cycles_per_px"], 4)
        ({'optics.sigma_px': 0.5, 'pixel.half_width_px': 0.5}, 0.3231)
    """
    checks.positive("radius", radius, "px")
    if isinstance(source, Camera):
        return {"holds": "a camera profile", **_camera_report(source)}
    if not isinstance(source, str | Path):
        from matcam.exchange.contents import contents_of
        from matcam.exchange.inspection import inspect_contents

        return inspect_contents(contents_of(source, "source", "a Camera or a path"), radius)
    return {"file": str(source), **_file_report(Path(source), sampling, radius)}


def _file_report(path: Path, sampling: Sampling, radius: float) -> dict[str, Any]:
    if is_folder(path):
        return folder_overview(path)
    if is_photograph(path):
        return photograph_overview(path)
    kind = identify(path)
    if kind == "camera profile":
        return result_overview(path) or {"format": kind, **_camera_report(Camera.load(path))}
    if kind == "picture sidecar":
        from matcam.files.sidecar import read_sidecar

        return {"format": kind, **read_sidecar(path)}
    if kind == "chart":
        return {"format": kind, "holds": "a chart's description", **_chart_report(read_chart(path))}
    overviews = {"csv": columns_overview, "exr": layers_overview}
    if kind in overviews and (found := overviews[kind](path)):
        return found
    from matcam.exchange.contents import read_contents
    from matcam.exchange.inspection import inspect_contents

    return {"format": kind, **inspect_contents(read_contents(path, sampling), radius)}


def _chart_report(chart: Chart) -> dict[str, Any]:
    counts = Counter(type(element).__name__.lower() for element in chart.elements)
    return {"page_mm": list(chart.page), "elements": dict(counts)}


def _camera_report(camera: Camera) -> dict[str, Any]:
    """Report on a camera: parameters, standard deviations, MTF50 (cycles/px, along a row), sensor and provenance.

    A lens that differs between colours or positions has an MTF50 for each of its representative lenses, by name.
    """
    found = mtf50(camera.optics, camera.pixel)
    return {
        "parameters": {name: float(value) for name, value in camera.parameters().items()},
        "std": camera.uncertainty.std() if camera.uncertainty else {},
        "mtf50_cycles_per_px": found.get("", found),
        "sensor": camera.profile()["sensor"],
        "provenance": dataclasses.asdict(camera.provenance),
    }
