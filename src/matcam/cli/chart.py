"""`matcam chart`: a chart to photograph, and its description."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from matcam.cli import show
from matcam.cli.options import AsJson, Force, option
from matcam.core.errors import ArgumentError
from matcam.core.io import check_output, check_picture


def command(
    kinds: Annotated[
        list[str] | None,
        typer.Argument(
            help="Panels to draw: squares, bars, sines, lines, star, dots. Default: squares, bars, star, dots."
        ),
    ] = None,
    output: Annotated[
        Path,
        option("--output -o", "FILE", "Page to write (.pdf, .svg, .png); its description is written beside it."),
    ] = Path("chart.pdf"),
    page: Annotated[
        Literal["a4", "a3", "letter"] | None,
        typer.Option("--page", help="Paper format, landscape. Default: a4."),
    ] = None,
    size: Annotated[
        tuple[float, float] | None,
        option("--size", "WIDTH HEIGHT", "Size of a page of another format, mm."),
    ] = None,
    pixels: Annotated[
        float, option("--pixels", "PX", "Number of camera pixels across the width of the page.")
    ] = 3000.0,
    dpi: Annotated[float, option("--dpi", "DPI", "Resolution of a PNG, dots per inch.")] = 600.0,
    force: Force = False,
    json: AsJson = False,
) -> None:
    """Draw a chart to photograph (slanted squares, gratings, Siemens star, dots), with a description for `calibrate`.

    Example: `matcam chart squares star --pixels 4000 -o chart.pdf`
    """
    from matcam.calibration.chart.chart_file import description_path, is_description_of, write_chart
    from matcam.calibration.chart.chart_layout import design_chart

    if page and size:
        raise ArgumentError("--page and --size both specify the size of the page: give one of them")
    description = description_path(output)
    check_picture(output, force=force)
    chart = design_chart(kinds or ["squares", "bars", "star", "dots"], page=size or page or "a4", pixels_across=pixels)
    described = is_description_of(description, chart)
    check_output(description, force=force or described)
    with show.working(f"{output}: drawing the chart"):
        from matcam.figures.chart import chart_figure, check_raster
        from matcam.figures.style import save

        remarks = check_raster(chart, dpi, pixels) if output.suffix.lower() == ".png" else []
        save(chart_figure(chart), output, force=force, dpi=dpi)
        if not described:
            write_chart(description, chart, force=force)
    counts: dict[str, Any] = {}
    for element in chart.elements:
        counts[type(element).__name__.lower()] = counts.get(type(element).__name__.lower(), 0) + 1
    for text in remarks:
        show.remark(text)
    if json:
        show.as_json({"files": [str(output), str(description)], "page_mm": chart.page, "elements": counts})
        return
    elements = ", ".join(_counted(kind, count) for kind, count in counts.items())
    show.say(f"{elements} on {chart.page[0]:g} x {chart.page[1]:g} mm")
    show.say(f"page: {output}, to be printed at true size; description: {description}, for `matcam calibrate --chart`")
    show.say(
        f"after photographing the page: {shlex.join(['matcam', 'calibrate', 'PHOTOGRAPHS', '--chart', str(description)])}"
    )


def _counted(kind: str, count: int) -> str:
    name = kind.replace("dots", "dot grid")
    return f"{count} {name}{'' if count == 1 else 'es' if name.endswith('ch') else 's'}"
