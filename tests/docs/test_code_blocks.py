"""Every block of code in README and the documentation: commands are read as the command line reads them, Python runs."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import matcam
from docs_commands import commands
from matcam import GGX, Conductor, Microfacet, metal, read_merl, write_merl
from matcam.cli import _run
from matcam.forward import true_table
from matcam.io import write_float_tiff
from matcam.targets import Star, design_chart, write_chart
from tests.batch.simple import work_in_this_process
from tests.oracle.chart_camera import ChartCamera

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
    """A folder with the files that README and the pages speak of: the table is ideal, and no camera has to be undone."""
    monkeypatch.chdir(tmp_path)
    chromium = Conductor(*metal("Cr", [610e-9, 550e-9, 465e-9])[:2])
    write_merl("chrome.binary", true_table(Microfacet(GGX(0.05), chromium)))
    Path("brdfs").mkdir()
    Path("brdfs/chrome.binary").write_bytes(Path("chrome.binary").read_bytes())
    Path("photographs").mkdir()
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
    """Its commands in their order, on an ideal table of chromium and a photograph of its chart, then its Python."""
    page = ROOT / "README.md"
    for words in lines_of(page):
        if words[0] == "calibrate":  # the chart has been drawn: photograph it
            chart = json.loads(Path("chart.json").read_text())
            shot = ChartCamera(page=tuple(chart["page_mm"]), width=2400, height=1700, sigma=0.5, fill=1.0)
            picture = shot.photograph(shot.expected(chart), 60, 1)
            write_float_tiff("photographs/one.tif", picture.astype(np.float32))
        assert _run([*words, "--force"] if "-o" in words and words[0] != "inspect" else words) == 0, words
    for n, block in enumerate(blocks(page, "python")):
        exec(compile(block, f"{page.name}, block {n}", "exec"), {"__name__": "__main__"})
    assert np.isfinite(read_merl("chrome-corrected.binary")).any()


@pytest.mark.slow
def test_the_page_of_runs(workplace, monkeypatch):
    work_in_this_process(monkeypatch)
    for block in blocks(ROOT / "docs" / "batch.md", "python"):
        exec(compile(block, "batch.md", "exec"), {"__name__": "__main__"})
    assert Path("corrected/index.html").exists()


@pytest.mark.slow
def test_the_page_of_charts(tmp_path, monkeypatch):
    """Its Python, on a photograph that the oracle's camera takes of the chart."""
    monkeypatch.chdir(tmp_path)
    chart = design_chart(("star", "bars"), pixels_across=700)
    write_chart("chart.json", chart)
    shot = ChartCamera(page=chart.page, width=700, height=500, sigma=0.5, fill=0.9)
    picture = shot.photograph(shot.expected(json.loads(Path("chart.json").read_text())), 60, 1)
    star = next(one for one in chart.elements if isinstance(one, Star))
    x, y = np.ravel(shot.sensor_of(*star.centre))
    radius = np.ravel(shot.sensor_of(star.centre[0] + star.outer, star.centre[1]))[0] - x + 4
    names = {
        "matcam": matcam,
        "picture": picture,
        "roi": [round(v) for v in (x - radius, y - radius, 2 * radius, 2 * radius)],
    }
    for block in blocks(ROOT / "docs" / "targets.md", "python"):
        exec(compile(block, "targets.md", "exec"), names)
    assert names["found"].problems == ()
    assert len(names["found"].samples) > 3
