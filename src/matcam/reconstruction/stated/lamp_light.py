"""Relative irradiance of each lamp position, from a table, a reference, or the specified stability of the lamp."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from matcam.acquisition.light.picture_light import LightAt, constant_light, stated_light
from matcam.acquisition.light.reference_patch import ReferencePatch, patch_light
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.radiometry import Radiometry
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Region, Stated


def gains_of(
    capture: Capture,
    radiometry: Radiometry,
    names: Sequence[str],
    lamps: np.ndarray,
    ball: MirrorBall,
    nearness: float,
    remarks: list[Remark],
) -> LightAt:
    """Determine the relative irradiance of each image, and the unit of the image values, from the reference.

    The result is a function of the directions and the inverse distance of the lamps, which the joint fit determines. Without
    a usable reference, the irradiance is assumed to be equal, with the specified standard deviation of the lamp. The remarks
    are for the directions `lamps` and the inverse distance `nearness`, 1/radii.
    """
    count, drift = len(names), max(float(capture.settings["lamp"]["gain_std"]), 1e-5)
    unknown = constant_light(count, drift)
    reference, region = capture.settings["reference"], capture.reference_position
    if reference is not None and reference["kind"] == "diffuse" and region is not None:
        # the highlights determine directions that are known to half a degree or worse
        read = partial(
            patch_light,
            _patch(capture, region),
            [radiometry.reference_light[name] for name in names],
            ball,
            lamp_std=np.full(count, min(capture.direction_std, float(np.radians(0.5)))),
            gain_std=drift,
            exposure_std=max(one.std / one.value for one in radiometry.exposures.values()),
            between=radiometry.reference_between,
        )
        found = read(lamps, nearness)
        if found is None:
            text = (
                "the diffuse reference is dark, clipped or lit at grazing incidence in every image, so F is relative: "
            )
            text += "correct reference.region_px or the exposures"
            remarks.append(Remark("no-reference", text))
        elif found.units is None:
            text = "F is relative, because the reflectance of the reference is unknown: specify reference.reflectance"
            remarks.append(Remark("no-reflectance", text))
        return lambda lamps, nearness: read(lamps, nearness) or unknown
    output = [radiometry.lamp_output.get(name) for name in names]
    known = np.array([one is not None and np.isfinite(one.value) and one.value > 0 for one in output])
    if not known.any():
        return lambda lamps, nearness: unknown
    if radiometry.reference_between >= drift:
        text = (
            f"the light changes by {radiometry.reference_between:.1%} between images of reference and sample, so the "
        )
        text += "reference is not used, and lamp.gain_std applies: include the reference in the frames of the sample"
        remarks.append(Remark("reference-unsteady", text))
        return lambda lamps, nearness: unknown
    gain = np.array([one.value if good and one is not None else 1.0 for one, good in zip(output, known, strict=True)])
    std = np.array(
        [one.std / one.value if good and one is not None else drift for one, good in zip(output, known, strict=True)]
    )
    measured = stated_light(gain, std)
    return lambda lamps, nearness: measured


def _patch(capture: Capture, region: Region) -> ReferencePatch:
    reference, radius = capture.settings["reference"], capture.radius_mm
    patch = ReferencePatch(region, tilt_std=float(np.radians(reference["tilt_std_deg"])))
    if reference["reflectance"] is not None:
        patch = patch._replace(reflectance=Stated(*reference["reflectance"]))
    if reference["depth_mm"] is not None and radius is not None:
        depth, std = reference["depth_mm"]
        patch = patch._replace(depth=Stated(depth / radius.value, std / radius.value))
    return patch
