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
from matcam.cli.options import Command, Group, option
from matcam.cli.rig_file import read_rig_file
from matcam.cli.rig_options import RigOptions


def _defaults_of_rig(context: Any, path: Path | None) -> Path | None:
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
    option(
        "--rig",
        "FILE",
        "Rig file to read (TOML): camera, sample, distances, lamp. Options override its values.",
        is_eager=True,
        callback=_defaults_of_rig,
    ),
]


def group(name: str, **commands: Callable[..., Any]) -> typer.Typer:
    """Build a group of commands, such as `matcam data`. `commands` are the functions of the commands by their names."""
    app = typer.Typer(cls=Group)
    app.callback()(lambda: None)  # without a callback, a group of one command would be this command
    for word, command in commands.items():
        app.command(word, cls=Command)(with_common(f"{name} {word}", command))
    return app


def with_common(name: str, command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the common options to a command, and the options of a rig if it has the parameter `rig`.

    Args:
        name: words of the command, such as "data merl".
        command: function of the command. It returns None, the exit code, or a dictionary of facts about its result. The
            next command is suggested from these facts.
    """
    kinds = get_type_hints(command, include_extras=True)
    result_kind = kinds.pop("return", None)
    names: list[str] = []
    options: dict[str, tuple[Any, Any]] = {}
    for parameter in inspect.signature(command).parameters.values():
        if parameter.name == "rig":
            names, of_rig = kinds["rig"].__metadata__[0].split(), get_type_hints(RigOptions, include_extras=True)
            options |= {one: (of_rig[one], getattr(parameter.default, one)) for one in names}
        else:
            options[parameter.name] = (kinds[parameter.name], parameter.default)
    options["quiet"] = (Quiet, False)
    if names:
        options["rig_file"] = (RigFile, None)

    @functools.wraps(command)
    def run(*, quiet: bool, rig_file: Path | None = None, **values: Any) -> Any:
        rig = {"rig": RigOptions(**{one: values[one] for one in names})} if names else {}
        given = {name: value for name, value in values.items() if name not in names}
        line = contextlib.nullcontext() if quiet else activity.shown(name)
        with line, show.speaking(quiet=quiet, schema=f"matcam-{name.replace(' ', '-')}-1"):
            result = command(**given, **rig)
            code, facts = (0, result) if isinstance(result, dict) else (result, {})
            if not code and not values.get("json") and (following := suggestions.after(name, values | facts)):
                show.say(f"next: {following}")
        return code

    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(one, inspect.Parameter.KEYWORD_ONLY, annotation=kind, default=value)
            for one, (kind, value) in options.items()
        ]
    )
    run.__annotations__ = {one: kind for one, (kind, _) in options.items()} | {"return": result_kind}
    return run
