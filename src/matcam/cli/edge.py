"""`matcam edge`: the MTF of a camera from one picture of one edge."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from matcam.cli import show
from matcam.cli.options import AsJson, Budget, EdgeLens, Force, Mosaic


def command(
    picture: Annotated[
        Path, typer.Argument(help="Photograph of an edge to read: TIFF, PNG, JPEG, OpenEXR, camera raw.")
    ],
    roi: Annotated[
        tuple[int, int, int, int] | None,
        typer.Option(
            "--roi",
            metavar="X Y WIDTH HEIGHT",
            help="Region that holds one edge, px; or X,Y,WIDTH,HEIGHT. Default: the whole picture.",
        ),
    ] = None,
    model: EdgeLens = "gaussian",
    wavelength: Annotated[
        float | None,
        typer.Option("--wavelength", metavar="NM", help="Wavelength of the light for diffraction and defocus, nm."),
    ] = None,
    pitch: Annotated[
        float | None,
        typer.Option(
            "--pitch", metavar="UM", help="Pixel pitch, um: for diffraction and defocus, and to print lp/mm besides."
        ),
    ] = None,
    half_width: Annotated[
        float, typer.Option("--half-width", metavar="PX", help="Half the width of a pixel's sensitive area, px.")
    ] = 0.5,
    cfa: Mosaic = None,
    channel: Annotated[
        Literal["R", "G", "B", "Y"] | None,
        typer.Option("--channel", help="Colour to measure; Y is luminance. Default: Y."),
    ] = None,
    tone: Annotated[
        Literal["linear", "srgb", "auto"],
        typer.Option(
            "--tone",
            help="What the codes are: linear, or sRGB, which is undone; auto: sRGB for 8 bits, and it says so.",
        ),
    ] = "auto",
    accept_sharpened: Annotated[
        bool, typer.Option("--accept-sharpened", help="Measure a sharpened picture all the same.")
    ] = False,
    sfr: Annotated[
        Path | None,
        typer.Option(
            "--sfr",
            metavar="FILE",
            help="CSV file of the MTF to write, as sfrmat and Imatest write it: frequency, SFR.",
        ),
    ] = None,
    budget: Budget = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Picture to write (.png, .pdf, .svg); a .csv goes beside it.",
        ),
    ] = None,
    force: Force = False,
    json: AsJson = False,
) -> None:
    """Measure the MTF of lens and pixel across a slanted edge (ISO 12233): free of a model, and as a lens.

    Example: `matcam edge chart.tif --roi 120 80 80 160`
    """
    from matcam.core import checks
    from matcam.core.io import check_output, check_picture
    from matcam.numerics.budget import check_budget

    if output:
        check_picture(output, force=force, inputs=[picture])
        check_output(output.with_suffix(".csv"), force=force, inputs=[picture])
    if pitch is not None:
        checks.positive("--pitch", pitch, "um")
    if sfr:
        check_output(sfr, force=force, inputs=[picture])
    if budget:
        check_budget(budget, force=force, inputs=[picture])
    with show.working(f"{picture}: measuring the edge"):
        from matcam.calibration.edge.edge import edge_mtf
        from matcam.files.photographs import open_photograph

        photograph = open_photograph(picture)
        result = edge_mtf(
            photograph,
            roi,
            model=model,
            wavelength=None if wavelength is None else wavelength * 1e-9,
            pixel_pitch=None if pitch is None else pitch * 1e-6,
            half_width=half_width,
            cfa=cfa,
            channel=channel,
            tone=tone,
            accept_sharpened=accept_sharpened,
        )
    files = [*([output, output.with_suffix(".csv")] if output else []), *(path for path in (sfr, budget) if path)]
    if json:
        document = result.to_dict()
        if pitch:
            document["mtf50_lp_per_mm"] = _lp_per_mm(result.mtf50, pitch)
        show.as_json(document | {"files": [str(path) for path in files]})
    else:
        _print(result, pitch)
    if sfr:
        _write_sfr(result, sfr, pitch, force)
    if budget:
        _write_budget(result, budget, force)
    if output:
        with show.working(f"{output}: drawing"):
            _write(result, photograph.values, roi, picture.name, output, force)
        if not json:
            show.say(f"picture: {output}")


def _lp_per_mm(frequency: Any, pitch: float) -> Any:
    """Convert cycles/px to line pairs per mm, by the pitch in um."""
    return frequency * 1000 / pitch


def _write_sfr(result: Any, path: Path, pitch: float | None, force: bool) -> None:
    """Write the MTF's columns; those below Nyquist's double, which other programs plot."""
    from matcam.core.io import replacing

    head = ["frequency_cy_per_px", *(["frequency_lp_per_mm"] if pitch else []), "SFR"]
    lines = [",".join(head)]
    for frequency, value in zip(result.frequency, result.mtf, strict=True):
        if frequency <= 1:
            cells = [frequency, *([_lp_per_mm(frequency, pitch)] if pitch else []), value]
            lines.append(",".join(f"{float(cell):.8g}" for cell in cells))
    with replacing(path, force=force) as temporary:
        Path(temporary).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_budget(result: Any, path: Path, force: bool) -> None:
    """Write the budgets of both MTF50 and of the lens's parameters."""
    from matcam.numerics.budget import fit_budget, parameter_budgets, write_budgets

    fit = result.parametric
    budgets = [
        fit_budget("MTF50 free of a model, cycles/px", result.mtf50, result.mtf50_std),
        fit_budget(f"MTF50 of the {fit.model} lens, cycles/px", fit.mtf50, fit.mtf50_std),
        *parameter_budgets(fit.names, fit.values, fit.covariance),
    ]
    write_budgets(path, budgets, force=force)


def _write(result: Any, image: Any, roi: Any, name: str, output: Path, force: bool) -> None:
    from matcam.core.io import write_columns
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

    rows = [row("free of a model", result.mtf50, result.mtf50_std)]
    if result.glare_found:
        rows.append(row("without its glare", result.core_mtf50, result.core_mtf50_std))
    rows.append(row(f"{fit.model} lens", fit.mtf50, fit.mtf50_std))
    show.table(["MTF50, lens and pixel", "cycles/px", *(["lp/mm"] if pitch else [])], rows)
    std = np.sqrt(np.diag(fit.covariance))
    for name, value, error in zip(fit.names, fit.values, std, strict=True):
        show.say(f"{name}: {value:.4g} ± {error:.2g}")
    verdict = "explains the edge" if fit.consistent else "does NOT explain the edge: believe the free curve"
    show.say(f"the {fit.model} lens {verdict} (probability of such residuals {fit.misfit_probability:.2g})")
    show.say(
        f"edge: normal at {np.degrees(result.angle):.3f}° ± {np.degrees(result.angle_std):.3f}°, bow {result.bow:+.2f} px; "
        f"light changes by {1e4 * result.light[0]:+.1f}, {1e4 * result.light[1]:+.1f} % per 100 px in x, y"
    )
    if result.glare_found:
        show.say(
            f"glare: {result.glare_fraction:.1%} ± {result.glare_fraction_std:.1%} of the light, "
            f"radius {result.glare_radius:.0f} px"
        )
    for remark in result.remarks:
        show.say(remark.text)
