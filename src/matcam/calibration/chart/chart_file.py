"""The description of a chart: a JSON file beside the page, which lists the printed elements and their positions.

    {
      "format": "matcam chart",  "version": 1,  "software": "matcam 0.1.0",
      "page_mm": [297, 210],  "ink_level": 0.05,
      "fiducials": [{"centre_mm": [9, 9], "radius_mm": 1, "rings": 2}, ...],
      "elements": [
        {"kind": "square", "corners_mm": [[x, y], ...], "level": 0.25},
        {"kind": "grating", "profile": "bars", "centre_mm": [x, y], "size_mm": [across, along], "angle_rad": 0.12,
         "period_mm": 0.5, "phase_rad": 0, "dark": 0.25, "bright": 1, "duty": 0.5},
        {"kind": "star", "centre_mm": [x, y], "inner_mm": 2, "outer_mm": 40, "cycles": 72, "phase_rad": 0,
         "dark": 0.25, "bright": 0.95},
        {"kind": "dots", "centres_mm": [[x, y], ...], "radius_mm": 0.1, "pitch_mm": 1.4, "level": 0.25},
        {"kind": "patch", "corners_mm": [[x, y], ...], "level": 0.5}
      ]
    }

Places are in mm on the page, x right and y down from the upper left corner. Levels are linear, relative to the bare paper.
"""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from matcam.calibration.chart.chart import Chart, Dots, Element, Fiducial, Grating, Patch, Square, Star
from matcam.core import checks
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.io import write_json
from matcam.core.readers.texts import checked_version, first_problem, read_json

FORMAT, VERSION = "matcam chart", 1
_WHAT = "the description of a chart"


def read_chart(path: str | Path) -> Chart:
    """Read the description of a chart.

    Args:
        path: JSON file that `write_chart` or `matcam chart` wrote.

    Returns:
        The chart: its page, fiducials and elements.

    Raises:
        FileFormatError: if the file is not a chart's description; the message names the file and the field.

    Source:
        docs/targets.md; the format is at the head of this module, its schema in docs/chart-v1.schema.json.

    Example:
        >>> import tempfile, pathlib
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "chart.json"
        >>> matcam.targets.write_chart(path, matcam.targets.design_chart(["dots"], pixels_across=1000))
        >>> matcam.targets.read_chart(path).page
        (297.0, 210.0)
    """
    path = Path(path)
    document = read_json(path, _WHAT)
    checked_version(document, path, _WHAT, FORMAT, (VERSION,))
    try:
        found = _Document.model_validate(document)
        return Chart(
            (found.page_mm[0], found.page_mm[1]),
            tuple(Fiducial(**_without_units(f.model_dump())) for f in found.fiducials),
            tuple(_CLASSES[e.kind](**_without_units(e.model_dump(exclude={"kind"}))) for e in found.elements),
            found.ink_level,
        )
    except ValidationError as error:
        raise FileFormatError(f"{path}: {first_problem(error)}") from None
    except ArgumentError as error:
        raise FileFormatError(f"{path}: {error}") from None


def write_chart(path: str | Path, chart: Chart, *, force: bool = False) -> None:
    """Write the description of a chart as JSON.

    Args:
        path: file to write.
        chart: the page and what is printed on it.
        force: replace an existing file. Default: False.

    Raises:
        OutputError: if the file exists and `force` is not set, or it cannot be written.

    Source:
        docs/targets.md; the format is at the head of this module, its schema in docs/chart-v1.schema.json.

    Example:
        >>> import tempfile, pathlib
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "chart.json"
        >>> matcam.targets.write_chart(path, matcam.targets.design_chart(["star"], pixels_across=1500))
        >>> path.exists()
        True
    """
    write_json(path, _document(checks.instance("chart", chart, Chart)), force=force)


def _document(chart: Chart) -> dict[str, Any]:
    """Describe a chart as a JSON object."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "software": f"matcam {metadata.version('matcam')}",
        "page_mm": list(chart.page),
        "ink_level": chart.ink,
        "fiducials": [_with_units(fiducial) for fiducial in chart.fiducials],
        "elements": [{"kind": type(element).__name__.lower(), **_with_units(element)} for element in chart.elements],
    }


def is_description_of(path: Path, chart: Chart) -> bool:
    """Check whether a file exists and describes this chart, whatever version of the software wrote it."""
    if not path.is_file():
        return False
    try:
        found = read_json(path, _WHAT)
    except FileFormatError:
        return False
    expected = json.loads(json.dumps(_document(chart)))
    return isinstance(found, dict) and {**found, "software": expected["software"]} == expected


def description_path(page: str | Path) -> Path:
    """Return the path of the description of a printed page: "chart.pdf" -> "chart.json"."""
    return Path(page).with_suffix(".json")


def chart_schema() -> dict[str, Any]:
    """Return the JSON Schema of a chart's description."""
    return _Document.model_json_schema()


_Positive = Annotated[FiniteFloat, Field(gt=0)]
_Level = Annotated[FiniteFloat, Field(ge=0, le=1)]
_Point = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
_Corners = Annotated[list[_Point], Field(min_length=4, max_length=4)]


# Models have no docstrings: pydantic would put them into the published schema.


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Square(_Strict):
    kind: Literal["square"]
    corners_mm: _Corners
    level: _Level


class _Patch(_Strict):
    kind: Literal["patch"]
    corners_mm: _Corners
    level: _Level


class _Grating(_Strict):
    kind: Literal["grating"]
    profile: Literal["sine", "bars", "lines"]
    centre_mm: _Point
    size_mm: Annotated[list[_Positive], Field(min_length=2, max_length=2)]
    angle_rad: FiniteFloat
    period_mm: _Positive
    phase_rad: FiniteFloat
    dark: _Level
    bright: _Level
    duty: FiniteFloat


class _Star(_Strict):
    kind: Literal["star"]
    centre_mm: _Point
    inner_mm: Annotated[FiniteFloat, Field(ge=0)]
    outer_mm: _Positive
    cycles: Annotated[int, Field(ge=8, le=2000)]
    phase_rad: FiniteFloat
    dark: _Level
    bright: _Level


class _Dots(_Strict):
    kind: Literal["dots"]
    centres_mm: Annotated[list[_Point], Field(min_length=1)]
    radius_mm: _Positive
    pitch_mm: _Positive
    level: _Level


class _Fiducial(_Strict):
    centre_mm: _Point
    radius_mm: _Positive
    rings: Annotated[int, Field(ge=1, le=2)]


class _Document(_Strict):
    format: Literal["matcam chart"]
    version: Literal[1]
    software: str
    page_mm: Annotated[list[_Positive], Field(min_length=2, max_length=2)]
    ink_level: _Level
    fiducials: list[_Fiducial]
    elements: list[Annotated[_Square | _Grating | _Star | _Dots | _Patch, Field(discriminator="kind")]]


_CLASSES: dict[str, type[Element]] = {
    "square": Square, "grating": Grating, "star": Star, "dots": Dots, "patch": Patch,
}  # fmt: skip
_UNITS = {
    **dict.fromkeys(("centre", "size", "corners", "centres", "inner", "outer", "radius", "pitch", "period"), "_mm"),
    **dict.fromkeys(("angle", "phase"), "_rad"),
}


def _with_units(thing: Element | Fiducial) -> dict[str, Any]:
    """Return an element's fields, with units in their names."""
    return {f"{name}{_UNITS.get(name, '')}": value for name, value in vars(thing).items()}


def _without_units(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document's fields under their names in Python, lists as tuples."""

    def plain(name: str) -> str:
        return name.removesuffix("_mm").removesuffix("_rad")

    return {plain(name): _tuples(value) for name, value in document.items()}


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value
