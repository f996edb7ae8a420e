"""Check of names in code type on written pages: commands, options, files, tests, Python names, fields of text files.

A name that does not exist fails the build. Fenced blocks of code are read and run by tests/docs/test_code_blocks.py.
"""

import importlib
import inspect
import json
import re
import shlex
import tomllib
from functools import cache
from pathlib import Path

import docs_results
import matcam
from docs_commands import commands
from docs_names import members, public_things, signature

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
GENERATED = {
    DOCS / "reference" / "messages.md",
    DOCS / "understand" / "trust.md",
    *(DOCS / "validation" / f"{name}.md" for name in docs_results.pages()),
}
"""Pages that the build writes, beside the folders of `GENERATED_FOLDERS`."""
GENERATED_FOLDERS = (
    DOCS / "reference" / "api",
    DOCS / "reference" / "commands",
    DOCS / "gallery",
    DOCS / "tutorials",
)
FOLDERS = (
    ROOT,
    ROOT / "src" / "matcam",
    ROOT / "tests",
    *(path for path in (ROOT / "tests").glob("*/") if path.name != "__pycache__"),
)
"""Folders to which a cited path may be relative."""
OTHERS = tomllib.loads((DOCS / "_ext" / "other_names.toml").read_text(encoding="utf-8"))
"""Names of other projects, and of files that users make."""


def written_pages():
    """List the pages that are written by hand.

    They belong to the site or are in the root folder of the project.
    """
    found = [
        page
        for page in sorted(DOCS.rglob("*.md"))
        if page not in GENERATED and not any(page.is_relative_to(folder) for folder in GENERATED_FOLDERS)
    ]
    return [*found, *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md"))]


def faults(pages=None):
    """List citations of names that do not exist, one line each."""
    found = []
    for page in written_pages() if pages is None else pages:
        where = page.relative_to(ROOT) if page.is_relative_to(ROOT) else page.name
        found += [f"{where}: `{span}`: {problem}" for span in spans(page) if (problem := problem_of(span))]
    return found


def spans(page):
    """List the texts in code type of a page, without fenced blocks."""
    text = re.sub(r"(?ms)^[ ]*(`{3,}|~{3,}).*?^[ ]*\1", "", page.read_text(encoding="utf-8"))
    return list(dict.fromkeys(" ".join(one.split()) for one in re.findall(r"(?<!`)`([^`]+)`(?!`)", text)))


def problem_of(span):
    """Find the part of a cited text that does not exist; None if all of it exists."""
    if span in OTHERS["names"] or span.split("(")[0] in OTHERS["names"]:
        return None
    if span.startswith("matcam "):
        return _problem_of_command(span)
    if span.startswith("--"):
        return _problem_of_options(span, _all_options())
    if re.fullmatch(r"(?:[\w.-]+/)+[\w.-]*|[\w-]+\.py", span):
        return _problem_of_path(span)
    if re.fullmatch(r"test_\w+(\.\.\.)?", span):
        known = span.removesuffix("...")
        return None if f"def {known}" in _tests() else "no such test"
    if span.startswith("MATCAM_"):
        return None if re.search(rf"\b{span.partition('=')[0]}\b", _sources()) else "no such variable"
    called = re.fullmatch(r"([A-Za-z_][\w.]*)\((.*)\)", span)
    if called:
        return _problem_of_call(called[1], called[2])
    if span.startswith("matcam.") or re.fullmatch(r"[A-Z]\w*[a-z]\w*(\.\w+)*", span):
        known = span.removeprefix("matcam.") in _python_names() or _module(span) or _defined(span)
        return None if known else "no such name"
    if re.fullmatch(r"\.[a-z]\w*", span) and span not in OTHERS["names"]:
        return (
            None if span[1:] in _attributes() or span in OTHERS["suffixes"] else "no public class has such an attribute"
        )
    if re.fullmatch(r"[a-z]\w*(\.[a-z]\w*)+", span):
        known = span in _python_names() or span in _fields() or Path(span).suffix in OTHERS["suffixes"] or _module(span)
        return None if known else "no such public name, and no such field of a text file"
    if re.fullmatch(r"[a-z]\w*_\w+|[a-z]+(-[a-z]+)+", span):
        return None if span in _words() else "not in the source code"
    return None


def _problem_of_command(span):
    words = shlex.split(span)[1:]
    while words and words[0].startswith("-"):
        words = words[1:]
    if not words or words[0].isupper():
        return None
    name = next((n for n in (" ".join(words[:2]), words[0]) if n in commands()), None)
    if name is None:
        group = any(n.split()[0] == words[0] for n in commands())
        return None if group and len(words) == 1 else f"no command {words[0]}"
    known = {option for param in commands()[name][0].params for option in (*param.opts, *param.secondary_opts)}
    return _problem_of_options(" ".join(words), known | {"--help"})


def _problem_of_options(text, known):
    wrong = [one for one in re.findall(r"(?<![\w-])--[a-z][\w-]*", text) if one not in known]
    return f"no option {', '.join(wrong)}" if wrong else None


def _problem_of_path(span):
    if span.split("/")[0] in OTHERS["folders"] or any((folder / span).exists() for folder in FOLDERS):
        return None
    return "no such file"


def _problem_of_call(name, arguments):
    names = _python_names()
    thing = names.get(name.removeprefix("matcam."))
    if thing is None:
        known = name.split(".")[0] in OTHERS["modules"] or _defined(name.rpartition(".")[2])
        return None if known else "no such function"
    taken = signature(thing)
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in taken.values()):
        return None
    wrong = [one for one in re.findall(r"(?:^|, )(\w+)=", arguments) if one not in taken]
    return f"no parameter {', '.join(wrong)}" if wrong else None


@cache
def _all_options():
    found = {
        option for command, _ in commands().values() for p in command.params for option in (*p.opts, *p.secondary_opts)
    }
    return found | set(OTHERS["options"]) | {"--help", "--version", "--trust"}


@cache
def _python_names():
    """Return {name: thing} of public names, with and without their namespace, and of the members of classes."""
    found = {}
    for name, thing in public_things():
        for shown in {name, name.rpartition(".")[2]}:
            found[shown] = thing
            if inspect.isclass(thing):
                for member, value in members(thing):
                    found[f"{shown}.{member}"] = value
                for member in (*signature(thing), *getattr(thing, "__annotations__", ())):
                    found[f"{shown}.{member}"] = thing
    return found


@cache
def _attributes():
    return {name.rpartition(".")[2] for name in _python_names() if "." in name}


def _module(span):
    parts = span.split(".")
    if parts[0] not in ("matcam", "tests"):
        return False
    for n in range(len(parts), 0, -1):
        if importlib.util.find_spec(".".join(parts[: min(n, 1)])) is None:
            return False
        try:
            thing = importlib.import_module(".".join(parts[:n]))
        except ImportError:
            continue
        for part in parts[n:]:
            thing = getattr(thing, part, None)
        return thing is not None
    return False


@cache
def _fields():
    """Return the dotted fields of capture.toml, of a rig file, of camera profiles and of reconstructions."""
    found = set(OTHERS["fields"])
    for schema in DOCS.glob("*.schema.json"):
        document = json.loads(schema.read_text(encoding="utf-8"))
        found |= set(_dotted(document, document, 4))
    page = (DOCS / "reference" / "schemas.md").read_text(encoding="utf-8")
    rig = tomllib.loads(page.split("```toml\n")[1].split("```")[0])
    found |= {f"{table}.{key}" for table, value in rig.items() if isinstance(value, dict) for key in value}
    camera = matcam.rigs.merl().camera
    return found | set(camera.parameters())


def _dotted(schema, document, depth):
    if "$ref" in schema:
        schema = document["$defs"][schema["$ref"].rpartition("/")[2]]
    for option in (*schema.get("anyOf", ()), *schema.get("oneOf", ())):
        yield from _dotted(option, document, depth)
    for name, inner in schema.get("properties", {}).items() if depth else ():
        yield name
        yield from (f"{name}.{rest}" for rest in _dotted(inner, document, depth - 1))


def _defined(name):
    """Check whether the sources define a class or a function of this name."""
    return name in _definitions()


@cache
def _definitions():
    return set(re.findall(r"(?m)^\s*(?:class|def) (\w+)", _sources()))


@cache
def _words():
    """Return all words of the sources, with underscores and hyphens."""
    return set(re.findall(r"[\w-]+", _sources()))


@cache
def _tests():
    return "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))


@cache
def _sources():
    kinds = (
        "src/**/*.py",
        "benchmarks/**/*.py",
        "docs/_ext/*.py",
        "docs/*.json",
        "docs/conf.py",
        "src/**/*.pyi",
    )
    texts = [path.read_text(encoding="utf-8") for kind in kinds for path in ROOT.glob(kind)]
    return "\n".join([*texts, *((ROOT / name).read_text(encoding="utf-8") for name in ("Makefile", "pyproject.toml"))])
