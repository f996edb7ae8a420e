"""What veiling glare makes of a material: a haze and a diffuse part that are not there (MODEL 2)."""

from __future__ import annotations

import numpy as np
import xarray as xr

from matcam.camera.camera import Camera
from matcam.camera.optics.halo import HaloOptics
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import cosines
from matcam.core.jax import jnp
from matcam.forward.integral.blur import blur_of
from matcam.forward.integral.plan import Targets, planned
from matcam.forward.integral.recording import record
from matcam.material.material import Material
from matcam.rigs import Rig
from matcam.sample.sphere import Sphere

_THETA_H = np.radians([0.5, 1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 50, 60])


def false_light(material: Material, rig: Rig, theta_d: float = np.pi / 8) -> xr.Dataset:
    """What the halo of the rig's lens adds to a material, in the slice theta_d (rad) of its table, across the plane of
    camera and lamp (phi_d = pi / 2), where light and view stay high.

    Dataset over theta_h (rad) and channel: `true` BRDF, `recorded`, and `added` = recorded less what the same camera without
    its halo would have recorded, 1/sr; and `false_diffuse` over channel: the albedo of the Lambertian part that `added` is
    taken for far from the highlight (pi times its mean from 30 degrees on). ArgumentError if the lens has no halo.
    """
    optics = rig.camera.optics
    if not isinstance(optics, HaloOptics):
        raise ArgumentError("the lens has no halo: HaloOptics(core, fraction, radius)")
    if not isinstance(rig.sample, Sphere):
        raise ArgumentError(f"false light is told of a Sphere, not of a {type(rig.sample).__name__}")
    theta_d = float(checks.within("theta_d", theta_d, 0, np.pi / 4, "rad"))
    sphere = rig.sample
    theta_h, phi_d = _THETA_H, np.full(_THETA_H.size, np.pi / 2)
    lamps = np.asarray(sphere.lamp_angle(jnp.asarray([theta_d])))
    place = sphere.place(theta_h, np.full(theta_h.size, theta_d), phi_d)
    x, y, lamp = (np.asarray(a) for a in place)
    targets = Targets(x, y, lamp, np.zeros(x.size, dtype=np.int32))
    cos_i = np.asarray(cosines(theta_h, theta_d, phi_d)[0])[:, None]
    bare = Rig(Camera(optics.core, rig.camera.pixel), sphere, rig.lamp_radius, jitter=rig.jitter)
    blurs = blur_of(rig), blur_of(bare)
    with_halo, without = (
        np.asarray(record(material, sphere, blur, planned(sphere, blur, lamps, targets))) / cos_i for blur in blurs
    )
    true = np.asarray(material.brdf(theta_h, theta_d, phi_d)).reshape(theta_h.size, -1)
    dims = ("theta_h", "channel")
    added = with_halo - without
    return xr.Dataset(
        {
            "true": (dims, np.broadcast_to(true, added.shape), {"units": "1/sr"}),
            "recorded": (dims, with_halo, {"units": "1/sr"}),
            "added": (dims, added, {"units": "1/sr"}),
            "false_diffuse": ("channel", np.pi * added[np.degrees(theta_h) >= 29.9].mean(axis=0)),
        },
        coords={"theta_h": ("theta_h", theta_h, {"units": "rad"})},
        attrs={"theta_d": theta_d, "fraction": float(optics.fraction), "radius_px": float(optics.radius)},
    )
