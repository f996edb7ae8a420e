"""`matcam chart`: pages in every format, their description, refusals."""

import json
import re

import pytest
from PIL import Image

from matcam.calibration.chart.chart_file import read_chart
from matcam.cli import main


@pytest.fixture
def chart(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def run(*arguments, code=0):
        with pytest.raises(SystemExit) as exit_:
            main(["chart", *map(str, arguments)])
        streams = capsys.readouterr()
        assert exit_.value.code == code, streams.err
        return streams

    return run


@pytest.mark.parametrize(("suffix", "start"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_page_and_description(chart, tmp_path, suffix, start):
    page = tmp_path / f"page.{suffix}"
    out = chart("squares", "star", "--pixels", 1500, "-o", page, "--dpi", 100, "--json").out
    found = json.loads(out)
    assert found["elements"]["star"] == 1
    assert found["files"] == [str(page), str(tmp_path / "page.json")]
    assert page.read_bytes().startswith(start)
    assert len(read_chart(tmp_path / "page.json").elements) == sum(found["elements"].values())
    assert "use --force" in chart("star", "-o", page, code=2).err
    text, remark = chart("squares", "star", "dots", "-o", page, "--force", "--dpi", 100)
    assert "true size" in text
    assert ("--dpi 514, or a .pdf file" in remark) == (suffix == "png")  # 3000 px on 297 mm, 2 dots each
    assert re.match(r"11 patches, 66 squares, 1 star, 1 dot grid on ", text)


def test_one_description_serves_pages_of_all_formats(chart, tmp_path):
    chart("star", "-o", tmp_path / "page.pdf")
    before = (tmp_path / "page.json").read_bytes()
    chart("star", "-o", tmp_path / "page.png", "--dpi", 100)
    with Image.open(tmp_path / "page.png") as page:
        assert page.info["dpi"] == pytest.approx((100, 100), abs=0.01)  # printed at true size
    assert (tmp_path / "page.json").read_bytes() == before
    refused = chart("star", "--pixels", 2000, "-o", tmp_path / "page.svg", code=2).err  # another chart
    assert "page.json exists" in refused
    assert (tmp_path / "page.json").read_bytes() == before
    (tmp_path / "page.json").write_text("[]")
    assert "page.json exists" in chart("star", "-o", tmp_path / "page.svg", code=2).err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("moon",), "kinds must be one of"),
        (("-o", "chart.bmp"), "must end in"),
        (("--page", "a9"), "'a9' is not one of"),
        (("--size", 1, 1), "--size must lie in"),
        (("--page", "a3", "--size", 200, 100), "--page and --size both specify"),
        (("-o", "chart.png", "--dpi", 9000), "million pixels"),
        (("-o", "chart.png", "--dpi", "nan"), "--dpi must lie in"),
        (("--pixels", 300), "--pixels above 300"),
    ],
)
def test_refusals_leave_nothing_behind(chart, tmp_path, arguments, words):
    lines = chart(*arguments, code=2).err.strip().splitlines()
    assert len(lines) == 1
    assert words in lines[0]
    assert not list(tmp_path.iterdir())
