"""`matcam app`: plan rigs, calibrate cameras and compare tables in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcam.cli import show
from matcam.cli.options import option
from matcam.core.errors import ArgumentError
from matcam.core.readers.names import is_there


def command(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Tables or images to open, or the folder or Zarr store of a run. Default: no file, to plan a rig."
        ),
    ] = None,
    host: Annotated[
        str,
        option(
            "--host",
            "ADDRESS",
            "Address to listen on. With an address other than the default, other machines can connect with the "
            "token, without encryption.",
        ),
    ] = "127.0.0.1",
    port: Annotated[int, option("--port", "PORT", "Port to listen on. Default: 0, any free port.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
) -> None:
    """Open a page in the browser to plan a rig, calibrate a camera and look at tables. Ctrl-C ends the command.

    Example: `matcam app chromium.binary`
    """
    from matcam.core import checks

    checks.extra("the app", "app", "bokeh")
    for path in files or ():
        if not is_there(path):
            raise ArgumentError(f"{path} does not exist: give an existing file or folder")
    if not 0 <= port < 2**16:
        raise ArgumentError(f"--port must lie in [0, {2**16 - 1}], got {port}")
    from matcam.app.server import AppServer

    server = AppServer(files or (), host, port)
    if host not in ("127.0.0.1", "localhost", "::1"):
        show.remark(
            f"--host {host}: anyone who has the address below and can reach this machine can use the app with your "
            "permissions, and the traffic is not encrypted"
        )
    show.say(server.address)
    if browser:
        _open(server.address)
    try:
        server.run()
    except KeyboardInterrupt:
        if server.busy:
            _leave()
        raise


def _leave() -> None:
    """End the process immediately, because a running computation in compiled code cannot be interrupted."""
    import os
    import sys

    show.remark("interrupted; no incomplete file was left")
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(130)


def _open(address: str) -> None:
    import contextlib
    import webbrowser

    with contextlib.suppress(webbrowser.Error, OSError):
        webbrowser.open(address)
