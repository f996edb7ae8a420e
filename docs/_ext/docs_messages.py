"""Messages of the error family, read from the sources: the page of troubleshooting, and what the tests ask of them.

A placeholder stands for a value.
"""

import ast
from pathlib import Path
from typing import NamedTuple

import matcam
from matcam.core import errors

SOURCES = Path(matcam.__file__).parent
PLACE = "{}"

ABOVE = ("ClusterError", "WorkerError")
FAMILY = {
    name for name, value in vars(errors).items() if isinstance(value, type) and issubclass(value, errors.MatcamError)
}


class Message(NamedTuple):
    """One message: its error, its text with placeholders, and where it stands."""

    error: str
    text: str
    place: str

    def __str__(self):
        return f"{self.place}: {self.text}"


def template(node):
    """The text of an expression, with placeholders."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else PLACE for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return template(node.left) + template(node.right)
    return PLACE


def collected():
    """Yield every message of the sources."""
    for path in sorted(SOURCES.rglob("*.py")):
        where = path.relative_to(SOURCES).as_posix()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
                name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
                if name in FAMILY | set(ABOVE) and node.args:
                    yield Message(name, template(node.args[0]), f"{where}:{node.lineno}")


MEANINGS = {
    "ArgumentError": (
        "A value that cannot be",
        "An option or an argument is out of its range, or two of them exclude each other. Nothing was written. The message names the "
        "option, its range and its value; a [glossary](/glossary.md) entry says what it means.",
    ),
    "FileFormatError": (
        "A file that cannot be read",
        "The message begins with the file's name. A file that was cut short has to be fetched or written again. What each format "
        "holds, and what is refused in it, stands under [files in and out](/exchange.md). With `matcam --trust` files of your own "
        "are decoded without limits of time and memory.",
    ),
    "OutputError": (
        "A file that is not written",
        "Nothing is replaced unasked: use `--force`, or another name. An input is never an output.",
    ),
    "DownloadError": (
        "A file that was not fetched",
        "The network or the server. Nothing is kept of what is not as published; try again, or name another copy with `--source`.",
    ),
    "FitError": (
        "Data that give no answer",
        "A photograph or a table is not what the method needs: focus, light, contrast, size, or anything sharp enough. "
        "[Photograph a chart](/howto/photograph-a-chart.md) says what a photograph needs, "
        "[what cannot be undone](/explanation/limits.md) what no table can tell.",
    ),
    "WorkerError": (
        "A run's worker that failed",
        "[A database at a time](/batch.md) says what a run does then.",
    ),
    "ClusterError": (
        "A cluster that cannot be used",
        "[A database at a time](/batch.md) says what workers need.",
    ),
}
"""Title and advice of each kind of error; the others are listed under their own names."""


def write(path):
    """Write the page of troubleshooting: every message, with what to do about its kind."""
    own = [m for m in collected() if any(letter.islower() for letter in m.text.replace(PLACE, ""))]
    lines = [
        "# Troubleshooting: every message",
        "",
        f"All {len(own)} messages of matcam, read from its sources. `…` stands for a value. A message says what was wrong, where, and "
        "what would be right. Search this page, or the site, for the words that you saw.",
        "",
        "On the command line a message is one line behind `matcam:`, and Python's arguments appear as options (`half_width` as "
        "`--half-width`). The exit code is 2 for bad input and 70 for a fault of ours, which has a traceback: please report it.",
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
                by_module.setdefault(message.place.partition(":")[0], []).append(message.text)
        lines += ["| from | message |", "|---|---|"]
        for module, texts in by_module.items():
            for text in dict.fromkeys(texts):
                lines.append(f"| `{module}` | {_as_text(text)} |")
        lines.append("")
    text = "\n".join(lines)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _as_text(text):
    """Return a message as a cell of a table, in code: nothing in it is markup."""
    shown = " ".join(text.replace(PLACE, "…").split()).replace("|", "\\|").replace("`", "'")
    return f"`{shown}`"
