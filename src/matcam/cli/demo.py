"""`matcam demo`: the main job, on data that the software makes itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcam.cli import figures, fresnel, predict, show
from matcam.cli.options import Force


def command(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to.")] = Path("demo"),
    force: Force = False,
) -> None:
    """Simulate a chromium sphere, photograph it with the MERL rig, and get its Fresnel term back.

    Example: `matcam demo -o demo`
    """
    from matcam._jax import use_compilation_cache
    from matcam.atomic import check_output

    table = output / "simulated-chromium.binary"
    check_output(table, force=force)
    use_compilation_cache()
    from matcam.files.merl import write_merl
    from matcam.forward.demonstration import WIDTH, simulated_chromium

    show.say(
        f"1. A chromium sphere with a lobe of {WIDTH} rad, photographed by the MERL rig, with 1 % pixel noise:\n   {table}"
    )
    with show.working("photographing the sphere"):
        write_merl(table, simulated_chromium().clip(min=0), force=force)
    show.say("2. What to expect of this rig:")
    predict.command(
        [0.001, 0.002, 0.005, 0.01, 0.05], ndf="gaussian", output=output / "predicted-loss.png", force=force
    )
    show.say("3. Its Fresnel term, as recorded and corrected for the camera:")
    fresnel.command(
        table,
        metal="Cr",
        ndf="auto",
        normalise=(10.0, 45.0),
        channel="G",
        output=output / "chromium-fresnel.png",
        force=force,
    )
    show.say("4. The paper's figures:")
    figures.command([], output=output, vector="svg", force=force)
    show.say(f"Done. Open {output / 'chromium-fresnel.png'} first.")
