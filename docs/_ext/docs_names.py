"""Public names and their docstrings, for the reference and for the tests."""

import inspect
import re
import types

import matcam

_SECTIONS = re.compile(r"^(Args|Attributes|Returns|Raises|Source|Example|Examples|Note|Notes|Yields):\s*$")
_PARAMETER = re.compile(r"^\*{0,2}(\w+)(?: \([^)]*\))?:\s*(.*)$")


def public_things():
    """Yield (dotted name, thing) of all public names.

    These include the names that public modules define.
    """
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
    """Yield (name, member) of the public methods and properties of a class.

    Members that are inherited from classes of the package are included.
    """
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
    """Return the parameters of a call, by name."""
    if inspect.isclass(thing) and issubclass(thing, BaseException):
        return {}
    if inspect.isclass(thing):
        thing = thing.__new__ if issubclass(thing, tuple) else thing.__init__
    parameters = inspect.signature(thing).parameters
    return {name: p for name, p in parameters.items() if name not in ("self", "cls", "_cls") and name[0] != "_"}


def sections(text):
    """Split a docstring into sections by name, as lines without common indentation.

    The section "" is the part before the first heading.
    """
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
    """Return {parameter: text} of the sections Args and Attributes."""
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
    """Return {parameter: text} of a method, including texts of base classes."""
    found = {}
    for base in reversed(cls.__mro__):
        if name in vars(base):
            member = vars(base)[name]
            found |= described(inspect.getdoc(getattr(member, "__func__", member)) or "")
    return found
