"""HTML pages: what is put into them is escaped, and nothing that a template needs may be missing."""

from importlib import resources

import pytest
from jinja2 import UndefinedError

from matcam.figures.pages import write_run_index
from matcam.figures.style import write_page

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
        "name": HOSTILE, "verdict": HOSTILE, "remarks": [HOSTILE], "family": HOSTILE, "parameters": [(HOSTILE, 1.0, 0.1)],
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
    assert names == {"page.html", "correction_page.html", "reconstruction_page.html", "run_index.html"}
