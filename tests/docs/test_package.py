"""What people install and cite: metadata, citation, recipe, and the size of the wheel."""

import io
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
VERSION = PROJECT["project"]["version"]


def test_citation_is_valid():
    """The required fields of format 1.2.0, and our own version and authors."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert set(citation) >= {"cff-version", "message", "title", "authors"}
    assert citation["cff-version"] == "1.2.0"
    assert citation["type"] == "software"
    assert citation["version"] == VERSION
    assert citation["license"] == PROJECT["project"]["license"]
    for authors in (citation["authors"], *(one["authors"] for one in citation["references"])):
        assert all("name" in one or {"family-names", "given-names"} <= set(one) for one in authors)
    owner = re.search(r"Copyright \(c\) \d+, (.*)", (ROOT / "LICENSE").read_text())[1]
    assert [one["name"] for one in citation["authors"]] == [owner]
    assert [one["name"] for one in PROJECT["project"]["authors"]] == [owner]


def test_recipe_asks_for_what_the_package_asks_for():
    names = {"netcdf4": "netCDF4", "openexr-python": "OpenEXR", "matplotlib-base": "matplotlib"}
    text = (ROOT / "packaging" / "conda" / "meta.yaml").read_text()
    run = re.search(r"  run:\n((?:    - .*\n)+)", text)[1]
    found = {names.get(n, n) + low for n, low in re.findall(r"- (\S+) (>=\S+)", run)}
    assert found == {*PROJECT["project"]["dependencies"], f"python{PROJECT['project']['requires-python']}"}
    assert f'version: "{VERSION}"' in text


def test_versions_of_python_are_stated():
    listed = {c.rpartition(" ")[2] for c in PROJECT["project"]["classifiers"] if re.search(r":: 3\.\d+$", c)}
    assert listed == {"3.11", "3.12", "3.13", "3.14"}


def test_oldest_versions_are_what_the_project_states():
    printed = subprocess.run(
        [sys.executable, ROOT / ".ci" / "oldest.py"], capture_output=True, text=True, check=True
    ).stdout
    asked = PROJECT["project"]["dependencies"] + PROJECT["project"]["optional-dependencies"]["scale"]
    wanted = {re.sub(r"\[.*\]", "", one).replace(">=", "==") for one in asked}
    assert wanted <= set(printed.split())


def test_the_wheel_is_small():
    """Its content, compressed as a wheel is: below 1.5 MB."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as wheel:
        for path in (ROOT / "src").rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                wheel.write(path, path.relative_to(ROOT / "src"))
    assert 100_000 < packed.tell() < 1_500_000


def test_the_source_distribution_is_whole():
    """All that is under version control, but for what only a checkout needs."""
    if not (shutil.which("git") and (ROOT / ".git").exists()):
        pytest.skip("no checkout")
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    top = {line.partition("/")[0] for line in listed.splitlines()}
    included = set(PROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"])
    own = {".gitignore", ".pre-commit-config.yaml", "pyproject.toml", ".dockerignore", "Dockerfile"}
    assert top - included <= own
    assert included <= {path.name for path in ROOT.iterdir()}


def test_the_paper_cites_what_its_bibliography_holds():
    paper = (ROOT / "paper" / "paper.md").read_text()
    known = set(re.findall(r"@\w+\{(\w+),", (ROOT / "paper" / "paper.bib").read_text()))
    assert set(re.findall(r"@(\w+\d{4})", paper)) == known
    drawn = (ROOT / "paper" / "make_figures.py").read_text()
    assert all(f'"{name}"' in drawn for name in re.findall(r"\]\((\w+\.png)\)", paper))
