"""HTML pages: what is put into them is escaped, and nothing that a template needs may be missing."""

from importlib import resources

import numpy as np
import pytest
from jinja2 import UndefinedError
from matplotlib.figure import Figure

from matcam.core.results.summary import Quantity
from matcam.figures.pages import write_run_index
from matcam.figures.style import fit_titles, inline_png, styled, write_page

HOSTILE = "<script>alert('\"&')</script>"


def record(name):
    fit = {
        "ndf": name, "params": {"alpha": 0.01}, "std": {"alpha": 1e-4}, "hwhm_rad": 0.01, "hwhm_std_rad": 1e-4,
        "determined": True, "noise": {"relative": 0.01},
    }  # fmt: skip
    remarks = [{"code": "outliers", "text": f"{name}; and more"}]
    return {"fit": fit, "verdict": name, "remarks": remarks, "run": {"files": {f"{name}.html": 1}, "seconds": 1.0}}


def test_an_index_cannot_be_injected_into(tmp_path):
    write_run_index(tmp_path / "index.html", [(HOSTILE, record(HOSTILE))], [HOSTILE], summary=HOSTILE)
    page = (tmp_path / "index.html").read_text()
    assert page.count("<script>") == 1  # the page's own
    assert "alert('" not in page
    assert page.count("&lt;script&gt;") >= 6  # summary, failure, name twice, verdict, remark, lobe


def test_a_correction_page_cannot_be_injected_into(tmp_path):
    content = {
        "name": HOSTILE, "verdict": HOSTILE, "remarks": [HOSTILE], "family": HOSTILE,
        "parameters": [Quantity(HOSTILE, 1.0, 0.1)],
        "figures": [(HOSTILE, "data:image/png;base64,")],
    }  # fmt: skip
    write_page(tmp_path / "a.html", "correction_page.html", content)
    page = (tmp_path / "a.html").read_text()
    assert "<script>" not in page
    assert page.count("&lt;script&gt;") == 8
    del content["verdict"]
    with pytest.raises(UndefinedError, match="verdict"):
        write_page(tmp_path / "b.html", "correction_page.html", content)
    assert not (tmp_path / "b.html").exists()


def test_templates_are_files_of_the_package():
    names = {file.name for file in (resources.files("matcam.figures") / "templates").iterdir()}
    assert names == {
        "page.html",
        "correction_page.html",
        "reconstruction_page.html",
        "run_index.html",
        "sensor_page.html",
    }


CONTENT = {
    "name": "a-material-with-a-long-name.binary", "verdict": "word " * 60, "remarks": ["long/" * 40], "family": "epd",
    "parameters": [Quantity("a long name of a parameter, rad", -1.23456e-05, 1.2e-07)],
    "budget_columns": [f"column {n} of the budget, %" for n in range(5)], "budget": [("noise", [0.123] * 5)],
    "explanations": [{"name": "ggx, lamp distance widened 63 times", "unexplained": 0.01, "probability": 1.0}],
    "not_determined": [("one[R]", "other[G]", 0.99)], "exposures": [("E1", 1.0, 0.01)],
    "lengths": [Quantity("distance of the camera, radii", "at least 400")],
    "pictures": [("L01-a-long-name-of-a-lamp", 45.0, 27.0, 3)],
    "left_out": ["frames/" + "z" * 120 + ".tiff: missing"],
    "uncertainty": [("a long name of a result, rad", [
        ["a long name of a source, px", "B", 0.5, 0.1, 2.0, 0.2, float("nan")],
        ["a long name of a result, rad, combined", "", 1e-05, 2e-07, float("nan"), 2e-07, 3.28e3],
        ["a long name of a result, rad, expanded (k = 2)", "", 1e-05, 4e-07, *[float("nan")] * 3],
    ])],
}  # fmt: skip


@pytest.mark.parametrize("template", ["correction_page.html", "reconstruction_page.html", "run_index.html"])
@pytest.mark.parametrize("width", [1200, 400])
def test_pages_do_not_overflow_sideways(chromium, template, width, tmp_path):
    """What is wider than a telephone's screen, tables, scrolls in itself."""
    if template == "run_index.html":
        name = "a-material-with-a-long-name-2024"
        write_run_index(tmp_path / template, [(name, record(name))], ["x" * 200], summary="y" * 200)
    else:
        picture = inline_png(Figure(figsize=(9.6, 6.4)))
        write_page(tmp_path / template, template, CONTENT | {"figures": [("Lobe", picture)]})
    page = chromium.new_page(viewport={"width": width, "height": 900})
    page.goto((tmp_path / template).as_uri())
    page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.close()


@pytest.mark.parametrize("template", ["correction_page.html", "run_index.html"])
def test_numbers_do_not_break_at_their_exponent(chromium, template, tmp_path):
    if template == "run_index.html":
        small = record("a")
        small["fit"] |= {
            "params": {"alpha": 1.2345e-05},
            "std": {"alpha": 1.2e-07},
            "hwhm_rad": 1e-8,
            "hwhm_std_rad": 1e-9,
        }
        write_run_index(tmp_path / template, [("a", small)], [])
    else:
        write_page(tmp_path / template, template, CONTENT | {"figures": []})
    page = chromium.new_page(viewport={"width": 400, "height": 900})
    page.goto((tmp_path / template).as_uri())
    page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
    lines = page.evaluate("""() => [...document.querySelectorAll("td")].filter(td => /e-\\d/.test(td.textContent)).map(td => {
        const range = document.createRange(); range.selectNodeContents(td); return range.getClientRects().length; })""")
    page.close()
    assert lines
    assert set(lines) == {1}


def test_an_index_says_of_what_a_share_is(tmp_path):
    write_run_index(tmp_path / "index.html", [("a", record("a"))], [])
    page = (tmp_path / "index.html").read_text()
    assert "supported, of entries<br>with known uncertainty" in page
    assert "<h1>1 corrected material</h1>" in page
    withheld = record("b") | {"withheld": True}
    write_run_index(tmp_path / "index.html", [("a", record("a")), ("b", withheld)], [], force=True)
    assert "<h1>1 corrected material, 1 withheld</h1>" in (tmp_path / "index.html").read_text()


@pytest.mark.parametrize("layout", ["constrained", None])
def test_no_title_leaves_its_figure(layout):
    """Names of files are as long as their owners like: a title is made smaller, then broken, before a panel or the edge."""
    with styled():
        figure = Figure(figsize=(8, 4), layout=layout)
        left, right = figure.subplots(1, 2)
        left.set_title("a photograph of a chart that was taken in the laboratory on the second floor.tif", loc="left")
        right.set_title("short", loc="left")
        figure.suptitle("a title of the whole figure " * 6, x=0.01, ha="left")
        figure.draw_without_rendering()
        assert fit_titles(figure)
        figure.draw_without_rendering()
        assert not fit_titles(figure)
        ends = [text.get_window_extent().x1 for text in (*left.get_children(), *figure.texts) if "a " in str(text)]
        boxes = {text.get_text(): text.get_window_extent() for axes in (left, right) for text in axes.get_children()
                 if hasattr(text, "get_text") and text.get_text()}  # fmt: skip
    assert len(ends) == 2
    assert max(ends) <= figure.bbox.width
    long = next(box for text, box in boxes.items() if text.startswith("a photograph"))
    assert long.x1 <= boxes["short"].x0
    assert np.isfinite(long.height)
