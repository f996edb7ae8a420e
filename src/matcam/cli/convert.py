"""`matcam convert`: the same data in another format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.inputs import check_inputs
from matcam.cli.options import AsJson, Force, Sampling, option, use_caches
from matcam.cli.rig_options import DistantRig, RigOptions
from matcam.core.errors import OutputError
from matcam.core.io import check_output, write_json
from matcam.files.formats import MEASUREMENTS, format_for, suffixes_for, titles_for


def command(
    source: Annotated[Path, typer.Argument(metavar="IN", help=f"File to read: {titles_for(*MEASUREMENTS)}.")],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help=f"File to write; its format follows its suffix: {', '.join(suffixes_for(*MEASUREMENTS, 'surface'))}.",
        ),
    ],
    sampling: Sampling = "centre",
    square: Annotated[
        int,
        option("--square", "N", "Resolution of a .bsdf to write: number of values along each side; 192 gives 36 MB."),
    ] = 192,
    error: Annotated[
        float | None,
        option(
            "--error",
            "SHARE",
            "Largest median difference, such as 0.01 (no unit): write the smallest .bsdf (0.2 to 70 MB) that meets it.",
        ),
    ] = None,
    metadata: Annotated[
        Path | None,
        option(
            "--metadata",
            "JSON",
            "JSON file to write with metadata of the measurement: the rig and the solid angle of its receiver.",
        ),
    ] = None,
    rig: DistantRig = RigOptions(),
    force: Force = False,
    json: AsJson = False,
) -> dict[str, Any]:
    """Convert data to another format; if they must be resampled, print the method and the differences.

    Example: `matcam convert chrome.binary chrome.bsdf`
    """
    from matcam.core import checks

    if ".zarr" in (*source.suffixes, *target.suffixes):
        checks.extra("Zarr", "scale", "zarr")
    format_for(target, *MEASUREMENTS, "surface")
    check_output(target, force=force, inputs=[source])
    check_inputs([source])
    from matcam.exchange.conversion import convert
    from matcam.exchange.receiver import metadata as about

    use_caches()
    if metadata:
        check_output(metadata, force=force, inputs=[source, *rig.files])
        if metadata.absolute() == target.absolute():
            raise OutputError(f"output {metadata} is given twice, as OUT and as --metadata: give two names")
        document = about(rig.build(), table=target.name)
    with show.working("converting"):
        report = convert(source, target, sampling=sampling, square=square, error=error, force=force)
    if metadata:
        write_json(metadata, document, force=force)
        report |= {"metadata": str(metadata), "receiver_sr": document["receiver"]["solid_angle_sr"]}
    if json:
        show.as_json(report)
    else:
        _print(report)
    return {"content": report["content"]}


def _print(report: dict[str, Any]) -> None:
    show.say(f"{report['input']}: {report['holds']} ({report['format']}) -> {report['output']}")
    if report.get("omitted"):
        show.say(f"not written, because the format contains only a BRDF: {', '.join(report['omitted'])}")
    if "supported" in report.get("omitted", ()):
        show.say("entries that are not supported have their recorded values")
    if not report["resampled"]:
        show.say("all other values are unchanged" if report.get("omitted") else "all values are unchanged")
    else:
        how = report["resampled"]
        show.say(how if how.startswith("fitted") else f"resampled {how}")
        error = report["error"]
        show.say(
            f"the output differs by {_percent(error['peak'])} at the peak (median up to 45°), and at random pairs of "
            f"directions up to 80° by {_percent(error['median'])} (median), {_percent(error['p99'])} (99 % of pairs) and "
            f"{_percent(error['largest'])} (largest); relative to the value or to a millionth of the peak, whichever is larger"
        )
        if report["missing_share"]:
            show.say(
                f"missing values, which the format does not support, were interpolated: {report['missing_share']:.2%}"
            )
    if "sidecar" in report:
        show.say(f"sidecar: {report['sidecar']}")
    if "metadata" in report:
        show.say(f"metadata: {report['metadata']}, receiver {report['receiver_sr']:.3g} sr")


def _percent(share: float) -> str:
    """Format a relative difference. Above 1000 % only this limit is printed, because the digits would be meaningless."""
    return "more than 1000%" if share > 10 else f"{share:.2%}"
