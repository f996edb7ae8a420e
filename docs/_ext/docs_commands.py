"""The reference of the command line: every command with its arguments, options, units, defaults, example and exit codes.

It is what `--help` prints (`matcam/cli/help_page.py`), as a page.
"""

import typer

from matcam.cli import help_page
from matcam.cli.app import app


def commands():
    """Return {words: (command, context)} of every command, those inside groups by both words."""
    root = typer.main.get_command(app)
    found = {}
    for name, command in root.commands.items():
        if hasattr(command, "commands"):
            found |= {f"{name} {inner}": one for inner, one in command.commands.items()}
        else:
            found[name] = command
    return {words: (one, _context(words, one)) for words, one in found.items()}


def _context(words, command):
    return command.make_context(f"matcam {words}", [], resilient_parsing=True)


def write(path):
    """Write the page."""
    found = commands()
    root = typer.main.get_command(app)
    lines = [
        "# Command line",
        "",
        "`matcam COMMAND --help` prints the same. Every value's name is its unit: `PX` pixels of the camera, `DEGREES`, `MM`, `NM`, `UM`,",
        "`RADII` of the sample, `SHARE` a number from 0 to 1. Options that take several numbers also take them as one word with commas:",
        "`--roi 120,80,80,160`.",
        "",
        "Options of `matcam` itself stand before the command:",
        "",
        *_table(help_page.entries(root, root.make_context("matcam", [], resilient_parsing=True))[1]),
        "",
        "## Exit codes",
        "",
        "| code | what it says |",
        "|---|---|",
        *(f"| {code} | {words} |" for code, words in help_page.EXIT_CODES.items()),
        "",
    ]
    for title, names in help_page.groups(root.commands):
        lines += [f"## {title}", ""]
        for name in names:
            for words in [w for w in found if w.split()[0] == name]:
                lines += [*_command(words, *found[words]), ""]
    text = "\n".join(lines)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _command(words, command, context):
    text, examples = help_page.parts(command)
    arguments, options = help_page.entries(command, context)
    if not examples:
        raise ValueError(f"matcam {words} has no example")
    lines = [f"(command-{words.replace(' ', '-')})=", f"### matcam {words}", "", text.replace("<", "\\<"), ""]
    lines += ["```text", help_page.usage(command, context), "```", "", "```sh", *examples, "```", ""]
    if arguments:
        lines += ["| argument | meaning |", "|---|---|"]
        lines += [f"| `{_cell(a.names)}` | {_cell(a.help)} |" for a in arguments]
        lines.append("")
    return [*lines, *_table(options)]


def _table(options):
    return [
        "| option | value | default | meaning |",
        "|---|---|---|---|",
        *(
            f"| `{_cell(o.names)}` | {_code(o.value)} | {_code(o.default)} | {_cell(o.help)} |"
            for o in options
            if "--help" not in o.names
        ),
    ]


def _code(text):
    return f"`{_cell(text)}`" if text else ""


def _cell(text):
    return " ".join(text.split()).replace("|", "\\|")
