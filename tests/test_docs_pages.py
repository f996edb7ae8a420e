"""docs/*.md: links lead somewhere, and the modules and tests that a page names exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = sorted((ROOT / "docs").glob("*.md"))
PLACES = [ROOT, ROOT / "src" / "matcam", ROOT / "tests", *(ROOT / "tests").glob("*/")]
TESTS = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))

pytestmark = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def test_links(page):
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
    assert [one for one in targets if not one.startswith("http") and not (page.parent / one).exists()] == []


def test_named_modules_exist(page):
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"`((?:\w+/)+(?:\w+\.(?:py|json|md))?|\w+\.py)[`: ]", text)
    assert [one for one in named if not any((place / one).exists() for place in PLACES)] == []


def test_named_tests_exist(page):
    named = re.findall(r"`(?:\w+\.py::)?(test_\w+?)(?:_?\.\.\.)?`", page.read_text(encoding="utf-8"))
    assert [one for one in named if f"def {one}" not in TESTS] == []
