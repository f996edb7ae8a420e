"""Lenses, pixels and cameras as objects: what they refuse, and that nothing is combined twice."""

import numpy as np
import pytest

import matcam
from matcam import BoxPixel, Camera, DiffractionOptics, GaussianOptics, MeasuredOptics, WindowedGaussianPixel
from matcam.camera import Provenance, Uncertainty
from matcam.core.errors import ArgumentError


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: GaussianOptics(-0.5), "sigma must lie in (0, inf) px, got -0.5"),
        (lambda: GaussianOptics(np.nan), "sigma"),
        (lambda: GaussianOptics([0.5, 0.6]), "sigma must be a single number"),
        (lambda: GaussianOptics("wide"), "sigma must be a number"),
        (lambda: BoxPixel(0.6), "half_width must lie in (0, 0.5] px (a pixel is no wider than the pitch), got 0.6"),
        (lambda: BoxPixel(0.0), "half_width"),
        (lambda: WindowedGaussianPixel(0.0, 0.5), "sigma"),
        (lambda: DiffractionOptics(0, 550e-9, 5e-6), "f_number"),
        (lambda: DiffractionOptics(8, 550, 5e-6), "550 nm is 550e-9"),
        (lambda: DiffractionOptics(8, 550e-9, 5), "5 um is 5e-6"),
        (lambda: MeasuredOptics([0, 0.1, 0.2], [1, 0.9, 0.8]), "equal length with at least 4 numbers"),
        (lambda: MeasuredOptics([0.1, 0.2, 0.3, 0.4], [1, 0.9, 0.8, 0]), "start at 0"),
        (lambda: MeasuredOptics([0, 0.2, 0.2, 0.4], [1, 0.9, 0.8, 0]), "increase strictly"),
        (lambda: MeasuredOptics([0, 0.1, 0.2, 0.4], [0.9, 0.9, 0.8, 0]), "divide the curve by its first sample"),
        (lambda: MeasuredOptics([0, 0.1, 0.2, 0.4], [1, 1.3, 0.8, 0]), "without sharpening"),
    ],
)
def test_constructors_refuse_nonsense_in_one_line(build, words):
    with pytest.raises(ArgumentError) as caught:
        build()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_nothing_is_blurred_twice():
    camera = Camera(GaussianOptics(0.5), BoxPixel(0.5))
    with pytest.raises(ArgumentError, match="already contains its pixel"):
        Camera(camera, BoxPixel(0.5))
    with pytest.raises(ArgumentError, match="pixel must be a PixelResponse, got Camera"):
        Camera(GaussianOptics(0.5), camera)
    with pytest.raises(ArgumentError, match="optics must be Optics, got BoxPixel"):
        Camera(BoxPixel(0.5), GaussianOptics(0.5))
    with pytest.raises(ArgumentError, match="got GaussianOptics"):
        Camera(GaussianOptics(0.5), GaussianOptics(0.5))


def test_measured_mtf_is_an_error_beyond_its_end_unless_it_has_reached_zero():
    f = np.linspace(0, 0.5, 6)
    open_ended = MeasuredOptics(f, np.exp(-f))
    assert float(open_ended.mtf(0.25)) == pytest.approx(np.exp(-0.25), abs=1e-6)
    for ask in (lambda: open_ended.mtf(0.6), lambda: open_ended.psf(0.0, 0.0), lambda: open_ended.lsf(0.0)):
        with pytest.raises(ArgumentError, match="append"):
            ask()
    ended = MeasuredOptics(f, 1 - 2 * f)
    assert float(ended.mtf(0.6)) == 0


@pytest.mark.parametrize(
    "part",
    [
        GaussianOptics(0.5),
        DiffractionOptics(8, 5.5e-7, 4.73e-6),
        matcam.DefocusOptics(8, 5.5e-7, 4.73e-6, 1.5),
        matcam.HaloOptics(GaussianOptics(0.5), 0.01, 40),
        matcam.Sensor(5e-6, 2e4, 2.5, 0.5, 12, "RGGB", prnu=0.01),
        Camera(GaussianOptics(0.5), BoxPixel(0.4), matcam.Sensor(5e-6, 2e4, 2.5)),
        MeasuredOptics([0, 0.2, 0.4, 0.8], [1, 0.7, 0.3, 0]),
        matcam.ZernikeOptics(8, 5.5e-7, 4.73e-6, coma=(0.1, 0.0), spherical=0.05),
        matcam.ColourOptics(GaussianOptics(0.5), GaussianOptics(0.6), GaussianOptics(0.7), blue_shift=(0.1, 0.2)),
        matcam.SeidelOptics(8, 5.5e-7, 4.73e-6, unit=500.0, coma=0.2),
        BoxPixel(0.45),
        WindowedGaussianPixel(0.2, 0.45),
        Uncertainty(["optics.sigma_px"], [[0.0004]]),
        Camera(GaussianOptics(0.5), BoxPixel(0.4), uncertainty=Uncertainty.of({"optics.sigma_px": 0.01})),
        matcam.Sphere(256),
        matcam.Cylinder(100.5),
        matcam.Flat(),
        matcam.rigs.merl(),
        matcam.GGX(0.1),
        matcam.GaussianNDF(0.002),
    ],
    ids=lambda part: type(part).__name__,
)
def test_repr_rebuilds_the_object(part):
    names = {name: getattr(space, name) for space in (matcam, matcam.camera) for name in space.__all__}
    assert repr(eval(repr(part), names)) == repr(part)


def test_uncertainty_is_checked():
    with pytest.raises(ArgumentError, match=r"must have shape \(2, 2\)"):
        Uncertainty(["a", "b"], [[1.0]])
    with pytest.raises(ArgumentError, match="symmetric"):
        Uncertainty(["a", "b"], [[1.0, 0.5], [0.1, 1.0]])
    with pytest.raises(ArgumentError, match="positive semidefinite"):
        Uncertainty(["a", "b"], [[1.0, 2.0], [2.0, 1.0]])
    with pytest.raises(ArgumentError, match="differ from each other"):
        Uncertainty(["a", "a"], np.eye(2))
    with pytest.raises(ArgumentError, match=r"the parameter 'optics.sigma', but the camera has only optics.sigma_px"):
        Camera(GaussianOptics(0.5), uncertainty=Uncertainty.of({"optics.sigma": 0.01}))
    with pytest.raises(ArgumentError, match="standard deviation of x"):
        Uncertainty.of({"x": -1})
    assert Uncertainty.of({"x": 0.1, "y": 2}).std() == pytest.approx({"x": 0.1, "y": 2})


def test_parameters_can_be_replaced_by_name():
    camera = Camera(MeasuredOptics([0, 0.2, 0.4, 0.8], [1, 0.7, 0.3, 0]), BoxPixel(0.5))
    assert set(camera.parameters()) == {*(f"optics.mtf[{i}]" for i in range(4)), "pixel.half_width_px"}
    changed = camera.with_parameters({"optics.mtf[1]": 0.75, "pixel.half_width_px": 0.4})
    assert float(changed.parameters()["optics.mtf[1]"]) == 0.75
    assert float(changed.pixel.half_width) == 0.4
    assert float(camera.pixel.half_width) == 0.5
    with pytest.raises(ArgumentError, match=r"no parameter 'optics\.sigma_px'"):
        camera.with_parameters({"optics.sigma_px": 1.0})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"optics.sigma_px": -0.5}, r"sigma must lie in \(0, inf\) px, got -0.5"),
        ({"optics.sigma_px": np.nan}, "optics.sigma_px must be finite, got nan"),
        ({"optics.sigma_px": [1, 2]}, "optics.sigma_px must be a single number"),
        ({"optics.sigma_px": "wide"}, "optics.sigma_px must be a number"),
        ({"pixel.half_width_px": 0.7}, r"half_width must lie in \(0, 0.5\] px"),
    ],
)
def test_replaced_parameters_are_checked(values, message):
    with pytest.raises(ArgumentError, match=message):
        Camera(GaussianOptics(0.5), BoxPixel(0.5)).with_parameters(values)


def test_parameters_of_a_lens_in_a_lens():
    camera = Camera(matcam.HaloOptics(matcam.HaloOptics(GaussianOptics(0.5), 0.1, 4), 0.01, 90), BoxPixel(0.5))
    assert set(camera.parameters()) == {
        "optics.core.core.sigma_px", "optics.core.fraction", "optics.core.radius_px", "optics.fraction",
        "optics.radius_px", "pixel.half_width_px",
    }  # fmt: skip
    changed = camera.with_parameters({"optics.core.core.sigma_px": 0.6, "optics.radius_px": 80, "optics.fraction": 0})
    assert repr(changed) == repr(
        Camera(matcam.HaloOptics(matcam.HaloOptics(GaussianOptics(0.6), 0.1, 4), 0.0, 80), BoxPixel(0.5))
    )


def test_provenance_is_kept():
    camera = Camera(GaussianOptics(0.5), provenance=Provenance(source="a slanted edge", notes="f/8"))
    assert camera.provenance.source == "a slanted edge"
    assert camera.provenance.notes == "f/8"


@pytest.mark.parametrize("sigma", [1e-12, 1e-3, 0.05, 0.0624, 0.0626, 0.2, 1e3, 1e6])
def test_a_windowed_gaussian_of_any_width_has_unit_area(sigma):
    """Narrower than the nodes of its rule too; a narrow one is the Gaussian itself, a wide one the box."""
    pixel = WindowedGaussianPixel(sigma, 0.5)
    assert float(pixel.mtf(0.0)) == pytest.approx(1, abs=1e-12)
    if sigma < 0.06:
        assert float(pixel.mtf(1.5)) == pytest.approx(np.exp(-2 * (np.pi * sigma * 1.5) ** 2), rel=1e-12)
    if sigma > 100:
        assert float(pixel.mtf(0.7)) == pytest.approx(np.sinc(0.7), rel=1e-6)
