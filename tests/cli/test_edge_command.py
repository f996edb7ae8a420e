"""`matcam edge`, run as users run it."""

import csv
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
    assert "without a model" in text
    assert "the gaussian lens explains the edge" in text
    assert [p.name for p in tmp_path.iterdir()] == ["chart.tif"]
    text = edge(photograph, *ROI, "-o", "chart-edge.png").stdout
    assert "written: chart-edge.png, chart-edge.csv" in text
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


def test_numbers_off_the_edge(edge, photograph):
    text = edge(photograph, *ROI, "--at", 0.25, "--at", 0.4).stdout
    for words in ("MTF30", "MTF20", "MTF10", "rise from 10 % to 90 %", "MTF at 0.25 cycles/px", "MTF at 0.4 cycles/px"):
        assert words in text
    found = json.loads(edge(photograph, *ROI, "--at", 0.25, "--json").stdout)
    truth = oracle.gaussian_mtf(np.array([0.25]), 0.5)[0]
    assert abs(found["mtf_at_0.25"] - truth) < 4 * found["mtf_at_0.25_std"] < 0.02
    assert found["mtf50_cycles_per_px"] < found["mtf30_cycles_per_px"] < found["mtf10_cycles_per_px"]


def test_the_standard_beside_ours(edge, photograph, tmp_path):
    text = edge(photograph, *ROI, "--method", "iso12233", "--sfr", "iso.csv").stdout
    assert "e-SFR, ISO 12233:2023" in text
    assert "±" not in text
    found = json.loads(edge(photograph, *ROI, "--method", "iso12233", "--json").stdout)
    assert found["method"] == "iso12233"
    assert found["mtf50_cycles_per_px"] == pytest.approx(oracle.gaussian_half(0.5), rel=0.03)
    header, *lines = (tmp_path / "iso.csv").read_text().splitlines()
    assert header == "frequency_cy_per_px,SFR"
    assert lines[0].startswith("0,1")
    assert "needs --method likelihood" in edge(photograph, "--method", "iso12233", "-o", "a.png", code=2).stderr
    of_a_model = edge(photograph, "--method", "iso12233", "--model", "halo", "--half-width", 0.3, code=2).stderr
    assert "--model, --half-width needs --method likelihood" in of_a_model


def test_many_edges_in_one_run(edge, photograph, tmp_path):
    colours = np.stack([tifffile.imread(photograph)] * 3, axis=-1)
    tifffile.imwrite(tmp_path / "colour.tif", colours, photometric="rgb")
    (tmp_path / "rois.csv").write_text("name,x,y,width,height\ngood,30,20,80,160\nnoise,0,0,29,60\n")
    done = edge("chart.tif", "colour.tif", "--rois", "rois.csv", "--channel", "all", "--table", "t.csv", code=1)
    header, *lines = (tmp_path / "t.csv").read_text().splitlines()
    rows = [dict(zip(header.split(","), line.split(","), strict=False)) for line in lines]
    assert [(r["file"], r["region"], r["channel"]) for r in rows] == [
        *[("chart.tif", name, "grey") for name in ("good", "noise")],
        *[("colour.tif", name, c) for c in "RGBY" for name in ("good", "noise")],
    ]
    good = [r for r in rows if r["region"] == "good"]
    for r in good:
        assert float(r["mtf50_cycles_per_px"]) == pytest.approx(oracle.gaussian_half(0.5), rel=0.02)
        assert float(r["rise_10_90_px"]) == pytest.approx(1.49, abs=0.03)
    assert all(r["mtf50_cycles_per_px"] == "" for r in rows if r["region"] == "noise")
    assert "left out: chart.tif noise grey: no edge" in done.stderr
    found = json.loads(edge("chart.tif", "--rois", "rois.csv", "--json", code=1).stdout)
    assert [one["region"] for one in found["edges"]] == ["good", "noise"]
    assert found["edges"][1]["problem"].startswith("no edge")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n", "column x is missing"),
        ("x,y,width,height\n1,2,3\n", "line 2 is not a region"),
        ("x,y,width,height\n", "contains no region"),
        ("name,x,y,width,height\na,0,0,20,20\na,0,0,20,20\n", "the name a occurs twice"),
    ],
)
def test_a_file_that_names_no_regions(edge, photograph, tmp_path, text, words):
    (tmp_path / "rois.csv").write_text(text)
    error = edge("chart.tif", "--rois", "rois.csv", code=2).stderr
    assert words in error
    assert "rois.csv" in error


def test_one_edge_has_a_figure_and_a_row_of_a_table(edge, photograph, tmp_path):
    said = edge("chart.tif", *ROI, "--table", "t.csv", "-o", "a.png", "--at", 0.25).stdout
    (row,) = csv.DictReader((tmp_path / "t.csv").read_text().splitlines())
    assert (row["file"], row["channel"]) == ("chart.tif", "grey")
    assert f"{float(row['mtf50_cycles_per_px']):.4f}" in said
    assert (tmp_path / "a.png").exists()


BAD = [
    (("chart.tif", *ROI, "--channel", "all", "-o", "a.png"), "-o needs one channel of one region of one image"),
    (
        ("chart.tif", *ROI, "-o", "a.png", "--table", "a.csv"),
        "a.csv is given twice, or is also written beside another output",
    ),
    (("chart.tif", *ROI, "--rois", "rois.csv"), "--roi and --rois both specify regions"),
    (("chart.tif", *ROI, "--at", 3), "--at must lie in [0, 1.25] cycles/px"),
    (("chart.tif", *ROI, "--method", "mtf"), "'mtf' is not one of"),
    (("chart.tif", *ROI, "--pitch", -1), "--pitch must lie in [0.01, 10000] um, got -1"),
    (("chart.tif", *ROI, "--pitch", 0.00345), "--pitch must lie in [0.01, 10000] um, got 0.00345"),
    (("none.tif",), "none.tif: no such file"),
    (("text.tif",), "neither TIFF, PNG, JPEG, OpenEXR nor camera raw"),
    (
        ("cut.tif",),
        "the file is damaged: its header specifies an image of shape (200, 150), but the file has only 3000 bytes",
    ),
    (("chart.tif", "--roi", 100, 0, 80, 160), "--roi must lie inside the image of 150 x 200 px"),
    (("chart.tif", "--roi", 0, 0, 10, 60), "at least 16 x 16 px"),
    (("chart.tif", "--roi", 1, 2, 3), "requires 4 arguments"),
    (("chart.tif", "--roi", "1,2,3"), "requires 4 arguments"),
    (("chart.tif", *ROI, "--model", "defocus"), "--wavelength must be given for the defocus model"),
    (("chart.tif", *ROI, "--model", "lens"), "'lens' is not one of"),
    (("chart.tif", *ROI, "--channel", "R"), "must not be 'R' for a grey image"),
    (("chart.tif", *ROI, "--half-width", 0.7), "--half-width must lie in (0, 0.5] px"),
    (("chart.tif", *ROI, "-o", "chart.tif"), "is the input itself"),
    (("chart.tif", *ROI, "-o", "a.bmp"), "must end in"),
    (("flat.tif",), "only one value"),
    (("white.tif",), "saturated"),
    (
        ("chart.tif",),
        "choose another region; give the region with --roi, or measure all edges: matcam calibrate chart.tif",
    ),
    (("chart.tif", "--method", "iso12233"), "with --roi, or measure all edges: matcam calibrate chart.tif"),
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


def focus_series(folder, positions=(-0.8, -0.4, 0.0, 0.4, 0.8)):
    """Photographs of an edge at focus positions; the best focus is 0.1."""
    for n, z in enumerate(positions):
        frame = oracle.photographs(oracle.gaussian(np.hypot(0.5, 0.5 * (z - 0.1))), 100, 1, n)[0]
        tifffile.imwrite(folder / f"F{n}.tif", frame.astype(np.uint16))
    return [folder / f"F{n}.tif" for n in range(len(positions))]


def test_a_through_focus_series(edge, tmp_path):
    pictures = focus_series(tmp_path)
    given = ("--focus=-0.8,-0.4,0,0.4,0.8", "--table", "series.csv", "-o", "focus.png")
    text = edge(*pictures, *given).stdout
    assert "best focus" in text
    assert "figure: focus.png" in text
    assert (tmp_path / "focus.png").read_bytes().startswith(b"\x89PNG")
    assert (
        (tmp_path / "focus.csv")
        .read_text()
        .startswith("region,channel,focus_position,mtf50,mtf50_std\nwhole,grey,-0.8,")
    )
    assert (tmp_path / "series.csv").read_text().startswith("file,focus_position,region,")
    document = json.loads(edge(*pictures, *given, "--force", "--json").stdout)
    (found,) = document["best_focus"]
    assert abs(found["position"] - 0.1) < 4 * found["position_std"] < 0.1
    assert (found["region"], found["channel"]) == ("whole", "grey")
    assert document["files"] == ["series.csv", "focus.png", "focus.csv"]


def test_a_series_without_a_best_focus_says_so(edge, tmp_path):
    done = edge(*focus_series(tmp_path, (1.0, 1.2, 1.4, 1.6)), "--focus", "1,1.2,1.4,1.6")
    assert "no best focus of whole grey: no maximum of MTF50 lies between the positions 1 and 1.6" in done.stderr


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--focus", "1,2"), "--focus must have a finite position for each of the 4 photographs"),
        (("--focus", "1,1,2,2"), "--focus must have at least 4 different positions"),
        (("--focus", "a,b,c,d"), "--focus must be numbers separated by commas"),
        (("--focus", "1,2,3,4", "--method", "iso12233"), "--focus needs --method likelihood"),
        (("-o", "a.png"), "-o needs one channel of one region of one image"),
    ],
)
def test_wrong_focus_positions(edge, tmp_path, given, words):
    assert words in edge(*[tmp_path / f"F{n}.tif" for n in range(4)], *given, code=2).stderr
