"""What `inspect` says of photographs, folders and the JSON files of results."""

import imagecodecs
import numpy as np
import pytest
import tifffile

from matcam import inspect, write_merl
from matcam.core.errors import FileFormatError
from matcam.core.grid import brdf_table
from matcam.core.io import write_columns, write_json
from matcam.files.capture_listing import list_photographs
from matcam.files.capture_writing import write_template
from matcam.files.float_pictures import read_exr, read_exr_layers, write_exr_layers

RECONSTRUCTION = {
    "format": "matcam reconstruction",
    "version": 1,
    "verdict": "8 images give a ggx lobe.",
    "sample": "sphere",
    "lobe": {"family": "ggx", "masking": "smith"},
    "parameters": {"alpha": [0.05, 3e-5], "diffuse_R": [0.1, None]},
    "pictures": [{"name": "L01"}, {"name": "L02"}],
    "left_out": ["L03"],
    "remarks": [{"code": "one", "text": "the lamp is near"}],
}


@pytest.fixture
def codes():
    found = np.arange(600, dtype=np.uint16).reshape(20, 30)
    found[:2] = 65535
    return found


@pytest.mark.parametrize("name", ["p.tif", "p.png"])
def test_a_photograph_of_16_bits(tmp_path, codes, name):
    path = tmp_path / name
    path.write_bytes(imagecodecs.png_encode(codes)) if name == "p.png" else tifffile.imwrite(path, codes)
    report = inspect(path)
    assert report["holds"] == "a photograph"
    assert report["size_px"] == [30, 20]
    assert (report["channels"], report["bits"], report["linear"]) == (["grey"], 16, False)
    assert report["range"] == [60, 65535]
    assert report["saturated_share"] == 0.1


@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 3)])
def test_an_image_of_floats_is_no_photograph(tmp_path, shape):
    photometric = "rgb" if len(shape) == 3 else "minisblack"
    tifffile.imwrite(tmp_path / "p.tif", np.full(shape, 0.5, np.float32), photometric=photometric)
    report = inspect(tmp_path / "p.tif")
    assert (report["holds"], report["shape"]) == ("an image", list(shape))


def test_a_reconstruction(tmp_path):
    write_json(tmp_path / "r.json", RECONSTRUCTION)
    report = inspect(tmp_path / "r.json")
    assert report["holds"] == "the result of a reconstruction from photographs of a sphere"
    assert report["verdict"] == RECONSTRUCTION["verdict"]
    assert report["parameters"] == {
        "alpha": {"value": 0.05, "std": 3e-5},
        "diffuse_R": {"value": 0.1, "std": None},
    }
    assert (report["images"], report["left_out"], report["remarks"]) == (2, ["L03"], ["the lamp is near"])


def test_a_correction(tmp_path):
    fit = {"ndf": "epd", "params": {"beta": 0.01}, "std": {"beta": 1e-4}}
    document = {"file": "a.binary", "camera": {"optics": {"model": "gaussian", "sigma_px": 0.5}}, "fit": fit}
    document |= {"supported_share": 0.9, "verdict": "it is corrected", "remarks": []}
    write_json(tmp_path / "r.json", document)
    report = inspect(tmp_path / "r.json")
    assert (report["holds"], report["table"]) == ("the result of a correction", "a.binary")
    assert (report["family"], report["supported_share"]) == ("epd", 0.9)
    assert report["lens"] == "gaussian, sigma_px 0.5"


def test_a_fit_and_its_budgets(tmp_path):
    fit = {"files": ["a.binary"], "ndf": "epd", "params": {"beta": 0.01}, "std": {"beta": 1e-4}, "remarks": []}
    write_json(tmp_path / "f.json", fit)
    report = inspect(tmp_path / "f.json")
    assert report["holds"] == "the result of a fit to a.binary"
    assert report["parameters"] == {"beta": {"value": 0.01, "std": 1e-4}}
    budget = {"result": "F(9.5 deg), R", "value": 1.0, "combined_standard_uncertainty": 6e-5}
    write_json(tmp_path / "b.json", {"budgets": [budget]})
    assert "1 ± 6e-05" in str(inspect(tmp_path / "b.json"))


def test_layers_of_an_image(tmp_path):
    layers = {"corrected": np.full((4, 5, 3), 2.0), "supported": np.array([[0.0] * 5] * 3 + [[1.0] * 5])}
    write_exr_layers(tmp_path / "a.exr", layers)
    for name, read in read_exr_layers(tmp_path / "a.exr").items():
        np.testing.assert_array_equal(read, layers[name])
    report = inspect(tmp_path / "a.exr")
    assert report["layers"]["corrected"] == "5 x 4 px, 3 channels, values 2 to 2"
    with pytest.raises(FileFormatError, match="the file has the layers corrected, supported"):
        read_exr(tmp_path / "a.exr")


def test_columns_of_a_result(tmp_path):
    write_columns(tmp_path / "c.csv", {"theta_d_rad": [0.1, 0.2], "channel": ["R", "G"], "raw": [0.5, np.nan]})
    report = inspect(tmp_path / "c.csv")
    assert report["rows"] == 2
    assert report["columns"] == {"theta_d_rad": "0.1 to 0.2", "channel": "-", "raw": "0.5 to 0.5"}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"parameters": 1}, "damaged result"),
        ({"pictures": None}, "damaged result"),
        ({"remarks": ["text"]}, "damaged result"),
        ({"verdict": None}, "not a camera profile"),
    ],
)
def test_a_damaged_result_is_refused(tmp_path, changed, words):
    write_json(tmp_path / "r.json", RECONSTRUCTION | changed)
    with pytest.raises(FileFormatError, match=words):
        inspect(tmp_path / "r.json")


def test_a_capture(tmp_path, codes):
    for name in ("L01_E1.tif", "L01_E2.tif", "L02_E1.tif", "L02_E2.tif"):
        (tmp_path / "photographs").mkdir(exist_ok=True)
        tifffile.imwrite(tmp_path / "photographs" / name, codes)
    listing = list_photographs(tmp_path / "photographs")
    write_template(tmp_path / "shots", listing.rows)
    listing.copy_to(tmp_path / "shots", force=False)
    report = inspect(tmp_path / "shots")
    assert report["holds"] == "a capture of a sphere"
    assert (report["lamp_positions"], report["exposures"]) == (2, ["E1", "E2"])
    assert report["images"] == {"frames": 4, "dark": 0, "flat": 0, "outline": 0, "reference": 0}
    assert report["camera_profile"] is None


def test_other_folders(tmp_path, codes):
    with pytest.raises(FileFormatError, match="contains no capture"):
        inspect(tmp_path)
    write_merl(tmp_path / "a.binary", brdf_table(np.full((90, 90, 180, 3), 0.3), "centre"))
    tifffile.imwrite(tmp_path / "p.tif", codes)
    report = inspect(tmp_path)
    assert (report["tables"], report["photographs"]) == (1, 1)
    for name in ("a-corrected.binary", "a-corrected.nc"):
        (tmp_path / name).touch()
    report = inspect(tmp_path)
    assert (report["tables"], report["results"]) == (1, 1)
    (tmp_path / "a-corrected.nc").unlink()
    rig = {"sample": {"kind": "sphere", "radius_px": 256.0}, "camera": {"optics": {"model": "gaussian"}}}
    write_json(tmp_path / "settings.json", {"format": "matcam run", "rig": rig})
    write_json(tmp_path / "failed.json", {"failed": [{"file": "b", "reason": "b: it is damaged"}]})
    (tmp_path / "a.nc").touch()
    report = inspect(tmp_path)
    assert report["holds"] == "the results of a run of matcam correct"
    assert (report["corrected"], report["failed"]) == (["a"], ["b: it is damaged"])
    assert (report["sample"], report["lens"], report["page"]) == ("sphere, radius_px 256", "gaussian", None)
    write_json(tmp_path / "settings.json", {"format": "matcam run"}, force=True)
    with pytest.raises(FileFormatError, match="a field is missing or wrong"):
        inspect(tmp_path)
