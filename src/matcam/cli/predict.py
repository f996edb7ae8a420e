"""`matcam predict`: how far can this rig be trusted?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from matcam.cli import show
from matcam.cli.options import AsJson, CameraProfile, Force, LampRadius, Radius, rig_of

_ANGLES = (0, 30, 45, 60, 75, 80, 85)


def command(
    roughness: Annotated[
        list[float] | None,
        typer.Argument(help="Widths of the lobe: alpha or beta, rad for gaussian. Default: a row of them."),
    ] = None,
    ndf: Annotated[
        Literal["ggx", "gaussian", "beckmann", "epd", "sgd"], typer.Option("--ndf", help="Family of the lobe.")
    ] = "ggx",
    power: Annotated[
        float | None, typer.Option("--power", help="The power p of an epd or sgd lobe, which must be given.")
    ] = None,
    sample: Annotated[Literal["sphere", "cylinder"], typer.Option("--sample", help="Shape of the sample.")] = "sphere",
    dims: Annotated[int, typer.Option("--dims", help="2: a real sample; 1: the paper's one-dimensional model.")] = 2,
    camera: CameraProfile = None,
    radius: Radius = None,
    lamp: LampRadius = 0.0,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Picture to write (.png, .pdf, .svg); a .csv goes beside it.")
    ] = None,
    force: Force = False,
    json: AsJson = False,
) -> None:
    """How much of a highlight a rig keeps, and up to which angle it loses less than 5 %.

    Example: `matcam predict 0.001 0.01 0.1 --radius 400 -o loss.png`
    """
    from matcam._jax import use_compilation_cache
    from matcam.figures.style import check_picture

    inputs = [camera] if camera else []
    if output:
        check_picture(output, force=force, inputs=inputs)
    use_compilation_cache()
    from matcam.forward.peak import predict
    from matcam.material.families import ndf_of

    rig = rig_of(camera, radius, lamp, sample)
    values = roughness or [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1]
    with show.working("predicting"):
        data = predict(rig, [ndf_of(ndf, value, power) for value in values], dims)
    if output:
        _write(data, rig, output, force)
    if json:
        show.as_json(
            {
                "ndf": ndf,
                "power": power,
                "roughness": data["roughness"].values,
                "loss_angle_deg": _degrees(data["loss_angle"]),
                "theta_deg": _degrees(data["theta"]),
                "response": data["response"].values,
            }
        )
        return
    at = data.sel(theta=[a * 3.141592653589793 / 180 for a in _ANGLES], method="nearest")
    rows = [
        [f"{value:g}", f"{r0:.1%}", *(f"{1 - r:.1%}" for r in relative[1:]), f"{angle:.1f}°" if angle < 90 else "-"]
        for value, r0, relative, angle in zip(
            values,
            at["response"].values[:, 0],
            at["relative_response"].values,
            _degrees(data["loss_angle"]),
            strict=True,
        )
    ]
    head = ["roughness", "kept at 0°", *(f"{a}°" for a in _ANGLES[1:]), "5 % at"]
    show.table(
        head,
        rows,
        f"{ndf}{f' {power:g}' if power else ''} lobe on a {sample}: peak kept at 0°, and loss relative to that",
    )
    if output:
        show.say(f"picture: {output}")


def _degrees(angles) -> list[float]:  # type: ignore[no-untyped-def]
    import numpy as np

    return np.degrees(angles.values).tolist()


def _write(data, rig, output: Path, force: bool) -> None:  # type: ignore[no-untyped-def]
    from matcam.figures.prediction import prediction_figure
    from matcam.figures.style import save
    from matcam.files.columns import write_columns

    parameters = ", ".join(
        f"{name.split('.')[1]} {float(value):g}" for name, value in list(rig.camera.parameters().items())[:3]
    )
    write_columns(output.with_suffix(".csv"), data, force=force)
    save(prediction_figure(data, f"Loss at the specular peak: {rig.sample!r}, {parameters}"), output, force=force)
