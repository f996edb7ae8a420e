"""`matcam calibrate`: what it writes, what it prints, and every kind of bad input."""

import json
import struct

import imagecodecs
import numpy as np
import pytest
import tifffile

from matcam import Camera
from matcam.cli import main
from tests.files.test_open_photograph import write_dng
from tests.oracle import slanted_squares


@pytest.fixture
def calibrate(capsys, monkeypatch, tmp_path):
    """Run the command in a folder of its own: (code, standard output, standard error)."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        with pytest.raises(SystemExit) as caught:
            main(["calibrate", *map(str, arguments)])
        captured = capsys.readouterr()
        return caught.value.code, captured.out, captured.err

    return run


def counts(sigma=0.5, seed=1):
    picture, _ = slanted_squares.field((420, 440), 140, 74, 5, sigma, dark=0.25)
    return np.random.default_rng(seed).poisson(picture * 3600)


@pytest.fixture
def chart(tmp_path):
    tifffile.imwrite(tmp_path / "chart.tif", (10 * counts()).astype(np.uint16))
    return tmp_path / "chart.tif"


def test_profile_page_and_table(calibrate, chart, tmp_path):
    chart = chart.rename("chart$^x$.tif")  # no formula: it would be none
    code, out, err = calibrate(chart.name, "--tone", "linear")
    assert code == 0, err
    assert "grey: optics.sigma_px = 0.5" in out
    assert "the camera explains the edges" in out
    assert sorted(p.name for p in tmp_path.iterdir() if p.is_file()) == [
        "camera-edges.csv",
        "camera.json",
        "camera.png",
        "chart$^x$.tif",
    ]
    camera = Camera.load("camera.json")
    std = camera.uncertainty.std()["optics.sigma_px"]
    assert abs(camera.optics.sigma - 0.5) < 4 * std
    assert "chart$^x$.tif" in camera.provenance.source
    header, *lines = (tmp_path / "camera-edges.csv").read_text().splitlines()
    assert header.startswith("edge,x_px,y_px,angle_rad,sigma_px,mtf50_cycles_per_px")
    assert len(lines) == 16
    code, _, err = calibrate(chart.name)
    assert (code, err.count("\n")) == (2, 1)
    assert "camera.json exists: use --force" in err
    # a bad picture among good ones: the rest is used
    (tmp_path / "bad.png").write_bytes(b"nothing")
    code, out, err = calibrate(
        chart.name, "bad.png", "--tone", "linear", "--json", "-o", "out/c.json", "--figure", "out/c.svg"
    )
    assert code == 1, err
    found = json.loads(out)
    assert found["pictures"] == [chart.name]
    assert found["failed"] == {
        "bad.png": "the file is neither TIFF, PNG, JPEG, OpenEXR nor camera raw: convert it to TIFF or PNG"
    }
    assert found["channels"]["grey"]["consistent"] is True
    assert (
        err
        == "matcam: left out: bad.png: the file is neither TIFF, PNG, JPEG, OpenEXR nor camera raw: convert it to TIFF or PNG\n"
    )
    assert "<svg" in (tmp_path / "out/c.svg").read_text()[:500]


@pytest.mark.slow
def test_raw_pictures_of_a_folder(calibrate, tmp_path):
    sigmas = {"R": 0.6, "G": 0.45, "B": 0.7}
    planes = [slanted_squares.field((420, 440), 140, 74, 5, s, dark=0.25)[0] for s in sigmas.values()]
    (tmp_path / "raw").mkdir()
    for number in range(2):
        expected = slanted_squares.mosaic(planes, "GBRG") * 3600
        taken = 512 + 4 * np.random.default_rng(number).poisson(expected)
        write_dng(tmp_path / "raw" / f"{number}.dng", taken.astype(np.uint16), "GBRG", white=65535)
    code, _, err = calibrate("raw")
    assert code == 0, err
    for name, sigma in sigmas.items():
        camera = Camera.load(f"camera-{name}.json")
        assert abs(camera.optics.sigma - sigma) < 4 * camera.uncertainty.std()["optics.sigma_px"]
    assert Camera.load("camera.json").optics.sigma == Camera.load("camera-G.json").optics.sigma
    whole = Camera.load("camera-RGB.json")
    for name, colour in (("R", "red"), ("G", "green"), ("B", "blue")):
        own = Camera.load(f"camera-{name}.json")
        assert getattr(whole.optics, colour) == own.optics
        std = own.uncertainty.std()["optics.sigma_px"]
        assert whole.uncertainty.std()[f"optics.{colour}.sigma_px"] == pytest.approx(std, rel=1e-9)


def promised(width, height):
    png = bytearray(imagecodecs.png_encode(np.zeros((4, 4), np.uint8)))
    png[16:24] = struct.pack(">II", width, height)
    return bytes(png)


def test_bad_input_is_one_line_and_code_2(calibrate, chart, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "odd.cr2").write_bytes(b"II*\0" + bytes(400))
    (tmp_path / "huge.png").write_bytes(promised(900_000, 900_000))
    (tmp_path / "wavy.dat").write_text("0\n5\n3\n")
    (tmp_path / "patches.txt").write_text("0 0 10 10 0.5\n")
    tifffile.imwrite(tmp_path / "sky.tif", np.random.default_rng(1).integers(90, 110, (300, 300)).astype(np.uint16))
    for name, model in (("one.dng", "One"), ("two.dng", "Two")):
        write_dng(tmp_path / name, np.full((64, 64), 900, np.uint16), model=model)
    soft = np.clip(10 * counts(0.8, 2), 0, 65535).astype(np.uint16)
    tifffile.imwrite(tmp_path / "soft.tif", soft)
    mosaic = np.clip(10 * counts(0.5, 3) * np.tile([[0.6, 1.0], [1.0, 0.5]], (210, 220)), 0, 65535).astype(np.uint16)
    tifffile.imwrite(tmp_path / "mosaic.tif", mosaic)
    for arguments, words in {
        ("sky.tif",): "sky.tif: no slanted edge was found",
        ("odd.cr2",): "odd.cr2: unknown camera raw",
        ("huge.png",): "huge.png: an image of 900000 x 900000 px needs",
        ("one.dng", "two.dng"): "the images are of different cameras: Maker One (one.dng), Maker Two (two.dng)",
        ("chart.tif", "soft.tif"): "channel grey: the measurements are contradictory: ",
        ("chart.tif", "--tone", "wavy.dat"): "wavy.dat: the tone curve must not decrease, but it decreases from code 1",
        ("mosaic.tif",): "as in a colour mosaic that is read as grey: if the image is a mosaic, give --cfa (",
        ("mosaic.tif", "--cfa", "RGBG"): "Invalid value for '--cfa'",
        ("empty",): "empty: this folder contains no images",
        ("none.tif",): "none.tif: no such file",
        ("chart.tif", "--tone", "film"): "--tone must be auto, linear, srgb, gamma:NUMBER or a file",
        ("chart.tif", "--tone", "gamma:x"): "a number must follow gamma:",
        ("chart.tif", "--tone", "srgb", "--tone-patches", "patches.txt"): "give one of them",
        ("chart.tif", "--tone-patches", "patches.txt"): "patches.txt: a tone curve requires at least 3 patches",
        ("chart.tif", "--half-width", "0.7"): "--half-width must lie in",
        ("chart.tif", "--channel", "X"): "--channel must be one of",
        ("chart.tif", "-o", "chart.tif"): "is a camera profile: its name must end in .json",
        (
            "chart.tif",
            "--budget",
            "camera.json",
        ): "camera.json is given twice, or is also written beside another output",
        ("chart.tif", "--figure", "page.gif"): "must end in .png, .pdf, .svg",
        (): "Missing argument",
    }.items():
        code, out, err = calibrate(*arguments)
        assert (code, out, err.count("\n")) == (2, "", 1), (arguments, err)
        assert words in err
    assert not list(tmp_path.glob("camera*"))
