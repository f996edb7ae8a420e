"""Every public name explains itself: a short summary, each parameter with its default, and an example that runs."""

import doctest
import inspect
import re
import types

import numpy as np
import pytest

import matcam

_LONGEST_SUMMARY = 12  # words
_POOR_STARTS = {"of", "what", "as", "how", "whether", "where", "a", "an", "the"}
_SECTIONS = re.compile(r"^(Args|Attributes|Returns|Raises|Source|Example|Examples|Note|Notes|Yields):\s*$")
_PARAMETER = re.compile(r"^\*{0,2}(\w+)(?: \([^)]*\))?:\s*(.*)$")
_FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


def public_things():
    """(dotted name, thing) of all that users may call: the public names, and what the public modules among them define."""
    for name in matcam.__all__:
        thing = getattr(matcam, name)
        yield name, thing
        if isinstance(thing, types.ModuleType):
            namespace = getattr(thing, "__all__", None)
            for inner in namespace or vars(thing):
                member = getattr(thing, inner)
                if namespace or (not inner.startswith("_") and getattr(member, "__module__", None) == thing.__name__):
                    yield f"{name}.{inner}", member


def members(cls):
    """(name, member) of a class's public methods and properties, those that it inherits inside the package included."""
    for name in dir(cls):
        member = inspect.getattr_static(cls, name)
        if isinstance(member, classmethod | staticmethod):
            member = member.__func__
        if isinstance(member, property):
            module = member.fget.__module__
        else:
            member = inspect.unwrap(member) if callable(member) else member
            module = member.__module__ if inspect.isfunction(member) else ""
        if not name.startswith("_") and module.split(".")[0] == "matcam":
            yield name, member


def signature(thing):
    """Parameters that a caller gives, by name."""
    if inspect.isclass(thing) and issubclass(thing, BaseException):
        return {}
    if inspect.isclass(thing):
        thing = thing.__new__ if issubclass(thing, tuple) else thing.__init__
    parameters = inspect.signature(thing).parameters
    return {name: p for name, p in parameters.items() if name not in ("self", "cls", "_cls") and name[0] != "_"}


def sections(text):
    """A docstring's sections by name, as lines without their common indentation; "" is what stands before the first."""
    found, current = {"": []}, ""
    for line in text.splitlines():
        heading = _SECTIONS.match(line)
        if heading:
            current = heading[1]
            found[current] = []
        else:
            found[current].append(line)
    return {name: inspect.cleandoc("\n" + "\n".join(lines)).splitlines() for name, lines in found.items()}


def described(text):
    """{parameter: its text} of the sections Args and Attributes."""
    found, name = {}, None
    for section in ("Args", "Attributes"):
        for line in sections(text).get(section, []):
            start = _PARAMETER.match(line)
            if start:
                name = start[1]
                found[name] = start[2]
            elif name and line.startswith(" "):
                found[name] += " " + line.strip()
    return found


def inherited_description(cls, name):
    """{parameter: its text} of a method; what a base class has said of a parameter need not be said again."""
    found = {}
    for base in reversed(cls.__mro__):
        if name in vars(base):
            member = vars(base)[name]
            found |= described(inspect.getdoc(getattr(member, "__func__", member)) or "")
    return found


def summary_faults(text):
    first = text.split("\n")[0]
    words = first.split()
    if not words:
        return ["no summary line"]
    faults = [] if len(words) <= _LONGEST_SUMMARY else [f"summary of {len(words)} words"]
    if words[0].lower().strip(",.:") in _POOR_STARTS:
        faults.append(f"summary begins with {words[0]!r}")
    if not first.endswith("."):
        faults.append("summary is not one sentence in one line")
    return faults


def parameter_faults(thing, texts):
    for name, parameter in signature(thing).items():
        if not texts.get(name):
            yield f"parameter {name} is not described"
        elif parameter.default not in (inspect.Parameter.empty, None) and "Default" not in texts[name]:
            yield f"parameter {name}: its default is not stated"
        elif parameter.default is None and not re.search(r"\bDefault\b|\bNone:", texts[name]):
            yield f"parameter {name}: what None means is not stated"


def faults(name, thing):
    """All that a public thing's docstring lacks, its methods and properties included."""
    text = inspect.getdoc(thing) or ""
    if isinstance(thing, types.ModuleType):
        return [f"{name}: no docstring"] if not text else []
    found = [f"{name}: {fault}" for fault in (*summary_faults(text), *parameter_faults(thing, described(text)))]
    if ">>>" not in "\n".join(sections(text).get("Example", [])) and not (
        inspect.isclass(thing) and issubclass(thing, BaseException)
    ):
        found.append(f"{name}: no Example: with >>>")
    if inspect.isclass(thing):
        for member_name, member in members(thing):
            inner = inspect.getdoc(member) or ""
            inner_faults = summary_faults(inner)
            if not isinstance(member, property):
                inner_faults += parameter_faults(member, inherited_description(thing, member_name))
            found += [f"{name}.{member_name}: {fault}" for fault in inner_faults]
    return found


THINGS = dict(public_things())


@pytest.mark.parametrize("name", sorted(THINGS))
def test_public_docstrings_are_complete(name):
    found = faults(name, THINGS[name])
    assert not found, "\n".join(found)


@pytest.mark.parametrize("name", sorted(THINGS))
def test_examples_run(name):
    thing = THINGS[name]
    texts = {name: inspect.getdoc(thing)}
    if inspect.isclass(thing):
        texts |= {f"{name}.{inner}": inspect.getdoc(member) for inner, member in members(thing)}
    runner = doctest.DocTestRunner(optionflags=_FLAGS)
    report = []
    for title, text in texts.items():
        example = doctest.DocTestParser().get_doctest(text or "", {"matcam": matcam, "np": np}, title, None, None)
        runner.run(example, out=report.append)
    assert not runner.failures, "".join(report)
