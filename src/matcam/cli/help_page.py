"""Help of the commands as plain text: groups of commands, options with units, examples and exit codes.

The reference of the command line in the documentation uses the same lines. This module imports no other module of matcam.
"""

from __future__ import annotations

import re
import shutil
import textwrap
from collections.abc import Iterator
from typing import Any, NamedTuple

GROUPS = {
    "Plan": ("predict", "limits", "simulate"),
    "Calibrate": ("chart", "edge", "calibrate", "sensor"),
    "Acquire": ("capture", "reconstruct", "data"),
    "Correct": ("correct", "fit", "fresnel"),
    "Exchange": ("inspect", "convert", "render", "app"),
    "Paper": ("figures", "demo"),
}
"""Groups of commands by purpose. Other commands are listed under Other, or under Commands if no command has a purpose."""

EXIT_CODES = {
    0: "done",
    1: "some inputs failed, and the others are finished",
    2: "bad input: nothing was written",
    70: "a fault of matcam, with a traceback",
    130: "interrupted (143 by SIGTERM), without incomplete files",
}


class HelpLine(NamedTuple):
    """Names, value, help text and default of an argument or option."""

    names: str
    value: str
    help: str
    default: str


def entry(param: Any, context: Any) -> HelpLine:
    if param.param_type_name == "argument":
        name = param.metavar or param.name.upper() + ("..." if param.nargs == -1 else "")
        return HelpLine(name, "", param.help or "", "" if param.required else "optional")
    names = ", ".join([*sorted(param.opts, key=len), *param.secondary_opts])
    if param.is_flag:
        return HelpLine(names, "", param.help or "", "")
    record = param.get_help_record(context)
    shown = param.metavar or _choices(record[0])
    return HelpLine(names, shown, param.help or "", _default(param))


def _choices(label: str) -> str:
    found = re.search(r"[<\[](.*?)[>\]]\.*$", label)
    return found[1] if found else label.rpartition(" ")[2]


def _default(param: Any) -> str:
    value = param.default
    if value is None or callable(value) or "Default" in (param.help or "") or value == ():
        return ""
    return f"{value:g}" if isinstance(value, float) else str(value)


def parts(command: Any) -> tuple[str, list[str]]:
    text = re.sub(r"[ \t]*\n[ \t]*(?!\n)", "\n", command.help or "")
    before, _, after = text.partition("Example:")
    return before.strip(), re.findall(r"`([^`]+)`", after)


def entries(command: Any, context: Any) -> tuple[list[HelpLine], list[HelpLine]]:
    params = command.get_params(context)
    shown = [p for p in params if not getattr(p, "hidden", False)]
    arguments = [entry(p, context) for p in shown if p.param_type_name == "argument"]
    return arguments, [entry(p, context) for p in shown if p.param_type_name == "option"]


def usage(command: Any, context: Any) -> str:
    arguments, _ = entries(command, context)
    words = [f"[{a.names}]" if a.default else a.names for a in arguments]
    tail = ["COMMAND ..."] if hasattr(command, "commands") else []
    return " ".join([context.command_path, "[OPTIONS]", *words, *tail])


def groups(commands: Any) -> Iterator[tuple[str, list[str]]]:
    left = [name for name in commands if not getattr(commands[name], "hidden", False)]
    rest = "Commands"
    for title, members in GROUPS.items():
        found = [name for name in members if name in left]
        left = [name for name in left if name not in found]
        if found:
            rest = "Other"
            yield title, found
    if left:
        yield rest, left


def page(command: Any, context: Any) -> str:
    width = max(50, min(shutil.get_terminal_size().columns, 100))
    text, examples = parts(command)
    lines = [f"Usage: {usage(command, context)}", ""]
    for paragraph in text.split("\n\n"):
        lines += [*_wrapped(paragraph.replace("`", ""), width, "  "), ""]
    arguments, options = entries(command, context)
    if hasattr(command, "commands"):
        for title, names in groups(command.commands):
            rows = [(name, summary(command.commands[name])) for name in names]
            lines += [f"{title}:", *_rows(rows, width), ""]
    for title, listed in (("Arguments", arguments), ("Options", options)):
        if listed:
            rows = [(f"{e.names} {e.value}".strip(), e.help + _note(e)) for e in listed]
            lines += [f"{title}:", *_rows(rows, width), ""]
    for title, shown in (("Example", examples[:1]), ("Another", examples[1:])):
        lines += [f"{title}: {one}" for one in shown]
    codes = "; ".join(f"{code} {words}" for code, words in EXIT_CODES.items())
    return "\n".join([*lines, *_wrapped(f"Exit codes: {codes}.", width, "")])


def summary(command: Any) -> str:
    return parts(command)[0].split("\n\n")[0].replace("\n", " ").replace("`", "")


def _note(one: HelpLine) -> str:
    return f" [default: {one.default}]" if one.default not in ("", "optional") else ""


def _wrapped(text: str, width: int, indent: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), width, initial_indent=indent, subsequent_indent=indent)


def _rows(rows: list[tuple[str, str]], width: int) -> list[str]:
    first = min(max(len(name) for name, _ in rows) + 2, 26)
    lines: list[str] = []
    for name, text in rows:
        wrapped = textwrap.wrap(" ".join(text.split()), width - first - 2, break_long_words=False) or [""]
        if len(name) + 2 > first:
            lines.append(f"  {name}")
        else:
            lines.append(f"  {name:<{first}}{wrapped.pop(0)}")
        lines += [" " * (first + 2) + line for line in wrapped]
    return lines
