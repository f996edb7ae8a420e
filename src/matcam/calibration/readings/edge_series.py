"""Measurement of many edges in one run: several photographs, regions and channels, with one table row for each edge."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from matcam.calibration.readings.through_focus import BestFocus, best_focus
from matcam.core.errors import FileFormatError, FitError, MatcamError
from matcam.core.readers.texts import read_lines
from matcam.files.photographs import Photograph

Region = tuple[int, int, int, int]
"""Region (x, y, width, height) of an image, px."""
_COLUMNS = ("x", "y", "width", "height")
"""Columns that a file of regions must have. They specify a region, px."""


class SeriesEdge(NamedTuple):
    """One edge of a series.

    Attributes:
        file: name of the photograph.
        region: name of the region; empty if the photograph cannot be read.
        channel: "R", "G", "B", "Y" or "grey"; empty if the photograph cannot be read.
        found: values by name; empty if the edge could not be measured.
        problem: reason why the edge could not be measured; empty if it was measured.
    """

    file: str
    region: str
    channel: str
    found: dict[str, Any]
    problem: str


def channels_of(photograph: Photograph, channel: str | None, cfa: str | None) -> list[str | None]:
    if channel != "all":
        return [channel]
    if (cfa or photograph.cfa) is not None:
        return ["R", "G", "B"]
    return ["R", "G", "B", "Y"] if photograph.values.ndim == 3 else [None]


def channel_name(photograph: Photograph, channel: str | None) -> str:
    return channel or ("Y" if photograph.values.ndim == 3 else "grey")


def region_name(region: Region | None) -> str:
    return "whole" if region is None else ",".join(map(str, region))


def measure_series(
    photographs: Sequence[tuple[str, Callable[[], Photograph]]],
    regions: dict[str, Region | None],
    channel: str | None,
    cfa: str | None,
    measure: Callable[[Photograph, Region | None, str | None], dict[str, Any]],
) -> list[SeriesEdge]:
    """Measure all regions of all photographs in all channels.

    Edges that cannot be measured are listed with the reason.

    Args:
        photographs: name of each photograph, and the function that reads it.
        regions: regions (x, y, width, height) in px by name; None for the whole photograph.
        channel: a colour, "all", or None for luminance or a grey photograph.
        cfa: colours of the first 2 x 2 px of mosaics whose files do not specify them; None for other photographs.
        measure: function that measures the edge in a region and channel of a photograph, and returns values by name.

    Returns:
        One row for each edge, and one for each photograph that cannot be read.
    """
    rows: list[SeriesEdge] = []
    for name, read in photographs:
        try:
            photograph = read()
        except MatcamError as error:
            rows.append(SeriesEdge(name, "", "", {}, str(error).removeprefix(f"{name}: ")))
            continue
        for colour in channels_of(photograph, channel, cfa):
            shown = channel_name(photograph, colour)
            for region, roi in regions.items():
                try:
                    found, problem = measure(photograph, roi, colour), ""
                except MatcamError as error:
                    found, problem = {}, str(error)
                rows.append(SeriesEdge(name, region, shown, found, problem))
    return rows


def series_columns(rows: Sequence[SeriesEdge]) -> dict[str, Sequence[Any]]:
    names: dict[str, None] = {}
    for row in rows:
        names.update(dict.fromkeys(name for name, value in row.found.items() if not isinstance(value, list | dict)))
    table: dict[str, Sequence[Any]] = {
        "file": [row.file for row in rows],
        "region": [row.region for row in rows],
        "channel": [row.channel for row in rows],
    }
    # A missing value becomes NaN.
    cells = {name: [row.found.get(name) for row in rows] for name in names}
    table |= {name: [np.nan if cell is None else cell for cell in column] for name, column in cells.items()}
    table["remarks"] = ["; ".join(row.found.get("remarks", ())) for row in rows]
    table["problem"] = [row.problem for row in rows]
    return table


def focus_of_series(
    rows: Sequence[SeriesEdge], positions: dict[str, float]
) -> dict[tuple[str, str], BestFocus | FitError]:
    """Find the best focus of each region and channel.

    Args:
        rows: result of `measure_series`.
        positions: focus position of each photograph by name, any unit.

    Returns:
        The best focus, or the error that gives the reason why there is none, by region and channel.
    """
    found: dict[tuple[str, str], BestFocus | FitError] = {}
    for key in dict.fromkeys((row.region, row.channel) for row in rows if row.found):
        mine = [row for row in rows if (row.region, row.channel) == key and row.found]
        values = ([row.found[name] for row in mine] for name in ("mtf50_cycles_per_px", "mtf50_std"))
        try:
            found[key] = best_focus([positions[row.file] for row in mine], *values)
        except FitError as error:
            found[key] = error
    return found


def read_regions(path: Path) -> dict[str, Region | None]:
    """Read regions from a CSV file with the columns x, y, width, height, and optionally name.

    Raises:
        FileFormatError: a column is missing, a line is not a region, a name occurs twice, or the file contains no region.
    """
    lines = list(csv.reader(read_lines(path, "a list of regions")))
    header = [cell.strip().lower() for cell in lines[0]] if lines else []
    if missing := [name for name in _COLUMNS if name not in header]:
        raise FileFormatError(
            f"{path}: column {missing[0]} is missing: the first line must name x, y, width and height"
        )
    regions: dict[str, Region | None] = {}
    for number, line in enumerate(lines[1:], start=2):
        if not any(cell.strip() for cell in line):
            continue
        cells = dict(zip(header, (cell.strip() for cell in line), strict=False))
        try:
            x, y, width, height = (int(cells[name]) for name in _COLUMNS)
        except (KeyError, ValueError):
            raise FileFormatError(
                f"{path}: line {number} is not a region: x, y, width and height must be whole numbers"
            ) from None
        name = cells.get("name") or f"{x},{y},{width},{height}"
        if name in regions:
            raise FileFormatError(f"{path}: line {number}: the name {name} occurs twice; give each region its own name")
        regions[name] = (x, y, width, height)
    if not regions:
        raise FileFormatError(f"{path}: the file contains no region: add a line with x, y, width and height")
    return regions
