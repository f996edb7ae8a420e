"""Description of a chart: a JSON file that lists the printed elements and their positions.

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

Positions are in mm on the page, with x to the right and y down from the upper left corner. Levels are linear reflectances
relative to the bare paper.
"""

from __future__ import annotations

import json
from dataclasses import fields
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, create_model

from matcam.calibration.chart.chart import Chart, Element, Fiducial
from matcam.core import checks
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.io import write_json
from matcam.core.readers.texts import checked_version, first_problem, read_json

FORMAT, VERSION = "matcam chart", 1
"""Name and version of the file format."""
_WHAT = "the description of a chart"
"""Name of the file in error messages."""


def read_chart(path: str | Path) -> Chart:
    """Read the description of a chart.

    Args:
        path: JSON file that `write_chart` or `matcam chart` wrote.

    Returns:
        The chart: its page, fiducials and elements.

    Raises:
        FileFormatError: if the file is not the description of a chart; the message contains the file and the field.

    Source:
        docs/targets.md; docs/chart-v1.schema.json is the JSON Schema of the format.

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
        found = _Document.model_validate(document).model_dump()
        fiducials = tuple(Fiducial(**_without_units(mark)) for mark in found["fiducials"])
        elements = tuple(_CLASSES[one.pop("kind")](**_without_units(one)) for one in found["elements"])
        return Chart(_tuples(found["page_mm"]), fiducials, elements, found["ink_level"])
    except ValidationError as error:
        raise FileFormatError(f"{path}: {first_problem(error)}") from None
    except ArgumentError as error:
        raise FileFormatError(f"{path}: {error}") from None


def write_chart(path: str | Path, chart: Chart, *, force: bool = False) -> None:
    """Write the description of a chart as JSON.

    Args:
        path: file to write.
        chart: chart to describe.
        force: True to replace an existing file. Default: False.

    Raises:
        OutputError: if the file exists and `force` is False, or if the file cannot be written.

    Source:
        docs/targets.md; docs/chart-v1.schema.json is the JSON Schema of the format.

    Example:
        >>> import tempfile, pathlib
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "chart.json"
        >>> matcam.targets.write_chart(path, matcam.targets.design_chart(["star"], pixels_across=1500))
        >>> path.exists()
        True
    """
    write_json(path, _document(checks.instance("chart", chart, Chart)), force=force)


def _document(chart: Chart) -> dict[str, Any]:
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
    """Check whether a file exists and describes this chart, regardless of the version of the software."""
    if not path.is_file():
        return False
    try:
        found = read_json(path, _WHAT)
    except FileFormatError:
        return False
    expected = json.loads(json.dumps(_document(chart)))
    return isinstance(found, dict) and {**found, "software": expected["software"]} == expected


def description_path(page: str | Path) -> Path:
    return Path(page).with_suffix(".json")


def chart_schema() -> dict[str, Any]:
    schema: dict[str, Any] = _Document.model_json_schema()
    return schema


# Types of the fields in the file.
_Positive = Annotated[FiniteFloat, Field(gt=0)]
_Level = Annotated[FiniteFloat, Field(ge=0, le=1)]
_Point = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
_Sides = Annotated[list[_Positive], Field(min_length=2, max_length=2)]
_FIELDS: dict[str, tuple[str, Any]] = {
    "profile": ("profile", Literal["sine", "bars", "lines"]),
    "corners": ("corners_mm", Annotated[list[_Point], Field(min_length=4, max_length=4)]),
    "centre": ("centre_mm", _Point),
    "centres": ("centres_mm", Annotated[list[_Point], Field(min_length=1)]),
    "size": ("size_mm", _Sides),
    "inner": ("inner_mm", Annotated[FiniteFloat, Field(ge=0)]),
    "outer": ("outer_mm", _Positive),
    "radius": ("radius_mm", _Positive),
    "pitch": ("pitch_mm", _Positive),
    "period": ("period_mm", _Positive),
    "angle": ("angle_rad", FiniteFloat),
    "phase": ("phase_rad", FiniteFloat),
    "cycles": ("cycles", Annotated[int, Field(ge=8, le=2000)]),
    "rings": ("rings", Annotated[int, Field(ge=1, le=2)]),
    "level": ("level", _Level),
    "dark": ("dark", _Level),
    "bright": ("bright", _Level),
    "duty": ("duty", FiniteFloat),
}
"""Name in the file and type of every field of elements and fiducials."""


class _Strict(BaseModel):
    # A docstring would become part of the published schema.
    model_config = ConfigDict(extra="forbid", strict=True)


def _model(name: str, printed: type | None = None, **types: Any) -> Any:
    """Create the model of an object in the file: fields of given types, and those of an element or fiducial."""
    types |= dict(_FIELDS[field.name] for field in fields(printed)) if printed else {}
    given: dict[str, Any] = {field: (kind, ...) for field, kind in types.items()}
    return create_model(f"_{name}", __base__=_Strict, **given)


_CLASSES: dict[str, type] = {one.__name__.lower(): one for one in get_args(Element)}
"""Classes of elements by their kind in the file."""
_ELEMENTS: Any = tuple(_model(one.__name__, one, kind=Literal[kind]) for kind, one in _CLASSES.items())
"""Pydantic models of all kinds of elements."""
_Document = _model(
    "Document",
    format=Literal["matcam chart"],
    version=Literal[1],
    software=str,
    page_mm=_Sides,
    ink_level=_Level,
    fiducials=list[_model("Fiducial", Fiducial)],  # type: ignore[misc]
    elements=list[Annotated[Union[_ELEMENTS], Field(discriminator="kind")]],  # noqa: UP007
)


def _with_units(thing: Element | Fiducial) -> dict[str, Any]:
    return {_FIELDS[name][0]: value for name, value in vars(thing).items()}


def _without_units(document: dict[str, Any]) -> dict[str, Any]:
    names = {there: here for here, (there, _) in _FIELDS.items()}
    return {names[name]: _tuples(value) for name, value in document.items()}


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value
