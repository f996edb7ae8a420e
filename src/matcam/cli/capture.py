"""`matcam capture`: create, plan and check a folder of photographs of a sample under a moved lamp."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.common import group
from matcam.cli.options import (
    AsJson,
    Force,
    option,
    use_caches,
)
from matcam.cli.rig_options import RigOptions, SphereRig
from matcam.core.errors import ArgumentError
from matcam.core.io import check_outputs


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the capture; it is created.")],
    photographs: Annotated[
        Path | None,
        option(
            "--from",
            "FOLDER",
            "Folder of photographs: they are copied and listed in frames.csv, with exposure times from the metadata.",
        ),
    ] = None,
    lamps: Annotated[
        Path | None,
        option(
            "--lamps",
            "FILE",
            "Light position file (.lp) of the photographs of --from. Default: the .lp file in that folder, if any.",
        ),
    ] = None,
    force: Force = False,
    json: AsJson = False,
) -> None:
    """Write a commented capture.toml, a frames.csv, and the folders of the frames.

    Example: `matcam capture init chromium --from photographs`
    """
    from matcam.files.capture import LIST, SETTINGS
    from matcam.files.capture_listing import Listing, list_photographs
    from matcam.files.capture_writing import write_template

    if lamps is not None and photographs is None:
        raise ArgumentError("--lamps describes the photographs of --from, but --from is missing: give both")
    listing = Listing() if photographs is None else list_photographs(photographs, lamps)
    check_outputs([folder / SETTINGS, folder / LIST], force=force)
    listing.copy_to(folder, force=force)
    files = write_template(folder, listing.rows, force=force)
    if json:
        show.as_json({"files": files, "frames": len(listing.rows), "notes": listing.notes})
        return
    for path in files:
        show.say(f"{'template' if not listing.rows or path.name == SETTINGS else 'list'}: {path}")
    show.notes(listing.notes)
    if photographs is None:
        show.notes(
            [f"{folder / LIST} lists no images: fill it in, or repeat with --from FOLDER --force to list photographs"]
        )


def check(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the capture.")],
    json: AsJson = False,
) -> int:
    """Check a capture for clipped or missing frames, missing angles, wrong exposure times and motion.

    The exit code is 1 if there are faults. Example: `matcam capture check chromium`
    """
    from matcam.acquisition.capture_check import check_capture
    from matcam.files.capture import read_capture

    capture = read_capture(folder)
    with show.stepping() as watch:
        found = check_capture(capture, watch)
    if json:
        show.as_json(
            {
                "findings": [remark.to_dict() for remark in found.findings],
                "notes": [remark.to_dict() for remark in found.notes],
                "frames": len(capture.frames),
                "lamps": len(capture.lamps),
                "centre_px": list(found.centre[:2]),
                "radius_px": found.centre[2],
                "turn_deg": [math.degrees(one) for one in found.turn],
                "turn_std_deg": [math.degrees(one) for one in found.turn_std],
                "radiometry": None if found.radiometry is None else found.radiometry.to_dict(),
            }
        )
        return 1 if found.findings else 0
    counts = {"frame": len(capture.frames), "lamp position": len(capture.lamps), "exposure": len(capture.exposures)}
    show.say(", ".join(f"{count} {one}{'s' * (count != 1)}" for one, count in counts.items()))
    if found.radiometry is not None:
        _print_radiometry(found.radiometry)
    if math.isfinite(found.centre[2]):
        column, row, radius = found.centre
        where = f"column {column:.1f}" + (f", row {row:.1f}" if math.isfinite(row) else "")
        show.say(f"approximate outline: {where}, radius {radius:.1f} px")
    show.notes(found.notes)
    for remark in found.findings:
        show.say(f"found: {remark}")
    if found.findings:
        show.say(f"next: correct these faults, then repeat {shlex.join(['matcam', 'capture', 'check', str(folder)])}")
    if not found.findings:
        show.say("no faults were found")
    return 1 if found.findings else 0


def _print_radiometry(found: Any) -> None:
    show.table(
        ["exposure", "relative", "std"],
        [[name, f"{value.value:.5g}", f"{value.std / value.value:.2%}"] for name, value in found.exposures.items()],
        "Exposures, measured from the frames",
    )
    clip = f"{found.clip.level:.0f} DN" if found.clip.pixels else "not reached"
    noise, gain = found.read_noise.value, found.gain.value
    show.say(f"clip level {clip}; gain {gain:.4g} DN per electron; read noise {noise:.3g} DN")


def plan(
    roughness: Annotated[float, typer.Argument(help="Expected roughness (alpha, a slope) of the sample.")] = 0.01,
    accuracy: Annotated[
        float,
        option("--accuracy", "SHARE", "Required relative standard deviation of F at the last angle (no unit)."),
    ] = 0.01,
    last: Annotated[float, option("--last", "DEGREES", "Largest theta_d at which F is required, degrees.")] = 75.0,
    metal: Annotated[
        str | None,
        option("--metal", "SYMBOL", "Metal whose F is expected. Default: a dielectric with n = 1.5, whose F is steep."),
    ] = None,
    rig: SphereRig = RigOptions(),
    json: AsJson = False,
) -> None:
    """Compute the lamp angles, exposures, image radius and tolerances for a required accuracy.

    Example: `matcam capture plan 0.02 --accuracy 0.01 --camera camera.json --radius 300`
    """
    workspace = use_caches()
    from matcam.inverse.capture_plan import plan_capture
    from matcam.material.optical_constants import metal as constants

    n, k = 1.5, 0.0
    if metal:
        values = constants(metal, 550e-9)
        n, k = float(values[0]), float(values[1])
    with show.working("planning"):
        needs = plan_capture(rig.build(), roughness, accuracy, math.radians(last), n=n, k=k, workspace=workspace)
    if json:
        show.as_json(needs.to_dict())
        return
    found = needs.to_dict()
    wide = f"{needs.radius:.0f} px or more" if math.isfinite(needs.radius) else "larger than all tried values"
    if needs.radius == needs.fresnel_std[0][0]:
        wide = f"{needs.radius:.0f} px suffices, the smallest tried (half of --radius)"
    show.table(
        ["quantity", "needed"],
        [
            ["radius of the limb", wide],
            ["lamp positions", f"{len(needs.theta_d)}"],
            ["exposures, each 4 times the previous one", f"{needs.exposures}"],
            ["tolerance of the lamp directions", f"{found['lamp_std_deg']:.2g}°"],
            ["tolerance of the outline of the sphere", f"{needs.outline_std:.2g} px"],
            ["tolerance of the gain of an image", f"{needs.gain_std:.2%}"],
        ],
        f"Requirements for F at {last:g}° with a relative error of {accuracy:.2g}, roughness {roughness:g}",
    )
    angles = ", ".join(f"{angle:.0f}" for angle in found["lamp_angle_deg"])
    show.say(f"angles between lamp and camera, degrees: {angles}")
    tried = ", ".join(f"{size:.0f} px {bound:.2%}" for size, bound in needs.fresnel_std)
    show.say(f"smallest relative standard deviation of F at {last:g}°, by radius: {tried}")


app = group("capture", init=init, check=check, plan=plan)
