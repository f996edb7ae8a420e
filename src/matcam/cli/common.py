"""Common parts of all commands: `--quiet`, `--rig`, the schema of the JSON output, and the suggested next command."""

from __future__ import annotations

import contextlib
import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from matcam.cli import activity, show, suggestions
from matcam.cli.rig_file import read_rig_file


def _defaults_of_rig(context: Any, path: Path | None) -> Path | None:
    """Make the values of a rig file the defaults of the options of the command."""
    if path is not None and not context.resilient_parsing:
        known = {param.name for param in context.command.params}
        if "glare_radius" not in known:  # --glare of `correct` is an allowance, not the halo of the rig
            known.discard("glare")
        values = read_rig_file(path, known, context.info_name)
        context.default_map = {**(context.default_map or {}), **values}
    return path


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only errors and the output of --json.")]
RigFile = Annotated[
    Path | None,
    typer.Option(
        "--rig",
        metavar="FILE",
        is_eager=True,
        callback=_defaults_of_rig,
        help="Rig file to read (TOML): camera, sample, distances, lamp. Options override its values.",
    ),
]


def with_common(name: str, command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the common options to a command, as typer requires.

    Args:
        name: words of the command, such as "data merl".
        command: function of the command.
    """
    kinds = get_type_hints(command, include_extras=True)
    result_kind = kinds.pop("return", None)
    old = inspect.signature(command).parameters
    added: dict[str, Any] = {"quiet": (Quiet, False)}
    if {"camera", "radius"} <= set(old):
        added["rig_file"] = (RigFile, None)

    @functools.wraps(command)
    def run(*, quiet: bool, rig_file: Path | None = None, **values: Any) -> Any:
        line = contextlib.nullcontext() if quiet else activity.shown(name)
        with line, show.speaking(quiet=quiet, schema=f"matcam-{name.replace(' ', '-')}-1"):
            result = command(**values)
            if not result and not values.get("json") and (following := suggestions.after(name, values)):
                show.say(f"next: {following}")
        return result

    by_name = inspect.Parameter.KEYWORD_ONLY
    parameters = [p.replace(kind=by_name, annotation=kinds[p.name]) for p in old.values()]
    parameters += [
        inspect.Parameter(one, by_name, annotation=kind, default=value) for one, (kind, value) in added.items()
    ]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {**kinds, **{one: kind for one, (kind, _) in added.items()}, "return": result_kind}
    return run
