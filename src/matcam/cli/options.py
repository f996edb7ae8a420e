"""Options that several commands share, and the rig that they describe."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

if TYPE_CHECKING:
    from matcam.rigs import Rig

CameraProfile = Annotated[
    Path | None,
    typer.Option("--camera", metavar="PROFILE", help="Camera profile (JSON). Default: the camera of the MERL rig."),
]
Radius = Annotated[
    float | None,
    typer.Option("--radius", metavar="PX", help="Radius of the sphere's picture in px. Default: 256, MERL's."),
]
LampRadius = Annotated[
    float, typer.Option("--lamp", metavar="DEGREES", help="Angular radius of the lamp's disc, degrees.")
]
Masking = Annotated[
    Literal["smith", "smith-separable", "van-ginneken", "none"],
    typer.Option("--masking", help="Masking G that the Fresnel term is freed from."),
]
Sampling = Annotated[
    Literal["centre", "edge"],
    typer.Option("--sampling", help="Where in its cell a tabulated value was sampled; the file does not say."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace existing output.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON, and nothing else, on standard output.")]


Distance = Annotated[
    float | None, typer.Option("--distance", help="Distance of the camera in radii of the sample. Default: far away.")
]
Glare = Annotated[
    float, typer.Option("--glare", help="Share of the light that the lens scatters around, beside its profile.")
]
GlareRadius = Annotated[float, typer.Option("--glare-radius", help="Standard deviation of that halo, px.")]


def rig_of(
    camera: Path | None,
    radius: float | None,
    lamp_degrees: float,
    sample: str = "sphere",
    distance: float | None = None,
    glare: float = 0.0,
    glare_radius: float = 30.0,
    **more: Any,
) -> Rig:
    """The MERL rig, with what the user has replaced."""
    from matcam import rigs
    from matcam.camera.camera import Camera
    from matcam.camera.optics.halo import HaloOptics
    from matcam.sample.cylinder import Cylinder
    from matcam.sample.shape import Flat, Sample
    from matcam.sample.sphere import Sphere

    merl = rigs.merl()
    chosen = merl.camera if camera is None else Camera.load(camera)
    if glare:
        optics = HaloOptics(chosen.optics, glare, glare_radius)
        chosen = Camera(optics, chosen.pixel, chosen.sensor, provenance=chosen.provenance)
    size = 256.0 if radius is None else radius
    far = math.inf if distance is None else distance
    shape: Sample = Flat() if sample == "flat" else {"sphere": Sphere, "cylinder": Cylinder}[sample](size, far)
    return rigs.Rig(chosen, shape, math.radians(lamp_degrees), **more)
