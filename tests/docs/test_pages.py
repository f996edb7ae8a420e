"""Pages of the documentation: links lead somewhere, and the names, options, files and tests that a page cites exist."""

import re
from pathlib import Path

import pytest

import docs_cites

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [page for page in docs_cites.written_pages() if page.is_relative_to(DOCS)]


def is_made(path):
    """Tell whether the build writes a page: links to it are good."""
    examples = [*(ROOT / "examples").glob("*/*.py"), *(ROOT / "examples").glob("*/*/*.py")]
    scripts = {DOCS / path.relative_to(ROOT / "examples").with_suffix(".rst") for path in examples}
    indices = {DOCS / "tutorials" / "index.rst", DOCS / "gallery" / "index.rst"}
    folders = (DOCS / "reference" / "api", DOCS / "reference" / "commands")
    return path in docs_cites.GENERATED | scripts | indices or path.parent in folders


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_links(page):
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
    local = [one for one in targets if not one.startswith("http")]
    positions = {one: (DOCS / one[1:] if one.startswith("/") else page.parent / one) for one in local}
    assert [one for one, position in positions.items() if not (position.exists() or is_made(position.resolve()))] == []


@pytest.mark.parametrize("page", docs_cites.written_pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_cites_exists(page):
    assert docs_cites.faults([page]) == []


@pytest.mark.parametrize(
    "span",
    [
        "matcam corect a.binary",
        "matcam predict --no-such-option",
        "--no-such-option",
        "inverse/no_such_file.py",
        "test_no_such_test",
        "MATCAM_NO_SUCH_VARIABLE",
        "measure(nothing=1)",
        "measure_everything()",
        "matcam.measure_everything",
        "NoSuchClass",
        ".no_such_attribute",
        "sample.no_such_field",
        "no_such_name",
    ],
)
def test_a_wrong_citation_is_found(span, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"Use `{span}`.")
    assert len(docs_cites.faults([page])) == 1


def test_a_right_citation_is_accepted(tmp_path):
    page = tmp_path / "page.md"
    right = ("matcam predict --radius 400", "measure(rig=, azimuth=)", "Rig.cell_value", "sample.radius_mm", "--camera")
    page.write_text("\n".join(f"`{span}`" for span in right) + "\n```sh\n`no_such_name`\n```\n")
    assert docs_cites.faults([page]) == []


def test_a_page_is_not_long():
    """The operator has one page of at most 200 lines, README at most 120, the changelog at most 6 kB."""
    assert len((DOCS / "forward.md").read_text(encoding="utf-8").splitlines()) <= 200
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120
    assert (ROOT / "CHANGELOG.md").stat().st_size <= 6000
