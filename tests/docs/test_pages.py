"""Pages of the documentation: links lead somewhere, and the modules and tests that a page names exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
GENERATED = [
    DOCS / "reference" / "commands.md",
    DOCS / "howto" / "troubleshooting.md",
    DOCS / "explanation" / "how-good.md",
]
PAGES = [
    p for p in sorted(DOCS.rglob("*.md")) if p not in GENERATED and p.parent.name not in ("api", "gallery", "tutorials")
]
MADE = {*GENERATED, DOCS / "tutorials" / "index.rst", DOCS / "gallery" / "index.rst"}
"""Pages that the build makes, so that links to them are good."""
PLACES = [ROOT, ROOT / "src" / "matcam", ROOT / "tests", *(ROOT / "tests").glob("*/")]
TESTS = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))

pytestmark = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))


def test_links(page):
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
    local = [one for one in targets if not one.startswith("http")]
    places = {one: (DOCS / one[1:] if one.startswith("/") else page.parent / one) for one in local}
    assert [one for one, place in places.items() if not (place.exists() or place.resolve() in MADE)] == []


def test_named_modules_exist(page):
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"`((?:\w+/)+(?:\w+\.(?:py|json|md))?|\w+\.py)[`: ]", text)
    assert [one for one in named if not any((place / one).exists() for place in PLACES)] == []


def test_named_tests_exist(page):
    named = re.findall(r"`(?:\w+\.py::)?(test_\w+?)(?:_?\.\.\.)?`", page.read_text(encoding="utf-8"))
    assert [one for one in named if f"def {one}" not in TESTS] == []
