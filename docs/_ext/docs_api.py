"""Pages of the Python reference: one page per public name, and one index per task.

`reference/api.toml` assigns each name to an index. Docstrings are read by the same functions as in tests/test_docstrings.py.
"""

import inspect
import re
import tomllib
import types
from pathlib import Path

from docs_names import inherited_description, members, public_things, sections, signature

_HERE = Path(__file__).parent.parent / "reference" / "api.toml"
_SOLE = ("rigs.Rig",)  # shown under its first name
_CITED = re.compile(r"docs/([a-z-]+)\.md(?:,? sections? ([\d, and]+)|,? (\d+))?")


SECTIONS = {
    2: "image-formation",
    3: "samples",
    4: "peak-loss",
    5: "merl",
    6: "microfacets",
    7: "measuring-the-camera",
    8: "inverse",
    9: "pitfalls",
    10: "photographs",
}
"""Pages of the sections of docs/model.md."""


class UndocumentedError(Exception):
    """Public name without a page, or unknown name on a page."""


def pages(names=None):
    """Return the pages of `api.toml`; each public name is on one page.

    The result is [(file, title, intro, {section: [names]})].
    """
    things = dict(public_things())
    names = (
        {n for n, thing in things.items() if not isinstance(thing, types.ModuleType)} if names is None else set(names)
    )
    left = names - set(_SOLE)
    plan = tomllib.loads(_HERE.read_text(encoding="utf-8"))["page"]
    explicit = [n for page in plan for listed in page["sections"].values() for n in listed if not n.endswith("*")]
    if wrong := sorted(set(explicit) - names) + sorted({n for n in explicit if explicit.count(n) > 1}):
        raise UndocumentedError(f"reference/api.toml: unknown, or listed twice: {', '.join(wrong)}")
    left -= set(explicit)
    found = []
    for page in plan:
        filled = {}
        for section, listed in page["sections"].items():
            filled[section] = []
            for one in listed:
                taken = sorted(n for n in left if n.startswith(one[:-1])) if one.endswith("*") else [one]
                left -= set(taken)
                filled[section] += taken
        found.append((page["file"], page["title"], page["intro"], {s: n for s, n in filled.items() if n}))
    if left:
        raise UndocumentedError(f"reference/api.toml: add public names that are on no page: {', '.join(sorted(left))}")
    return found


def write(folder):
    """Write a page for each name and an index for each task, and remove pages of names that no longer exist."""
    things = dict(public_things())
    texts = {}
    for file, title, intro, filled in pages():
        lines = [f"# {title}", "", intro, ""]
        for section, names in filled.items():
            lines += [f"## {section}", "", "| name | description |", "|---|---|"]
            lines += [f"| [`{name}`]({name}.md) | {summary(things[name])} |" for name in names]
            lines.append("")
        listed = [name for names in filled.values() for name in names]
        lines += ["```{toctree}", ":hidden:", "", *listed, "```"]
        texts[file] = "\n".join(lines)
        texts |= {name: "\n".join([f"# matcam.{name}", "", *entry(name, things[name]), ""]) for name in listed}
    write_pages(folder, texts)
    return list(texts)


def write_pages(folder, texts):
    """Write {name: text} as the only pages of a folder. Unchanged files keep their times: Sphinx reads newer files again."""
    folder.mkdir(parents=True, exist_ok=True)
    for stale in set(folder.glob("*.md")) - {folder / f"{name}.md" for name in texts}:
        stale.unlink()
    for name, text in texts.items():
        update(folder / f"{name}.md", text)


def update(path, text):
    """Write a file if its text differs."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def summary(thing):
    """Return the first sentence of a docstring as the cell of a table."""
    first = (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ")
    return inline(first).replace("|", "\\|")


def entry(name, thing):
    """Return the lines of the entry of a name."""
    text = inspect.getdoc(thing) or ""
    if inspect.isclass(thing):
        lines = [f":::::{{py:class}} matcam.{name}{_arguments(thing)}", *described_lines(thing, text)]
        for member_name, member in members(thing):
            lines += ["", *_member(thing, member_name, member)]
        return [*lines, ":::::"]
    return [f":::::{{py:function}} matcam.{name}{_arguments(thing)}", *described_lines(thing, text), ":::::"]


def _member(cls, name, member):
    text = inspect.getdoc(member) or ""
    if isinstance(member, property):
        return [f"::::{{py:property}} {name}", *described_lines(None, text), "::::"]
    kind = "method"
    static = inspect.getattr_static(cls, name)
    options = [":classmethod:"] if isinstance(static, classmethod) else []
    options += [":staticmethod:"] if isinstance(static, staticmethod) else []
    body = described_lines(member, text, inherited_description(cls, name))
    return [f"::::{{py:{kind}}} {name}{_arguments(member)}", *options, *body, "::::"]


def _arguments(thing):
    """Format a signature with names and defaults; the list of parameters contains the types."""
    words, keyword_only = [], False
    for name, parameter in signature(thing).items():
        if parameter.kind is parameter.KEYWORD_ONLY and not keyword_only:
            keyword_only = True
            words.append("*")
        if parameter.kind is parameter.VAR_POSITIONAL:
            keyword_only = True
            words.append(f"*{name}")
        elif parameter.kind is parameter.VAR_KEYWORD:
            words.append(f"**{name}")
        else:
            words.append(name + default_of(parameter))
    return f"({', '.join(words)})"


def default_of(parameter):
    """Format the default of a parameter, abbreviated."""
    if parameter.default is inspect.Parameter.empty:
        return ""
    shown = repr(parameter.default)
    if not isinstance(parameter.default, str | int | float | bool | tuple | None) or len(shown) > 40:
        shown = "..."
    return f"={shown}"


def described_lines(thing, text, texts=None):
    """Convert a docstring to lines of Markdown.

    The lines contain the summary, the parameters with types, the other sections, and the example.
    """
    parts = sections(text)
    lines = ["", *prose(parts.pop("", []))]
    types_of = {} if thing is None else signature(thing)
    described = dict(texts or {})
    for heading in ("Args", "Attributes"):
        for name, words in _described_in(parts.pop(heading, [])):
            described[name] = words
    own = {name: words for name, words in described.items() if name in types_of}
    others = {name: words for name, words in described.items() if name not in types_of and not name.startswith("_")}
    for title, which in (("Parameters", own), ("Attributes", others if inspect.isclass(thing) else {})):
        if which:
            lines += ["", f"**{title}**", ""]
            lines += [_listed(name, which[name], types_of.get(name)) for name in which]
    for heading, body in parts.items():
        if heading in ("Example", "Examples"):
            lines += ["", "**Example**", "", "```pycon", *body, "```"]
        elif body:
            lines += ["", f"**{heading}**", "", *prose(body)]
    return lines


def _described_in(body):
    """Return [(name, text)] of a section of parameters, with the lines of each text joined."""
    found = []
    for line in body:
        start = re.match(r"^\*{0,2}(\w+)(?: \([^)]*\))?:\s*(.*)$", line)
        if start:
            found.append([start[1], start[2]])
        elif found and line.strip():
            found[-1][1] += " " + line.strip()
    return [(name, words) for name, words in found]


def _listed(name, words, parameter):
    annotation = "" if parameter is None else parameter.annotation
    shown = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", str(annotation))
    kind = f" (`{shown}`)" if shown and shown != "_empty" else ""
    return f"- **{name}**{kind}: {inline(words)}"


def prose(lines):
    """Convert lines of a docstring to Markdown, with links to pages.

    The errors of a section become a list.
    """
    text = "\n".join(lines).strip("\n")
    text = re.sub(r"(?m)^(\w+(?:Error)?): ", r"- `\1`: ", text) if re.match(r"\w+Error: ", text) else text
    return inline(text).split("\n")


def inline(text):
    """Add links to cited pages to a text, and escape Markdown characters."""
    text = re.sub(r"``([^`]+)``", r"`\1`", text)
    parts = re.split(r"(`[^`]*`|\n)", text)
    for i in range(0, len(parts), 2):
        plain = re.sub(r"([<*$])", r"\\\1", parts[i])
        plain = re.sub(r"(?<!\w)_|_(?!\w)", r"\\_", plain)
        parts[i] = _CITED.sub(_link, plain)
    return "".join(parts)


def _link(found):
    section = found[2] or found[3]
    words = found[1].replace("-", " ") + (f", section {section}" if section else "")
    if "schema" in found[0]:
        return found[0]
    number = int(re.match(r"[0-9]+", section)[0]) if section else 1
    page = f"model/{SECTIONS[number]}" if found[1] == "model" and number in SECTIONS else found[1]
    return f"[{words}](/{page}.md)"
