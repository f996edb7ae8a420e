"""Print the oldest versions that pyproject.toml allows, as constraints for pip: `name==bound`, one a line.

What users install is held down: the dependencies and the extras app, raw, render and scale, not the tools of the tests. A bound
that was never released is an error of pip, by name. `make test-oldest` runs the tests on them.
"""

import re
import sys
import tomllib
from pathlib import Path

EXTRAS = ("app", "raw", "render", "scale")
ALSO = ("pandas<3", "pyparsing<3.3", "click<8.3")
"""Needed by the oldest xarray, Matplotlib and typer, which warn with later ones: a warning fails a test."""


def constraints(project: dict) -> list[str]:
    """Return one constraint for each dependency; every one must state a lower bound and nothing else."""
    listed = [*project["dependencies"], *(one for extra in EXTRAS for one in project["optional-dependencies"][extra])]
    found = {}
    for one in listed:
        match = re.fullmatch(r"([\w.-]+)(?:\[[\w,-]+\])?>=([\w.]+)", one)
        if match is None:
            sys.exit(f"pyproject.toml: {one!r} must state its oldest version and nothing else: name>=version")
        found[match[1]] = f"{match[1]}=={match[2]}"
    return [*found.values(), *ALSO]


if __name__ == "__main__":
    pyproject = Path(__file__).resolve().parent.parent / "pyproject.toml"
    print(*constraints(tomllib.loads(pyproject.read_text())["project"]), sep="\n")
