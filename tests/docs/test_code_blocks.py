"""Every block of code in README and the documentation: commands are read as the command line reads them, Python runs."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from docs_commands import commands
from matcam import read_merl, write_merl
from matcam.cli import _run

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    *sorted(p for p in (ROOT / "docs").rglob("*.md") if p.parent.name not in ("api", "gallery", "tutorials")),
]
COMMANDS = commands()


def blocks(page, language):
    found = re.findall(rf"(?ms)^[ ]*```{language}\n(.*?)^[ ]*```", page.read_text(encoding="utf-8"))
    return [re.sub(r"(?m)^[ ]{3}(?=matcam|make)", "", block) for block in found]


def lines_of(page):
    """Commands of matcam on a page, without comments."""
    for block in blocks(page, "sh"):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if words and Path(words[0]).name == "matcam":
                yield words[1:]


SHELL = [(page, words) for page in PAGES for words in lines_of(page)]
PYTHON = [(page, n, block) for page in PAGES for n, block in enumerate(blocks(page, "python"))]


def test_there_are_blocks():
    assert len(SHELL) > 30
    assert len(PYTHON) >= 7


@pytest.mark.parametrize(("page", "words"), SHELL, ids=lambda v: v.stem if isinstance(v, Path) else " ".join(v)[:60])
def test_commands_are_understood(page, words):
    """Every option exists and takes the value that is given to it. A command that is not there fails, by name."""
    name = next((n for n in (" ".join(words[:2]), words[0]) if n in COMMANDS), None)
    assert name, f"{page.name}: no command {words[0]}"
    command, _ = COMMANDS[name]
    command.make_context(f"matcam {name}", list(words[len(name.split()) :]))


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """A folder with the files that README and the pages speak of."""
    import sys

    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    from shared_table import recorded

    write_merl("chrome.binary", recorded().clip(min=0))
    Path("brdfs").mkdir()
    Path("brdfs/chrome.binary").write_bytes(Path("chrome.binary").read_bytes())
    Path("photographs").mkdir()
    sys.modules.pop("shared_table")
    return tmp_path


HEAVY = ("README.md", "batch.md", "targets.md")
"""Pages whose Python corrects tables or measures charts."""


@pytest.mark.parametrize(
    ("page", "n", "block"),
    [p for p in PYTHON if p[0].name not in HEAVY],
    ids=lambda v: v.stem if isinstance(v, Path) else "" if isinstance(v, str) and len(v) > 9 else str(v),
)
def test_python_runs(page, n, block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(block, f"{page.name}, block {n}", "exec"), {"__name__": "__main__"})


@pytest.mark.slow
def test_readme_runs(workplace):
    """The commands of README in their order, on a table of chromium and a photograph of slanted squares, then its Python."""
    page = ROOT / "README.md"
    source = (ROOT / "examples" / "tutorials" / "plot_2_calibrate_a_camera.py").read_text()
    names = {"__name__": "example"}
    exec(source.split("folder = Path(")[0].replace("import matplotlib.pyplot as plt\n", ""), names)
    from matcam.io import write_float_tiff

    write_float_tiff("photographs/one.tif", names["photograph"].astype(np.float32))
    for words in lines_of(page):
        assert _run([*words, "--force"] if "-o" in words and words[0] != "inspect" else words) == 0, words
    for n, block in enumerate(blocks(page, "python")):
        exec(compile(block, f"{page.name}, block {n}", "exec"), {"__name__": "__main__"})
    assert np.isfinite(read_merl("chrome-corrected.binary")).any()


@pytest.mark.slow
def test_heavy_pages_run(workplace, monkeypatch):
    """Python of the other pages that need files: a run, and a chart."""
    from tests.batch.simple import work_in_this_process

    work_in_this_process(monkeypatch)
    for block in blocks(ROOT / "docs" / "batch.md", "python"):
        exec(compile(block, "batch.md", "exec"), {"__name__": "__main__"})
    assert Path("corrected/index.html").exists()
