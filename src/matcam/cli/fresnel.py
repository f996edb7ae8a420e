"""`matcam fresnel`: the Fresnel term of a measured material, raw and corrected for the camera."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.inputs import check_inputs
from matcam.cli.options import (
    AsJson,
    Budget,
    FamilyOrAuto,
    Force,
    ForceCorrection,
    Masking,
    option,
    use_caches,
)
from matcam.cli.rig_options import RigOptions, TableRig
from matcam.core.errors import ArgumentError
from matcam.core.io import check_outputs, write_columns

_ANGLES = (10, 30, 45, 60, 70, 75, 80, 85)


def command(
    file: Annotated[Path, typer.Argument(help="Table to read (.binary, .nc, .csv).")],
    metal: Annotated[
        str | None,
        option(
            "--metal",
            "SYMBOL",
            "Metal (Cr, Fe, ...) for comparison. Default: the closest of all materials, including dielectrics.",
        ),
    ] = None,
    ndf: FamilyOrAuto = "auto",
    masking: Masking = "smith",
    rig: TableRig = RigOptions(),
    normalise: Annotated[
        tuple[float, float],
        option("--normalise", "LOW HIGH", "Range of theta_d, degrees; F is divided by its mean over this range."),
    ] = (10.0, 45.0),
    channel: Annotated[
        str | None,
        option(
            "--channel",
            "NAME",
            "Channel of the table to draw and print. Default: G, or the middle one of other channels.",
        ),
    ] = None,
    slice_step: Annotated[int, option("--slice-step", "N", "Use every n-th slice of theta_d.", min=1, max=30)] = 1,
    output: Annotated[
        Path | None,
        option(
            "--output -o",
            "FILE",
            "Figure to write (.png, .pdf, .svg); .csv and .nc are written beside it. Default: FILE-fresnel.png.",
        ),
    ] = None,
    budget: Budget = None,
    force_correction: ForceCorrection = False,
    force: Force = False,
    json: AsJson = False,
) -> dict[str, Any]:
    """Extract the Fresnel term of a measured metal, raw and corrected for the camera, with its uncertainty.

    Example: `matcam fresnel chrome.binary --metal Cr`
    """
    from matcam.core.threads import import_behind

    low, high = normalise
    if not 0 <= low < high < 90:
        raise ArgumentError(f"--normalise must be LOW HIGH with 0 <= LOW < HIGH < 90 degrees, got {low:g} {high:g}")
    output = output or Path(f"{file.stem}-fresnel.png")
    inputs = [file, *rig.files]
    check_inputs(inputs, "a table")
    files = [output, output.with_suffix(".csv"), output.with_suffix(".nc"), *([budget] if budget else [])]
    check_outputs(files, force=force, inputs=inputs, figure=output)
    with show.working(f"{file}: fitting the lobe through the camera"):
        workspace = use_caches()
        from matcam.exchange.contents import read_recorded_table
        from matcam.inverse.fresnel_tables import known_wavelengths, tabulated_fresnel
        from matcam.inverse.fresnel_term import fresnel
        from matcam.material.optical_constants import metals

        if metal is not None:
            metals(metal)  # raises an error for an unknown name before the fit
        table = read_recorded_table(file, sampling=rig.sampling)
        table = table.assign_attrs(source=table.attrs.get("source") or file.name)
        channel = _channel_of(table, channel)
        compared = known_wavelengths(table) is not None
        if metal is not None and not compared:
            raise ArgumentError(
                f"--metal is for the channels R, G, B, but {file} has channels of unknown wavelengths: omit this option"
            )
        recorded = rig.of_table()
        import_behind("matcam.figures.curves", "matcam.files.datasets")
        result = fresnel(
            table,
            recorded,
            ndf=ndf,
            masking=masking,
            normalise=(math.radians(low), math.radians(high)),
            slice_step=slice_step,
            force_correction=force_correction,
            workspace=workspace,
        )
        tables = tabulated_fresnel(result, metal) if compared else None
        _write(result, tables, output, force, channel)
        if budget:
            _write_budget(result, budget, force)
    if json:
        show.as_json(_document(result, tables, files))
    else:
        _print(result, tables, files, channel, rig.camera)
    return {"channels": table.sizes["channel"]}


def _channel_of(table: Any, given: str | None) -> str:
    labels = [str(label) for label in table["channel"].values]
    if given is None:
        return "G" if "G" in labels else labels[len(labels) // 2]
    if given not in labels:
        raise ArgumentError(f"--channel must be a channel of the table ({', '.join(labels)}), got {given!r:.40}")
    return given


def _write_budget(result: Any, path: Path, force: bool) -> None:
    import numpy as np

    from matcam.inverse.fresnel_term import fresnel_budget
    from matcam.numerics.budget import write_budgets

    near = result.sel(theta_d=np.radians(_ANGLES), method="nearest")
    budgets = [
        fresnel_budget(result, float(angle), str(channel))
        for channel in result["channel"].values
        for angle in np.unique(near["theta_d"].values)
        if np.isfinite(float(result["corrected"].sel(theta_d=angle, channel=channel)))
    ]
    write_budgets(path, budgets, force=force)


def _write(result: Any, tables: Any, output: Path, force: bool, channel: str) -> None:
    from matcam.figures.curves import fresnel_figure
    from matcam.figures.style import save
    from matcam.files.datasets import write_netcdf

    position = [str(label) for label in result["channel"].values].index(channel)
    write_netcdf(output.with_suffix(".nc"), result, force=force)
    write_columns(output.with_suffix(".csv"), result.drop_dims("source"), force=force)
    save(fresnel_figure(result, tables, channel=position), output, force=force)


def _document(result: Any, tables: Any, files: list[Path]) -> dict[str, Any]:
    import numpy as np

    from matcam.core.remark import from_attribute

    def by_channel(name: str) -> dict[str, Any]:
        return {str(c): result[name].sel(channel=c).values for c in result["channel"].values}

    return {
        **result.attrs,
        "remarks": [remark.to_dict() for remark in from_attribute(result.attrs["remarks"])],
        "normalised_over": np.degrees(result.attrs["normalised_over"]),
        "width": float(result["width"]),
        "width_std": float(result["width_std"]),
        "hwhm_deg": float(np.degrees(result["hwhm"])),
        "hwhm_std_deg": float(np.degrees(result["hwhm_std"])),
        "supported_angle_deg": dict(
            zip(result["channel"].values.tolist(), np.degrees(result["supported_angle"].values), strict=True)
        ),
        "theta_d_deg": np.degrees(result["theta_d"].values),
        **{
            name: by_channel(name)
            for name in ("raw", "raw_std", "corrected_peak", "corrected", "corrected_std", "absolute", "absolute_std")
        },
        "response": by_channel("response") if "channel" in result["response"].dims else result["response"].values,
        "tables": {
            str(t): {
                "rms_corrected": tables["rms_corrected"].sel(table=t).values,
                "rms_raw": tables["rms_raw"].sel(table=t).values,
            }
            for t in (tables["table"].values if tables is not None else ())
        },
        "files": files,
    }


def _print(result: Any, tables: Any, files: list[Path], channel: str, profile: Path | None) -> None:
    import numpy as np

    from matcam.camera.sensor import PixelNoise
    from matcam.core.remark import from_attribute
    from matcam.core.results.summary import half_width, with_std
    from matcam.inverse.fit.fit_data import noise_text

    one = result.sel(channel=channel)
    # nearest existing slices: a table has slices at 74.5 and 75.5 degrees, and --slice-step omits some
    at = one.sel(theta_d=np.unique(one["theta_d"].sel(theta_d=np.radians(_ANGLES), method="nearest")))
    relative = at["response"].values / float(one["response"][0])

    def shown(value: float, std: float | None = None) -> str:
        if np.isnan(value):
            return "-"
        return f"{value:.3f}" if std is None else f"{value:.3f} ± {std:.3f}"

    rows = [
        [f"{angle:.4g}°", f"{1 - lost:.0%}", shown(raw), shown(peak), shown(corrected, std)]
        for angle, lost, raw, peak, corrected, std in zip(
            np.degrees(at["theta_d"].values),
            relative,
            at["raw"].values,
            at["corrected_peak"].values,
            at["corrected"].values,
            at["corrected_std"].values,
            strict=True,
        )
    ]
    show.table(
        ["theta_d", "loss relative to 0°", "F raw", "F peak / response", "F corrected"],
        rows,
        f"{result.attrs['source']}, channel {channel}",
    )
    attrs = result.attrs
    determined = "" if attrs["width_determined"] else " (narrower than this camera can resolve: an upper bound)"
    width = f"width {with_std(float(result['width']), float(result['width_std']))}{determined}"
    show.say(
        f"lobe: {attrs['ndf']}, {'spline-modified' if attrs['spline_modified'] else width}; "
        f"half width at half maximum {half_width(float(result['hwhm']), float(result['hwhm_std'])).text}"
    )
    noise = PixelNoise(attrs["noise_relative"], attrs["noise_floor"])
    share = f"{noise.relative:.2%}" if attrs["noise"] == "given" else noise_text(noise, 2)
    show.say(f"noise of a pixel ({attrs['noise']}): {share} of its value, {noise.floor:.2%} of the image's peak")
    show.say(f"camera: {f'{profile.name}, ' if profile else ''}{attrs['camera_uncertainty']}")
    show.notes(from_attribute(attrs["remarks"]))
    show.say(f"supported (std below 5 %) up to theta_d = {np.degrees(float(one['supported_angle'])):.1f}°")
    if tables is not None:
        rms = tables.sel(channel=channel)
        for i in np.argsort(rms["rms_corrected"].values, kind="stable")[:4]:
            name, after, before = str(rms["table"].values[i]), float(rms["rms_corrected"][i]), float(rms["rms_raw"][i])
            raw = f"{before:.1%} raw, " if np.isfinite(before) else ""  # the peaks may be missing
            show.say(f"against {name}: rms difference {raw}{after:.1%} corrected")
    else:
        show.say("not compared with published tables, because the wavelengths of the channels are unknown")
    show.written(files)
