"""Rig and material of the plan view, also as a command line, as Python and as a rig file."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from matcam.app.controls import Setting
from matcam.core.registry import FAMILIES

if TYPE_CHECKING:
    from matcam.material.microfacet import Microfacet
    from matcam.rigs import Rig

SETTINGS = (
    Setting("sigma", "lens blur, std [px]", 0.05, 5, 0.5, log=True),
    Setting("half_width", "pixel half width [px]", 0.05, 0.5, 0.5),
    Setting("radius", "sphere radius [px]", 20, 2000, 256, log=True),
    Setting("distance", "camera distance [radii]", 2, 999, math.inf, log=True, infinite=True),
    Setting("lamp_distance", "lamp distance [radii]", 2, 999, math.inf, log=True, infinite=True),
    Setting("lamp_radius", "lamp radius [degrees]", 0, 5, 0),
    Setting("roughness", "roughness [slope]", 0.0005, 0.3, 0.01, log=True),
    Setting("glare", "glare, share of light", 0, 0.05, 0),
    Setting("theta_d", "images: θ_d [degrees]", 5, 80, 45),
)

OTHERS = (0.001, 0.005, 0.02, 0.1)
"""Roughnesses whose curves are drawn for comparison with the selected roughness."""

PRESETS = {
    "MERL": {"sigma": 0.5, "half_width": 0.5, "radius": 256},
    "phone": {
        "sigma": 0.8,
        "half_width": 0.5,
        "radius": 600,
        "distance": 12,
        "lamp_distance": 20,
        "lamp_radius": 0.5,
        "glare": 0.01,
    },
    "machine vision": {
        "sigma": 0.45,
        "half_width": 0.45,
        "radius": 400,
        "distance": 30,
        "lamp_distance": 30,
        "lamp_radius": 0.2,
        "glare": 0.002,
    },
}
"""Predefined rigs. Omitted distances are infinite, and other omitted entries are 0."""

GLARE_RADIUS = 30.0
"""Standard deviation of the halo, px: the default of `matcam predict --glare-radius`."""


@dataclass(frozen=True)
class Planned:
    """Rig and material of the plan view.

    Attributes:
        sigma: standard deviation of the lens's blur, px.
        half_width: half width of a pixel, px.
        radius: radius of the sphere, px.
        distance: distance of the camera, radii of the sphere; it may be infinite.
        lamp_distance: distance of the lamp, radii of the sphere; it may be infinite.
        lamp_radius: angular radius of the source disc, degrees.
        roughness: roughness of the chosen lobe, slope (no unit).
        glare: share of the light in the halo, no unit.
        theta_d: difference angle of the images, degrees.
        metal: name of a metal. Default: "Cr".
        family: family of the lobe. Default: "ggx".
        n_and_k: refractive index n and extinction coefficient k for green light, no unit. Default: None, those of the metal.
    """

    sigma: float
    half_width: float
    radius: float
    distance: float
    lamp_distance: float
    lamp_radius: float
    roughness: float
    glare: float
    theta_d: float
    metal: str = "Cr"
    family: str = "ggx"
    n_and_k: tuple[float, float] | None = None

    @property
    def roughnesses(self) -> list[float]:
        return sorted({self.roughness, *OTHERS})

    @property
    def loses_at_most_cos(self) -> bool:
        """True if the relative response at a viewing angle theta is at least cos(theta).

        This holds for a point lamp, if camera and lamp are infinitely distant.
        """
        return self.lamp_radius == 0 and math.isinf(self.distance) and math.isinf(self.lamp_distance)

    def rig(self) -> Rig:
        from matcam.camera.camera import Camera
        from matcam.camera.optics.gaussian import GaussianOptics
        from matcam.camera.optics.halo import HaloOptics
        from matcam.camera.pixel import BoxPixel
        from matcam.lamp.lamps import DistantLamp, NearLamp
        from matcam.rigs import Rig
        from matcam.sample.curved import Sphere

        lens: Any = GaussianOptics(self.sigma)
        if self.glare:
            lens = HaloOptics(lens, self.glare, GLARE_RADIUS)
        angle = math.radians(self.lamp_radius)
        lamp: Any = DistantLamp(angle)
        if math.isfinite(self.lamp_distance):
            lamp = NearLamp(self.lamp_distance, math.tan(angle) * self.lamp_distance)
        return Rig(Camera(lens, BoxPixel(self.half_width)), Sphere(self.radius, self.distance), lamp)

    def lobes(self) -> list[Any]:
        return [FAMILIES[self.family](r) for r in self.roughnesses]

    def material(self) -> Microfacet:
        import numpy as np

        from matcam.material.microfacet import Microfacet
        from matcam.material.reflectance import Conductor

        n, k = self.n_and_k or green_indices(self.metal)
        return Microfacet(FAMILIES[self.family](self.roughness), Conductor(np.array([n]), np.array([k])))

    def camera_profile(self) -> str:
        """Format the camera profile as JSON, without the glare.

        Rig file and command specify the glare separately.
        """
        from dataclasses import replace

        return json.dumps(replace(self, glare=0.0).rig().camera.profile(), indent=2)

    def rig_file(self) -> str:
        """Format the rig as TOML for `--rig`.

        The rig file refers to the profile camera.json in the same folder.
        """
        from matcam.files.capture_writing import as_toml

        lens = {"distance": self.distance} if math.isfinite(self.distance) else {}
        if self.glare:
            lens |= {"glare": self.glare, "glare_radius_px": GLARE_RADIUS}
        lamp = {"radius_deg": self.lamp_radius} if self.lamp_radius else {}
        if math.isfinite(self.lamp_distance):
            lamp["distance"] = self.lamp_distance
        sections = {"sample": {"shape": "sphere", "radius_px": self.radius}, "lens": lens, "lamp": lamp}
        head = {"schema": "matcam-rig-1", "camera": "camera.json"}
        return as_toml(head | {name: values for name, values in sections.items() if values})

    def command(self) -> str:
        words = [
            "matcam predict",
            *(f"{r:g}" for r in self.roughnesses),
            f"--ndf {self.family}",
            "--camera camera.json",
        ]
        numbers = {"radius": self.radius, "distance": self.distance, "lamp": self.lamp_radius}
        numbers["lamp-distance"] = self.lamp_distance
        if self.glare:
            numbers |= {"glare": self.glare, "glare-radius": GLARE_RADIUS}
        words += [f"--{name} {value:g}" for name, value in numbers.items() if value and math.isfinite(value)]
        return " ".join(words)

    def python(self) -> str:
        lens = f"matcam.GaussianOptics({self.sigma:g})"
        if self.glare:
            lens = f"matcam.HaloOptics({lens}, {self.glare:g}, {GLARE_RADIUS:g})"
        distance = f", {self.distance:g}" if math.isfinite(self.distance) else ""
        lamp = f"matcam.DistantLamp(math.radians({self.lamp_radius:g}))"
        if math.isfinite(self.lamp_distance):
            far = f"{self.lamp_distance:g}"
            lamp = f"matcam.NearLamp({far}, math.tan(math.radians({self.lamp_radius:g})) * {far})"
        lobe = {"ggx": "GGX", "beckmann": "Beckmann", "gaussian": "GaussianNDF"}[self.family]
        return (
            "import math\nimport matcam\n"
            f"camera = matcam.Camera({lens}, matcam.BoxPixel({self.half_width:g}))\n"
            f"rig = matcam.Rig(camera, matcam.Sphere({self.radius:g}{distance}), {lamp})\n"
            f"angle = matcam.loss_angle(rig, matcam.{lobe}({self.roughness:g}))  # rad\n"
        )


def green_indices(name: str) -> tuple[float, float]:
    from matcam.core.grid import CHANNEL_WAVELENGTHS
    from matcam.material.optical_constants import metal

    n, k, _ = metal(name, [CHANNEL_WAVELENGTHS[1]])
    return float(n[0]), float(k[0])
