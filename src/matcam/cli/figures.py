"""`matcam figures`: Figures 3 to 6 of Holzschuch & Pacanowski (2017)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from matcam.cli import show
from matcam.cli.options import AsJson, Force, option, use_caches
from matcam.core.errors import ArgumentError
from matcam.core.io import check_outputs, write_columns


def command(
    measured: Annotated[
        list[Path] | None, typer.Argument(help="Tables to read for Figure 6. Default: a simulated chromium sphere.")
    ] = None,
    output: Annotated[Path, option("--output -o", "FOLDER", "Folder to write to.")] = Path("figures"),
    vector: Annotated[Literal["pdf", "svg"], typer.Option("--vector", help="Vector format beside PNG.")] = "pdf",
    metal: Annotated[
        str | None,
        option(
            "--metal",
            "SYMBOL",
            "Metal (Cr, Fe, ...) for comparison in Figure 6. Default: the closest of all materials for tables; Cr for the "
            "simulation.",
        ),
    ] = None,
    force: Force = False,
    json: AsJson = False,
) -> None:
    """Draw Figures 3 to 6 of Holzschuch & Pacanowski (2017) as PNG and PDF or SVG, with the data of each as CSV.

    Example: `matcam figures chrome.binary --metal Cr -o figures`
    """
    sources = measured or []
    stems = [
        "figure-3",
        "figure-4",
        "figure-5",
        *(f"figure-6-{path.stem}" for path in sources or [Path("simulated-chromium")]),
    ]
    if len(set(stems)) < len(stems):
        raise ArgumentError(
            "two files have the same name without the suffix, so their figures would overwrite each other: draw the figures "
            "into two folders"
        )
    check_outputs(outputs(output, stems, vector), force=force, inputs=sources)
    use_caches()
    of_stem = [*[None] * 3, *sources] if sources else [None] * 4
    if metal is not None:
        from matcam.material.optical_constants import metals

        metals(metal)  # raises an error for an unknown name before figures are drawn
    metal = metal if sources else metal or "Cr"
    draw_all(dict(zip(stems, of_stem, strict=True)), output, vector, metal=metal, force=force, quiet=json)
    if json:
        show.as_json({"files": outputs(output, stems, vector)})


def draw_all(
    sources: Mapping[str, Any], output: Path, vector: str, *, metal: str | None, force: bool, quiet: bool
) -> None:
    """Draw and write figures.

    `sources` contains, for the stem of each file name, the data of the figure. For Figure 6 they are the file of a table, a
    result of `fresnel`, or None for a simulated table. For Figures 3 to 5 they are None. `metal` is the metal for comparison
    in Figure 6; None: the closest materials.
    """
    drawn = {}
    for stem, source in sources.items():
        with show.working(f"drawing {stem}"):
            drawn[stem] = _draw(stem, source, metal)
    # a bad file among several is found before the first figure is written
    for stem, (data, figure) in drawn.items():
        _write(data, figure, output / stem, vector, force)
        show.say(f"{output / stem}.png, .{vector}, .csv", quiet=quiet)


def outputs(folder: Path, stems: Sequence[str], vector: str) -> list[Path]:
    return [folder / f"{stem}.{suffix}" for stem in stems for suffix in ("png", vector, "csv")]


def _draw(stem: str, source: Any, metal: str | None) -> tuple[Any, Any]:
    from matcam import paper
    from matcam.figures.curves import highlight_figure, loss_figure

    if stem in ("figure-3", "figure-4"):
        data = paper.figure_3_4(10.0 if stem == "figure-3" else 1.0)
        return data, highlight_figure(data)
    if stem == "figure-5":
        data = paper.figure_5()
        return data, loss_figure(data)
    from matcam import rigs
    from matcam.figures.curves import fresnel_figure
    from matcam.inverse.fresnel_tables import tabulated_fresnel
    from matcam.inverse.fresnel_term import fresnel

    if source is not None and not isinstance(source, Path):
        return source, fresnel_figure(source, tabulated_fresnel(source, metal))
    from matcam.exchange.contents import read_recorded_table
    from matcam.forward.measurement import simulated_chromium

    result = fresnel(simulated_chromium() if source is None else read_recorded_table(source), rigs.merl())
    return result, fresnel_figure(result, tabulated_fresnel(result, metal))


def _write(data: Any, figure: Any, stem: Path, vector: str, force: bool) -> None:
    from matcam.figures.style import save

    write_columns(stem.with_name(f"{stem.name}.csv"), data, force=force)
    for suffix in ("png", vector):
        save(figure, stem.with_name(f"{stem.name}.{suffix}"), force=force)
