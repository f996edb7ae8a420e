"""Every public name explains itself: a short summary, each parameter with its default, and an example that runs."""

import doctest
import inspect
import re
import types

import numpy as np
import pytest

import matcam
from docs_names import described, inherited_description, members, public_things, sections, signature

_LONGEST_SUMMARY = 12  # words
_POOR_STARTS = {"of", "what", "as", "how", "whether", "where", "a", "an", "the"}
_FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


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
