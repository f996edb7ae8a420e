"""The site is built: without its examples, whose run is `make docs`; and what is broken fails it, by name."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import docs_check

pytest.importorskip("sphinx_gallery", reason="the extra matcam[docs] is not installed")

ROOT = Path(__file__).parents[2]
CONF = """
exclude_patterns = ["examples"]
extensions = ["myst_parser", "sphinx_gallery.gen_gallery"]
sphinx_gallery_conf = {"examples_dirs": ["examples"], "gallery_dirs": ["gallery"], "filename_pattern": r"\\.py$",
                       "abort_on_example_error": True}
"""

pytestmark = pytest.mark.slow


def built(source, output, *options):
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-n", "-W", *options, str(source), str(output)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)


def test_the_site_has_no_warning_and_no_bad_link(tmp_path):
    copy = tmp_path / "checkout"
    for folder in ("benchmarks", "docs", "examples", "packaging", "paper", "src", "tests"):
        ignored = shutil.ignore_patterns("__pycache__", *(("tutorials", "gallery") if folder == "docs" else ()))
        shutil.copytree(ROOT / folder, copy / folder, ignore=ignored)
    for file in (*ROOT.glob("*.md"), ROOT / "Makefile", ROOT / "pyproject.toml"):
        shutil.copy(file, copy)
    done = built(copy / "docs", tmp_path / "site", "-D", "plot_gallery=0")
    assert done.returncode == 0, done.stderr[-3000:]
    pages = docs_check.read(tmp_path / "site")
    assert len(pages) > 200
    assert docs_check.faults(tmp_path / "site") == []
    assert (tmp_path / "site" / "_static" / "tex-svg.js").stat().st_size > 1e6
    assert "Search.setIndex" in (tmp_path / "site" / "searchindex.js").read_text()[:100]


@pytest.fixture
def small(tmp_path):
    """A site of one page and one example."""
    (tmp_path / "conf.py").write_text(CONF)
    (tmp_path / "index.md").write_text("# Title\n\n```{toctree}\ngallery/index\n```\n")
    (tmp_path / "examples").mkdir()
    (tmp_path / "examples" / "GALLERY_HEADER.rst").write_text("Gallery\n=======\n")
    (tmp_path / "examples" / "plot_a.py").write_text('"""\nTitle\n=====\n"""\nprint(1)\n')
    return tmp_path


def test_a_good_example_passes(small):
    done = built(small, small / "site")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("examples/plot_a.py", '"""\nTitle\n=====\n"""\nraise ValueError("no")\n', "plot_a.py"),
        ("index.md", "# Title\n\n[gone](nowhere.md)\n\n```{toctree}\ngallery/index\n```\n", "nowhere.md"),
        ("index.md", "# Title\n\n{py:class}`matcam.Gone`\n\n```{toctree}\ngallery/index\n```\n", "matcam.Gone"),
    ],
)
def test_what_is_broken_fails_and_is_named(small, file, text, words):
    (small / file).write_text(text)
    done = built(small, small / "site")
    assert done.returncode != 0
    assert words in done.stderr + done.stdout
