"""docs/glossary.md: each term once, what it points to exists, and no common parameter of the public face is missing."""

import inspect
import re
from collections import Counter
from pathlib import Path
from types import ModuleType

import matcam

ROOT = Path(__file__).parent.parent
SOURCES = ROOT / "src" / "matcam"
PAGE = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")


def rows():
    """Cells of the rows of the tables of terms: term, name, unit, meaning, where."""
    lines = [line for line in PAGE.splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in cells if row[0] != "term" and set(row[0]) != {"-"}]


def quoted(text):
    return re.findall(r"`([^`]+)`", text)


def public_functions(module=matcam, seen=()):
    """Functions of the public face and of its namespaces, each by its full name."""
    for name in module.__all__:
        thing = getattr(module, name)
        if isinstance(thing, ModuleType):
            if hasattr(thing, "__all__") and thing not in seen:
                yield from public_functions(thing, (*seen, thing))
        elif inspect.isfunction(thing):
            yield f"{thing.__module__}.{thing.__qualname__}", thing


def test_rows_are_whole_and_terms_unique():
    assert 60 < len(rows()) < 100  # standard terms need few entries
    assert [row for row in rows() if len(row) != 5 or not all(row)] == []
    count = Counter(row[0].lower() for row in rows())
    assert [term for term, times in count.items() if times > 1] == []
    assert [row[0] for row in rows() if not row[3].endswith(".")] == []


def test_modules_exist():
    paths = [one for row in rows() for one in quoted(row[4]) if "/" in one or one.endswith(".py")]
    assert len(paths) > 40
    missing = [path for path in paths if not ((SOURCES / path).exists() or (ROOT / path).exists())]
    assert missing == []


def test_options_exist():
    options = {one for row in rows() for one in quoted(row[4]) if one.startswith("--")}
    command_line = "".join(path.read_text(encoding="utf-8") for path in (SOURCES / "cli").glob("*.py"))
    assert len(options) > 30
    assert [
        option for option in options if f'"{option}"' not in command_line and f'"{option}/' not in command_line
    ] == []


def test_common_parameters_stand_in_it():
    count = Counter(
        parameter
        for function in dict(public_functions()).values()
        for parameter in inspect.signature(function).parameters
    )
    common = {parameter for parameter, times in count.items() if times >= 3}
    assert len(common) > 20
    named = {word for row in rows() for name in quoted(row[1]) for word in name.split()}
    assert sorted(common - named) == []
