"""Uneven pixels and vignetting, judged by captures whose truth is known (tests/oracle/capture.py)."""

from functools import cache

import numpy as np
import pytest

from matcam.acquisition.merging import bracket_misfit, merge
from matcam.acquisition.radiometry import measure_radiometry
from matcam.files.capture import read_capture
from tests.acquisition.drawn import VIEW, changed, surface
from tests.oracle.capture import Sensor, draw, noiseless, response

UNEVEN = Sensor(prnu=0.01, vignetting=0.1)


@cache
def drawn():
    return draw(
        surface(alpha=0.5, diffuse=0.5),
        VIEW,
        np.radians([20, 45]),
        sensor=UNEVEN,
        seed=4,
        flats=4,
        exposures=3,
        reference="diffuse",
    )


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    with_flats = drawn().write(tmp_path_factory.mktemp("flats"))
    rows = [row for row in drawn().rows if not row["file"].startswith("flat")]
    frames = {name: v for name, v in drawn().frames.items() if not name.startswith("flat")}
    without = changed(drawn(), frames=frames, rows=rows).write(tmp_path_factory.mktemp("none"))
    return read_capture(with_flats), read_capture(without)


def pulls(capture):
    """(merged - true) / std of bright pixels of the sphere; the true light is that of an even sensor."""
    pictures, radiometry = merge(capture)
    relative = {one["exposure"]: one["relative"] for one in drawn().truth["exposures"]}[radiometry.reference_exposure]
    clean = noiseless(drawn(), "L01") * relative * drawn().truth["gain_dn_per_electron"] / radiometry.gain.value
    picture = pictures[1]
    bright = (clean > 300) & ~picture.clipped & np.isfinite(picture.values)
    bright[:50, :50] = False
    ratio = (picture.values / np.where(bright, clean, 1))[bright]
    return ratio / np.median(ratio) - 1, (picture.std / np.where(bright, clean, 1))[bright], radiometry


def test_flat_frames_take_away_vignetting_and_uneven_pixels(captures):
    off, std, radiometry = pulls(captures[0])
    assert radiometry.flat.frames == 4
    assert radiometry.flat.prnu == pytest.approx(0.01, rel=0.15)
    assert len(off) > 3000
    assert 0.9 < np.std(off / std) < 1.15
    raw, raw_std, _ = pulls(captures[1])
    assert np.std(raw / raw_std) > 1.2
    assert np.sqrt(max(np.var(off) - np.mean(std**2), 0)) < 0.005 < np.sqrt(np.var(raw) - np.mean(raw_std**2))


def test_the_response_is_that_of_the_pixels(captures):
    flat = measure_radiometry(captures[0], lamps=["L00"]).flat
    truth = response(VIEW.shape, UNEVEN, 4)
    ratio = flat.response / truth
    assert np.std(ratio / ratio.mean()) < 0.7 * 0.01  # four frames know a pixel to 0.4 to 0.6 %
    assert np.std(ratio / ratio.mean()) == pytest.approx(flat.std.mean(), rel=0.2)
    # the patch in the corner sees 5 % less than the middle
    corner = truth[8:48, 8:48].mean() / truth[np.hypot(*np.meshgrid(*[np.linspace(-1, 1, 220)] * 2)) < 0.5].mean()
    assert flat.reference == pytest.approx(corner, rel=2e-3)


def test_exposures_of_a_bracket_agree_on_an_uneven_sensor(captures):
    pictures, radiometry = merge(captures[0])
    assert bracket_misfit(captures[0], "L01", radiometry, pictures[1]) == pytest.approx(1.0, abs=0.2)


def test_bad_flat_frames_are_named_and_left_out(tmp_path):
    frames = dict(drawn().frames)
    frames["flat/F0.tif"] = frames["dark/D0_E0.tif"]
    frames["flat/F1.tif"] = np.full_like(frames["flat/F1.tif"], 15256)
    frames["flat/F2.tif"] = frames["flat/F2.tif"][:200]
    radiometry = measure_radiometry(read_capture(changed(drawn(), frames=frames).write(tmp_path)), lamps=["L01"])
    assert radiometry.flat.frames == 1
    texts = [remark.text for remark in radiometry.remarks if remark.code == "bad-flat"]
    for name, what in (("F0", "too dark"), ("F1", "are clipped"), ("F2", "size")):
        assert any(name in text and what in text for text in texts)
