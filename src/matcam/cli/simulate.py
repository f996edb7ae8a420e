"""`matcam simulate`: table or image of a known material as a rig records it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from matcam.cli import show
from matcam.cli.options import (
    AsJson,
    Device,
    Family,
    Force,
    Power,
    Sampling,
    choose_device,
    option,
    use_caches,
)
from matcam.cli.rig_options import HaloRig, RigOptions
from matcam.core.errors import ArgumentError
from matcam.core.io import check_outputs
from matcam.files.formats import suffixes_for

_TABLES, _PICTURES = (".binary", ".nc"), suffixes_for("picture")


def command(
    output: Annotated[
        Path | None,
        option(
            "--output -o", "FILE", "Table (.binary, .nc) or image (.exr, .tif; a .json is written beside it) to write."
        ),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Argument(help="Table of the material (.binary, .nc, .csv). Default: the lobe given by the options."),
    ] = None,
    roughness: Annotated[
        float,
        option("--roughness", "ALPHA", "Width of the lobe: alpha or beta (slopes), rad for gaussian."),
    ] = 0.01,
    ndf: Family = "ggx",
    power: Power = None,
    metal: Annotated[str, option("--metal", "SYMBOL", "Metal whose n and k give the Fresnel term.")] = "Cr",
    source: Annotated[
        str | None,
        option("--source", "SOURCE", "Published table of n and k. Default: the first table of the metal."),
    ] = None,
    diffuse: Annotated[float, option("--diffuse", "ALBEDO", "Albedo of a Lambertian part, 0 to 1 (no unit).")] = 0.0,
    lamp_angle: Annotated[
        float,
        option("--lamp-angle", "DEGREES", "Angle between lamp and camera in an image, degrees."),
    ] = 60.0,
    azimuth: Annotated[
        float,
        option("--azimuth", "DEGREES", "Azimuth of the lamp about the optical axis, degrees; 0 is right, 90 up."),
    ] = 0.0,
    cell: Annotated[
        Literal["centre", "edge", "mean", "nearest", "bilinear"],
        typer.Option("--cell", help="Definition of the value of a cell of a table."),
    ] = "centre",
    phase: Annotated[
        tuple[float, float] | None,
        option(
            "--phase",
            "X Y",
            "Offset of the pixel centres of --cell nearest, bilinear or mean from the sphere's centre, modulo 1 px.",
        ),
    ] = None,
    size: Annotated[
        tuple[int, int] | None,
        option("--size", "HEIGHT WIDTH", "Height and width of the image, px. Default: that of the sample."),
    ] = None,
    crop: Annotated[
        tuple[int, int] | None,
        option("--crop", "HEIGHT WIDTH", "Height and width of the used part of the sensor, which is centred, px."),
    ] = None,
    exposure: Annotated[
        float | None,
        option(
            "--exposure",
            "ELECTRONS",
            "Electrons per unit of radiance: simulate a raw image with the sensor of the profile and its noise.",
        ),
    ] = None,
    capture: Annotated[
        Path | None,
        option(
            "--capture",
            "DIR",
            "Folder to write a whole capture to, instead of --output: frames, dark frames, outline, reference, truth.",
        ),
    ] = None,
    positions: Annotated[
        int,
        option(
            "--lamp-positions",
            "N",
            "Number of lamp positions of --capture, theta_d from 5 to 82 degrees; or of tilts of a flat sample, from 0 to "
            "40 degrees.",
        ),
    ] = 18,
    preview: Annotated[
        Path | None,
        option("--preview", "FILE", "Figure of the image to write (.png, .pdf, .svg)."),
    ] = None,
    seed: Annotated[int, option("--seed", "N", "Seed of the noise of --exposure.")] = 0,
    rig: HaloRig = RigOptions(),
    sampling: Sampling = "centre",
    device: Device = None,
    force: Force = False,
    json: AsJson = False,
) -> None:
    """Simulate the record of a known material by a rig: a table, one image, or a capture of many images.

    Example: `matcam simulate --ndf ggx --roughness 0.005 --metal Cr --lamp-angle 60 -o chromium.exr`
    """
    lobe = {"ndf": ndf, "roughness": roughness, "power": power, "metal": metal, "source": source, "diffuse": diffuse}
    if (output is None) == (capture is None):
        raise ArgumentError("give either --output for a table or an image, or --capture for a folder of images")
    if capture is not None:
        if table or preview or exposure:
            raise ArgumentError(
                "--capture simulates the lobe of a metal with computed exposures: omit TABLE, --preview and --exposure"
            )
        plan: dict[str, Any] = {"azimuth": math.radians(azimuth), "shape": size}
        if rig.sample == "flat":
            plan["exposures"] = 2  # exposures without clipping
        _capture(lobe, rig.build(), plan, positions, capture, seed, force, json)
        return
    assert output is not None
    suffix = output.suffix.lower()
    if suffix not in _TABLES + _PICTURES:
        raise ArgumentError(f"{output}: the name of the output must end in one of {', '.join(_TABLES + _PICTURES)}")
    inputs = [*rig.files, *([table] if table else [])]
    files = [output, preview]
    if suffix in _PICTURES:
        from matcam.files.sidecar import sidecar_path

        files.insert(1, sidecar_path(output))
    elif preview:
        raise ArgumentError("--preview shows an image, but the output is a table: omit --preview")
    check_outputs(files, force=force, inputs=inputs, figure=preview)
    choose_device(device)
    use_caches()
    built = rig.build(cell_value=cell, pixel_phase=phase, crop=crop)
    turned = math.radians(azimuth)
    material, described = _tabulated(table, sampling) if table else _microfacet(lobe)
    if suffix in _TABLES:
        result = _table(material, built, turned, output, described, force)
    else:
        options = {"shape": size, "exposure": exposure, "seed": seed if exposure else None, "azimuth": turned}
        result = _picture(material, built, math.radians(lamp_angle), options, output, described, force)
        if preview:
            _preview(result.pop("picture"), described, built, preview, force)
        result.pop("picture", None)
    if json:
        show.as_json({**result, "material": described, "output": str(output)})
    else:
        show.say(f"{result['what']}: {output}")


def _capture(
    lobe: dict[str, Any],
    rig: Any,
    options: dict[str, Any],
    positions: int,
    folder: Path,
    seed: int,
    force: bool,
    json: bool,
) -> None:
    import numpy as np

    from matcam.core import checks
    from matcam.forward.synthetic_capture import CapturePlan, sensor_or_usual, simulate_capture

    checks.whole_number("--lamp-positions", positions, 1)
    use_caches()
    material, described = _microfacet(lobe)
    theta_d = np.radians(np.linspace(5, 82, positions)) if positions > 1 else [math.radians(45)]
    plan = CapturePlan(tuple(theta_d), **options)
    with show.tallying("drawing") as progress:
        truth = simulate_capture(
            material, sensor_or_usual(rig), plan, folder, seed=seed, force=force, progress=progress
        )
    if json:
        show.as_json({"capture": str(folder), "material": described, "truth": truth})
    else:
        show.say(f"capture of {positions} lamp positions, {plan.exposures} exposures each: {folder}")


def _tabulated(table: Path, sampling: Any) -> tuple[Any, dict[str, Any]]:
    from matcam.exchange.contents import read_table
    from matcam.material.measured import Tabulated

    return Tabulated(read_table(table, sampling=sampling)), {"table": table.name, "sampling": sampling}


def _microfacet(lobe: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    from matcam.core.grid import CHANNEL_WAVELENGTHS
    from matcam.core.registry import family_ndf
    from matcam.material.microfacet import Microfacet
    from matcam.material.optical_constants import metal
    from matcam.material.reflectance import Conductor

    n, k, source = metal(lobe["metal"], CHANNEL_WAVELENGTHS, *([lobe["source"]] if lobe["source"] else []))
    ndf = family_ndf(lobe["ndf"], lobe["roughness"], lobe["power"])
    return Microfacet(ndf, Conductor(n, k), lobe["diffuse"]), {**lobe, "source": source}


def _table(
    material: Any, rig: Any, azimuth: float, output: Path, described: dict[str, Any], force: bool
) -> dict[str, Any]:
    from matcam.files.datasets import write_netcdf
    from matcam.files.merl import write_merl
    from matcam.forward.measurement import measure

    with show.working("simulating every cell"):
        data = measure(material, rig, azimuth=azimuth)
    if output.suffix.lower() == ".nc":
        write_netcdf(output, data.assign_attrs(material=str(described)).to_dataset(), force=force)
    else:
        write_merl(output, data, force=force)
    return {"what": "table", "missing_share": float(data.isnull().mean()), "largest": float(data.max())}


def _picture(
    material: Any,
    rig: Any,
    lamp_angle: float,
    options: dict[str, Any],
    output: Path,
    described: dict[str, Any],
    force: bool,
) -> dict[str, Any]:
    from matcam.core.grid import CHANNEL_WAVELENGTHS
    from matcam.files.float_pictures import write_exr, write_float_tiff
    from matcam.files.sidecar import sidecar_path, write_sidecar
    from matcam.forward.image import picture

    with show.working("simulating the image"):
        image = picture(material, rig, lamp_angle, **options)
    height, width = image.shape[:2]
    about = rig.description()
    noise = {"electrons_per_radiance": [options["exposure"]], "times_s": [0.0], "seed": options["seed"]}
    write = write_exr if output.suffix.lower() == ".exr" else write_float_tiff
    write(output, image.values, force=force)
    write_sidecar(
        sidecar_path(output),
        picture={
            "file": output.name,
            "shape": list(image.shape),
            "quantity": image.attrs["quantity"],
            "channel_wavelengths_m": list(CHANNEL_WAVELENGTHS) if image.ndim == 3 and image.shape[2] == 3 else None,
            "axis_column_px": (width - 1) / 2,
            "axis_row_px": (height - 1) / 2,
        },
        camera=about["camera"],
        sample=about["sample"],
        lamp={
            "angles_rad": [lamp_angle],
            "azimuths_rad": [options["azimuth"]],
            "radius_rad": about["lamp_radius_rad"],
            "distance_radii": about["lamp_distance_radii"],
        },
        blur=about["blur"],
        exposure=noise if options["exposure"] else None,
        material=described,
        force=force,
    )
    return {
        "what": f"image of {width} x {height} px",
        "largest": float(image.max()),
        "units": image.attrs["units"],
        "picture": image,
    }


def _preview(image: Any, described: dict[str, Any], rig: Any, path: Path, force: bool) -> None:
    from matcam.figures.spheres import picture_figure
    from matcam.figures.style import save

    name = described.get("table") or f"{described['metal']}, {described['ndf']} {described['roughness']:g}"
    angle = math.degrees(image.attrs["lamp_angle"])
    save(
        picture_figure(image, f"{name}, lamp {angle:.0f}° from the camera: {rig.sample.in_words()}"), path, force=force
    )
