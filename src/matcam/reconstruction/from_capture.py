"""Reconstruction from a capture of a sphere, a cylinder or a flat sample."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from matcam.acquisition.light.kept_work import KeptWork
from matcam.acquisition.radiometry import Progress
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.registry import FAMILIES
from matcam.files.capture import Capture, read_capture
from matcam.inverse.fit.fit_setup import AUTO
from matcam.material.masking import MASKINGS, Masking
from matcam.reconstruction.cylinder.captured_cylinder import captured_cylinder
from matcam.reconstruction.cylinder.cylinder_pixels import cylinder_pixels
from matcam.reconstruction.cylinder.strips import strip_profiles
from matcam.reconstruction.flat.flat_reconstruction import FlatReconstruction, reconstruct_flat
from matcam.reconstruction.reconstruction import Reconstruction, reconstructed
from matcam.reconstruction.rig.rig_document import EarlierRig, read_rig
from matcam.reconstruction.sphere_fit import fit_sphere
from matcam.reconstruction.stated.captured_scene import captured_scene


def reconstruct(
    capture: Capture | str | Path,
    ndf: str = AUTO,
    *,
    masking: Masking = "smith",
    diffuse: bool = True,
    rig_from: EarlierRig | str | Path | None = None,
    progress: Progress | None = None,
    workers: int = 1,
    keep: str | Path | None = None,
) -> Reconstruction | FlatReconstruction:
    """Reconstruct a material from photographs of a sample under a moved lamp.

    Spheres, cylinders and flat samples are supported. Exposures, noise and clipping are estimated from the frames, and
    the frames of each lamp position are merged to one image. Outline and highlights give a first estimate of the geometry. Then
    lobe, reflectance, diffuse part, lens, outline, lamps and distances are fitted jointly to the pixels of all images. The
    specified values of the capture are the priors. Standard deviations include the uncertainty of all these quantities,
    and the unexplained residual. For a flat sample, maps of the texture are estimated at each frequency instead.

    Args:
        capture: capture, as returned by `files.capture.read_capture`, or its folder.
        ndf: family of the lobe: "ggx", "epd", "sgd", "beckmann" or "gaussian"; for a flat sample, "ggx", "beckmann" or
            "gaussian". Default: "auto", the more probable of "ggx" and "epd", spline-modified if that reduces the
            residual. For a cylinder with strips of several orientations, "auto" is GGX with two roughnesses; for a flat
            sample, it is "ggx".
        masking: model of the masking of the lobe: "smith", "smith-separable", "van-ginneken" or None. Default: "smith".
        diffuse: True if the material may have a Lambertian part; not used for a flat sample. Default: True.
        rig_from: earlier reconstruction of a sphere with the same rig, or its JSON file. The earlier lens, distances,
            lamps and distortion, with their covariance, replace the specified values of the capture. Default: None, the
            specified values are used.
        progress: function that is called with the name of a step, the number of finished parts and the number of all parts.
            Default: None.
        workers: number of lamp positions whose frames are read at the same time, in threads. Default: 1.
        keep: folder for intermediate results, from which an interrupted computation resumes. Default: None, not stored.

    Returns:
        `Reconstruction` with table, parameters, geometry, error budget and remarks; for a flat sample,
        `FlatReconstruction` with the maps and their resolution.

    Raises:
        ArgumentError: an argument is wrong or unsuitable for the sample, or `rig_from` is of another rig.
        FileFormatError: a file of the capture, or the file `rig_from`, is missing or invalid.
        FitError: the frames do not determine the result. For example, no outline was found, or too few lamp positions
            can be used.

    Source:
        docs/model.md 10.

    Example:
        >>> found = matcam.reconstruct("shots/")  # doctest: +SKIP
        >>> print(found.verdict)  # doctest: +SKIP
        >>> matcam.reconstruct("no-such-folder")
        Traceback (most recent call last):
        ...
        matcam.core.errors.FileFormatError: no-such-folder: no such folder
    """
    checks.choice("ndf", ndf, (AUTO, *FAMILIES))
    checks.choice("masking", masking, MASKINGS)
    checks.flag("diffuse", diffuse)
    if not isinstance(capture, Capture):
        capture = read_capture(capture)
    say = progress or (lambda step, done, total: None)
    checks.whole_number("workers", workers, 1)
    kind = capture.settings["sample"]["kind"]
    if rig_from is not None and kind != "sphere":
        raise ArgumentError(f"rig_from requires photographs of a sphere, but sample.kind is {kind}: omit rig_from")
    if kind == "flat" and not diffuse:
        raise ArgumentError(
            "diffuse = False cannot be given for a flat sample, whose result has a map of the diffuse albedo: omit --no-diffuse"
        )
    kept = None if keep is None else KeptWork(Path(keep))
    if kind == "flat":
        return reconstruct_flat(capture, ndf, masking=masking, progress=progress, workers=workers, kept=kept)
    steps = iter(range(1, 1000))

    def fitting(line: str) -> None:
        say(f"fitting ({line})", next(steps), 0)

    fit = partial(fit_sphere, masking=masking)
    if kind == "cylinder":
        found, strips = captured_cylinder(capture, progress, workers=workers, kept=kept)
        # strips of different orientations distinguish two roughnesses
        turned = len({round(float(np.degrees(strip.turn)) % 180, 3) for strip in strips}) > 1
        stretched = ndf == AUTO and turned
        family = "ggx" if stretched else ndf
        profiles = {one.name: strip_profiles(one, strips) for one in found.pictures}
        observe = partial(cylinder_pixels, strips=strips, profiles=profiles)
        fit = partial(fit, observe=observe, stretched=stretched)
    else:
        earlier = read_rig(rig_from) if isinstance(rig_from, str | Path) else rig_from
        found, family = captured_scene(capture, progress, earlier, workers=workers, kept=kept), ndf
    result = reconstructed(found, family, fit, sample=kind, diffuse=diffuse, progress=fitting)
    if kept is not None:
        kept.clear()
    return result
