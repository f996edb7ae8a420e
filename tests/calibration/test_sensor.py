"""A sensor's electronics, by a simulated sensor of known truth, by the package `emva1288`, and by its public data sets."""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
import tifffile

from docs_claims import limit
from matcam import Camera, GaussianOptics, characterise_sensor
from matcam.core.errors import ArgumentError, FileFormatError, FitError
from matcam.figures.sensor import write_sensor_page
from tests.conftest import SHARED
from tests.oracle import exposures

GOLDEN = Path(__file__).parents[1] / "golden" / "emva1288.json"
"""Results of the package `emva1288` 1.0.2 for the public reference data sets."""
COMPARED = {
    "gain": "K",
    "read_noise": "sigma_d",
    "saturation": "u_e_sat",
    "prnu": "PRNU1288",
    "dsnu": "DSNU1288",
}


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exposures")
    exposures.write_folder(folder)
    return characterise_sensor(folder)


def test_all_characteristics_are_those_of_the_simulated_sensor(found):
    truth = {
        "gain": exposures.GAIN,
        "read_noise": exposures.READ_NOISE,
        "black_level": exposures.BLACK,
        "dark_current": exposures.CURRENT,
        "prnu": exposures.PRNU,
        "prnu_pixel": exposures.PRNU,
        "dsnu": exposures.DSNU,
        "full_well": exposures.WELL,
    }
    own = np.random.default_rng(11)
    truth["prnu"] = truth["prnu_pixel"] = exposures.PRNU * float(own.standard_normal((90, 120)).std())
    truth["dsnu"] = exposures.DSNU * float(own.standard_normal((90, 120)).std())
    assert found.saturated
    # pixels begin to clip where the brightest three standard deviations reach the well, and exposures are 600 e- apart
    assert 0.92 * exposures.WELL < found.saturation.value < exposures.WELL
    for name, value in truth.items():
        measured = getattr(found, name)
        assert abs(measured.value - value) < 4 * measured.std + 1e-3 * value, (name, measured, value)
        assert measured.std < 0.12 * value, name
    assert max(map(abs, found.linearity_error)) < 0.005
    assert found.bits == 12
    assert [remark.code for remark in found.remarks] == ["clipped"]


def test_standard_deviations_are_those_of_repeated_series(tmp_path):
    """Ten series of one sensor scatter by what each states."""
    times = exposures.TIMES[::4]
    several = []
    for seed in range(8):
        exposures.write_folder(tmp_path / str(seed), seed, stack=2, times=np.append(times, exposures.TIMES[7]))
        several.append(characterise_sensor(tmp_path / str(seed)))
    for name in ("gain", "read_noise", "dark_current", "prnu"):
        values = np.array([getattr(one, name) for one in several])
        ratio = values[:, 0].std(ddof=1) / np.sqrt(np.mean(values[:, 1] ** 2))
        print(name, ratio, values)
        assert 0.25 < ratio < 2.0, (name, ratio)


def test_an_exposure_of_another_light_is_named_and_not_used(tmp_path, found):
    wrong = exposures.TIMES[6]
    exposures.write_folder(tmp_path, light={wrong: 1.2})
    bad = characterise_sensor(tmp_path)
    named = [remark.text for remark in bad.remarks if remark.code == "not-linear"]
    assert len(named) == 1
    assert f"{wrong:g} s" in named[0]
    plane = bad.transfers[0]
    assert not plane.used[np.isclose(plane.time, wrong)].any()
    assert bad.gain.value == pytest.approx(found.gain.value, rel=0.01)
    assert max(map(abs, bad.linearity_error)) < 0.005


def test_clipped_exposures_are_named_and_not_used(found):
    plane = found.transfers[0]
    full = exposures.RATE * plane.time > exposures.WELL
    assert full.sum() >= 3
    assert not plane.used[full].any()
    assert not plane.judged[full].any()


def test_a_tone_curve_is_refused(tmp_path):
    random = np.random.default_rng(0)
    for seconds in exposures.TIMES[:9]:
        for kind, light in (("flat", 1.0), ("dark", 0.0)):
            for number, frame in enumerate(exposures.frames(random, seconds, 2, light)):
                bent = np.round(4095 * (frame / 4095) ** 0.45).astype(np.uint16)
                tifffile.imwrite(tmp_path / f"{kind}_{1e3 * seconds:g}ms_{number}.tif", bent)
    with pytest.raises(FitError, match="a tone curve was applied to the frames"):
        characterise_sensor(tmp_path)


def test_exchanged_dark_and_lit_frames_are_refused(tmp_path):
    exposures.write_folder(tmp_path, stack=2, times=exposures.TIMES[::3])
    for kind, folder in (("flat", "dark"), ("dark", "flat")):
        (tmp_path / folder).mkdir()
        for file in tmp_path.glob(f"{kind}_*.tif"):
            file.rename(tmp_path / folder / file.name)
    message = r"dark/flat_56ms_0.tif: the dark frames are brighter than the lit frames .*flat/dark_56ms_0.tif: exchange"
    with pytest.raises(FitError, match=message):
        characterise_sensor(tmp_path)


def test_each_colour_of_a_mosaic_saturates_by_itself(tmp_path):
    random = np.random.default_rng(3)
    tile = np.tile([[0.5, 1.0], [1.0, 0.3]], (45, 60))
    for seconds in exposures.TIMES[::2]:
        for kind, light in (("flat", tile), ("dark", 0.0)):
            for number, frame in enumerate(exposures.frames(random, seconds, 2, light)):
                tifffile.imwrite(tmp_path / f"{kind}_{1e3 * seconds:g}ms_{number}.tif", frame)
    colour = characterise_sensor(tmp_path, cfa="RGGB")
    assert len(colour.transfers) == 4
    assert colour.gain.value == pytest.approx(exposures.GAIN, rel=0.01)
    assert colour.full_well.value == pytest.approx(exposures.WELL, rel=0.02)
    assert colour.prnu.value == pytest.approx(exposures.PRNU, rel=0.1)
    assert colour.sensor(3e-6).cfa == "RGGB"


def test_the_sensor_goes_into_a_profile(found, tmp_path):
    sensor = found.sensor(3.45e-6)
    camera = Camera(GaussianOptics(0.5)).with_sensor(sensor)
    camera.save(tmp_path / "camera.json")
    again = Camera.load(tmp_path / "camera.json").sensor
    assert float(again.gain) == found.gain.value
    assert float(again.saturation) == pytest.approx(found.full_well.value, rel=0.02)
    assert (again.bits, again.cfa) == (12, None)
    assert float(again.dsnu) == pytest.approx(exposures.DSNU, rel=0.1)


def test_a_series_that_ends_early_gives_a_lower_limit(tmp_path):
    exposures.write_folder(tmp_path, times=exposures.TIMES[:9])
    part = characterise_sensor(tmp_path)
    assert not part.saturated
    assert "not-saturated" in {remark.code for remark in part.remarks}
    assert part.saturation.value < exposures.WELL


def test_saturation_does_not_depend_on_the_noise_of_saturated_exposures(tmp_path):
    """The charge clips 14 % below the limit of the converter, in the last three exposures."""
    for seed in range(12):
        exposures.write_folder(
            tmp_path / str(seed), seed, stack=2, times=exposures.TIMES[[0, 2, 4, 6, 9, 11, 13, 14, 15]]
        )
        grey, mosaic = (characterise_sensor(tmp_path / str(seed), cfa=cfa) for cfa in (None, "RGGB"))
        for one in (grey, mosaic):
            assert one.saturated, seed
            assert abs(one.full_well.value - exposures.WELL) < 4 * one.full_well.std, (seed, one.full_well)
            # the exposures before saturation have 10500 and 12600 e-
            assert 10_000 < one.saturation.value < exposures.WELL, (seed, one.saturation)
        assert mosaic.full_well.value == pytest.approx(grey.full_well.value, rel=0.02), seed


def test_what_is_written(found, tmp_path):
    document = json.loads(json.dumps(found.to_dict(), allow_nan=True))
    assert document["gain_dn_per_electron"] == list(found.gain)
    columns = found.columns()
    assert {len(column) for column in columns.values()} == {len(exposures.TIMES)}
    write_sensor_page(tmp_path / "page.html", found, "a <sensor>")
    text = (tmp_path / "page.html").read_text()
    assert "a &lt;sensor&gt;" in text
    assert "gain, DN per e-" in text
    with pytest.raises(ArgumentError, match=r"signal must lie in \[0, inf"):
        found.snr(np.array([-1.0]))


def test_wrong_series_are_refused_by_name(tmp_path):
    with pytest.raises(FileFormatError, match="contains no exposures: give images in dark/ and flat/"):
        characterise_sensor(tmp_path)
    frame = np.full((8, 8), 100, np.uint16)
    tifffile.imwrite(tmp_path / "flat_1.tif", frame)
    with pytest.raises(FileFormatError, match=r"flat_1.tif: the image has no exposure time .* as in flat_20ms_1.tif"):
        characterise_sensor(tmp_path)
    with pytest.raises(
        FileFormatError, match=r"flat_1.tif: the input is an image, not a series: give the folder of the"
    ):
        characterise_sensor(tmp_path / "flat_1.tif")
    (tmp_path / "flat_1.tif").rename(tmp_path / "flat_1ms_1.tif")
    with pytest.raises(FileFormatError, match="contains no dark exposure"):
        characterise_sensor(tmp_path)
    tifffile.imwrite(tmp_path / "dark_1ms_1.tif", frame)
    with pytest.raises(ArgumentError, match="no lit exposure has two frames"):
        characterise_sensor(tmp_path)
    tifffile.imwrite(tmp_path / "dark_1ms_2.tif", frame[:4])
    with pytest.raises(
        FileFormatError, match=r"dark_1ms_2.tif: the frame has 8 x 4 px of uint16, but the preceding frames have 8 x 8"
    ):
        characterise_sensor(tmp_path)
    with pytest.raises(ArgumentError, match="bits must be a whole number"):
        characterise_sensor(tmp_path, bits=40)
    tifffile.imwrite(tmp_path / "dark_1ms_2.tif", frame)
    tifffile.imwrite(tmp_path / "flat_1ms_2.tif", frame)
    with pytest.raises(ArgumentError, match=r"bits must be at least 7, got 6: .*the exposure of .*_1ms_1.tif is 100"):
        characterise_sensor(tmp_path, bits=6)
    described = tmp_path / "series.txt"
    for line in ("q 1", "b 10", "d -1", "i ../outside.png", "i early.png"):
        described.write_text(f"n 12 8 8\n{line}\n")
        with pytest.raises((FileFormatError, ArgumentError)):
            characterise_sensor(described)


def test_public_data_sets_give_what_the_reference_package_gives():
    folder = Path(os.environ.get("MATCAM_EMVA1288_DATASETS", SHARED / "data" / "emva1288"))
    if not folder.is_dir():
        pytest.skip("the EMVA 1288 reference data sets are not in MATCAM_EMVA1288_DATASETS")
    allowed = limit("emva1288-sets")
    for name, reference in json.loads(GOLDEN.read_text()).items():
        found = characterise_sensor(folder / name)
        for ours, theirs in COMPARED.items():
            scale = 0.01 if theirs.startswith("PRNU") else 1.0
            assert getattr(found, ours).value == pytest.approx(scale * reference[theirs], rel=allowed), (name, ours)
        assert 100 * found.linearity_error[0] == pytest.approx(reference["LE_min"], rel=1e-3)
        assert 100 * found.linearity_error[1] == pytest.approx(reference["LE_max"], rel=1e-3)
        if math.isfinite(found.dark_current.value):
            assert abs(found.dark_current.value - reference["u_I_mean"]) < found.dark_current.std


def test_a_stack_of_a_descriptor_is_named_and_is_not_part_of_the_series(tmp_path):
    """Its light may be that of another lamp."""
    found = characterise_sensor(exposures.write_descriptor(tmp_path / "set"))
    (text,) = [remark.text for remark in found.remarks if remark.code == "fixed-patterns-only"]
    assert f"{exposures.TIMES[7] + 1e-6:g} s" in text
    assert len(found.columns()["signal_dn"]) == len(exposures.TIMES)
    assert found.prnu.value == pytest.approx(exposures.PRNU, rel=0.02)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # it leaves the descriptor open
def test_the_reference_package_gives_the_same_of_a_simulated_set(tmp_path, monkeypatch):
    monkeypatch.setattr(np, "asfarray", lambda a: np.asarray(a, np.float64), raising=False)  # 1.0.2 is of NumPy 1
    process = pytest.importorskip("emva1288.process", reason="emva1288 is not installed")
    path = exposures.write_descriptor(tmp_path / "set")
    found = characterise_sensor(path)
    images = process.LoadImageData(process.ParseEmvaDescriptorFile(str(path)).images, fload=tifffile.imread)
    theirs = process.Results1288(process.Data1288(images.data).data)
    for ours, name in COMPARED.items():
        scale = 0.01 if name.startswith("PRNU") else 1.0
        assert getattr(found, ours).value == pytest.approx(scale * getattr(theirs, name), rel=0.01), ours
