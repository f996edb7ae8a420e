"""Measurement of many edges by `matcam edge`: several photographs, regions or channels, or a through-focus series."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from matcam.cli import show
from matcam.core.errors import ArgumentError, FitError
from matcam.core.io import plain, write_columns


def focus_positions(text: str, count: int, method: str) -> list[float]:
    if method == "iso12233":
        raise ArgumentError(
            "--focus needs --method likelihood, because --method iso12233 gives no standard deviations: omit one of these "
            "options"
        )
    try:
        positions = [float(cell) for cell in text.split(",")]
    except ValueError:
        raise ArgumentError(f"--focus must be numbers separated by commas, such as -1,0,1, got {text!r:.60}") from None
    if len(positions) != count or not all(map(math.isfinite, positions)):
        raise ArgumentError(
            f"--focus must have a finite position for each of the {count} photographs, got {text!r:.60}"
        )
    from matcam.calibration.readings.through_focus import FEWEST_POSITIONS

    if len(set(positions)) < FEWEST_POSITIONS:
        raise ArgumentError(f"--focus must have at least {FEWEST_POSITIONS} different positions, got {text!r:.60}")
    return positions


def _draw_focus(rows: Any, of_file: dict[str, float], foci: Any, figure: Path, force: bool) -> None:
    import numpy as np

    from matcam.figures.style import save
    from matcam.figures.through_focus import through_focus_figure

    series = {}
    columns: dict[str, Any] = {"region": [], "channel": [], "focus_position": [], "mtf50": [], "mtf50_std": []}
    for (region, colour), of in foci.items():
        mine = [row for row in rows if (row.region, row.channel) == (region, colour) and row.found]
        values = [(of_file[row.file], row.found["mtf50_cycles_per_px"], row.found["mtf50_std"]) for row in mine]
        position, mtf50, std = np.array(values).T
        series[f"{region} {colour}"] = position, mtf50, std, of if hasattr(of, "mtf50_at") else None
        for name, cells in zip(columns, zip(*((region, colour, *one) for one in values), strict=True), strict=True):
            columns[name] += cells
    save(through_focus_figure(series), figure, force=force)
    write_columns(figure.with_suffix(".csv"), columns, force=force)


def run_series(
    pictures: list[Path],
    rois: Path | None,
    roi: tuple[int, int, int, int] | None,
    channel: str | None,
    cfa: str | None,
    positions: list[float] | None,
    table: Path | None,
    figure: Path | None,
    force: bool,
    json: bool,
    measure: Any,
) -> int:
    """Measure many edges, and show or write a row for each. The result is 1 if an edge could not be measured, otherwise 0.

    `positions` are the focus positions of the photographs, or None if they are not a through-focus series. `table` is the
    CSV file to write, with a row for each edge. `figure` is the figure to write, of MTF50 over the focus position. `measure`
    computes the readings of one edge. A FitError is raised if no edge can be measured.
    """
    from functools import partial

    from matcam.calibration.readings.edge_series import (
        focus_of_series,
        measure_series,
        read_regions,
        region_name,
        series_columns,
    )
    from matcam.files.photographs import open_photograph

    regions = read_regions(rois) if rois else {region_name(roi): roi}
    photographs = [(str(path), partial(open_photograph, path)) for path in pictures]
    with show.working(f"measuring {len(pictures)} image{'s' * (len(pictures) > 1)}"):
        rows = measure_series(photographs, regions, channel, cfa, measure)
    failed = [row for row in rows if row.problem]
    if len(failed) == len(rows):
        first = failed[0]
        raise FitError(
            f"none of the {len(rows)} edges can be measured; the first problem is: {first.file}: {first.problem}"
        )
    columns = series_columns(rows)
    of_file = dict(zip(map(str, pictures), positions or [], strict=False))
    if positions:
        columns = {"file": columns.pop("file"), "focus_position": [of_file[row.file] for row in rows], **columns}
    foci = focus_of_series(rows, of_file) if positions else {}
    if table:
        write_columns(table, columns, force=force)
    if figure:
        _draw_focus(rows, of_file, foci, figure, force)
    written = [path for path in (table, figure, figure and figure.with_suffix(".csv")) if path]
    if json:
        edges = [
            {"file": r.file, "region": r.region, "channel": r.channel, **r.found, "problem": r.problem} for r in rows
        ]
        found = [
            {"region": region, "channel": colour} | ({"problem": str(of)} if isinstance(of, FitError) else of._asdict())
            for (region, colour), of in foci.items()
        ]
        show.as_json({"edges": plain(edges), **({"best_focus": found} if positions else {}), "files": written})
    else:
        names = ["mtf50_cycles_per_px", "mtf50_std", "mtf10_cycles_per_px", "rise_10_90_px"]
        cells = [[f"{r.found[name]:.4f}" if name in r.found else "" for name in names] for r in rows]
        head = ["file", "region", "channel", "MTF50", "±", "MTF10, cycles/px", "rise 10-90 %, px"]
        show.table(head, [[r.file, r.region, r.channel, *of] for r, of in zip(rows, cells, strict=True)])
        focused = {key: of for key, of in foci.items() if not isinstance(of, FitError)}
        if focused:
            head = ["region", "channel", "best focus", "±", "MTF50 there, cycles/px", "±"]
            show.table(head, [[*key, *(f"{value:.4f}" for value in of[:4])] for key, of in focused.items()])
        for name, path in (("table", table), ("figure", figure)):
            if path:
                show.say(f"{name}: {path}")
    for (region, colour), of in foci.items():
        if isinstance(of, FitError):
            show.remark(f"no best focus of {region} {colour}: {of}")
    for row in failed:
        show.remark(f"left out: {row.file} {row.region} {row.channel}: {row.problem}".replace("  ", " "))
    return int(bool(failed))
