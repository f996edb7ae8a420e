"""Pictures through lenses with aberrations, by colour and over the field, against sums over normals by another's pupil."""

import numpy as np
import pytest

from matcam import (
    GGX,
    BoxPixel,
    Camera,
    ColourOptics,
    Conductor,
    Cylinder,
    DefocusOptics,
    DiffractionOptics,
    GaussianNDF,
    GaussianOptics,
    MeasuredOptics,
    Microfacet,
    NearLamp,
    Rig,
    SeidelOptics,
    Sphere,
    ZernikeOptics,
    picture,
)
from matcam.core.errors import ArgumentError
from tests.oracle import aberrated
from tests.oracle.sphere_record import Surface

PARTS = (8.0, 550e-9, 4e-6)
ALL = {"defocus": 0.05, "astigmatism": (0.05, -0.08), "coma": (0.1, 0.06), "trefoil": (0.02, 0.03), "spherical": 0.04}
LENS = ZernikeOptics(*PARTS, **ALL)
MATERIAL = Microfacet(GGX(0.2), 1.0, diffuse=0.3)
RADIUS = 7.0
FIELD = {"astigmatism": 0.08, "coma": 0.1, "curvature": 0.05, "spherical": 0.03}


def pupil_of(lens):
    if isinstance(lens, DefocusOptics):
        edge = float(lens.blur_diameter * lens.focused.pixel_pitch / (8 * lens.focused.f_number))
        return aberrated.Pupil(float(lens.focused.cutoff), edge / float(lens.focused.wavelength) / (2 * np.sqrt(3)))
    if isinstance(lens, DiffractionOptics):
        return aberrated.Pupil(float(lens.cutoff))
    pairs = {name: tuple(getattr(lens, name).tolist()) for name in ("astigmatism", "coma", "trefoil")}
    return aberrated.Pupil(float(lens.cutoff), float(lens.defocus), **pairs, spherical=float(lens.spherical))


def against_the_sum(lens, angle, azimuth, **options):
    """Largest difference of pixels from the oracle's, over the picture's peak: highlight, limb, terminator and beyond."""
    rig = Rig(Camera(lens, BoxPixel(0.5)), Sphere(RADIUS))
    image = picture(MATERIAL, rig, angle, azimuth, shape=(23, 25), **options)
    assert image.attrs["route"] == "frequencies"
    rng = np.random.default_rng(2)
    rows, columns = rng.integers(0, 23, 40), rng.integers(0, 25, 40)
    lamp = np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)
    values = image.values[..., 0]
    rows[0], columns[0] = np.unravel_index(values.argmax(), values.shape)
    truth = aberrated.sphere_pixels(
        image.x.values[columns], image.y.values[rows], lamp, Surface(0.2, 0.3), pupil_of(lens), RADIUS
    )
    return np.abs(values[rows, columns] - truth).max() / values.max()


@pytest.mark.parametrize(
    ("lens", "angle", "azimuth", "options"),
    [
        (LENS, 0.9, 2.2, {}),
        pytest.param(LENS, 0.9, 2.2, {"error": 1e-4}, marks=pytest.mark.slow),
        pytest.param(LENS, 0.5, 0.0, {}, marks=pytest.mark.slow),
        *(
            pytest.param(DiffractionOptics(n, *PARTS[1:]), 0.9, 2.2, options, marks=pytest.mark.slow)
            for n in (2.8, 5.6, 16.0)
            for options in ({}, {"error": 1e-4})
        ),
        pytest.param(DefocusOptics(*PARTS, 2.0), 0.9, 2.2, {}, marks=pytest.mark.slow),
        pytest.param(ZernikeOptics(2.8, *PARTS[1:], **ALL), 0.9, 2.2, {}, marks=pytest.mark.slow),
    ],
)
def test_pixels_against_a_sum_over_normals(lens, angle, azimuth, options):
    assert against_the_sum(lens, angle, azimuth, **options) < 1e-4


def test_colours_have_lenses_and_shifts_of_their_own():
    rig = {"sample": Sphere(RADIUS)}
    lens = ColourOptics(LENS, DiffractionOptics(*PARTS), LENS, blue_shift=(1.0, -2.0))
    whole = picture(MATERIAL, Rig(Camera(lens), **rig), 0.9, 2.2, shape=(23, 25)).values
    alone = picture(MATERIAL, Rig(Camera(LENS), **rig), 0.9, 2.2, shape=(23, 25)).values[..., 0]
    assert whole.shape == (23, 25, 3)
    np.testing.assert_allclose(whole[..., 0], alone, rtol=0, atol=1e-5 * alone.max())
    np.testing.assert_allclose(whole[2:, 1:, 2], alone[:-2, :-1], rtol=0, atol=1e-5 * alone.max())
    assert np.abs(whole[..., 1] - alone).max() > 0.02 * alone.max()
    two = Microfacet(GGX(0.2), Conductor([0.2, 0.4], [3.0, 2.0]))
    with pytest.raises(ArgumentError, match="has 3 colours, but the material has 2 channels"):
        picture(two, Rig(Camera(lens), **rig), 0.9)


@pytest.mark.parametrize(
    ("field", "angle", "azimuth"),
    [
        pytest.param({"coma": 0.04}, 0.9, 0.7, marks=pytest.mark.slow, id="little"),
        pytest.param(FIELD, 1.2, 0.7, marks=pytest.mark.slow, id="much"),
        pytest.param(FIELD, 0.4, 3.6, marks=pytest.mark.slow, id="much, near the axis"),
    ],
)
def test_a_point_off_the_axis_is_spread_by_the_lens_there(field, angle, azimuth):
    """A highlight of 0.003 px on a sphere, where the lens over the field says how it is spread."""
    radius = 30.0
    lens = SeidelOptics(*PARTS, unit=radius, **field)
    rig = Rig(Camera(lens, BoxPixel(0.5)), Sphere(radius))
    image = picture(Microfacet(GaussianNDF(1e-4), 1.0, masking=None), rig, angle, azimuth, shape=(61, 61))
    position = radius * np.sin(angle / 2) * np.array([np.cos(azimuth), np.sin(azimuth)])
    kernel = aberrated.seen_by_pixel(pupil_of(lens.at(*position)), 12.0)
    x, y = np.meshgrid(image.x.values, image.y.values)
    near = np.maximum(np.abs(x - position[0]), np.abs(y - position[1])) < 8
    truth = kernel(x[near] - position[0], y[near] - position[1])
    found = image.values[near, 0]
    scale = (found * truth).sum() / (truth**2).sum()
    assert np.abs(found / scale - truth).max() < 1e-4 * truth.max()
    axial = aberrated.seen_by_pixel(pupil_of(lens.at(0.0, 0.0)), 12.0)(x[near] - position[0], y[near] - position[1])
    assert np.abs(axial - truth).max() > 0.01 * truth.max()


@pytest.mark.slow
def test_over_the_field_a_broad_light_is_the_sum_of_its_parts():
    """The lens that is the same all over, by the shares; and a field that differs, by its value where the light is."""
    rig = {"sample": Sphere(30.0)}
    even = SeidelOptics(*PARTS, unit=1e4, coma=0.01, spherical=0.05)
    by_shares = picture(MATERIAL, Rig(Camera(even), **rig), 0.9, 2.2, shape=(64, 66)).values
    at_once = picture(
        MATERIAL, Rig(Camera(ZernikeOptics(*PARTS, spherical=0.05)), **rig), 0.9, 2.2, shape=(64, 66)
    ).values
    assert np.abs(by_shares - at_once).max() < 1e-5 * at_once.max()


@pytest.mark.slow
def test_a_cylinder_is_its_lines():
    """Rows are alike, and a lens that is a Gaussian by its measured curve is that Gaussian."""
    f = np.linspace(0, 2.2, 300)
    curve = MeasuredOptics(f, np.where(f < f[-1], np.exp(-2 * (np.pi * f * 0.5) ** 2), 0.0))
    exact, by_curve = (
        picture(MATERIAL, Rig(Camera(one), Cylinder(RADIUS)), 0.9, shape=(3, 25))
        for one in (GaussianOptics(0.5), curve)
    )
    assert (exact.attrs["route"], by_curve.attrs["route"]) == ("space", "frequencies")
    np.testing.assert_allclose(by_curve, exact, rtol=0, atol=1e-5 * float(exact.max()))
    aberrated_one = picture(MATERIAL, Rig(Camera(LENS), Cylinder(RADIUS)), 0.9, np.pi, shape=(1, 25))
    other_way = picture(MATERIAL, Rig(Camera(ZernikeOptics(*PARTS, coma=(-0.1, 0.06), defocus=0.05, astigmatism=(0.05, 0.08),
                        trefoil=(-0.02, 0.03), spherical=0.04)), Cylinder(RADIUS)), 0.9, 0.0, shape=(1, 25))  # fmt: skip
    np.testing.assert_allclose(aberrated_one.values[:, ::-1], other_way.values, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        (Rig(Camera(LENS), Cylinder(40.0), NearLamp(9.0)), "a cylinder's image with a near camera or lamp"),
        (Rig(Camera(SeidelOptics(*PARTS, unit=40.0, coma=0.1)), Cylinder(40.0)), "the same all over the field"),
        (Rig(Camera(SeidelOptics(*PARTS, unit=4.0, coma=0.1)), Sphere(40.0)), "the wavefront error is"),
        (Rig(Camera(ZernikeOptics(1.0, 550e-9, 4e-6)), Sphere(40.0)), "give a larger f-number"),
    ],
)
def test_what_no_picture_is_taken_of(rig, words):
    with pytest.raises(ArgumentError) as caught:
        picture(MATERIAL, rig, 0.5)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
