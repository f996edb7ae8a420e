"""`matcam limits`: smallest standard deviations of the parameters that a rig can determine."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.options import (
    AsJson,
    option,
    use_caches,
)
from matcam.cli.rig_options import RigOptions, TurnedRig


def command(
    roughness: Annotated[
        list[float] | None,
        typer.Argument(help="Roughnesses (alpha, a slope) to evaluate. Default: ten from 0.0003 to 0.2."),
    ] = None,
    relative: Annotated[
        float, option("--noise", "SHARE", "Noise of a pixel, as a share of its value (no unit).")
    ] = 0.01,
    floor: Annotated[
        float,
        option("--floor", "SHARE", "Noise of a pixel, as a share of its slice's peak (no unit)."),
    ] = 1e-4,
    rig: TurnedRig = RigOptions(),
    json: AsJson = False,
) -> None:
    """Compute Cramer-Rao bounds of roughness and Fresnel term for a rig, and the effect of changes of the rig.

    Example: `matcam limits 0.0005 0.001 0.005 --radius 256`
    """
    workspace = use_caches()
    from matcam.camera.sensor import PixelNoise
    from matcam.inverse.recoverability import ROUGHNESSES, limits

    with show.stepping() as progress:
        found = limits(
            rig.build(),
            roughness=roughness or ROUGHNESSES,
            noise=PixelNoise(relative, floor, 0.01),
            workspace=workspace,
            progress=progress,
        )
    if json:
        show.as_json({**found.attrs, **{str(name): found[name].values for name in [*found.data_vars, *found.coords]}})
    else:
        _print(found)


def _print(found: Any) -> None:
    import numpy as np

    def share(value: float) -> str:
        return "-" if not np.isfinite(value) else f"{value:.2%}" if value < 1 else "> 100 %"

    rows = []
    for r in found["roughness"].values:
        one = found.sel(roughness=r)
        fine = np.flatnonzero(one["fresnel_std"].values < 0.05)
        last = f"{np.degrees(one['theta_d'].values[fine[-1]]):.0f}°" if fine.size else "none"
        rows.append(
            [
                f"{r:g}",
                share(float(one["width_std"])),
                share(float(one["width_std_stated"])),
                share(float(one["width_std_free"])),
                last,
            ]
        )
    show.table(
        ["roughness", "camera exact", "camera as specified", "lens free", "F known to 5 % up to"],
        rows,
        f"Smallest standard deviations of ln roughness, from {found.sizes['theta_d']} of 90 slices of theta_d, one channel, "
        f"and a noise of the gain of an image of {found.attrs['picture_gain']:.0%}",
    )
    rows = []
    for r in found["roughness"].values:
        pairs = zip(
            found["correlation"].sel(roughness=r).values, found["smallest"].sel(roughness=r).values, strict=True
        )
        rows.append([f"{r:g}", *(f"{correlation:.3f} / {smallest:.2g}" for correlation, smallest in pairs)])
    show.table(
        ["roughness", *map(str, found["blur"].values)], rows,
        "Blurs that resemble the lens: correlation (1: indistinguishable) / smallest detectable size",
    )  # fmt: skip
    rows = [
        [f"{r:g}", *(" / ".join(share(v) for v in found["width_std_changed"].sel(roughness=r, change=c).values)
                     for c in found["change"].values)]
        for r in found["roughness"].values
    ]  # fmt: skip
    show.table(
        ["roughness", *map(str, found["change"].values)], rows, "The same after a change: camera exact / lens free"
    )
