"""Draw docstrings and messages of the package at random, for an editor who checks their English.

python docs/_ext/docs_draw.py SEED [COUNT]

The same seed gives the same draw from the same sources. `PYTHONPATH` must contain src and docs/_ext.
"""

import ast
import random
import sys
from functools import cache
from typing import NamedTuple

from docs_messages import PLACE, SOURCES, collected, template

COUNT = 100
REMARK_TEXT = 1
"""Position of the text in the arguments of a `Remark`."""


class Text(NamedTuple):
    """Docstring or message with its file and line."""

    position: str
    text: str

    def __str__(self):
        return f"{self.position}\n    " + "\n    ".join(self.text.splitlines())


def docstrings():
    """Yield every docstring of a module, class or function in the sources."""
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for path in sorted(SOURCES.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            text = ast.get_docstring(node) if isinstance(node, kinds) else None
            if text:
                yield Text(f"{path.relative_to(SOURCES).as_posix()}:{node.body[0].lineno}", text)


def messages():
    """Yield the messages of errors and the texts of remarks in the sources, without mere placeholders."""
    for message in collected():
        if message.text.replace(PLACE, "").strip():
            yield Text(message.position, message.text)
    for path in sorted(SOURCES.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Remark" and len(node.args) > REMARK_TEXT:
                text = template(node.args[REMARK_TEXT])
                if text.replace(PLACE, "").strip():
                    yield Text(f"{path.relative_to(SOURCES).as_posix()}:{node.lineno}", text)


def draw(seed, count=COUNT):
    """Draw docstrings and messages without replacement, `count` of each."""
    chance = random.Random(seed)
    return tuple(chance.sample(texts, count) for texts in _texts())


@cache
def _texts():
    """Collect all docstrings and all messages, which takes some seconds."""
    return list(docstrings()), list(messages())


def main(arguments):
    """Print a draw."""
    seed, count = int(arguments[0]), int(arguments[1]) if len(arguments) > 1 else COUNT
    for title, texts in zip(("docstrings", "messages"), draw(seed, count), strict=True):
        print(f"# {count} {title}, seed {seed}\n")
        print("\n\n".join(map(str, texts)), end="\n\n")


if __name__ == "__main__":
    main(sys.argv[1:])
