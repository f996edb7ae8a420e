"""From pictures to a camera: models, lens and pixel apart, what is said of pictures, and what is refused."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter1d

from matcam import Camera, LinearImage, calibrate, edge_mtf_stack
from matcam.calibration.camera.camera_fit import fit_camera
from matcam.calibration.camera.consensus import disagreement_remarks
from matcam.calibration.camera.evidence import Evidence, Finding
from matcam.calibration.photograph.linear_image import planes_of
from matcam.core.errors import ArgumentError, FitError
from matcam.core.remark import Remark, texts
from matcam.files.photographs import Photograph
from matcam.files.picture_header import Exif
from matcam.targets import MTFSamples
from tests.oracle import processed_pictures as software
from tests.oracle import slanted_edge, slanted_squares

F = np.linspace(0.02, 0.5, 25)


def chart(sigma, half_width=0.5, seed=1, snr=60, **more):
    """16 edges."""
    picture, _ = slanted_squares.field((420, 440), 140, 74, 5, sigma, half_width, **({"dark": 0.25} | more))
    return np.random.default_rng(seed).poisson(picture * snr**2).astype(float)


def test_a_gaussian_camera_with_its_errors_and_its_origin(tmp_path):
    found = calibrate([chart(0.5, 0.4)], half_width=0.4)
    fit = found.channels["grey"]
    assert found.channel == "grey"
    assert fit.names == ("optics.sigma_px",)
    assert abs(fit.values[0] - 0.5) < 4 * fit.std[0] < 0.02
    assert fit.consistent
    assert fit.spread < 0.02
    assert 0.9 < fit.chi2 / fit.degrees < 1.1
    assert fit.edges.x.size == fit.measurements["image 1 (edges)"] == 16
    found.camera.save(tmp_path / "camera.json")
    loaded = Camera.load(tmp_path / "camera.json")
    assert loaded.uncertainty.std()["optics.sigma_px"] == pytest.approx(fit.std[0])
    assert loaded.pixel.half_width == 0.4
    assert "16 edges" in loaded.provenance.source
    edges = found.edges_dataset()
    assert edges.sizes["edge"] == 16
    # an edge that points to the middle of the picture shows the meridional plane
    middle = (np.array(found.shape[::-1]) - 1) / 2
    towards = np.stack([edges.x - middle[0], edges.y - middle[1]], -1)
    height = np.hypot(*towards.T)
    cosine = (towards * np.stack([np.cos(edges.angle), np.sin(edges.angle)], -1)).sum(1) / height
    assert edges.image_height.values == pytest.approx(height)
    assert set(edges.plane.values[np.abs(cosine) > 0.8]) == {"meridional"}
    assert set(edges.plane.values[np.abs(cosine) < 0.6]) == {"sagittal"}
    # edges tell that the blur does not grow; nothing tells the distortion
    assert loaded.field.k1 == (0.0, 0.01)
    assert abs(loaded.field.growth.value) < 4 * loaded.field.growth.std < 0.4


@pytest.mark.slow
def test_a_linear_image_is_a_picture_of_one_colour():
    picture = chart(0.5, 0.4)
    plain = calibrate([picture], half_width=0.4).channels["grey"]
    found = calibrate([LinearImage(picture, source="a.tif", f_number=5.6)], half_width=0.4)
    assert found.pictures == ("a.tif",)
    assert found.channels["grey"].values == pytest.approx(plain.values, rel=1e-9)


@pytest.mark.slow
def test_a_linear_image_of_a_mosaic_is_its_colour():
    green = calibrate([LinearImage(chart(0.5, 0.4), "G", "RGGB")], half_width=0.4).channels["G"]
    assert abs(green.values[0] - 0.5) < 4 * green.std[0] < 0.02


def mosaic_of(picture, cfa="GBRG"):
    """A grey picture of `chart` as a mosaic sees it: less red and blue light than green, and the same lens."""
    share = {"R": 0.6, "G": 1.0, "B": 0.5}
    weight = np.array([share[c] for c in cfa]).reshape(2, 2)
    return picture * np.tile(weight, (picture.shape[0] // 2, picture.shape[1] // 2))


def test_a_mosaic_is_read_as_grey_by_nobody():
    codes = np.random.default_rng(4).poisson(mosaic_of(chart(0.5))).astype(np.uint16)
    planes = list(planes_of(Photograph(codes, None, 65535.0, False, Exif()), cfa="GBRG"))
    assert [plane.channel for plane in planes] == ["R", "G", "B"]
    assert [plane.cfa for plane in planes] == ["GBRG"] * 3
    assert planes[1].values[0, 0] == codes[0, 0]
    assert planes[0].values[1, 0] == codes[1, 0]
    with pytest.raises(FitError, match="alternate pixels differ by 67%, as in a colour mosaic"):
        calibrate([codes])
    with pytest.raises(ArgumentError, match="cfa is for a mosaic"):
        calibrate([np.stack([codes] * 3, -1)], cfa="GBRG")
    with pytest.raises(ArgumentError, match="cfa is already specified by the LinearImage"):
        calibrate([LinearImage(codes.astype(float))], cfa="GBRG")


@pytest.mark.slow
def test_a_mosaic_that_its_file_does_not_name():
    picture, _ = slanted_squares.field((420, 440), 140, 74, 5, 0.5, 0.4, dark=0.25)
    codes = np.random.default_rng(4).poisson(mosaic_of(picture) * 60000 / 16).astype(np.uint16) * 10
    green = calibrate([codes], cfa="GBRG", half_width=0.4, channels=["G"]).channels["G"]
    assert abs(green.values[0] - 0.5) < 4 * green.std[0] < 0.02


@pytest.mark.slow
def test_other_models():
    picture = chart(0.5)
    measured = calibrate([picture], model="measured").camera
    truth = slanted_edge.gaussian_mtf(F, 0.5, 0)
    assert np.max(np.abs(np.asarray(measured.mtf(F)) - truth)) < 0.006
    std = measured.uncertainty.std()
    assert 1e-4 < std["optics.mtf[16]"] < 0.01
    core, halo = (slanted_squares.field((420, 440), 140, 74, 5, s, dark=0.25)[0] for s in (0.5, 12.0))
    counts = np.random.default_rng(2).poisson((0.9 * core + 0.1 * halo) * 3600).astype(float)
    fit = calibrate([counts], model="halo").channels["grey"]
    assert abs(fit.values[0] - 0.5) < 4 * fit.std[0]
    # the fit takes edges for endless: a halo of 12 px sees the corners of squares of 74 px
    assert fit.values[1:] == pytest.approx([0.1, 12.0], rel=0.1)
    assert fit.consistent  # the largest of many differences: up to 3 standard deviations by chance
    gaussian = calibrate([counts]).channels["grey"]
    assert not gaussian.consistent
    # light that bends over a square takes a part of so wide a halo: three times the misfit, not thirty, as in even light
    assert gaussian.misfit > 2 * fit.misfit
    assert gaussian.misfit > 5 * gaussian.misfit_std


def samples_of(sigma, half_width, seed, count=12, std=0.003, **more):
    rng = np.random.default_rng(seed)
    made = []
    for number in range(count):
        direction = np.full(F.size, number * np.pi / count)
        box = np.sinc(2 * half_width * F * np.cos(direction)) * np.sinc(2 * half_width * F * np.sin(direction))
        mtf = np.exp(-2 * (np.pi * sigma * F) ** 2) * box + rng.normal(0, std, F.size)
        made.append(
            MTFSamples(
                "star", (9.0, 9.0), F, direction, mtf, np.eye(F.size) * std**2, **({"source": "star.png"} | more)
            )
        )
    return made


@pytest.mark.slow
def test_values_of_other_targets_alone_and_with_edges():
    alone = calibrate([], samples=samples_of(0.6, 0.45, 1), half_width=0.45).channels["grey"]
    assert abs(alone.values[0] - 0.6) < 4 * alone.std[0] < 0.01
    assert alone.edges is None
    assert np.isnan(alone.misfit)
    both = calibrate([chart(0.6, 0.45)], samples=samples_of(0.6, 0.45, 2), half_width=0.45).channels["grey"]
    assert abs(both.values[0] - 0.6) < 4 * both.std[0]
    assert both.std[0] < alone.std[0]
    assert set(both.measurements.values()) == {16, 12}


@pytest.mark.slow
def test_values_state_their_errors():
    pulls = []
    for seed in range(200):
        fit = calibrate([], samples=samples_of(0.6, 0.45, seed, 2), half_width=0.45).channels["grey"]
        pulls.append((fit.values[0] - 0.6) / fit.std[0])
    assert np.std(pulls) == pytest.approx(1, abs=0.2)  # 4 standard errors
    assert abs(np.mean(pulls)) < 0.3


# ---------------------------------------------------------------- lens and pixel apart

PITCH, WAVELENGTH = 4.73e-6, 550e-9
LENS = {"half_width": None, "wavelength": WAVELENGTH, "pixel_pitch": PITCH}


def at_aperture(f_number, sigma, half_width, seed):
    """100 edges at SNR 100."""
    response = slanted_squares.diffracted(PITCH / (WAVELENGTH * f_number), sigma, 5, half_width)
    picture, sides = slanted_squares.field((1275, 1275), 215, 140, 5, sigma, half_width, dark=0.25, response=response)
    assert len(sides) == 100
    return np.random.default_rng(seed).poisson(picture * 1e4).astype(float)


@pytest.mark.slow
@pytest.mark.parametrize("half_width", [0.5, 0.45])
def test_four_apertures_tell_lens_and_pixel_apart(half_width):
    f_numbers = (2.8, 4.0, 5.6, 8.0)
    pictures = [at_aperture(n, 0.5, half_width, int(10 * n)) for n in f_numbers]
    fit = calibrate(pictures, f_numbers=f_numbers, **LENS).channels["grey"]
    print("found", fit.values, "std", fit.std, "edges", fit.edges.x.size)
    assert fit.names == ("optics.sigma_px", "pixel.half_width_px")
    assert fit.values == pytest.approx([0.5, half_width], rel=0.03)
    assert fit.consistent
    # the profile holds this aperture's lens: core and diffraction in one curve
    truth = np.exp(-2 * (np.pi * 0.5 * F) ** 2) * slanted_edge.airy_mtf(F, PITCH / (WAVELENGTH * 2.8), 0)
    truth = truth / slanted_edge.box_mtf(F, 0) * slanted_edge.box_mtf(F, 0, half_width)
    assert np.max(np.abs(np.asarray(fit.camera.mtf(F)) - truth)) < 0.005


@pytest.mark.slow
def test_four_apertures_refuse_a_small_pixel_that_they_cannot_know():
    """Linear fill 0.8: what a core may stray from a Gaussian weighs (0.5 / 0.4)^4 as much."""
    f_numbers = (2.8, 4.0, 5.6, 8.0)
    with pytest.raises(FitError, match=r"400 edges determine the half width of the pixel to \d+%"):
        calibrate([at_aperture(n, 0.5, 0.4, int(10 * n)) for n in f_numbers], f_numbers=f_numbers, **LENS)


@pytest.mark.slow
def test_one_aperture_at_a_wide_blur_is_refused():
    with pytest.raises(
        FitError, match=r"lens and pixel cannot be separated: 100 edges determine the half width of the pixel to \d+%"
    ):
        calibrate([at_aperture(5.6, 0.8, 0.4, 1)], f_numbers=5.6, **LENS)


@pytest.mark.slow
def test_few_edges_do_not_tell_lens_and_pixel_apart():
    with pytest.raises(
        FitError, match=r"cannot be separated: 16 edges determine the half width of the pixel to .* give half_width"
    ):
        calibrate([chart(0.8, 0.4)], half_width=None)
    many = samples_of(0.4, 0.4, 3, 24, std=1e-4)
    fit = calibrate([], samples=many, half_width=None).channels["grey"]
    assert np.all(np.abs(fit.values - 0.4) < 3 * fit.std)
    assert fit.values == pytest.approx([0.4, 0.4], rel=0.02)


# ---------------------------------------------------------------- what is said of pictures


def remarks(picture, **options):
    return " ".join(texts(calibrate([picture], **options).remarks))


def refusal(picture):
    with pytest.raises(FitError) as refused:
        calibrate([picture])
    return str(refused.value)


@pytest.mark.slow
def test_what_a_photographer_should_know():
    even = chart(0.5)
    assert remarks(even) == ""
    moved = (
        np.random.default_rng(1).poisson(uniform_filter1d(chart(0.5, snr=1000) / 1e6, 3, axis=1) * 3600).astype(float)
    )
    assert (
        "px along 5 degrees" in remarks(moved)
        or "px along 0 degrees" in remarks(moved)
        or "the camera moved" in remarks(moved)
    )
    assert "contrast is only 7%" in remarks(chart(0.5, snr=300, dark=0.87))
    codes = np.clip(even / 3000 * 255, 0, 255)
    codes[:, :300] = np.clip(even[:, :300] / 4300 * 255, 0, 255)
    assert "saturated edges were excluded" in remarks(codes.astype(np.uint8), tone="linear")

    def sharpened(rows):
        part = even.copy()
        part[:rows] += 1.0 * (even - gaussian_filter(even, 1.0))[:rows]
        return part

    assert "overshoot, as after sharpening" in remarks(sharpened(70))
    # where most are sharpened, the others are no sample of the lens
    assert "are sharpened or saturated, or have crushed blacks" in refusal(sharpened(200))


def test_what_was_assumed_of_the_tone_curve(tmp_path):
    from imagecodecs import png_encode

    light = chart(0.5) / 4500
    codes = 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    (tmp_path / "a.png").write_bytes(png_encode(np.rint(codes).clip(0, 255).astype(np.uint8)))
    found = calibrate([tmp_path / "a.png"])
    assert found.remarks == (
        Remark(
            "tone-assumed",
            "a.png: no tone curve is specified: sRGB is assumed for 8 bits; give the tone curve (--tone)",
        ),
    )
    assert found.channels["grey"].values[0] == pytest.approx(0.5, rel=0.01)
    assert calibrate([tmp_path / "a.png"], tone="srgb").remarks == ()
    (tmp_path / "b.png").write_bytes(png_encode((60000 * light).clip(0, 65535).astype(np.uint16)))
    assert (
        "no tone curve is specified: linear is assumed for 16 bits" in calibrate([tmp_path / "b.png"]).remarks[0].text
    )


# ---------------------------------------------------------------- what is refused


def taken(values, camera):
    return Photograph(values, None, np.inf, True, Exif(camera))


def test_contradictions_and_mixed_cameras():
    sharp, soft = chart(0.5), chart(0.8, seed=2)
    with pytest.raises(
        FitError, match=r"channel grey: the measurements are contradictory: the blur of image [12] \(edges\) differs by"
    ):
        calibrate([sharp, soft])
    with pytest.raises(
        FitError,
        match=r"contradictory: the blur of image 1 \(edges\) differs by -\d+% from that of star.png \(star\)",
    ):
        calibrate([sharp], samples=samples_of(0.9, 0.5, 1))
    with pytest.raises(ArgumentError, match=r"different cameras: One \(image 1\), Two \(image 2\)"):
        calibrate([taken(sharp, "One"), taken(sharp, "Two")])


def test_bad_pictures_among_good_ones():
    good, empty = chart(0.5), np.random.default_rng(1).normal(100, 3, (420, 440))
    found = calibrate([good, empty])
    assert found.pictures == ("image 1",)
    assert "no slanted edge was found" in found.failed["image 2"]
    with pytest.raises(FitError, match="image 1: no slanted edge was found"):
        calibrate([empty])
    with pytest.raises(FitError, match="all 2 images are unusable; error of the first image: image 1: no slanted edge"):
        calibrate([empty, empty])
    with pytest.raises(FitError, match=r"none of the edges can be measured; .* of 16\): .* image is sharpened"):
        calibrate([good + 1.5 * (good - gaussian_filter(good, 1.0))])


def test_bad_arguments():
    picture = np.zeros((50, 50))
    for options, words in (
        ({"model": "airy"}, "model must be one of"),
        ({"half_width": 0.7}, "half_width must lie in"),
        ({"half_width": None, "model": "halo"}, "with the gaussian model only"),
        ({"channels": ["X"]}, "channel must be one of"),
        ({"f_numbers": [2.8, 4.0]}, "one for each image"),
        ({"f_numbers": 0.0}, "f_numbers must lie in"),
        ({"cfa": "RGBG"}, "cfa must be one of"),
    ):
        with pytest.raises(ArgumentError, match=words):
            calibrate([picture], **options)
    with pytest.raises(ArgumentError, match="neither pictures nor samples were given"):
        calibrate([])
    with pytest.raises(ArgumentError, match="an image must be numbers of shape"):
        calibrate([np.zeros((4, 5, 2))])
    star = samples_of(0.5, 0.5, 1)
    for options, words in (
        ({"model": "diffraction"}, "wavelength and pixel_pitch must be given"),
        (
            {"half_width": None, "wavelength": 5e-7, "pixel_pitch": 5e-6},
            "the f-number of at least one image is not known",
        ),
        ({"model": "defocus", "wavelength": 550.0, "pixel_pitch": 5e-6}, "wavelength must lie in"),
        ({"model": "defocus", "wavelength": 5e-7, "pixel_pitch": 5.0}, "pixel_pitch must lie in"),
    ):
        with pytest.raises(ArgumentError, match=words):
            calibrate([], samples=star, **options)
    with pytest.raises(FitError, match="the lens model 'measured' needs edges"):
        calibrate([], samples=star, model="measured")
    mosaic = Photograph(picture, "RGGB", 1.0, True, Exif())
    with pytest.raises(ArgumentError, match="camera raw is linear"):
        list(planes_of(mosaic, None, "srgb"))
    with pytest.raises(ArgumentError, match="channel must be one of R, G, B for this image, got 'Y'"):
        planes_of(mosaic, ["Y"], None)


def test_too_few_edges_are_no_camera():
    picture = chart(0.5)
    with pytest.raises(FitError, match=r"good edges is .*, but a camera requires at least 8 in two directions: photo"):
        calibrate([picture[:150, :150]])
    noise = 0.5 + 0.01 * np.random.default_rng(1).standard_normal((150, 150))
    with pytest.raises(FitError, match="at least 8 in two directions; none are in image 2: photograph"):
        calibrate([picture[:150, :150], noise])


def test_mostly_processed_pictures_are_no_camera():
    picture = chart(0.5)
    sharp = picture + 1.2 * (picture - gaussian_filter(picture, 1.0))
    sharp[:, 260:] = picture[:, 260:]
    with pytest.raises(
        FitError, match=r"edges are sharpened or saturated, or have crushed blacks: this is a sign of processed"
    ):
        calibrate([sharp])


def test_pictures_that_software_has_been_at():
    counts, white = chart(0.5), 1.25 * 3600
    for processed in (
        software.bilateral(counts),
        software.phone(counts, white),
        software.phone(counts, white, 95, 0.2),
    ):
        with pytest.raises(
            FitError,
            match="this is a processed image, whose MTF is not that of the lens: the noise of neighbouring pixels",
        ):
            calibrate([processed])
    with pytest.raises(
        FitError, match=r"none of the edges can be measured.* of 16\): blacks are crushed: .* of the dark side"
    ):
        calibrate([np.maximum(counts - 0.3 * 3600, 0)])
    clean, filled, bent = (
        calibrate([p]) for p in (counts, software.demosaiced(counts), software.encoded(counts, white))
    )
    assert not clean.remarks
    for found, code in ((filled, "demosaiced"), (bent, "tone-curve")):
        fit = found.channels["grey"]
        assert code in [remark.code for remark in found.remarks]
        assert fit.std[0] > 5 * clean.channels["grey"].std[0]
        assert abs(fit.values[0] - 0.5) < 2 * fit.std[0]
        assert found.camera.uncertainty.std()["optics.sigma_px"] == pytest.approx(fit.std[0])


def test_an_edge_that_disagrees_is_left_out():
    picture = chart(0.5)
    # one square of the four out of focus
    blurred = gaussian_filter(picture, 1.6)
    blurred = np.random.default_rng(3).poisson(np.maximum(blurred, 0)).astype(float)
    picture[:205, :215] = blurred[:205, :215]
    found = calibrate([picture])
    fit = found.channels["grey"]
    assert any(remark.code == "no-consensus" for remark in found.remarks)
    assert abs(fit.values[0] - 0.5) < 4 * fit.std[0] < 0.05


def grating_of(sigma, number, off=0.0, std=1e-3):
    """MTF of a lens at 0.2 cycles/px; off: of ln sigma, by the slope of the MTF there. std: of ln sigma."""
    f = np.array([0.2])
    mtf = np.exp(-2 * (np.pi * sigma * f) ** 2) * np.sinc(f)
    slope = 4 * (np.pi * sigma * f) ** 2 * mtf
    values = (f, np.zeros(1), mtf - slope * off, np.diag((slope * std) ** 2))
    return MTFSamples("grating", (9.0, 9.0), *values, "grey", None, f"a.png: grating {number} (bars)")


def test_one_grating_does_not_veto_the_edges():
    """Edges believe it by less than 5 standard deviations, but all other gratings contradict it by more."""
    edges = edge_mtf_stack(slanted_edge.photographs(slanted_edge.gaussian(0.5), 100, 8, 3))
    samples = [grating_of(0.51, number) for number in range(20)] + [grating_of(0.51, 66, off=0.26, std=0.05)]
    shape = (800, 900)
    finding = Finding("grey", "a.png", None, edges, tuple(samples), (), shape)
    fit = fit_camera(Evidence([finding]), "grey", "gaussian", 0.5, None, None)
    assert 0.495 < fit.values[0] < 0.515
    remark, widened = fit.remarks
    assert remark.code == "target-disagrees"
    assert "grating 66" in remark.text
    assert widened.code == "disagreement"  # the edges have 0.5 px, the other gratings 0.51 px
    assert abs(fit.values[0] - 0.5) < fit.std[0] < 0.02
    # where there are no edges, nobody knows which are wrong
    alone = Finding("grey", "a.png", None, None, tuple(samples[-2:]), (), shape)
    with pytest.raises(FitError, match="measurements are contradictory"):
        fit_camera(Evidence([alone]), "grey", "gaussian", 0.5, None, None)


def test_targets_of_one_kind_are_named_in_one_remark():
    strangers = {f"a.png: grating {n} (bars) (grating)": off for n, off in ((3, 0.2), (4, 36.0))} | {
        "a.png: star 9 (star)": -0.1
    }
    gratings, star = disagreement_remarks(strangers, "R")
    assert gratings.text.startswith("R: the blurs of 2 targets of one kind (grating) differ by +20% to more than +100%")
    assert "grating 3 (bars)" in gratings.text
    assert star.text == "R: the blur of a.png: star 9 (star) differs by -10% from that of the edges: it was excluded"


def test_rounded_light_is_no_denoised_picture(tmp_path):
    light = slanted_squares.field((420, 440), 140, 74, 5, 0.5, 0.5, dark=0.25)[0]
    y, x = np.mgrid[:420, :440]
    codes = np.rint(200 * light * (1 - 0.2 * ((x - 200) ** 2 + (y - 200) ** 2) / 300**2)).astype(np.uint8)
    found = calibrate([codes], tone="linear")
    assert not {remark.code for remark in found.remarks} & {"processed", "demosaiced"}
    assert found.channels["grey"].values[0] == pytest.approx(0.5, rel=0.01)
    assert found.channels["grey"].std[0] < 0.02
