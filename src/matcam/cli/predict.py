"""`matcam predict`: response and loss angle of a rig, by roughness and viewing angle."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.options import (
    AsJson,
    Family,
    Force,
    Power,
    option,
    use_caches,
)
from matcam.cli.rig_options import RigOptions, TurnedHaloRig
from matcam.core.io import check_picture, write_columns

_PARAMETERS = {
    "sigma_px": "lens sigma {:g} px",
    "f_number": "f/{:g}",
    "half_width_px": "pixel half width {:g} px",
    "blur_diameter_px": "blur diameter {:g} px",
}
"""Formats of the parameters of a camera in a title."""
_ANGLES = (0, 30, 45, 60, 75, 80, 85)


def command(
    roughness: Annotated[
        list[float] | None,
        typer.Argument(
            help="Widths of the lobe: alpha or beta (slopes), rad for gaussian. Default: seven from 0.001 to 0.1."
        ),
    ] = None,
    ndf: Family = "ggx",
    power: Power = None,
    dims: Annotated[
        int,
        option(
            "--dims",
            "N",
            "Dimensions: 2 for a real sample, 1 for the one-dimensional model of Holzschuch & Pacanowski (2017).",
        ),
    ] = 2,
    exact: Annotated[
        bool,
        typer.Option(
            "--exact",
            help="Integrate over the curved sample with its limb and Smith masking, instead of its tangent plane.",
        ),
    ] = False,
    rig: TurnedHaloRig = RigOptions(),
    map_: Annotated[
        Path | None,
        option("--map", "FILE", "Figure over roughness and angle to write; a .csv is written beside it."),
    ] = None,
    output: Annotated[
        Path | None,
        option("--output -o", "FILE", "Figure to write (.png, .pdf, .svg); a .csv is written beside it."),
    ] = None,
    force: Force = False,
    json: AsJson = False,
) -> None:
    """Predict the response of a rig at the peak of a lobe, and the loss angle.

    The response is the recorded peak divided by the true peak. At viewing angles below the loss angle, the response is at
    least 95 % of the response in normal view.

    With --glare, also predict the false haze and the false diffuse reflection of each material.

    Example: `matcam predict 0.001 0.01 0.1 --radius 400 -o loss.png --map plane.png`
    """
    for path in (output, map_):
        if path:
            check_picture(path, force=force, inputs=rig.files)
    if exact or rig.glare:
        use_caches()
    from matcam.core.registry import family_ndf
    from matcam.forward.prediction import predicted

    built = rig.build()
    values = roughness or [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1]
    with show.working("predicting"):
        lobes = [family_ndf(ndf, value, power) for value in values]
        data = predicted(built, lobes, dims, exact)
    false = _false_light(built, lobes) if rig.glare else []
    title = f"{ndf}{f' {power:g}' if power else ''} lobe on a {rig.sample}: response at 0°, and loss relative to 0°"
    if json:
        show.as_json(
            {
                "ndf": ndf,
                "power": power,
                "roughness": data.roughness,
                "loss_angle_deg": _degrees(data.loss_angle),
                "theta_deg": _degrees(data.theta),
                "response": data.response,
                "false_light": [{"diffuse": f["false_diffuse"].values, "haze_2deg": _haze(f)} for f in false],
            }
        )
    else:
        _print(data, title)
        if false:
            _print_false_light(data, false, rig.glare, rig.glare_radius)
    if output:
        _write(data, built, output, force)
    if map_:
        _map(built, ndf, power, (dims, exact), map_, force)
    for path in (output, map_):
        if path and not json:
            show.say(f"figure: {path}")


def _print(data: Any, title: str) -> None:
    at = [int(abs(data.theta - math.radians(angle)).argmin()) for angle in _ANGLES]
    rows = [
        [f"{value:g}", f"{r0:.1%}", *(f"{1 - r:.1%}" for r in relative[1:]), f"{angle:.1f}°" if angle < 90 else "-"]
        for value, r0, relative, angle in zip(
            data.roughness, data.response[:, 0], data.relative_response[:, at], _degrees(data.loss_angle), strict=True
        )
    ]
    show.table(["roughness", "response at 0°", *(f"{a}°" for a in _ANGLES[1:]), "5 % loss at"], rows, title)


def _print_false_light(data: Any, false: list[Any], glare: float, radius: float) -> None:
    show.table(
        ["roughness", "false diffuse", "haze at 2°", "at 5°", "at 10°"],
        [
            [f"{value:g}", f"{float(f['false_diffuse'][0]):.2g}", *(f"{_haze(f, a):.2g}" for a in (2, 5, 10))]
            for value, f in zip(data.roughness, false, strict=True)
        ],
        f"{glare:g} of the light in a halo of {radius:g} px: false albedo, and ratio of added to "
        "true BRDF off the half vector, for the Fresnel term of a perfect mirror",
    )


def _false_light(rig: Any, lobes: list[Any]) -> list[Any]:
    from matcam.forward.false_light import false_light
    from matcam.material.microfacet import Microfacet

    with show.working("computing the effect of the glare"):
        return [false_light(Microfacet(lobe, 1.0), rig) for lobe in lobes]


def _haze(false: Any, degrees: float = 2.0) -> float:
    """Compute the BRDF that the glare adds, divided by the true BRDF, no unit.

    degrees: angle theta_h of the half vector to the normal, degrees.
    """
    at = false.isel(channel=0).sel(theta_h=math.radians(degrees), method="nearest")
    return float(at["added"] / at["true"])


def _map(rig: Any, ndf: str, power: float | None, how: tuple[int, bool], path: Path, force: bool) -> None:
    import numpy as np

    from matcam.core.registry import family_ndf
    from matcam.figures.curves import plane_figure
    from matcam.figures.style import save
    from matcam.forward.prediction import predicted

    with show.working("drawing the map"):
        data = predicted(rig, [family_ndf(ndf, value, power) for value in np.geomspace(3e-4, 0.3, 49)], *how)
        write_columns(path.with_suffix(".csv"), data.columns(), force=force)
        save(
            plane_figure(data, f"Recorded share of the peak, relative to 0°: {rig.sample.in_words()}"),
            path,
            force=force,
        )


def _degrees(angles: Any) -> list[float]:
    import numpy as np

    return np.degrees(angles).tolist()


def _write(data: Any, rig: Any, output: Path, force: bool) -> None:
    from matcam.figures.curves import prediction_figure
    from matcam.figures.style import save

    numbers = [(name.split(".")[1], float(value)) for name, value in list(rig.camera.parameters().items())[:3]]
    parameters = ", ".join(_PARAMETERS.get(name, f"{name} {{:g}}").format(value) for name, value in numbers)
    write_columns(output.with_suffix(".csv"), data.columns(), force=force)
    save(
        prediction_figure(data, f"Recorded share of the peak: {rig.sample.in_words()}, {parameters}"),
        output,
        force=force,
    )
