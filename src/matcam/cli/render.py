"""`matcam render`: an image of a sphere of a material."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from matcam.cli import show
from matcam.cli.inputs import check_inputs
from matcam.cli.options import AsJson, Force, Sampling, option, use_caches
from matcam.core.errors import ArgumentError
from matcam.core.io import check_output, check_picture


def command(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE [FILE]", help="Table to read, or two tables to compare.")
    ],
    output: Annotated[
        Path | None,
        option(
            "--output -o",
            "FILE",
            "Figure (.png, .pdf, .svg) or linear radiance of one file (.exr) to write. Default: FILE-render.png here.",
        ),
    ] = None,
    lamp_angle: Annotated[float, option("--lamp-angle", "DEGREES", "Angle between lamp and camera, degrees.")] = 40.0,
    environment: Annotated[
        Path | None,
        option("--environment", "EXR", "Environment map that lights the sphere instead of the lamp."),
    ] = None,
    exposure: Annotated[
        float,
        option("--exposure", "FACTOR", "Factor by which radiance is multiplied before display (no unit)."),
    ] = 0.8,
    size: Annotated[int, option("--size", "PX", "Height and width of the image of a sphere, px.")] = 256,
    samples: Annotated[int, option("--samples", "N", "Number of rays for each pixel.")] = 64,
    sampling: Sampling = "centre",
    force: Force = False,
    json: AsJson = False,
) -> None:
    """Render a sphere of a measured material under a lamp or an environment map with Mitsuba 3.

    Two files are rendered side by side.

    Example: `matcam render chrome.binary chrome-corrected.binary -o chrome.png`
    """
    from matcam.core import checks

    checks.extra("rendering", "render", "mitsuba")
    if len(files) > 2:
        raise ArgumentError(f"give one file, or two files to show side by side, got {len(files)}")
    if not (exposure > 0 and math.isfinite(exposure)):
        raise ArgumentError(f"--exposure must be above 0 and finite, got {exposure:g}")
    target = Path(f"{files[0].name.split('.')[0]}-render.png") if output is None else output
    inputs = [*files, *([environment] if environment else [])]
    linear = target.suffix.lower() == ".exr"
    if linear and len(files) > 1:
        raise ArgumentError("an .exr file contains the image of one sphere: render each table with a separate command")
    (check_output if linear else check_picture)(target, force=force, inputs=inputs)
    check_inputs(inputs)
    from matcam.exchange.contents import material_of, read_contents
    from matcam.exchange.renderers import rendered_sphere
    from matcam.figures.spheres import spheres_figure
    from matcam.figures.style import save
    from matcam.files.float_pictures import write_exr

    use_caches()
    pictures, notes = {}, []
    for number, file in enumerate(files):
        with show.working(f"rendering {file.name}"):
            contents = read_contents(file, sampling)
            negative = 0.0 if contents.brdf is None else float((contents.brdf.values < 0).mean())
            if negative > 0.01:
                notes.append(
                    f"{file.name}: {negative:.0%} of the values are negative because of noise; they are rendered as 0, which "
                    "brightens the sphere away from the highlight"
                )
            material = material_of(contents)
            angle = math.radians(lamp_angle)
            picture = rendered_sphere(material, lamp_angle=angle, environment=environment, size=size, samples=samples)
        pictures[file.name if file.name not in pictures else f"{file.name} ({number + 1})"] = picture
    light = f"under {environment.name}" if environment else f"lamp {lamp_angle:g}° from the camera, uniform sky"
    if linear:
        write_exr(target, picture, force=force)
    else:
        save(spheres_figure(pictures, light, exposure), target, force=force)
    if json:
        means = {name: [float(v) for v in p.mean(axis=(0, 1))] for name, p in pictures.items()}
        show.as_json({"output": str(target), "files": files, "light": light, "mean_radiance": means})
    else:
        show.say(f"{', '.join(f.name for f in files)}, {light}: {target}")
        show.notes(notes)
