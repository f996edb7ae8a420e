"""`matcam inspect`: contents of a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.options import AsJson, Sampling, option
from matcam.core.remark import some_of
from matcam.files.formats import CONTENTS, titles_for


def command(
    file: Annotated[
        Path,
        typer.Argument(
            help=f"File to read: {titles_for(*CONTENTS)}, the JSON file of a result, a photograph; or a folder: a capture, "
            "the results of a run, tables or photographs."
        ),
    ],
    sampling: Sampling = "centre",
    radius: Annotated[
        float,
        option("--radius", "PX", "Radius of the limb in the images behind a table, px."),
    ] = 256.0,
    json: AsJson = False,
) -> dict[str, Any]:
    """Show the contents of a file or folder: a BRDF, another result, an image, a camera profile or a capture.

    For a BRDF, print the grid, the share of missing values, the reciprocity, the albedo and the lobe width by angle. Also
    print whether the blur of a camera is visible, and whether neighbouring cells were read from the same pixel.

    Example: `matcam inspect chrome.binary`
    """
    report = _report(file, sampling, radius)
    if json:
        show.as_json(report)
    elif report["format"] == "camera profile":
        _print_profile(report)
    elif "albedo" in report:
        _print_brdf(report)
    elif "saturated_share" in report:
        _print_photograph(report)
    elif "shape" in report and "range" in report:
        _print_image(report)
    elif "parameters" in report:
        _print_result(report)
    elif report["format"] == "folder":
        _print_folder(report)
    else:
        _print_remainder(report)
    return {"report": report}


def _report(file: Path, sampling: Any, radius: float) -> dict[str, Any]:
    from matcam.exchange.file_report import inspect

    with show.working("inspecting the file"):
        return inspect(file, sampling=sampling, radius=radius)


def _print_brdf(report: dict[str, Any]) -> None:
    show.say(f"{report['file']}: {report['holds']} ({report['format']})")
    if "own_grid" in report:
        own = report["own_grid"]
        show.say(own["description"])
        light = own["light_directions"]
        show.say(
            f"{light['phi_i']} x {light['theta_i']} directions of light, {own['square'][0]} x {own['square'][1]} values each, "
            f"{'isotropic' if own['isotropic'] else 'anisotropic'}; below zero: {own['negative_share']:.2%}"
        )
    if "grid" in report:
        _print_table(report)
    channels = [name for name in report["albedo"][0] if name not in ("theta_o_deg", "missing_share")][:12]
    text = lambda value: "-" if value is None else f"{value:.4f}"  # noqa: E731
    rows = [
        [f"{row['theta_o_deg']}°", *(text(row[c]) for c in channels), f"{row['missing_share']:.2%}"]
        for row in report["albedo"]
    ]
    show.table(
        ["theta_o", *channels, "missing"],
        rows,
        "Albedo: share of the light that is reflected; a lower bound where values are missing (share of diffuse light)",
    )
    if "camera" in report:
        _print_trace(report["camera"])
        _print_cells(report["cells"])
        if "supported_share" in report:
            show.say(f"supported: {report['supported_share']:.0%} of the entries that have a standard deviation")
        show.notes(report["remarks"])
        if report["correction"]["reason"] and not report["corrected"]:
            show.say(f"correction: not possible; {report['correction']['reason']}")
    if "variables" in report:
        for name, what in {"source": "recorded table", "camera_uncertainty": "camera of the rig"}.items():
            if report["attributes"].get(name):
                show.say(f"{what}: {report['attributes'][name]}")
        own = [name for name, variable in report["variables"].items() if list(variable["shape"]) != [name]]
        show.say("variables: " + ", ".join(own))


def _print_trace(trace: dict[str, Any]) -> None:
    if trace["visible"] is None:
        show.say("camera: too few angles show a lobe")
    elif trace["visible"]:
        show.say(
            f"camera: visible. In the plane of light and view, lobes widen {trace['widening']:.2f} times as much as across it. "
            f"Roughly, the standard deviation of the blur is {trace['kernel_rad']:.1g} rad / cos theta_d, and that of the lobe "
            f"{trace['lobe_rad']:.1g} rad, for Gaussians; `fresnel` and `correct` fit both accurately"
        )
    else:
        show.say(
            f"camera: not visible; in the plane of light and view, lobes widen {trace['widening']:.2f} times as much as "
            "across it"
        )


def _print_cells(cells: dict[str, Any]) -> None:
    if cells["rule"] is None:
        show.say("cells: there is no evidence of lookup in shared pixels")
        return
    from matcam.inverse.operator.pixel_phase import READ_FROM

    share = f"{cells['repeated_share']:.0%} of neighbours near the highlight have equal values"
    how = READ_FROM[cells["rule"]]
    if cells["phase_px"] is None:
        where = f"no grid of pixels fits a sphere with a radius of {cells['radius_px']:g} px: try another --radius"
    else:
        phases, std = cells["phase_px"], f"± {cells['phase_std_px']:.1g} px"
        where = "the positions of the pixel centres "
        if isinstance(phases[0], list):
            where += f"differ between the images, {std} each"
        else:
            where += f"are ({phases[0]:+.3f}, {phases[1]:+.3f}) {std} from the centre of the sphere"
    show.say(f"cells: {how} ({share}, {cells['distinct_values']:.0f} values a slice); {where}")


def _print_image(report: dict[str, Any]) -> None:
    height, width, *channels = report["shape"]
    low, high = report["range"]
    show.say(f"{report['file']}: {report['holds']} of {width} x {height} px, {(*channels, 1)[0]} channels of floats")
    show.say(f"values: {low:.6g} to {high:.6g}; missing: {report['missing_share']:.2%}")


def _print_photograph(report: dict[str, Any]) -> None:
    (width, height), channels = report["size_px"], " ".join(report["channels"])
    (low, high), exposure = report["range"], report["exposure_time_s"]
    show.say(f"{report['file']}: a photograph of {width} x {height} px, {report['bits']} bits, channels {channels}")
    show.say(f"values: {low:.6g} to {high:.6g}")
    if report["saturated_share"] is not None:
        show.say(f"saturated: {report['saturated_share']:.2%} of the values are {report['saturation']:.6g} or more")
    show.say(
        "encoding: linear, as the format specifies"
        if report["linear"]
        else "encoding: the file does not specify it; edge and calibrate assume sRGB for 8 bits and linear codes for 16 bits"
    )
    settings = [
        report["camera"],
        "" if report["f_number"] is None else f"f/{report['f_number']:g}",
        "" if exposure is None else f"{exposure:g} s",
    ]
    show.say(f"camera: {', '.join(filter(None, settings)) or 'not specified in the file'}")
    show.say(
        "matcam edge measures the blur of the camera across one edge of a photograph, and matcam calibrate across all"
    )


def _print_result(report: dict[str, Any]) -> None:
    from matcam.core.results.summary import Quantity

    show.say(f"{report['file']}: {report['holds']}")
    if report["verdict"]:
        show.say(report["verdict"])
    if "lens" in report:
        show.say(f"table: {report['table']}; lens {report['lens']}")
    found = [Quantity(name, one["value"], _known(one["std"])) for name, one in report["parameters"].items()]
    show.quantities(found, f"Lobe of the family {report['family']}")
    if report.get("left_out"):
        show.say(f"images that were left out: {', '.join(report['left_out'])}")
    show.notes(report["remarks"])


def _print_folder(report: dict[str, Any]) -> None:
    show.say(f"{report['file']}: {report['holds']}")
    if "lamp_positions" in report:
        images = ", ".join(f"{count} {kind}" for kind, count in report["images"].items() if count)
        exposures = ", ".join(report["exposures"])
        show.say(f"images: {images}; {report['lamp_positions']} lamp positions; exposures {exposures}")
        show.say(f"camera profile: {report['camera_profile'] or 'none, so the lens is estimated from the photographs'}")
        show.notes(report["problems"])
    elif "corrected" in report:
        show.say(
            f"corrected: {len(report['corrected'])} ({some_of(report['corrected'])}); failed: {len(report['failed'])}"
        )
        show.say(f"rig: {report['sample']}; lens {report['lens']}")
        if report["page"]:
            show.say(f"pages of the results: {report['page']}")
        show.notes(report["failed"])
    else:
        results = f"results with a .nc file: {report['results']}; " if report["results"] else ""
        show.say(f"tables (.binary): {report['tables']}; {results}images: {report['photographs']}")
        if report["photographs"]:
            show.say(
                "matcam calibrate measures a camera from photographs of a chart in a folder, and matcam capture init --from "
                "lists photographs of a sample"
            )


def _print_remainder(report: dict[str, Any]) -> None:
    show.say(f"{report['file']}: {report.get('holds', report['format'])} ({report['format']})")
    for name, value in report.items():
        if name in ("file", "format", "holds"):
            continue
        if name == "variables":
            _print_variables(value)
        elif isinstance(value, dict):
            show.table([name, ""], [[str(key), str(item)] for key, item in value.items()])
        else:
            show.say(f"{name.replace('_', ' ')}: {_plain(value)}")


def _print_variables(variables: dict[str, Any]) -> None:
    rows = [
        [name, " x ".join(f"{size} {along}" for along, size in one["shape"].items()), one["units"]]
        for name, one in variables.items()
        if list(one["shape"]) != [name]  # coordinates are named by the sizes
    ]
    show.table(["variable", "size", "unit"], rows)


def _known(std: float | None) -> float:
    return float("nan") if std is None else std


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_plain, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _print_table(report: dict[str, Any]) -> None:
    grid = " x ".join(f"{n} {name}" for name, n in report["grid"].items())
    low, high = report["range_per_sr"]
    show.say(
        f"{'resampled to the MERL grid' if 'resampled' in report else 'MERL table'}, {grid}, "
        f"channels {' '.join(report['channels'])}, "
        f"sampled at each cell's {report['sampling']}"
    )
    if report["rig"]:
        show.say(f"recorded by {report['rig']}", verbatim=True)
    show.say(
        f"missing: {report['missing_share']:.1%} of all values, "
        f"{report['missing_above_horizon_share']:.2%} of those above the horizon"
    )
    show.say(f"valid below the horizon: {report['valid_below_horizon_share']:.2%}")
    show.say(f"values: {low:.4g} to {high:.4g} 1/sr")
    show.say(f"reciprocity: values at phi_d and 180° - phi_d differ by {report['reciprocity_rms']:.2%} rms")
    text = lambda value: "-" if value is None else f"{value:.3f}°"  # noqa: E731
    rows = [
        [f"{row['theta_d_deg']}°", text(row["in_plane_hwhm_deg"]), text(row["across_hwhm_deg"])]
        for row in report["lobe"]
    ]
    show.table(["theta_d", "in plane", "across"], rows, "Half width of the lobe at half maximum, in theta_h")


def _print_profile(report: dict[str, Any]) -> None:
    from matcam.core.results.summary import Quantity

    show.say(f"{report['file']}: camera profile")
    exact = 0.0 if report["std"] else None
    show.quantities(
        Quantity(name, value, _known(report["std"].get(name, exact))) for name, value in report["parameters"].items()
    )
    if not report["std"]:
        show.say("standard deviations of the parameters: not specified")
    mtf50 = report["mtf50_cycles_per_px"]
    for name, value in mtf50.items() if isinstance(mtf50, dict) else [("", mtf50)]:
        lens = f", {name}" if name else ""
        show.say(f"MTF50 along a row of pixels{lens}: {value:.4f} cycles/px")
    if report["sensor"] is not None:
        known = {name: value for name, value in report["sensor"].items() if value is not None}
        show.table(["sensor", "value"], [[name, _plain(value)] for name, value in known.items()])
    for key in ("source", "created", "software", "notes"):
        if report["provenance"][key]:
            show.say(f"{key}: {report['provenance'][key]}")
