"""Options that describe a rig, and construction of the rig from their values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from matcam.cli.options import Sampling, option
from matcam.core.errors import ArgumentError

if TYPE_CHECKING:
    from matcam.lamp.lamps import Lamp
    from matcam.rigs import Rig


@dataclass(frozen=True)
class RigOptions:
    """Values of the options that describe a rig. The defaults describe the MERL rig.

    A parameter of a command with the annotation `Annotated[RigOptions, "camera radius"]` represents the options
    `--camera` and `--radius`.
    """

    camera: Annotated[
        Path | None,
        option("--camera", "PROFILE", "Camera profile (JSON). Default: the MERL rig's camera."),
    ] = None
    sample: Annotated[
        Literal["sphere", "cylinder", "flat"],
        typer.Option(
            "--sample", help="Shape of the sample. The camera does not blur the reflectance of a flat sample."
        ),
    ] = "sphere"
    radius: Annotated[
        float | None,
        option("--radius", "PX", "Radius of the sample's limb in the image, px. Default: 256, as in the MERL rig."),
    ] = None
    distance: Annotated[
        float | None,
        option("--distance", "RADII", "Distance of the camera, in radii of the sample. Default: infinite."),
    ] = None
    lamp: Annotated[
        float,
        option("--lamp", "DEGREES", "Angular radius of the source disc as seen from the sample, degrees."),
    ] = 0.0
    lamp_distance: Annotated[
        float | None,
        option(
            "--lamp-distance",
            "RADII",
            "Distance of the lamp from the sample's centre, in radii of the sample; in mm with --sample-mm. "
            "Default: infinite.",
        ),
    ] = None
    sample_mm: Annotated[
        float | None,
        option("--sample-mm", "MM", "Radius of the sample, mm. With this option --lamp-distance is in mm."),
    ] = None
    azimuth: Annotated[
        float | None,
        option(
            "--azimuth",
            "DEGREES",
            "Azimuth of the lamp about the optical axis, degrees; 0 is right, 90 up. Default: from the table, or 0.",
        ),
    ] = None
    glare: Annotated[
        float,
        option(
            "--glare", "SHARE", "Share of the light that the lens scatters into a halo, added to its profile (no unit)."
        ),
    ] = 0.0
    glare_radius: Annotated[float, option("--glare-radius", "PX", "Standard deviation of the halo of --glare, px.")] = (
        30.0
    )
    sampling: Sampling = "centre"
    cell: Annotated[
        Literal["nearest", "bilinear", "mean"] | None,
        typer.Option(
            "--cell",
            help="Lookup of cells in real pixels; mean: mean of the pixels inside a cell. Default: estimated from the "
            "table; one pixel for each cell if the table does not determine it.",
        ),
    ] = None
    phase: Annotated[
        tuple[float, float] | None,
        option(
            "--phase",
            "X Y",
            "Offset of the pixel centres of --cell from the sphere's centre, modulo 1 px. "
            "Default: estimated from the table.",
        ),
    ] = None

    @property
    def files(self) -> list[Path]:
        return [] if self.camera is None else [self.camera]

    def build(self, **more: Any) -> Rig:
        """Build the rig. `more` are further arguments of `Rig`."""
        from matcam import rigs
        from matcam.camera.camera import Camera
        from matcam.camera.optics.halo import HaloOptics
        from matcam.core import checks
        from matcam.sample.curved import Cylinder, Sphere
        from matcam.sample.shape import Flat, Sample

        camera = rigs.merl().camera if self.camera is None else Camera.load(self.camera)
        if self.glare:
            checks.within("--glare", self.glare, 0, 1, open_high=True)
            checks.positive("--glare-radius", self.glare_radius, "px")
            optics = HaloOptics(camera.optics, self.glare, self.glare_radius)
            camera = Camera(optics, camera.pixel, camera.sensor, provenance=camera.provenance)
        size = 256.0 if self.radius is None else self.radius
        far = math.inf if self.distance is None else self.distance
        shape: Sample = (
            Flat() if self.sample == "flat" else {"sphere": Sphere, "cylinder": Cylinder}[self.sample](size, far)
        )
        turned = None if self.azimuth is None else math.radians(self.azimuth)
        return rigs.Rig(camera, shape, self._lamp(), lamp_azimuth=turned, **more)

    def of_table(self) -> Rig:
        return self.build(cell_value=self.cell or "unknown", pixel_phase=self.phase)

    def _lamp(self) -> Lamp:
        from matcam.core import checks
        from matcam.lamp.lamps import DistantLamp, NearLamp

        lamp, distance = DistantLamp(math.radians(self.lamp)), self.lamp_distance
        if distance is None:
            if self.sample_mm is not None:
                raise ArgumentError(
                    "--sample-mm sets the unit of --lamp-distance, but --lamp-distance is missing: give both"
                )
            return lamp
        if self.sample_mm is not None:
            distance /= float(checks.positive("--sample-mm", self.sample_mm, "mm"))
        return NearLamp(distance, math.tan(math.radians(self.lamp)) * distance if distance > 1 else 0.0)


_NEAR = "camera sample radius distance lamp lamp_distance sample_mm"
DistantRig = Annotated[RigOptions, "camera radius lamp"]
SphereRig = Annotated[RigOptions, "camera radius distance lamp_distance sample_mm"]
HaloRig = Annotated[RigOptions, f"{_NEAR} glare glare_radius"]
TurnedHaloRig = Annotated[RigOptions, f"{_NEAR} glare glare_radius azimuth"]
TurnedRig = Annotated[RigOptions, f"{_NEAR} azimuth"]
TableRig = Annotated[RigOptions, f"{_NEAR} azimuth sampling cell phase"]
