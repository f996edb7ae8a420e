"""What codes mean, judged by captures whose truth is known (tests/oracle/capture.py)."""

import re
from dataclasses import replace

import numpy as np
import pytest

from matcam.acquisition.bracket_sample import noise_correlation
from matcam.acquisition.capture_check import check_capture
from matcam.acquisition.darkness import dark_of, pair_correlation
from matcam.acquisition.exposure_ratios import ExposureRatios
from matcam.acquisition.merging import bracket_misfit, merge, misfit_remark
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.acquisition.radiometry import capture_camera, measure_radiometry
from matcam.acquisition.radiometry_remarks import processing_remarks, tone_curve_proof, tone_exponent
from matcam.core.errors import FileFormatError, FitError
from matcam.files.capture import read_capture
from matcam.reconstruction.from_capture import reconstruct
from tests.acquisition.drawn import changed, small
from tests.oracle.capture import noiseless


@pytest.fixture(scope="module")
def merged(tmp_path_factory):
    folder = small().write(tmp_path_factory.mktemp("capture"))
    capture = read_capture(folder)
    return capture, *merge(capture)


def codes(radiometry):
    return {remark.code for remark in radiometry.remarks}


def ratio_errors(radiometry, truth):
    true = {one["exposure"]: one["relative"] for one in truth["exposures"]}
    unit = true[radiometry.reference_exposure]
    return np.array([v.value * unit / true[name] - 1 for name, v in radiometry.exposures.items()])


def test_exposure_ratios_are_the_frames_own(merged):
    _, _, radiometry = merged
    errors = ratio_errors(radiometry, small().truth)
    assert list(radiometry.exposures) == ["E0", "E1", "E2", "E3", "E4"]
    assert np.abs(errors).max() < 2e-3
    std = np.array([v.std / v.value for v in radiometry.exposures.values()])
    assert (np.abs(errors)[std > 0] < 4 * std[std > 0]).all()
    assert 0.5 < radiometry.misfit < 1.5


def test_wrong_dials_are_named(merged):
    _, _, radiometry = merged
    truth = small().truth["exposures"]
    said = np.array([one["nominal_s"] for one in truth])
    true = np.array([one["relative"] for one in truth])
    wrong = {
        one["exposure"] for one, e in zip(truth, true / true[0] * said[0] / said - 1, strict=True) if abs(e) > 0.025
    }
    named = {r.text.split(":")[0].split()[1] for r in radiometry.remarks if r.code == "times-wrong"}
    assert wrong
    assert wrong <= named
    said = " ".join(remark.text for remark in radiometry.remarks if remark.code == "times-wrong")
    assert len(re.findall(r"[\d.]+ ± 0\.0*[1-9]\d times", said)) == len(named)  # two significant digits


def test_clip_level_and_noise_come_from_the_frames(merged):
    _, _, radiometry = merged
    truth = small().truth
    assert radiometry.clip.level == pytest.approx(truth["clip_dn"], rel=5e-3)
    assert radiometry.clip.pixels > 20
    assert radiometry.gain.value == pytest.approx(truth["gain_dn_per_electron"], rel=0.05)
    assert radiometry.gain.value == pytest.approx(truth["gain_dn_per_electron"], abs=4 * radiometry.gain.std)
    assert radiometry.read_noise.value == pytest.approx(np.hypot(3.0 * 0.5, np.sqrt(1 / 12)), rel=0.02)


def test_lamp_drift_is_read_off_the_reference(merged):
    _, _, radiometry = merged
    gains = np.array([lamp["gain"] for lamp in small().truth["lamps"]])
    found = np.array([radiometry.lamp_output[lamp["lamp"]] for lamp in small().truth["lamps"]])
    assert np.abs(found[:, 0] / gains * gains.mean() - 1).max() < 1e-3
    assert (found[:, 1] < 1e-3).all()
    assert np.abs(gains - 1).max() > 2e-3


@pytest.mark.parametrize("lamp", ["L00", "L03"])
def test_merged_pictures_are_the_light_with_its_noise(merged, lamp):
    _, pictures, radiometry = merged
    picture = next(p for p in pictures if p.name == lamp)
    rel = {one["exposure"]: one["relative"] for one in small().truth["exposures"]}
    clean = noiseless(small(), lamp) * rel[radiometry.reference_exposure]
    clean *= small().truth["gain_dn_per_electron"] / radiometry.gain.value  # the unit is as good as the gain
    sphere = np.ones(clean.shape, bool)
    sphere[:50, :50] = False  # the reference
    good = sphere & ~picture.clipped & np.isfinite(picture.values)
    assert good.mean() > 0.9
    pull = (picture.values - clean)[good] / picture.std[good]
    for low, high in ((0, 5), (5, 100), (100, 3000), (3000, 1e9)):
        part = (clean[good] >= low) & (clean[good] < high)
        if part.sum() < 40:
            continue
        # a common factor of 0.1 % of the ratios shows in bright pixels
        slack = 4 / np.sqrt(part.sum()) + 1.5e-3 * np.mean(clean[good][part] / picture.std[good][part])
        assert abs(pull[part].mean()) < slack
        assert 0.85 < pull[part].std() < 1.15
    assert picture.channels == ("R", "G", "B")
    assert (picture.channel[:2, :2] == [[0, 1], [1, 2]]).all()


def test_a_region_is_the_same_picture_cropped(merged):
    capture, pictures, radiometry = merged
    cropped, other = merge(capture, region=(40, 38, 150, 150))
    assert cropped[1].origin == (38, 40)
    assert (cropped[1].channel == pictures[1].channel[38:188, 40:190]).all()
    whole = pictures[1].values[38:188, 40:190] * radiometry.gain.value / other.gain.value
    assert np.nanmedian(np.abs(cropped[1].values - whole) / pictures[1].std[38:188, 40:190]) < 0.1


def test_what_clips_in_the_shortest_exposure_is_censored(tmp_path):
    drawn = small(peak_fill=4.0, clip="converter", cfa=None)
    pictures, radiometry = merge(read_capture(drawn.write(tmp_path)))
    assert "peak-clipped" in codes(radiometry)
    picture = pictures[-1]
    assert picture.clipped.sum() > 3
    assert picture.channels == ("grey",)
    rel = {one["exposure"]: one["relative"] for one in drawn.truth["exposures"]}
    clean = noiseless(drawn, picture.name) * rel[radiometry.reference_exposure]
    clean *= drawn.truth["gain_dn_per_electron"] / radiometry.gain.value
    # the truth is at least what is stated, but for the noise of a pixel that is just about to clip
    assert (clean[picture.clipped] > 0.97 * picture.values[picture.clipped]).all()
    assert not picture.clipped[clean < 0.9 * picture.values[picture.clipped].min()].any()


def test_a_sphere_that_moves_inside_a_bracket_is_noticed(merged, tmp_path):
    capture, pictures, radiometry = merged
    assert misfit_remark("L01", bracket_misfit(capture, "L01", radiometry, pictures[1])) is None
    moved = read_capture(small(within=0.5, cfa=None).write(tmp_path))
    pictures, radiometry = merge(moved)
    assert "L01" in str(misfit_remark("L01", bracket_misfit(moved, "L01", radiometry, pictures[1])))


def test_exposures_without_times_are_ordered_by_their_light(tmp_path):
    drawn = small()
    rows = [{**row, "time_s": ""} for row in drawn.rows]
    radiometry = measure_radiometry(read_capture(changed(drawn, rows=rows).write(tmp_path)))
    assert list(radiometry.exposures) == ["E0", "E1", "E2", "E3", "E4"]
    assert np.abs(ratio_errors(radiometry, drawn.truth)).max() < 2e-3
    assert "times-missing" in codes(radiometry)


def test_frames_that_cannot_be_used_are_named_and_the_rest_is(tmp_path):
    drawn = small()
    frames = dict(drawn.frames)
    frames["frames/L00_E1.tif"] = frames["frames/L00_E1.tif"][:100]
    frames["frames/L01_E2.tif"] = (frames["frames/L01_E2.tif"] >> 8).astype(np.uint8)
    frames["dark/D0_E0.tif"] = frames["dark/D0_E0.tif"] + np.uint16(900)
    rows = [row for row in drawn.rows if row["file"] != "frames/L02_E3.tif"]
    folder = changed(drawn, frames=frames, rows=rows).write(tmp_path)
    (folder / "frames/L03_E0.tif").write_bytes(b"II*\0" + bytes(30))
    pictures, radiometry = merge(read_capture(folder))
    assert [p.name for p in pictures] == ["L00", "L01", "L02", "L03"]
    texts = {code: [r.text for r in radiometry.remarks if r.code == code] for code in codes(radiometry)}
    assert any("L00_E1.tif" in text for text in texts["other-size"])
    assert any("L01_E2.tif" in text and "differs from the first frame" in text for text in texts["bad-frame"])
    assert any("L03_E0.tif" in text for text in texts["bad-frame"])
    assert any("D0_E0.tif" in text for text in texts["dark-too-bright"])
    assert any("L02_E3.tif" in text for text in texts["unlisted-frame"])
    assert any("L02" in text and "E3" in text for text in texts["missing-frame"])
    assert np.abs(ratio_errors(radiometry, drawn.truth)).max() < 3e-3


def test_all_dark_is_refused(tmp_path):
    drawn = small()
    frames = dict.fromkeys(drawn.frames, drawn.frames["dark/D0_E0.tif"])
    with pytest.raises(FitError, match="dark"):
        measure_radiometry(read_capture(changed(drawn, frames=frames).write(tmp_path)))


def test_all_clipped_is_said(tmp_path):
    drawn = small()
    frames = {name: v if name.startswith("dark") else np.full_like(v, 15256) for name, v in drawn.frames.items()}
    with pytest.raises(FitError, match="clipped"):
        measure_radiometry(read_capture(changed(drawn, frames=frames).write(tmp_path)))


def test_a_tone_curve_is_noticed(tmp_path):
    drawn = small()
    frames = {
        name: np.round(16383 * (np.maximum(v.astype(float) - 240, 0) / 16383) ** (1 / 2.2)).astype(np.uint16)
        for name, v in drawn.frames.items()
    }
    radiometry = measure_radiometry(read_capture(changed(drawn, frames=frames).write(tmp_path)))
    assert codes(radiometry) & {"tone-curve", "not-linear"}


def through_gamma(drawn):
    """The same capture of a camera that takes its black level away and encodes with a gamma of 2.2 in 16 bits."""
    return {
        name: np.round(65535 * (np.maximum(codes - 256.0, 0) / 16127) ** (1 / 2.2)).clip(0, 65535).astype(np.uint16)
        for name, codes in drawn.frames.items()
    }


def test_a_proven_tone_curve_is_refused_unless_accepted(tmp_path):
    drawn = small(cfa=None)
    capture = changed(drawn, frames=through_gamma(drawn))
    with pytest.raises(FitError, match=r"to the power 0\.4\d .* a tone curve.*accept_processed = true$") as refused:
        merge(read_capture(capture.write(tmp_path / "a")))
    assert "\n" not in str(refused.value)
    accepted = {**drawn.settings, "camera": {**drawn.settings["camera"], "accept_processed": True}}
    _, radiometry = merge(read_capture(changed(capture, settings=accepted).write(tmp_path / "b")))
    assert "tone-curve" in codes(radiometry)
    # what the docs state as not detectable: without times a pure power is another set of linear exposures
    rows = [{**row, "time_s": ""} for row in drawn.rows]
    radiometry = measure_radiometry(read_capture(changed(capture, rows=rows).write(tmp_path / "c")))
    assert "tone-curve" not in codes(radiometry)
    assert np.isnan(radiometry.tone_exponent.value)


def linked(values):
    """Exposures that the frames link, as they are measured."""
    count = len(values)
    return ExposureRatios(np.asarray(values) / values[0], np.zeros((count, count)), 1.0, np.zeros((0, 3)), True)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
def test_wrong_times_are_not_taken_for_a_tone_curve(count):
    """500 sets of dials that err by 7 %, and each single time wrong by a factor of 2.5."""
    rng, true = np.random.default_rng(count), 4.0 ** np.arange(count)
    dials = [true * np.exp(0.07 * rng.standard_normal(count)) for _ in range(500)]
    dials += [true * np.where(np.arange(count) == k, factor, 1) for k in range(count) for factor in (0.4, 2.5)]
    assert not any(tone_curve_proof(tone_exponent(linked(true), times)) for times in dials)
    if count > 2:
        assert all(tone_curve_proof(tone_exponent(linked(true**0.45), times)) for times in dials[:500])


def test_sharpened_and_smoothed_frames_are_noticed(merged, tmp_path):
    from scipy.ndimage import gaussian_filter

    assert not codes(merged[2]) & {"sharpened", "smoothed"}
    drawn = small(cfa=None, peak_fill=4.0, clip="converter")
    for amount, code in ((0.8, "sharpened"), (0.2, "sharpened"), (-0.5, "smoothed")):
        frames = {}
        for name, v in drawn.frames.items():
            v = v.astype(float)
            frames[name] = np.clip(np.round(v + amount * (v - gaussian_filter(v, 1.0))), 0, 65535).astype(np.uint16)
        capture = read_capture(changed(drawn, frames=frames).write(tmp_path / f"{code} {amount}"))
        assert code in codes(measure_radiometry(capture, lamps=["L00", "L02"]))
        if code == "sharpened":
            with pytest.raises(FitError, match=r"sharpened: .*accept_processed = true"):
                merge(capture)


def test_noise_of_raw_frames_is_not_taken_for_a_sharpened_one():
    """100 pairs of dark frames, of rounded codes with noise of rows and a pattern; and the same sharpened by a fifth."""
    from scipy.ndimage import gaussian_filter

    rng, wrong, seen = np.random.default_rng(8), 0, 0
    pattern = 3 * rng.standard_normal((300, 300))
    for _ in range(100):
        noise = 1.5 * rng.standard_normal((2, 300, 300)) + 0.1 * rng.standard_normal((2, 300, 1)) + pattern
        first, second = np.round(256 + noise)
        wrong += bool(processing_remarks("darks", *pair_correlation([second - first])))
        both = noise + 0.2 * (noise - gaussian_filter(noise, (0, 1, 1)))
        first, second = np.round(256 + both)
        seen += bool(processing_remarks("darks", *pair_correlation([second - first])))
    assert wrong == 0
    assert seen == 100


def test_one_exposure_is_merged_with_what_noise_it_shows(tmp_path):
    """As many published captures are: no brackets, no darks, no profile; clipped at the largest code of 16 bits."""
    drawn = small(cfa=None)
    frames, rows = {}, []
    for row in drawn.rows:
        if row["exposure"] == "E3" and row["lamp"]:
            codes_ = (drawn.frames[row["file"]].astype(int) - 256) * 4  # 2 DN per electron
            frames[row["file"]] = np.where(codes_ > 39_000, 65535, np.clip(codes_, 0, None)).astype(np.uint16)
            rows.append(row)
    unstated = changed(drawn, frames=frames, rows=rows, settings=drawn.settings | {"camera": {}})
    with pytest.raises(FitError, match=r"no usable dark frames: .* or specify camera\.black_level_dn"):
        measure_radiometry(read_capture(unstated.write(tmp_path / "unstated")))
    settings = drawn.settings | {"camera": {"black_level_dn": 0}}
    pictures, radiometry = merge(read_capture(changed(unstated, settings=settings).write(tmp_path / "stated")))
    assert len(pictures) == 4
    assert radiometry.exposures == {"E3": (1.0, 0.0)}
    assert "gain-bound" in codes(radiometry)
    assert 1.5 < radiometry.gain.value < 4
    for picture in pictures:
        assert (picture.clipped == (frames[f"frames/{picture.name}_E3.tif"] == 65535)).all()


def test_full_colour_is_refused_unless_accepted(tmp_path):
    drawn = small()
    frames = {name: np.repeat(v[..., None], 3, axis=2) for name, v in drawn.frames.items()}
    with pytest.raises(FitError, match="accept_processed"):
        measure_radiometry(read_capture(changed(drawn, frames=frames).write(tmp_path / "a")))
    settings = {**drawn.settings, "camera": {**drawn.settings["camera"], "accept_processed": True}}
    radiometry = measure_radiometry(
        read_capture(changed(drawn, frames=frames, settings=settings).write(tmp_path / "b"))
    )
    assert "demosaiced" in next(r.text for r in radiometry.remarks if r.code == "processed")
    assert np.abs(ratio_errors(radiometry, drawn.truth)).max() < 2e-3


def test_full_colour_of_an_unknown_mosaic(tmp_path):
    drawn = small()
    frames = {name: np.repeat(v[..., None], 3, axis=2) for name, v in drawn.frames.items() if "dark" not in name}
    rows = [row for row in drawn.rows if row["file"] in frames]
    camera = {"black_level_dn": 256}
    capture = changed(drawn, frames=frames, rows=rows, settings={**drawn.settings, "camera": camera})
    # what is wrong with the frames, and not that there are no dark ones
    with pytest.raises(
        FitError, match=r"no frame .* demosaiced: .*accept_processed = true, and specify .* camera\.cfa$"
    ):
        measure_radiometry(read_capture(capture.write(tmp_path / "a")))
    settings = {**drawn.settings, "camera": {**camera, "accept_processed": True}}
    capture = changed(drawn, frames=frames, rows=rows, settings=settings)
    radiometry = measure_radiometry(read_capture(capture.write(tmp_path / "b")))
    assert radiometry.channels == ("R", "G", "B")
    assert any("no camera.cfa" in r.text for r in radiometry.remarks if r.code == "processed")
    assert np.abs(ratio_errors(radiometry, drawn.truth)).max() < 2e-3


def test_the_profile_belongs_to_the_camera(tmp_path):
    drawn = small()
    assert float(capture_camera(read_capture(drawn.write(tmp_path / "a"))).optics.sigma) == pytest.approx(0.5, rel=0.15)
    settings = {**drawn.settings, "camera": {**drawn.settings["camera"], "cfa": "BGGR"}}
    with pytest.raises(FileFormatError, match="give the profile of the camera"):
        capture_camera(read_capture(changed(drawn, settings=settings).write(tmp_path / "b")))


def test_every_frame_of_another_mosaic_is_refused(tmp_path):
    capture = read_capture(small().write(tmp_path))
    frames = capture.of("frames")[:3]
    reader = MosaicReader(replace(capture, settings={"camera": {**capture.settings["camera"], "cfa": "BGGR"}}))
    photograph = capture.read(frames[0])._replace(cfa="RGGB")  # as a raw file states it
    for frame in frames:
        with pytest.raises(FileFormatError, match="the mosaic of the frame is RGGB, but capture"):
            reader._check(frame, photograph)


def test_a_mosaic_that_is_read_as_grey_is_refused(tmp_path):
    """By the profile, which states it, or by alternate pixels. Grey frames of the same sphere are not refused."""
    drawn = small()
    without = changed(drawn, settings={**drawn.settings, "camera": {"profile": "camera.json"}})
    capture = read_capture(without.write(tmp_path / "a"))
    with pytest.raises(FitError, match=r"camera with the mosaic RGGB, but capture.toml has no camera.cfa.*: specify"):
        capture_camera(capture)
    assert {"bad-profile", "no-radiometry"} <= {one.code for one in check_capture(capture).findings}
    steps = []
    with pytest.raises(FitError, match=r"capture.toml has no camera.cfa"):
        reconstruct(capture, "ggx", progress=lambda *step: steps.append(step))
    assert not steps
    without = changed(drawn, settings={**drawn.settings, "camera": {}})
    with pytest.raises(FitError, match=r"frames/L00_E3.tif: alternate pixels differ .*: .* specify camera.cfa"):
        measure_radiometry(read_capture(without.write(tmp_path / "b")))
    grey = read_capture(small(cfa=None).write(tmp_path / "c"))
    assert capture_camera(grey) is not None
    assert measure_radiometry(grey).channels == ("grey",)


def test_fixed_pattern_and_hot_pixels_of_dark_frames():
    rng = np.random.default_rng(3)
    pattern = 20 * rng.standard_normal((60, 70))
    stack = [np.round(500 + pattern + 2 * rng.standard_normal((60, 70))) for _ in range(4)]
    for one in stack:
        one[10, 20] = 5000
    dark = dark_of(stack)
    assert dark.read_noise == pytest.approx(2.0, rel=0.05)
    assert np.std((dark.level - 500 - pattern)[dark.hot == 0]) < 1.1
    assert dark.hot.sum() == 1
    assert dark.hot[10, 20]
    plain = dark_of([np.round(500 + 2 * rng.standard_normal((60, 70))) for _ in range(2)])
    assert plain.level == pytest.approx(500, abs=0.1)
    assert not plain.hot.any()


def test_faint_light_is_not_taken_for_sharpening():
    """Raw noise about light that fades through the level at which pixels count as dark."""
    random = np.random.default_rng(3)
    faint = np.linspace(0, 6, 400) * np.ones((300, 1))
    for _ in range(20):
        correlation, std = noise_correlation(faint + 1.5 * random.standard_normal(faint.shape), 1.5)
        assert abs(correlation) < 0.015 + 3 * std
