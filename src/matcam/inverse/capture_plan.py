"""Lamp angles, exposures, radius and tolerances for a wanted accuracy of the Fresnel term F (docs/model.md 10).

`limits` computes the accuracy that pixels and lens allow. An error of an angle results in F at another angle, so the
tolerances of the geometry follow from the slope of F. A relative error of the image gain is an equal relative error of F.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import jnp
from matcam.core.workspace import Workspace
from matcam.forward.peaks.peak import peak_response
from matcam.inverse.recoverability import limits
from matcam.material.ndf.ggx import GGX
from matcam.material.reflectance import fresnel_conductor
from matcam.rigs import Rig
from matcam.sample.curved import Sphere

_FIRST = 5.0
"""theta_d of the first lamp position, degrees. F is nearly constant below this angle."""
_STEP = 4.5
"""Largest step of theta_d between lamp positions, degrees."""
_SHARES = 4.0
"""Number of independent sources of error that share the wanted accuracy: lamp angle, image gain, outline and
pixels.
"""
_FLOOR = 30.0
"""Smallest useful signal of a pixel, in units of the read noise, which is then about 3 % of the signal."""
_STEP_OF_EXPOSURE = 4.0  # ratio of successive exposure times: two photographic stops
_RADII = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
"""Radii that are tried, as multiples of the radius of the rig. Neighbouring radii differ by
a factor of about sqrt(2), so that the number of pixels doubles.
"""


class CaptureNeeds(NamedTuple):
    """Requirements of a capture for a wanted accuracy of the Fresnel term F.

    Attributes:
        theta_d: difference angle at the highlight for each lamp position, rad, (n,).
        lamp_angle: angle between lamp and optical axis, seen from the sample's centre, rad, (n,).
        radius: smallest tried radius of the limb at which the pixels allow the accuracy, px; infinite if there is none.
        fresnel_std: for each radius that was tried, the radius, px, and the bound of the relative standard deviation of F at
            the largest wanted theta_d, no unit.
        exposures: number of exposures of each image. Their times differ by factors of 4.
        dynamic_range: ratio of the values of the brightest and the dimmest useful pixel, no unit.
        lamp_std: tolerance of the direction of each lamp, rad.
        outline_std: tolerance of centre and radius of the sphere, px.
        gain_std: relative tolerance of the image gain, no unit.
        slope: magnitude of the derivative of ln F with respect to theta_d, at the largest wanted theta_d, 1/rad.
    """

    theta_d: np.ndarray
    lamp_angle: np.ndarray
    radius: float
    fresnel_std: tuple[tuple[float, float], ...]
    exposures: int
    dynamic_range: float
    lamp_std: float
    outline_std: float
    gain_std: float
    slope: float

    def to_dict(self) -> dict[str, Any]:
        """Convert the requirements to a dictionary for JSON, with angles in degrees."""
        return {
            "theta_d_deg": np.degrees(self.theta_d).tolist(),
            "lamp_angle_deg": np.degrees(self.lamp_angle).tolist(),
            "radius_px": self.radius,
            "fresnel_std": [list(pair) for pair in self.fresnel_std],
            "exposures": self.exposures,
            "dynamic_range": self.dynamic_range,
            "lamp_std_deg": math.degrees(self.lamp_std),
            "outline_std_px": self.outline_std,
            "gain_std": self.gain_std,
            "fresnel_slope_per_deg": self.slope * math.pi / 180,
        }


def plan_capture(
    rig: Rig,
    roughness: float,
    accuracy: float = 0.01,
    last: float = math.radians(75),
    *,
    n: float = 1.5,
    k: float = 0.0,
    workspace: Workspace | None = None,
) -> CaptureNeeds:
    """Plan a capture for a wanted accuracy of the Fresnel term F.

    Four independent errors contribute to the error of F: those of the lamp angle, the image gain, the outline, and the
    pixels. Each contribution may have half of the wanted standard deviation of F.

    Args:
        rig: camera with a Gaussian lens, a `Sphere` and a lamp, distant or near. Distances in radii stay constant when
            other radii of the sphere in the image are tried.
        roughness: alpha of a GGX lobe, no unit.
        accuracy: wanted relative standard deviation of the ratio of F at `last` to F at small angles, no unit, in
            [1e-4, 0.5]. Default: 0.01.
        last: largest theta_d at which F is wanted, rad, [0.2, 1.5]. Default: 75 degrees.
        n: refractive index of the material, no unit. Default: 1.5, for which F is steep at large angles.
        k: extinction coefficient of the material, no unit. Default: 0.
        workspace: store of results that depend only on the rig. Default: None, that of the process.

    Returns:
        Lamp positions, radius, exposures and tolerances.

    Raises:
        ArgumentError: an argument is out of range, or `limits` does not support the rig.

    Source:
        docs/model.md 8 and 10.
    """
    accuracy = float(checks.within("accuracy", accuracy, 1e-4, 0.5))
    last = float(checks.within("last", last, 0.2, 1.5, "rad"))
    if not isinstance(rig.sample, Sphere):
        raise ArgumentError(f"the sample must be a Sphere, got a {type(rig.sample).__name__}")
    share = accuracy / math.sqrt(_SHARES)
    reflectance = lambda t: float(fresnel_conductor(t, n, k))  # noqa: E731
    step = 1e-4
    slope = abs(math.log(reflectance(last + step) / reflectance(last - step))) / (2 * step)
    known = share / max(slope, 1e-6)
    radius = float(rig.sample.radius)
    end = min(math.degrees(last) + 5.0, 85.0)
    theta_d = np.radians(np.linspace(_FIRST, end, 1 + math.ceil((end - _FIRST) / _STEP)))
    bounds = []
    smallest = math.inf
    for factor in _RADII:
        size = factor * radius
        found = limits(
            _enlarged(rig, size),
            roughness=[roughness],
            workspace=workspace,
        )
        bound = float(np.interp(last, found["theta_d"].values, found["fresnel_std"].values[0]))
        bounds.append((size, bound))
        if bound <= share:
            smallest = size
            break
    at = smallest if math.isfinite(smallest) else bounds[-1][0]
    sensor = rig.camera.sensor
    # brightest: the recorded peak at the last angle; dimmest: 1 % of the peak at the first angle
    ends = np.array([theta_d[0], last])
    peaks = np.asarray(peak_response(_enlarged(rig, at), GGX(roughness), ends)) / np.cos(ends)
    ratio = 100 * peaks[1] / peaks[0] * reflectance(last) / reflectance(float(theta_d[0]))
    full = 1e4 if sensor is None else float(sensor.saturation) / max(_FLOOR * float(sensor.read_noise), 1.0)
    exposures = 1 + max(0, math.ceil(math.log(max(ratio / full, 1.0)) / math.log(_STEP_OF_EXPOSURE)))
    angles = np.asarray(rig.sample.lamp_angle(jnp.asarray(theta_d), rig.lamp.nearness))
    return CaptureNeeds(
        theta_d,
        angles,
        smallest,
        tuple(bounds),
        max(exposures, 2),
        float(ratio),
        2 * known,
        at * math.cos(last) * known / math.sqrt(2),
        share,
        slope,
    )


def _enlarged(rig: Rig, radius: float) -> Rig:
    """Replace the radius of the sphere in the image, px. Distances in units of the radius are constant."""
    assert isinstance(rig.sample, Sphere)
    distance = np.inf if rig.sample.distant else rig.sample.distance
    return eqx.tree_at(lambda r: r.sample, rig, Sphere(radius, distance))
