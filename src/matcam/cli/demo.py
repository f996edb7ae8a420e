"""`matcam demo`: correction of simulated data."""

from __future__ import annotations

import contextlib
import sys
import tempfile
from pathlib import Path
from typing import Annotated

from matcam.cli import figures, fresnel, predict, show
from matcam.cli.options import AsJson, Force, option, use_caches
from matcam.core.io import check_outputs, where_written


def command(
    output: Annotated[Path, option("--output -o", "FOLDER", "Folder to write to.")] = Path("demo"),
    force: Force = False,
    json: AsJson = False,
) -> None:
    """Simulate the MERL rig's record of a chromium sphere, and recover the Fresnel term of chromium from the record.

    Example: `matcam demo -o demo`
    """
    table, loss, term = (
        output / name for name in ("simulated-chromium.binary", "predicted-loss.png", "chromium-fresnel.png")
    )
    files = [table, loss, loss.with_suffix(".csv"), term, term.with_suffix(".csv"), term.with_suffix(".nc")]
    files += figures.outputs(output, ["figure-3", "figure-4", "figure-5", "figure-6-simulated-chromium"], "svg")
    check_outputs(files, force=force)
    use_caches()
    with contextlib.redirect_stdout(sys.stderr) if json else contextlib.nullcontext():
        _show_all(output, table, loss, term, force)
    if json:
        show.as_json({"open_first": str(term), "files": files})


def _show_all(output: Path, table: Path, loss: Path, term: Path, force: bool) -> None:
    from matcam.files.datasets import read_netcdf
    from matcam.files.merl import write_merl
    from matcam.forward.measurement import CHROMIUM_WIDTH, simulated_chromium

    show.say(
        f"1. Chromium sphere with a Gaussian lobe of width {CHROMIUM_WIDTH} rad (EPD: {2**0.5 * CHROMIUM_WIDTH:.3g}), "
        "photographed by the MERL rig, with 1 % pixel noise:"
    )
    show.say(f"   {table}")
    with show.working("simulating the images of the sphere"):
        write_merl(table, simulated_chromium().clip(min=0), force=force)
    show.say("2. Predicted loss of this rig:")
    predict.command([0.001, 0.002, 0.005, 0.01, 0.05], ndf="gaussian", output=loss, force=force)
    show.say("3. Fresnel term of the sphere, as recorded and as corrected for the camera:")
    with tempfile.TemporaryDirectory() as folder:  # the table gets its name only at the end
        named = Path(folder, table.name)
        named.symlink_to(where_written(table).absolute())
        fresnel.command(named, metal="Cr", output=term, force=force)
    show.say("4. The paper's figures:")
    extracted = read_netcdf(where_written(term.with_suffix(".nc")))  # result of the fit above
    stems = {"figure-3": None, "figure-4": None, "figure-5": None, f"figure-6-{table.stem}": extracted}
    figures.draw_all(stems, output, "svg", metal="Cr", force=force, quiet=False)
    show.say(f"Done. Open {term} first.")
