"""Megabytes of every package that an installation brings, and which of the package's dependencies needs it.

`python benchmarks/bench_install.py [EXTRA ...]`; of the environment that it runs in, without compiled Python.
"""

import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = Path(__file__).parents[1] / "pyproject.toml"
SMALLEST = 1.0  # MB that are worth a line


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def needed_by(direct: list[str]) -> dict[str, set[str]]:
    """Packages by name, and those of the direct dependencies through which each comes."""
    found: dict[str, set[str]] = {}
    waiting = [(Requirement(text), normal(Requirement(text).name)) for text in direct]
    while waiting:
        requirement, through = waiting.pop()
        name = normal(requirement.name)
        if through in found.get(name, ()) or (requirement.marker and not requirement.marker.evaluate({"extra": ""})):
            continue
        try:
            requires = metadata.distribution(name).requires or []
        except metadata.PackageNotFoundError:
            continue  # for another system
        found.setdefault(name, set()).add(through)
        for one in map(Requirement, requires):
            extras = {"", *requirement.extras}
            if one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in extras):
                one.marker = None
                waiting.append((one, through))
    return found


def size(name: str) -> float:
    """Megabytes of a package's files."""
    package = metadata.distribution(name)
    paths = (Path(str(package.locate_file(file))) for file in package.files or [])
    return sum(path.stat().st_size for path in paths if path.suffix != ".pyc" and path.exists()) / 1e6


def main() -> None:
    project = tomllib.loads(PROJECT.read_text())["project"]
    extras = [text for name in sys.argv[1:] for text in project["optional-dependencies"][name]]
    found = needed_by(project["dependencies"] + extras)
    sizes = {name: size(name) for name in found}
    for name in sorted(found, key=lambda name: -sizes[name]):
        if sizes[name] >= SMALLEST:
            print(f"{sizes[name]:6.0f}  {name:16s} {', '.join(sorted(found[name]))}")
    print(f"{sum(sizes.values()):6.0f}  all {len(found)} packages")


if __name__ == "__main__":
    main()
