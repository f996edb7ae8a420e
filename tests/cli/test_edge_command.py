"""`matcam edge`, run as users run it."""

import json
from functools import partial

import numpy as np
import pytest
import tifffile

from matcam.cli import main
from tests.oracle import slanted_edge as oracle


@pytest.fixture
def edge(matcam):
    """edge(*arguments) runs the command in an empty folder."""
    return partial(matcam, "edge")


@pytest.fixture
def photograph(tmp_path):
    """A 16-bit TIFF with an edge at (30, 20), 80 x 160 px, in a field of noise."""
    rng = np.random.default_rng(2)
    frame = rng.integers(2000, 9000, (200, 150)).astype(np.uint16)
    frame[20:180, 30:110] = oracle.photographs(oracle.gaussian(0.5), 100, 1, 4)[0]
    tifffile.imwrite(tmp_path / "chart.tif", frame)
    return tmp_path / "chart.tif"


ROI = ("--roi", 30, 20, 80, 160)


def test_verdict_figure_and_columns(edge, photograph, tmp_path):
    text = edge(photograph, *ROI).stdout
    assert "free of a model" in text
    assert "the gaussian lens explains the edge" in text
    assert [p.name for p in tmp_path.iterdir()] == ["chart.tif"]
    text = edge(photograph, *ROI, "-o", "chart-edge.png").stdout
    assert "picture: chart-edge.png" in text
    assert (tmp_path / "chart-edge.png").read_bytes().startswith(b"\x89PNG")
    header, *lines = (tmp_path / "chart-edge.csv").read_text().splitlines()
    assert header.startswith("frequency_cycles_per_px,mtf,mtf_std,core_mtf,")
    assert len(lines) == 81
    found = json.loads(edge(photograph, *ROI, "--json", "-o", "out/e.svg").stdout)
    truth = oracle.gaussian_half(0.5)
    assert abs(found["mtf50_cycles_per_px"] - truth) < 4 * found["mtf50_std"]
    assert abs(found["parametric"]["parameters"]["optics.sigma_px"] - 0.5) < 0.01
    assert found["angle_deg"] == pytest.approx(5, abs=0.05)
    assert "use --force" in edge("chart.tif", "-o", "out/e.svg", code=2).stderr
    assert found["files"] == ["out/e.svg", "out/e.csv"]


def test_pitch_commas_and_the_curve_for_other_programs(edge, photograph, tmp_path):
    text = edge(photograph, "--roi", "30,20,80,160", "--pitch", 5, "--sfr", "mtf.csv").stdout
    document = json.loads(edge(photograph, "--roi=30,20,80,160", "--pitch", 5, "-o", "b.png", "--json").stdout)
    lp = document["mtf50_cycles_per_px"] / 0.005
    assert document["mtf50_lp_per_mm"] == pytest.approx(lp, rel=1e-12)
    assert "lp/mm" in text
    assert f"{lp:.2f} ± " in text
    header, *lines = (tmp_path / "mtf.csv").read_text().splitlines()
    assert header == "frequency_cy_per_px,frequency_lp_per_mm,SFR"
    columns = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    assert columns[-1, 0] <= 1
    np.testing.assert_allclose(columns[:, 1], columns[:, 0] / 0.005, rtol=1e-6)
    half = np.interp(document["mtf50_cycles_per_px"], columns[:, 0], columns[:, 2])
    assert half == pytest.approx(0.5, abs=2e-3)


BAD = [
    (("chart.tif", *ROI, "--pitch", -1), "--pitch must lie in (0, inf) um"),
    (("none.tif",), "none.tif: no such file"),
    (("text.tif",), "neither TIFF, PNG, JPEG, OpenEXR nor camera raw"),
    (("cut.tif",), "more than its 3000 bytes can hold: damaged"),
    (("chart.tif", "--roi", 100, 0, 80, 160), "--roi must lie inside the picture of 150 x 200 px"),
    (("chart.tif", "--roi", 0, 0, 10, 60), "at least 16 x 16 px"),
    (("chart.tif", "--roi", 1, 2, 3), "requires 4 arguments"),
    (("chart.tif", "--roi", "1,2,3"), "requires 4 arguments"),
    (("chart.tif", *ROI, "--model", "defocus"), "--wavelength must be given for the defocus model"),
    (("chart.tif", *ROI, "--model", "lens"), "'lens' is not one of"),
    (("chart.tif", *ROI, "--channel", "R"), "asks for a colour of a grey image"),
    (("chart.tif", *ROI, "--half-width", 0.7), "--half-width must lie in (0, 0.5] px"),
    (("chart.tif", *ROI, "-o", "chart.tif"), "is the input itself"),
    (("chart.tif", *ROI, "-o", "a.bmp"), "must end in"),
    (("flat.tif",), "all one value"),
    (("white.tif",), "saturated"),
]


@pytest.mark.parametrize(("arguments", "words"), BAD, ids=[words for _, words in BAD])
def test_bad_input_is_one_line_code_2_and_nothing_written(photograph, tmp_path, monkeypatch, capsys, arguments, words):
    (tmp_path / "text.tif").write_text("not a picture")
    (tmp_path / "cut.tif").write_bytes(photograph.read_bytes()[:3000])
    tifffile.imwrite(tmp_path / "flat.tif", np.full((50, 50), 9, np.uint8))
    white = np.where(np.arange(50) > 25, 255, 40 + np.arange(50) % 3).astype(np.uint8)
    tifffile.imwrite(tmp_path / "white.tif", np.tile(white, (50, 1)))
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as exit_:
        main(["edge", *map(str, arguments)])
    assert exit_.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("matcam: ")
    assert words in lines[0]
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_budget(edge, photograph, tmp_path):
    found = json.loads(edge(photograph, *ROI, "--budget", "budget.json", "--json").stdout)
    assert "budget.json" in found["files"]
    free, *others = json.loads((tmp_path / "budget.json").read_text())["budgets"]
    assert free["combined_standard_uncertainty"] == pytest.approx(found["mtf50_std"])
    assert free["expanded_uncertainty"] == pytest.approx(2 * found["mtf50_std"])
    assert "optics.sigma_px" in {one["result"] for one in others}
    failed = edge(photograph, *ROI, "--budget", "budget.txt", "-o", "b.png", code=2)
    assert "must end in .json or .csv" in failed.stderr
