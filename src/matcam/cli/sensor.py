"""`matcam sensor`: characteristics of a sensor from a series of exposures (EMVA 1288)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.options import AsJson, Force, Mosaic, option, pitch_option
from matcam.core.errors import ArgumentError
from matcam.core.io import check_outputs, write_columns


def command(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="Folder of flat-field and dark frames, two or more of each exposure, in flat/ and dark/ or with names that "
            "begin with flat and dark; or a descriptor file of the EMVA 1288 reference data sets.",
        ),
    ],
    cfa: Mosaic = None,
    bits: Annotated[
        int | None,
        option("--bits", "N", "Depth of the codes. Default: from the descriptor or the largest code."),
    ] = None,
    camera: Annotated[
        Path | None,
        option("--camera", "PROFILE", "Camera profile (JSON) to which the sensor is added."),
    ] = None,
    profile: Annotated[
        Path | None,
        option("--profile", "FILE", "Camera profile to write: the profile of --camera with this sensor."),
    ] = None,
    pitch: Annotated[
        float | None,
        pitch_option(". Default: that of --camera, if it has one."),
    ] = None,
    output: Annotated[
        Path | None,
        option("--output -o", "FILE", "Figure to write (.png, .pdf, .svg). Default: FOLDER-sensor.png here."),
    ] = None,
    page: Annotated[
        Path | None, option("--page", "FILE", "HTML page to write, with values, remarks and figure.")
    ] = None,
    maps: Annotated[
        bool,
        typer.Option(
            "--maps", help="Also write maps of the response and the dark signal of the pixels, as two TIFF files."
        ),
    ] = False,
    force: Force = False,
    json: AsJson = False,
) -> None:
    """Measure gain, noise, dark current, linearity, saturation and fixed patterns of a sensor according to EMVA 1288.

    Example: `matcam sensor exposures --camera camera.json --profile camera-with-sensor.json --pitch 3.45`
    """
    from matcam.files.exposure_series import read_exposure_series

    if (profile is None) != (camera is None):
        raise ArgumentError("--profile writes the profile of --camera with this sensor: give both or neither")
    name = folder.resolve().stem
    output = output or Path(f"{name}-sensor.png")
    table = output.with_suffix(".csv")
    pictures = {f"{one}_map": output.with_name(f"{output.stem}-{one}.tif") for one in ("prnu", "dsnu")} if maps else {}
    inputs = [file for one in read_exposure_series(folder).sets for file in one.files] + ([camera] if camera else [])
    check_outputs([output, table, page, profile, *pictures.values()], force=force, inputs=inputs, figure=output)
    base, metres = _camera(camera, pitch)
    with show.stepping() as progress:
        from matcam.calibration.sensor.characterise import characterise_sensor

        found = characterise_sensor(folder, bits=bits, cfa=cfa, progress=progress)
    with show.working("writing"):
        from matcam.figures.sensor import sensor_figure, write_sensor_page
        from matcam.figures.style import save
        from matcam.files.float_pictures import write_float_tiff

        save(sensor_figure(found, name), output, force=force)
        write_columns(table, found.columns(), force=force)
        if page is not None:
            write_sensor_page(page, found, name, force=force)
        for attribute, path in pictures.items():
            write_float_tiff(path, getattr(found, attribute), force=force)
        if profile is not None:
            base.with_sensor(found.sensor(metres)).save(profile, force=force)
    files = [output, table, *(path for path in (page, profile) if path is not None), *pictures.values()]
    if json:
        show.as_json({**found.to_dict(), "files": files})
    else:
        _print(found, files)


def _camera(path: Path | None, pitch: float | None) -> tuple[Any, float]:
    """Load the profile to which the sensor is added, and determine the pixel pitch, m.

    `pitch` is the value of --pitch, um. Without it, the pitch in the profile is used. Without a profile, the results are
    None and NaN.
    """
    if path is None:
        return None, float("nan")
    from matcam.camera.camera import Camera

    camera = Camera.load(path)
    stated = [value for name, value in camera.parameters().items() if name.endswith("pixel_pitch_m")]
    if camera.sensor is not None:
        stated.append(camera.sensor.pitch)
    if pitch is not None:
        return camera, pitch * 1e-6
    if not stated:
        raise ArgumentError(f"{path} has no pixel pitch: give --pitch")
    return camera, float(stated[0])


def _print(found: Any, files: list[Path]) -> None:

    show.quantities(found.quantities(), head="characteristic")
    show.say(found.verdict)
    show.notes(found.remarks)
    show.written(files)
