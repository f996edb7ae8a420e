"""`matcam edge`: the MTF of a camera from one image of one edge."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from matcam.cli import show
from matcam.cli.edge_series import focus_positions, run_series
from matcam.cli.options import AsJson, Budget, EdgeLens, Force, HalfWidth, Mosaic, Pitch, Wavelength, option
from matcam.core.errors import ArgumentError, RegionError
from matcam.core.io import check_outputs, write_columns, write_text

_DOUBTS = {"asymmetric", "compressed", "crushed", "demosaiced", "denoised", "filtered", "sharpened", "tone-curve"}
"""Codes of the remarks on images whose MTF is not that of the lens, in either estimate."""


def command(
    pictures: Annotated[
        list[Path],
        typer.Argument(
            help="Photographs of an edge to read, such as a through-focus series: TIFF, PNG, JPEG, OpenEXR, camera raw."
        ),
    ],
    roi: Annotated[
        tuple[int, int, int, int] | None,
        option("--roi", "X Y WIDTH HEIGHT", "Region with one edge, px; or X,Y,WIDTH,HEIGHT. Default: the whole image."),
    ] = None,
    rois: Annotated[
        Path | None,
        option(
            "--rois",
            "FILE",
            "CSV file to read, with columns x, y, width, height and optionally name: regions with one edge each.",
        ),
    ] = None,
    method: Annotated[
        Literal["likelihood", "iso12233"],
        typer.Option(
            "--method",
            help="likelihood: matcam's estimates with their errors; iso12233: the e-SFR of ISO 12233:2023, without errors, "
            "for comparison with other programs.",
        ),
    ] = "likelihood",
    at: Annotated[
        list[float] | None,
        option("--at", "CY_PER_PX", "Frequency at which to print the MTF, cycles/px; may be repeated."),
    ] = None,
    model: EdgeLens = "gaussian",
    wavelength: Wavelength = None,
    pitch: Pitch = None,
    half_width: HalfWidth = 0.5,
    cfa: Mosaic = None,
    channel: Annotated[
        Literal["R", "G", "B", "Y", "all"] | None,
        typer.Option(
            "--channel",
            help="Colour to measure. Y: luminance; all: each colour in turn. Default: Y. A mosaic requires R, G or B.",
        ),
    ] = None,
    tone: Annotated[
        Literal["linear", "srgb", "auto"],
        typer.Option(
            "--tone",
            help="Encoding of the codes: linear, or sRGB, which is decoded; auto: sRGB for 8 bits, with a remark.",
        ),
    ] = "auto",
    accept_sharpened: Annotated[
        bool, typer.Option("--accept-sharpened", help="Also measure a sharpened image.")
    ] = False,
    sfr: Annotated[
        Path | None,
        option("--sfr", "FILE", "CSV file of the MTF to write, in the form of sfrmat and Imatest: frequency, SFR."),
    ] = None,
    table: Annotated[
        Path | None,
        option("--table", "FILE", "CSV file to write: a row for each photograph, region and channel."),
    ] = None,
    focus: Annotated[
        str | None,
        option(
            "--focus",
            "POSITIONS",
            "Focus position of each photograph, separated by commas, in any unit: find the best focus, at which MTF50 is "
            "largest. -o then draws MTF50 over the position.",
        ),
    ] = None,
    budget: Budget = None,
    output: Annotated[
        Path | None,
        option("--output -o", "FILE", "Figure to write (.png, .pdf, .svg); a .csv is written beside it."),
    ] = None,
    force: Force = False,
    json: AsJson = False,
) -> int:
    """Measure the MTF of lens and pixel across slanted edges (ISO 12233), without and with a model of the lens.

    Example: `matcam edge chart.tif --roi 120 80 80 160`
    """
    from matcam.core import checks

    several = len(pictures) > 1 or rois is not None or channel == "all"
    positions = None if focus is None else focus_positions(focus, len(pictures), method)
    for name, given in (("-o", output), ("--sfr", sfr), ("--budget", budget)):
        if given and not (positions and name == "-o") and (several or (method == "iso12233" and name != "--sfr")):
            one = "one channel of one region of one image" if several else "--method likelihood"
            instead = "give one image, one region and one channel" if several else "omit --method iso12233"
            raise ArgumentError(f"{name} needs {one}: omit this option, or {instead}")
    of_a_model = {
        "--model": model != "gaussian",
        "--wavelength": wavelength is not None,
        "--pitch": pitch is not None,
        "--half-width": half_width != 0.5,
        "--accept-sharpened": accept_sharpened,
    }
    if method == "iso12233" and any(of_a_model.values()):
        named = ", ".join(name for name, one in of_a_model.items() if one)
        raise ArgumentError(f"{named} needs --method likelihood: omit this option, or omit --method iso12233")
    if roi is not None and rois is not None:
        raise ArgumentError("--roi and --rois both specify regions: give one of them")
    files = [path for path in (output, output and output.with_suffix(".csv"), sfr, table, budget) if path]
    check_outputs(files, force=force, inputs=pictures, figure=output)
    # the MTF of an edge is tabulated up to 1.25 cycles/px
    frequencies = tuple(float(checks.within("--at", f, 0, 1.25, "cycles/px")) for f in at or ())

    def measure(photograph: Any, region: Any, colour: Any) -> Any:
        if method == "iso12233":
            from matcam.calibration.readings.iso12233 import iso12233_sfr

            return iso12233_sfr(photograph, region, cfa=cfa, channel=colour, tone=tone)
        from matcam.calibration.edge.edge import edge_mtf

        return edge_mtf(
            photograph,
            region,
            model=model,
            wavelength=None if wavelength is None else wavelength * 1e-9,
            pixel_pitch=None if pitch is None else pitch * 1e-6,
            half_width=half_width,
            cfa=cfa,
            channel=colour,
            tone=tone,
            accept_sharpened=accept_sharpened,
        )

    def document_of(result: Any) -> dict[str, Any]:
        document = result.to_dict() | _readings(result, frequencies)
        if pitch:
            document["mtf50_lp_per_mm"] = _lp_per_mm(document["mtf50_cycles_per_px"], pitch)
        return dict(document)

    if several:
        return run_series(
            pictures, rois, roi, channel, cfa, positions, table, output, force, json,
            lambda *given: document_of(measure(*given)),
        )  # fmt: skip
    picture = pictures[0]
    with show.working(f"{picture}: measuring the edge"):
        from matcam.files.photographs import open_photograph

        photograph = open_photograph(picture)
        try:
            result = measure(photograph, roi, channel)
        except RegionError as error:
            if roi is not None:
                raise
            whole = shlex.join(["matcam", "calibrate", str(picture)])
            raise RegionError(f"{error}; give the region with --roi, or measure all edges: {whole}") from error
    if json:
        show.as_json(document_of(result) | {"files": files})
    elif method == "iso12233":
        _print_readings(_readings(result, frequencies), pitch, "e-SFR, ISO 12233:2023")
    else:
        _print(result, pitch)
        _print_readings(_readings(result, frequencies), pitch, "without a model")
    if sfr:
        _write_sfr(result, sfr, pitch, force)
    if table:
        from matcam.calibration.readings.edge_series import SeriesEdge, channel_name, region_name, series_columns

        row = SeriesEdge(str(picture), region_name(roi), channel_name(photograph, channel), document_of(result), "")
        write_columns(table, series_columns([row]), force=force)
    if budget:
        _write_budget(result, budget, force)
    if output:
        with show.working(f"{output}: drawing"):
            _write(result, photograph.values, roi, picture.name, output, force)
    if files and not json:
        show.written(files)
    return 0


def _readings(result: Any, frequencies: tuple[float, ...]) -> dict[str, Any]:
    """Compute MTF50 and other readings of an edge. The readings of ISO 12233 have no standard deviations."""
    if hasattr(result, "fits"):
        from matcam.calibration.readings.edge_numbers import readings

        return readings(result, frequencies)
    found: dict[str, Any] = result.readings(frequencies)
    return found


def _print_readings(found: dict[str, Any], pitch: float | None, name: str) -> None:
    def shown(key: str, std: str) -> str:
        return f"{found[key]:.4f}" + (f" ± {found[std]:.4f}" if std in found else "")

    levels = [key for key in found if key.endswith("_cycles_per_px")]
    rows = []
    for key in levels:
        row = [key.split("_")[0].upper(), shown(key, key.replace("cycles_per_px", "std"))]
        rows.append([*row, f"{_lp_per_mm(found[key], pitch):.2f}"] if pitch else row)
    show.table([name, "cycles/px", *(["lp/mm"] if pitch else [])], rows)
    show.say(f"rise from 10 % to 90 %: {shown('rise_10_90_px', 'rise_10_90_std')} px")
    for key in found:
        if key.startswith("mtf_at_") and not key.endswith("_std"):
            show.say(f"MTF at {key.removeprefix('mtf_at_')} cycles/px: {shown(key, key + '_std')}")


def _lp_per_mm(frequency: Any, pitch: float) -> Any:
    """Convert a frequency from cycles/px to line pairs per mm.

    `pitch` is the pixel pitch, um.
    """
    return frequency * 1000 / pitch


def _write_sfr(result: Any, path: Path, pitch: float | None, force: bool) -> None:
    """Write the MTF up to 1 cycle/px (twice the Nyquist frequency), which is the range in other programs."""
    head = ["frequency_cy_per_px", *(["frequency_lp_per_mm"] if pitch else []), "SFR"]
    lines = [",".join(head)]
    mtf = result.sfr if hasattr(result, "sfr") else result.mtf
    for frequency, value in zip(result.frequency, mtf, strict=True):
        if frequency <= 1:
            cells = [frequency, *([_lp_per_mm(frequency, pitch)] if pitch else []), value]
            lines.append(",".join(f"{float(cell):.8g}" for cell in cells))
    write_text(path, "\n".join(lines) + "\n", force=force)


def _write_budget(result: Any, path: Path, force: bool) -> None:
    from matcam.numerics.budget import fit_budget, parameter_budgets, write_budgets

    fit = result.parametric
    budgets = [
        fit_budget("MTF50 without a model, cycles/px", result.mtf50, result.mtf50_std),
        fit_budget(f"MTF50 of the {fit.model} lens, cycles/px", fit.mtf50, fit.mtf50_std),
        *parameter_budgets(fit.names, fit.values, fit.covariance),
    ]
    write_budgets(path, budgets, force=force)


def _write(result: Any, image: Any, roi: Any, name: str, output: Path, force: bool) -> None:
    from matcam.figures.calibration import edge_figure
    from matcam.figures.style import save

    write_columns(output.with_suffix(".csv"), result.columns(), force=force)
    save(edge_figure(result, image, roi, name), output, force=force)


def _print(result: Any, pitch: float | None) -> None:
    import numpy as np

    fit = result.parametric

    def row(name: str, value: float, std: float) -> list[str]:
        shown = [name, f"{value:.4f} ± {std:.4f}"]
        return [*shown, f"{_lp_per_mm(value, pitch):.2f} ± {_lp_per_mm(std, pitch):.2f}"] if pitch else shown

    rows = [row("without a model", result.mtf50, result.mtf50_std)]
    if result.glare_found:
        rows.append(row("without glare", result.core_mtf50, result.core_mtf50_std))
    rows.append(row(f"{fit.model} lens", fit.mtf50, fit.mtf50_std))
    show.table(["MTF50, lens and pixel", "cycles/px", *(["lp/mm"] if pitch else [])], rows)
    std = np.sqrt(np.diag(fit.covariance))
    for name, value, error in zip(fit.names, fit.values, std, strict=True):
        show.say(f"{name}: {value:.4g} ± {error:.2g}")
    # the model-free curve also includes the effect of software
    believe = "" if {remark.code for remark in result.remarks} & _DOUBTS else ": use the model-free curve"
    verdict = "explains the edge" if fit.consistent else f"does NOT explain the edge{believe}"
    show.say(f"the {fit.model} lens {verdict} (probability of such residuals {fit.misfit_probability:.2g})")
    show.say(
        f"edge: normal at {np.degrees(result.angle):.3f}° ± {np.degrees(result.angle_std):.3f}°, bow {result.bow:+.2f} px; "
        f"the light changes by {1e4 * result.light[0]:+.1f}, {1e4 * result.light[1]:+.1f} % per 100 px in x, y"
    )
    if result.glare_found:
        show.say(
            f"glare: {result.glare_fraction:.1%} ± {result.glare_fraction_std:.1%} of the light, "
            f"radius {result.glare_radius:.0f} px"
        )
    for remark in result.remarks:
        show.say(remark.text)
