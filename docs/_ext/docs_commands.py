"""Pages of the command line: each command with its arguments, options, units, defaults and example.

They contain the output of `--help` (`matcam/cli/help_page.py`).
"""

from functools import cache

import typer

import docs_api
from matcam.cli import help_page
from matcam.cli.app import app


@cache
def commands():
    """Return {words: (command, context)} of every command.

    The key of a command in a group is the two words of group and command.
    """
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


def file_of(words):
    """Return the name of a command's page, without suffix."""
    return words.replace(" ", "-")


def write(folder):
    """Write one page for each command, and an index.

    The index contains the units, options and exit codes that are common to all commands.
    """
    found = commands()
    root = typer.main.get_command(app)
    lines = [
        "# Command line",
        "",
        "`matcam COMMAND --help` prints the page of a command.",
        "",
    ]
    for title, names in help_page.groups(root.commands):
        listed = [words for name in names for words in found if words.split()[0] == name]
        lines += [f"## {title}", "", "| command | description |", "|---|---|"]
        lines += [f"| [`matcam {w}`]({file_of(w)}.md) | {_cell(help_page.summary(found[w][0]))} |" for w in listed]
        lines.append("")
    lines += [
        "## Values",
        "",
        "The name of a value is its unit: `PX` (pixels of the camera), `DEGREES`, `MM`, `NM`, `UM`, `RADII` (radii of the sample) and "
        "`SHARE` (0 to 1). An option that takes several numbers also takes them as one word with commas: `--roi 120,80,80,160`.",
        "",
        "## Options of `matcam` itself",
        "",
        "These options precede the command.",
        "",
        *_table(help_page.entries(root, root.make_context("matcam", [], resilient_parsing=True))[1]),
        "",
        "## Exit codes",
        "",
        "| code | meaning |",
        "|---|---|",
        *(f"| {code} | {words} |" for code, words in help_page.EXIT_CODES.items()),
        "",
        "```{toctree}",
        ":hidden:",
        "",
        *map(file_of, found),
        "```",
    ]
    texts = {file_of(words): "\n".join(_command(words, *found[words])) for words in found}
    docs_api.write_pages(folder, texts | {"index": "\n".join(lines)})


def _command(words, command, context):
    text, examples = help_page.parts(command)
    arguments, options = help_page.entries(command, context)
    if not examples:
        raise ValueError(f"matcam {words} has no example")
    lines = [f"# matcam {words}", "", text.replace("<", "\\<"), ""]
    lines += ["```text", help_page.usage(command, context), "```", ""]
    lines += ["## Example", "", "```sh", *examples, "```", ""]
    if arguments:
        lines += ["## Arguments", "", "| argument | meaning |", "|---|---|"]
        lines += [f"| `{_cell(a.names)}` | {_cell(a.help)} |" for a in arguments]
        lines.append("")
    if options:
        lines += ["## Options", "", *_table(options), ""]
    return [*lines, "[Units of values, common options, exit codes](index.md)", ""]


def _table(options):
    return [
        "| option | value | default | meaning |",
        "|---|---|---|---|",
        *(
            f"| `{_cell(o.names)}` | {_code(o.value.replace('|', ' | '))} | {_code(o.default)} | {_cell(o.help)} |"
            for o in options
            if "--help" not in o.names
        ),
    ]


def _code(text):
    return f"`{_cell(text)}`" if text else ""


def _cell(text):
    return " ".join(text.split()).replace("|", "\\|")
