"""Clipping that no bracket proves: pixels that pile up at one code. Codes are drawn here, or by the oracle of captures."""

import numpy as np
import pytest

from matcam.acquisition.light.pile_up import find_pile_up, top_codes
from matcam.acquisition.merging import merge
from matcam.acquisition.radiometry import measure_radiometry
from matcam.files.capture import read_capture
from matcam.reconstruction.stated.captured_scene import INCOMPLETE
from tests.acquisition.drawn import VIEW, changed, small, surface
from tests.oracle.capture import Sensor, draw, noiseless

SIZE, BLACK = 160, 256
ROW, COLUMN = np.mgrid[:SIZE, :SIZE]


def scene(kind):
    """Light without noise, DN: what a false alarm could come from."""
    middle = 79.5 if kind.startswith("symmetric") else 80.3
    radius = np.hypot(ROW - middle, COLUMN - middle)
    faint = 200 * np.exp(-((radius / 60) ** 4))
    return {
        "highlight": 14000 / (1 + (radius / 6) ** 2) ** 2 + faint,
        "symmetric highlight": 14000 / (1 + (radius / 6) ** 2) ** 2 + faint,
        "symmetric ring": 14000 * np.exp(-(((radius - 20) / 6) ** 2)) + faint,
        "image of a lamp": np.where(radius < 12, 13000.0, 0.0) + faint,
        "flat area": np.where(radius < 50, 12000.0, 300.0),
        "gradient": 3000 + 50.0 * COLUMN,
    }[kind]


def found_in(light, gain, read_noise, *, scale=1.0, clip=np.inf, frames=4, seed=0):
    """What is found in frames of one scene; gain 0: without noise."""
    rng = np.random.default_rng(seed)
    noise = max(read_noise * scale, np.sqrt(1 / 12))
    tops = []
    for _ in range(frames):
        seen = rng.poisson(light / gain) * gain if gain else light
        codes = np.round((np.minimum(seen + read_noise * rng.standard_normal(light.shape), clip) + BLACK) * scale)
        tops.append(top_codes(codes.astype(np.float32), BLACK * scale, np.zeros(light.shape, bool), 1, noise))
    return find_pile_up(tops, noise, np.nan)


KINDS = ["highlight", "symmetric highlight", "symmetric ring", "image of a lamp", "flat area", "gradient"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scale", [1, 1 / 64], ids=["14 bits", "8 bits"])
def test_what_is_not_clipped_is_not_taken_for_it(kind, scale):
    """Six scenes without noise, and with noise of 0.05 to 5 DN an electron, of 14 and of 8 bits."""
    for gain in (0.0, 0.05, 0.5, 5.0):
        for seed in range(3):
            assert found_in(scene(kind), gain, gain, scale=scale, seed=seed) is None, gain


@pytest.mark.parametrize("kind", ["highlight", "image of a lamp", "flat area", "gradient"])
@pytest.mark.parametrize("gain", [0.05, 0.5, 5.0])
def test_what_is_clipped_is_found(kind, gain):
    light = scene(kind)
    level = np.round(0.85 * light.max())
    found = found_in(light, gain, gain, clip=level)
    assert found.clip.level == level + BLACK
    assert found.clip.pixels > 30
    assert found.apart == ()


@pytest.mark.parametrize("clip", ["converter", "well"])
def test_one_exposure_that_clips_below_the_files_largest_code(tmp_path, clip):
    """No shorter exposure proves it, and 16 bits could hold more: some 20 pixels of each highlight."""
    drawn = draw(
        surface(alpha=0.03), VIEW, np.radians([10, 35, 55, 75]), exposures=1, peak_fill=8.0, reference=None,
        sensor=Sensor(clip=clip, cfa=None), seed=5,
    )  # fmt: skip
    capture = read_capture(drawn.write(tmp_path))
    some = measure_radiometry(capture, lamps=["L00", "L02", "L03"])
    note = next(one.text for one in some.remarks if one.code == "clip-by-pile-up")
    assert "of the 3 frames that were read for this test" in note
    pictures, radiometry = merge(capture)
    assert radiometry.clip.level == pytest.approx(drawn.truth["clip_dn"], abs=2)
    assert {"clip-by-pile-up", "peak-clipped"} <= {one.code for one in radiometry.remarks}
    for picture in pictures:
        clean = noiseless(drawn, picture.name) * drawn.truth["gain_dn_per_electron"] / radiometry.gain.value
        assert picture.clipped.sum() > 5
        assert picture.clipped[clean > 1.05 * clean[picture.clipped].min()].all()
        assert (clean[picture.clipped] > 0.95 * picture.values[picture.clipped]).all()


def test_an_exposure_that_is_clipped_all_over_is_left_out(tmp_path):
    """12 bits in a file of 16: every pixel of the longest exposure reads 4095."""
    drawn = small()
    frames = {
        name: np.full_like(codes, 4095) if name.endswith("_E4.tif") and "frames" in name else codes >> 2
        for name, codes in drawn.frames.items()
    }
    radiometry = measure_radiometry(read_capture(changed(drawn, frames=frames).write(tmp_path)))
    assert list(radiometry.exposures) == ["E0", "E1", "E2", "E3"]
    assert radiometry.clip.level == 4095
    said = next(one for one in radiometry.remarks if one.code == "frame-clipped")
    where, what = (
        "lamps L00, L01, L02, L03: ",
        "every pixel of exposure E4 is clipped at 4095 DN, so the frame was omitted",
    )
    assert said.text == f"{where}{what}: take shorter exposures"
    assert said.code in INCOMPLETE
    true = [one["relative"] for one in drawn.truth["exposures"]][:4]
    found = [one.value for one in radiometry.exposures.values()]
    assert np.divide(found, found[0]) == pytest.approx(np.divide(true, true[0]), rel=3e-3)
