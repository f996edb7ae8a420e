"""`matcam data`: fetch published measurements."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcam.cli import show
from matcam.cli.common import group
from matcam.cli.options import AsJson, Force, option
from matcam.core.errors import ArgumentError, DownloadError, OutputError, unknown_name
from matcam.core.io import check_output_folder, one_by_one


def merl(
    materials: Annotated[
        list[str] | None, typer.Argument(metavar="NAME...", help="Materials to fetch, such as chrome.")
    ] = None,
    output: Annotated[
        Path, option("--output -o", "FOLDER", "Folder to write to. Default: the current folder.")
    ] = Path(),
    source: Annotated[
        str | None,
        option(
            "--source",
            "SOURCE",
            "Address of an archive (.zip) or folder on another server. Default: the official archive.",
            envvar="MATCAM_MERL_SOURCE",
        ),
    ] = None,
    listing: Annotated[bool, typer.Option("--list", help="List the 100 materials.")] = False,
    force: Force = False,
    json: AsJson = False,
) -> int:
    """Fetch measured MERL files (35 MB each, CC BY-SA 4.0) and check each against its published SHA-256.

    Example: `matcam data merl chrome nickel -o merl`
    """
    from matcam.files.downloads import fetch_merl, merl_checksums

    known = merl_checksums()
    if listing:
        show.as_json({"materials": sorted(known)}) if json else show.say("\n".join(sorted(known)))
        return 0
    if not materials:
        raise ArgumentError("no material was given: name at least one, or use --list to list all")
    for name in materials:
        if name not in known:
            raise unknown_name("MERL material", name, known)
    check_output_folder(output)
    fetched, failed = [], []
    for name in materials:
        try:
            with one_by_one(), show.counting(name) as progress:
                fetched.append(str(fetch_merl(name, output, source, progress, force=force)))
            show.say(fetched[-1], quiet=json)
        except (DownloadError, OutputError) as error:
            failed.append(show.worded(str(error)))
            show.remark(str(error))
    if json:
        show.as_json({"files": fetched, "failed": failed})
    if not failed:
        return 0
    return 1 if len(failed) < len(materials) else 2


app = group("data", merl=merl)
