"""`matcam inspect`: what is in this file?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.options import AsJson, Sampling


def command(
    file: Annotated[Path, typer.Argument(help="MERL file or camera profile.")],
    sampling: Sampling = "centre",
    json: AsJson = False,
) -> None:
    """Format, grid, missing share, reciprocity and lobe width against theta_d of a table; the numbers of a camera profile.

    Example: `matcam inspect chrome.binary`
    """
    from matcam.inspection import identify

    kind = identify(file)
    report = {"file": str(file), "format": kind, **(_table(file, sampling) if kind == "merl" else _profile(file))}
    if json:
        show.as_json(report)
    elif kind == "merl":
        _print_table(report)
    else:
        _print_profile(report)


def _table(file: Path, sampling: Any) -> dict[str, Any]:
    from matcam.files.merl import read_merl
    from matcam.inspection import inspect_table

    return inspect_table(read_merl(file, sampling=sampling))


def _profile(file: Path) -> dict[str, Any]:
    from matcam.inspection import inspect_camera

    return inspect_camera(file)


def _print_table(report: dict[str, Any]) -> None:
    grid = " x ".join(f"{n} {name}" for name, n in report["grid"].items())
    low, high = report["range_per_sr"]
    show.say(
        f"{report['file']}: MERL table, {grid}, channels {' '.join(report['channels'])}, "
        f"read as sampled at each cell's {report['sampling']}"
    )
    show.say(
        f"missing: {report['missing_share']:.1%} of all values, "
        f"{report['missing_above_horizon_share']:.2%} of those above the horizon"
    )
    show.say(f"valid below the horizon: {report['valid_below_horizon_share']:.2%}")
    show.say(f"values: {low:.4g} to {high:.4g} 1/sr")
    show.say(f"reciprocity: phi_d and 180° - phi_d differ by {report['reciprocity_rms']:.2%} rms")
    text = lambda value: "-" if value is None else f"{value:.3f}°"  # noqa: E731
    rows = [
        [f"{row['theta_d_deg']}°", text(row["in_plane_hwhm_deg"]), text(row["across_hwhm_deg"])]
        for row in report["lobe"]
    ]
    show.table(["theta_d", "in plane", "across"], rows, "Half width of the lobe at half maximum, in theta_h")


def _print_profile(report: dict[str, Any]) -> None:
    show.say(f"{report['file']}: camera profile")
    rows = [
        [name, f"{value:.6g}", "exact" if report["std"].get(name) is None else f"± {report['std'][name]:.2g}"]
        for name, value in report["parameters"].items()
    ]
    show.table(["parameter", "value", "standard deviation"], rows)
    show.say(f"MTF50 along a row of pixels: {report['mtf50_cycles_per_px']:.4f} cycles/px")
    for key in ("source", "created", "software", "notes"):
        if report["provenance"][key]:
            show.say(f"{key}: {report['provenance'][key]}")
