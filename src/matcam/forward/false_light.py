"""Apparent haze and apparent diffuse part that the glare of a lens adds to a record."""

from __future__ import annotations

import numpy as np
import xarray as xr

from matcam.camera.camera import Camera
from matcam.camera.optics.halo import HaloOptics
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import cosines
from matcam.core.results.labelled import named
from matcam.forward.integral.blur import imaging_of
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.record import record
from matcam.lamp.lamps import closeness
from matcam.material.material import Material
from matcam.rigs import Rig
from matcam.sample.curved import Sphere

_FALSE_LIGHT_THETA_H = np.radians([0.5, 1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 50, 60])
_NAMES = {
    "true": "BRDF of the material [1/sr]",
    "recorded": "BRDF as recorded, with the halo [1/sr]",
    "added": "BRDF that the halo adds [1/sr]",
    "false_diffuse": "albedo that the halo adds",
}
"""Description and unit of each variable of the result."""


def false_light(material: Material, rig: Rig, theta_d: float = np.pi / 8) -> xr.Dataset:
    """Predict the haze and the diffuse part that a halo adds.

    Both are veiling glare of the highlight (docs/model.md 2). The normals are tilted perpendicularly to the plane of
    camera and lamp (phi_d = pi / 2). The directions to lamp and camera are then far from the horizon.

    Args:
        material: the material.
        rig: a rig with a `Sphere` and a `HaloOptics`.
        theta_d: difference angle of the slice of the table, in [0, pi/4], rad. Default: pi / 8.

    Returns:
        Dataset. Over theta_h (rad) and channel it has the BRDFs `true` and `recorded`, and `added`, the recorded BRDF
        minus the BRDF recorded without the halo, 1/sr. Over channel it has `false_diffuse`, no unit: the albedo of the
        Lambertian part that would explain `added` far from the highlight. This is pi times the mean of `added` for
        theta_h of at least 30 degrees.

    Raises:
        ArgumentError: the lens has no halo, the sample is not a sphere, or `theta_d` is out of its range.
    """
    optics = rig.camera.optics
    if not isinstance(optics, HaloOptics):
        raise ArgumentError("the lens has no halo: use HaloOptics(core, fraction, radius)")
    if not isinstance(rig.sample, Sphere):
        raise ArgumentError(
            f"the prediction of false light needs a sphere, got a {type(rig.sample).__name__}: use a rig with a Sphere"
        )
    theta_d = float(checks.within("theta_d", theta_d, 0, np.pi / 4, "rad"))
    sphere = rig.sample
    theta_h, phi_d = _FALSE_LIGHT_THETA_H, np.full(_FALSE_LIGHT_THETA_H.size, np.pi / 2)
    near = rig.lamp.nearness
    position = sphere.position(theta_h, np.full(theta_h.size, theta_d), phi_d, near)
    x, y, lamp = (np.asarray(a) for a in position)
    positions, finest = RecordPositions(x, y, lamp), float(material.finest)
    cos_i = cosines(theta_h, theta_d, phi_d)[0]
    irradiance = np.asarray(cos_i * closeness(near, cos_i) ** 2)[:, None]
    bare = Rig(Camera(optics.core, rig.camera.pixel), sphere, rig.lamp, jitter=rig.jitter)
    with_halo, without = (
        np.asarray(record(material, imaging, record_plan(imaging, positions, finest))) / irradiance
        for imaging in (imaging_of(rig, gaussian_disc=True), imaging_of(bare, gaussian_disc=True))
    )
    true = np.asarray(material.brdf(theta_h, theta_d, phi_d)).reshape(theta_h.size, -1)
    dims = ("theta_h", "channel")
    added = with_halo - without
    far = np.degrees(theta_h) > 29.9
    data = xr.Dataset(
        {
            "true": (dims, np.broadcast_to(true, added.shape)),
            "recorded": (dims, with_halo),
            "added": (dims, added),
            "false_diffuse": ("channel", np.pi * added[far].mean(axis=0)),
        },
        coords={"theta_h": theta_h},
        attrs={"theta_d": theta_d, "fraction": float(optics.fraction), "radius_px": float(optics.radius)},
    )
    return named(data, _NAMES)
