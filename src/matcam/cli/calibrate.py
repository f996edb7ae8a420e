"""`matcam calibrate`: a camera profile from photographs of charts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.options import (
    AsJson,
    Budget,
    Force,
    HalfWidth,
    Lens,
    Mosaic,
    Pitch,
    Wavelength,
    option,
    use_caches,
)
from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.core.io import check_outputs, write_columns
from matcam.core.readers.names import is_file, is_folder


def command(
    pictures: Annotated[
        list[Path],
        typer.Argument(
            help="Photographs of slanted edges to read, or folders of photographs: TIFF, PNG, JPEG, OpenEXR, camera raw."
        ),
    ],
    output: Annotated[Path, option("--output -o", "FILE", "Camera profile to write (JSON).")] = Path("camera.json"),
    model: Lens = "gaussian",
    half_width: HalfWidth = 0.5,
    fit_pixel: Annotated[
        bool,
        typer.Option(
            "--fit-pixel",
            help="Also fit the half width; the command fails if the images do not determine it to 10 %.",
        ),
    ] = False,
    wavelength: Wavelength = None,
    pitch: Pitch = None,
    f_number: Annotated[
        list[float] | None,
        option("--f-number", "F", "F-number: one for all images, or one for each image. Default: from the files."),
    ] = None,
    tone: Annotated[
        str,
        option(
            "--tone",
            "CURVE",
            "Tone curve: auto (8 bits are sRGB), linear, srgb, gamma:2.2, or a file with the linear value of each code.",
        ),
    ] = "auto",
    tone_patches: Annotated[
        Path | None,
        option(
            "--tone-patches",
            "FILE",
            "File with lines x y width height light: patches of the first image that determine its tone curve.",
        ),
    ] = None,
    channel: Annotated[
        list[str] | None,
        option(
            "--channel",
            "COLOUR",
            "Channel to measure: R, G, B, Y (luminance) or grey. Default: all channels of the images.",
        ),
    ] = None,
    cfa: Mosaic = None,
    chart: Annotated[
        Path | None,
        option("--chart", "FILE", "Description of the chart, as `matcam chart` writes it: measure all its targets."),
    ] = None,
    accept_sharpened: Annotated[
        bool, typer.Option("--accept-sharpened", help="Also measure sharpened and processed images.")
    ] = False,
    sensor: Annotated[
        Path | None,
        option(
            "--sensor", "PROFILE", "Camera profile whose sensor is copied to the new profile (see `matcam sensor`)."
        ),
    ] = None,
    budget: Budget = None,
    figure: Annotated[
        Path | None,
        option("--figure", "FILE", "Figure to write (.png, .pdf, .svg). Default: a .png file beside the profile."),
    ] = None,
    force: Force = False,
    json: AsJson = False,
) -> int:
    """Calibrate a camera from photographs of a chart, whose edges are found and measured automatically.

    Example: `matcam calibrate chart-1.dng chart-2.dng -o camera.json`
    """
    files = _files(pictures)
    figure = figure or output.with_suffix(".png")
    table = output.with_name(f"{output.stem}-edges.csv")
    if output.suffix.lower() != ".json":
        raise OutputError(f"output {output} is a camera profile: its name must end in .json")
    check_outputs([output, table, figure, budget], force=force, inputs=files, figure=figure)
    electronics = _sensor(sensor)
    with show.working(f"measuring {len(files)} image{'s' * (len(files) > 1)}"):
        use_caches()
        from matcam.calibration.camera.calibration import calibrate

        found = calibrate(
            files,
            model=model,
            half_width=None if fit_pixel else half_width,
            wavelength=None if wavelength is None else wavelength * 1e-9,
            pixel_pitch=None if pitch is None else pitch * 1e-6,
            f_numbers=None if f_number is None else (f_number if len(f_number) > 1 else f_number[0]),
            tone=_tone(tone, tone_patches, files),
            channels=channel,
            cfa=cfa,
            chart=chart,
            accept_sharpened=accept_sharpened,
        )
        written = _write(found, electronics, output, figure, table, files, force)
        if budget:
            written.append(_write_budget(found, budget, force))
    if json:
        show.as_json({**found.to_dict(), "files": written})
    else:
        _print(found, written, pitch)
    for name, why in found.failed.items():
        show.remark(f"left out: {name}: {why}")
    return 1 if found.failed else 0


def _write_budget(found: Any, path: Path, force: bool) -> Path:
    from matcam.numerics.budget import parameter_budgets, write_budgets

    budgets = []
    for channel, fit in found.channels.items():
        names = [f"{channel}: {name}" for name in fit.names]
        budgets += parameter_budgets(names, fit.values, fit.covariance)
    write_budgets(path, budgets, force=force)
    return path


def _sensor(path: Path | None) -> Any:
    if path is None:
        return None
    from matcam.camera.camera import Camera

    sensor = Camera.load(path).sensor
    if sensor is None:
        raise ArgumentError(f"{path} has no sensor: give --sensor a profile that `matcam sensor --profile` has written")
    return sensor


def _files(given: list[Path]) -> list[Path]:
    from matcam.core.readers.names import check_within
    from matcam.files.photographs import PICTURES

    files: list[Path] = []
    for path in given:
        if not is_folder(path):
            files.append(path)
            continue
        inside = sorted(p for p in path.iterdir() if p.suffix.lower() in PICTURES and is_file(p))
        if not inside:
            raise FileFormatError(
                f"{path}: this folder contains no images ({', '.join(PICTURES[:6])}, camera raw): give another folder"
            )
        for file in inside:
            check_within(file, path)
        files += inside
    return files


def _tone(tone: str, patches: Path | None, files: list[Path]) -> Any:

    if patches is not None:
        if tone != "auto":
            raise ArgumentError("--tone and --tone-patches both specify the tone curve: give one of them")
        from matcam.calibration.photograph.tone import patch_tone_curve

        return patch_tone_curve(files[0], patches)
    if tone in ("auto", "linear", "srgb"):
        return tone
    if tone.startswith("gamma:"):
        try:
            return float(tone.removeprefix("gamma:"))
        except ValueError:
            raise ArgumentError(f"--tone {tone!r}: a number must follow gamma:, such as gamma:2.2") from None
    if not is_file(Path(tone)):
        raise ArgumentError(
            f"--tone must be auto, linear, srgb, gamma:NUMBER or a file, got {tone!r}, which is not a file"
        )
    from matcam.files.tone_curve import read_tone_curve

    return read_tone_curve(tone)


def _write(
    found: Any, sensor: Any, output: Path, figure: Path, table: Path, files: list[Path], force: bool
) -> list[Path]:
    from matcam.figures.calibration import calibration_figure
    from matcam.figures.style import save
    from matcam.files.photographs import open_photograph

    profiles = {output: found.camera}
    if len(found.channels) > 1:
        colours = {**found.cameras, "RGB": found.colour_camera}
        profiles |= {output.with_name(f"{output.stem}-{name}.json"): one for name, one in colours.items() if one}
    check_outputs(profiles, force=force, inputs=files)
    used = next(file for file in files if str(file) not in found.failed)
    picture = open_photograph(used).values
    for path, camera in profiles.items():
        (camera if sensor is None else camera.with_sensor(sensor)).save(path, force=force)
    write_columns(table, found.edges_dataset(), force=force)
    save(calibration_figure(found, picture, _verdict(found)), figure, force=force)
    return [*profiles, table, figure]


def _verdict(found: Any) -> list[str]:
    lines = []
    for name, fit in found.channels.items():
        numbers = ", ".join(
            f"{label} = {value:.4g} ± {std:.2g}"
            for label, value, std in zip(fit.names, fit.values, fit.std, strict=True)
        )
        if fit.edges is None:
            count = sum(fit.measurements.values())
            lines.append(f"{name}: {numbers}  (no edges, {count} other measurement{'s' * (count != 1)})")
            continue
        how = "explains the edges" if fit.consistent else "does NOT explain the edges (try --model measured or halo)"
        varies = f", whose blur varies by {fit.spread:.1%}" if round(fit.spread, 3) else ""
        lines.append(f"{name}: {numbers}  ({fit.edges.x.size} edges{varies})")
        lines.append(
            f"   the camera {how}: their MTFs differ by at most {fit.misfit:.4f} ± {fit.misfit_std:.4f} below Nyquist"
        )
    return lines


def _print(found: Any, written: list[Path], pitch: float | None) -> None:
    for line in _verdict(found):
        show.say(line)
    if pitch:
        from matcam.camera.kernel import mtf50

        for name, camera in found.cameras.items():
            for half in mtf50(camera.optics, camera.pixel).values():
                show.say(f"{name}: MTF50 along the rows {half:.4f} cycles/px, {half * 1000 / pitch:.2f} lp/mm")
    show.notes(found.remarks)
    show.written(written)
