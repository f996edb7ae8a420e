"""Command-line application with all commands."""

from __future__ import annotations

from typing import Annotated

import typer

from matcam.cli import (
    browser,
    calibrate,
    capture,
    chart,
    convert,
    correct,
    data,
    demo,
    edge,
    figures,
    fit,
    fresnel,
    inspect,
    limits,
    predict,
    reconstruct,
    render,
    sensor,
    simulate,
)
from matcam.cli.common import with_common
from matcam.cli.options import Command, Group

app = typer.Typer(
    cls=Group,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # the help is plain text, and Rich is slow to load
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Correct reflectance measurements for the camera that recorded them.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib import metadata

        typer.echo(f"matcam {metadata.version('matcam')}")
        raise typer.Exit


@app.callback()
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="Decode files in this process, without limits of time and memory.")
    ] = False,
) -> None:
    if trust:
        from matcam.core.readers.apart import reading_limits

        context.with_resource(reading_limits(None))


for _name, _module in {
    "predict": predict,
    "fresnel": fresnel,
    "correct": correct,
    "reconstruct": reconstruct,
    "fit": fit,
    "limits": limits,
    "simulate": simulate,
    "edge": edge,
    "calibrate": calibrate,
    "sensor": sensor,
    "chart": chart,
    "inspect": inspect,
    "convert": convert,
    "render": render,
    "app": browser,
    "figures": figures,
    "demo": demo,
}.items():
    app.command(_name, cls=Command)(with_common(_name, _module.command))
app.add_typer(
    capture.app, name="capture", help="Create, plan and check a capture: photographs of a sample under a moved lamp."
)
app.add_typer(data.app, name="data", help="Fetch published measurements.")
