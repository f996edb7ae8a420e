"""Messages of the errors of matcam, read from the sources, for the index of messages and for the tests.

A placeholder stands for a value.
"""

import ast
from functools import cache
from pathlib import Path
from typing import NamedTuple

import docs_api
import matcam
from matcam.core import errors

SOURCES = Path(matcam.__file__).parent
PLACE = "{}"

ABOVE = ("ClusterError", "WorkerError")
FAMILY = {
    name for name, value in vars(errors).items() if isinstance(value, type) and issubclass(value, errors.MatcamError)
}


class Message(NamedTuple):
    """Name of an error, its text with placeholders, and its position."""

    error: str
    text: str
    position: str

    def __str__(self):
        return f"{self.position}: {self.text}"


def template(node):
    """Return the text of an expression, with placeholders."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else PLACE for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return template(node.left) + template(node.right)
    return PLACE


@cache
def collected():
    """Return every message of the sources."""
    return tuple(_collected())


def _collected():
    names = FAMILY | set(ABOVE)
    for path in sorted(SOURCES.rglob("*.py")):
        where = path.relative_to(SOURCES).as_posix()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
                name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
                if name in names and node.args:
                    yield Message(name, template(node.args[0]), f"{where}:{node.lineno}")


MEANINGS = {
    "ArgumentError": (
        "Invalid values",
        "An option or an argument is out of its range, or two of them exclude each other. Nothing was written. The message names the "
        "option, its value and its range. The [glossary](/glossary.md) explains the terms.",
    ),
    "FileFormatError": (
        "Unreadable files",
        "The message begins with the name of the file. Fetch or write a truncated file again. [File formats](/exchange.md) lists the "
        "content of each format. `matcam --trust COMMAND` decodes your own files without limits of time and memory.",
    ),
    "OutputError": (
        "Outputs that are not written",
        "Existing files are kept: use `--force` or another name. An input is never an output.",
    ),
    "DownloadError": (
        "Failed downloads",
        "The network or the server failed, or the file differs from the published one. Try again, or specify another copy with `--source`.",
    ),
    "FitError": (
        "Data that do not permit a result",
        "A photograph or a table does not meet the requirements of the method: focus, light, contrast, size or sharpness. See "
        "[photograph a chart](/howto/photograph-a-chart.md), [photograph a sphere](/howto/photograph-a-sphere.md) and "
        "[limits](/understand/limits.md).",
    ),
    "WorkerError": (
        "Failed workers of a run",
        "The run lists the material and continues ([correct a database](/batch.md)).",
    ),
    "ClusterError": (
        "Unusable clusters",
        "[Correct a database](/batch.md) lists the requirements of workers.",
    ),
}
"""Title and advice of each kind of error; the others are listed under their own names."""


def write(path):
    """Write the index of messages, by kind of error."""
    own = [m for m in collected() if any(letter.islower() for letter in m.text.replace(PLACE, ""))]
    lines = [
        "# Messages",
        "",
        f"This index lists all {len(own)} error messages, read from the source code. `…` stands for a value. "
        "[Troubleshooting](/howto/troubleshooting.md) explains the most common problems.",
        "",
        "On the command line a message is one line after `matcam:`, and arguments of Python functions appear as options (`half_width` "
        "as `--half-width`). Exit code 2 means invalid input. Exit code 70 means a fault of matcam: please report its traceback.",
        "",
    ]
    kinds = [kind for kind in MEANINGS if any(m.error == kind for m in own)]
    kinds += sorted({m.error for m in own} - set(kinds))
    for kind in kinds:
        title, advice = MEANINGS.get(kind, (kind, ""))
        lines += [f"## {title}", "", f"`{kind}`. {advice}".strip(), ""]
        by_module = {}
        for message in own:
            if message.error == kind:
                by_module.setdefault(message.position.partition(":")[0], []).append(message.text)
        lines += ["| module | message |", "|---|---|"]
        for module, texts in by_module.items():
            for text in dict.fromkeys(texts):
                lines.append(f"| `{module}` | {_as_text(text)} |")
        lines.append("")
    docs_api.update(path, "\n".join(lines))


def _as_text(text):
    """Format a message as a cell of a table, in code type and without markup."""
    shown = " ".join(text.replace(PLACE, "…").split()).replace("|", "\\|").replace("`", "'")
    return f"`{shown}`"
