"""What the pixels of a picture record of a lobe, against a quadrature that shares no code; derivatives against differences."""

import numpy as np
import pytest

from matcam import Camera, GaussianOptics, NearLamp, Rig, Sphere
from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.camera.lens_field import Coefficient, LensField
from matcam.forward.integral.blur import blur_of
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.material.diffuse_shape import TERMS
from matcam.reconstruction import picture_rule
from matcam.reconstruction.joint.field_change import FieldChange
from matcam.reconstruction.observed_pixels import chosen_pixels
from matcam.reconstruction.picture_model import PictureModel, lamp_frame
from tests.oracle.sphere_picture import Surface, View, direction, lamp_angle, mirror_angle, picture

VIEW = View(radius=120.0, column=140.0, row=140.0, shape=(281, 281))
NEAR = (1 / VIEW.camera, 1 / VIEW.lamp)
_WINDOW = picture_rule.WINDOW**2


@pytest.fixture(scope="module")
def model():
    rig = Rig(Camera(GaussianOptics(VIEW.sigma)), Sphere(VIEW.radius, VIEW.camera), NearLamp(VIEW.lamp))
    return PictureModel(LobeKind("ggx", "smith"), blur_of(rig), *picture_rule.lamp_disc(1))


def parameters(alpha):
    return np.array([np.log(alpha), 0.0, VIEW.radius, *NEAR, VIEW.column, VIEW.row, 0.0, 0.0])


def seen(alpha, theta_d, azimuth, view=VIEW, field=None):
    """A picture of a perfect mirror's lobe by the oracle, and the pixels of it that a fit would choose."""
    lamp = direction(lamp_angle(np.radians(theta_d), VIEW), azimuth)
    truth = picture(Surface("ggx", alpha, n=(1e9,), k=(0.0,), diffuse=(0.0,)), view, lamp)[..., 0]
    nothing = np.zeros(truth.shape, int)
    merged = MergedPicture("L", truth, np.ones_like(truth), nothing > 0, nothing, ("grey",))
    normal = mirror_angle(lamp_angle(np.radians(theta_d), VIEW), VIEW)
    out = np.sin(normal) * np.sqrt(1 - NEAR[0] ** 2) / (1 - NEAR[0] * np.cos(normal))
    highlight = VIEW.column + VIEW.radius * out * np.cos(azimuth), VIEW.row - VIEW.radius * out * np.sin(azimuth)
    ball = MirrorBall(VIEW.row, VIEW.column, VIEW.radius, VIEW.camera)
    return lamp, chosen_pixels(merged, ball, lamp, highlight, scale=alpha / 3, plateau=0.0, seed=0, field=field)


@pytest.mark.parametrize(
    ("alpha", "theta_d", "azimuth"), [(0.003, 75, 0.7), (0.02, 75, 2.0), (0.02, 10, 1.0), (0.1, 30, 4.0)]
)
def test_pixels_record_what_an_independent_quadrature_says(model, alpha, theta_d, azimuth):
    """In the window to 3e-4 of the peak; beyond it to 1e-3 of the value or 1e-7 of the peak."""
    lamp, pixels = seen(alpha, theta_d, azimuth)
    frame, p = lamp_frame(lamp), parameters(alpha)
    near, _ = model.window(p, frame, pixels.window, slopes=False)
    far, _ = model.pixels(p, frame, pixels.column, pixels.row, slopes=False)
    used = pixels.used
    ours = np.concatenate([np.asarray(near.lobe).ravel(), np.asarray(far.lobe)])
    missed = np.abs(ours - pixels.values)
    inside = np.arange(used.size) < _WINDOW
    assert missed[used & inside].max() < 3e-4 * pixels.values.max()
    beyond = used & ~inside
    assert beyond.sum() > 300
    assert (missed / np.maximum(1e-3 * pixels.values, 1e-7 * pixels.values.max()))[beyond].max() < 1


def field_of(view):
    """The lens's field as a profile would state it."""
    centre = view.column + view.axis[0], view.row - view.axis[1]
    return LensField(centre, view.radius, Coefficient(view.k1, 0.001), growth=Coefficient(view.growth, 0.01))


@pytest.mark.parametrize(
    ("alpha", "theta_d", "azimuth", "k1", "growth"),
    [(0.003, 75, 0.7, 0.01, 0.2), (0.02, 75, 2.0, -0.01, 0.0), (0.02, 45, 5.5, 0.02, 0.0)],
)
def test_pixels_behind_a_lens_that_distorts(model, alpha, theta_d, azimuth, k1, growth):
    """1 to 2 % at the limb, its centre beside the sphere's, a lens that widens."""
    view = VIEW._replace(k1=k1, axis=(15.0, -25.0), growth=growth)
    lamp, pixels = seen(alpha, theta_d, azimuth, view, field_of(view))
    _, straight = seen(alpha, theta_d, azimuth, view)
    frame, p = lamp_frame(lamp), parameters(alpha)
    missed = []
    for chosen in (pixels, straight):
        near, _ = model.window(p, frame, chosen.window, slopes=False)
        used = chosen.used[:_WINDOW]
        off = np.abs(np.asarray(near.lobe).ravel() - chosen.values[:_WINDOW])[used]
        missed.append(off.max() / chosen.values.max())
    assert missed[0] < 1e-3
    assert missed[1] > 0.03  # what leaving it out would cost
    if growth:
        return  # which the drawing has at highlight and limb only
    far, _ = model.pixels(p, frame, pixels.column, pixels.row, slopes=False)
    used, truth = pixels.used[_WINDOW:], pixels.values[_WINDOW:]
    off = np.abs(np.asarray(far.lobe) - truth)[used]
    assert (off / np.maximum(2e-3 * truth[used], 1e-7 * pixels.values.max())).max() < 1


def test_a_change_of_the_field_is_seen_by_the_same_nodes(model):
    """Nodes laid for k1 = 0.004 as they are seen through 0.005 and a lens that widens by 2 % more, window and elsewhere."""
    view, other = VIEW._replace(k1=0.004), VIEW._replace(k1=0.005, growth=0.02)
    lamp, pixels = seen(0.02, 60, 0.7, view, field_of(view))
    _, there = seen(0.02, 60, 0.7, other, field_of(other))
    assert np.array_equal(pixels.window.pixel_u, there.window.pixel_u)
    frame, p = lamp_frame(lamp), parameters(0.02)
    row, column = MirrorBall(VIEW.row, VIEW.column, VIEW.radius, VIEW.camera).mirror_position(lamp, VIEW.lamp)
    change = FieldChange(field_of(view), (float(column), float(row)), pixels.seen)
    window = change.window(pixels.window, np.array([0.001, 0.02]))
    near = there.used[:_WINDOW]
    truth, peak = there.values[:_WINDOW][near], there.values.max()
    ours, plain = (
        np.asarray(model.window(p, frame, one, slopes=False)[0].lobe).ravel()[near] for one in (window, pixels.window)
    )
    assert np.abs(ours - truth).max() < 5e-4 * peak
    assert np.abs(plain - truth).max() > 0.01 * peak
    positions = np.array(change.positions(np.array([0.001, 0.0])))
    inside = pixels.seen[0] > 0
    assert np.array(field_of(other).seen_at(*positions))[:, inside] == pytest.approx(pixels.seen[:, inside], abs=1e-9)
    step = (positions - np.array(change.positions(np.zeros(2)))) / 0.001
    assert change.positions_slopes(np.array([0.0005, 0.0]))[:, inside] == pytest.approx(
        step[:, inside], rel=2e-3, abs=1e-6
    )


@pytest.mark.parametrize("shape", [0, pytest.param(TERMS, marks=pytest.mark.slow)])
def test_derivatives_are_those_of_the_values(model, shape):
    """Each parameter's derivative against central differences; at the terminator, where a node appears or goes, a pixel or two
    may differ. With a diffuse part of Lambert's law, and with one of another shape."""
    bent = VIEW._replace(k1=0.01)
    lamp, pixels = seen(0.02, 60, 0.7, bent, field_of(bent))
    frame, p = lamp_frame(lamp), np.insert(parameters(0.02), 5, 0.05 * np.arange(1, shape + 1))
    calls = (
        lambda p, slopes: model.window(p, frame, pixels.window, slopes=slopes),
        lambda p, slopes: model.pixels(p, frame, pixels.column[:200], pixels.row[:200], slopes=slopes),
    )
    for call in calls:
        _, slopes = call(p, True)
        for index in range(p.size):
            step = np.zeros(p.size)
            step[index] = 1e-5 * max(1.0, abs(p[index]))
            up, down = (call(p + sign * step, False)[0] for sign in (1, -1))
            for name in ("lobe", "lambert", "theta_d"):
                ahead, behind, slope = (np.asarray(getattr(one, name)) for one in (up, down, slopes))
                difference = (ahead - behind) / (2 * step[index])
                missed = np.abs(slope[..., index] - difference) / (2e-5 * np.abs(difference).max() + 1e-9)
                assert np.quantile(missed, 0.995) < 1


def test_a_bright_disc_is_the_mean_of_its_points(model):
    """A lamp's disc of 36 places integrates to what a finer one of 90 does."""
    lamp, pixels = seen(0.02, 40, 0.3)
    recorded = []
    for points in (36, 90):
        positions, weights = picture_rule.lamp_disc(points)
        assert weights.sum() == pytest.approx(1)
        disc = PictureModel(model.kind, model.blur, 0.02 * positions, weights)
        recorded.append(
            np.asarray(disc.window(parameters(0.02), lamp_frame(lamp), pixels.window, slopes=False)[0].lobe)
        )
    point = np.asarray(model.window(parameters(0.02), lamp_frame(lamp), pixels.window, slopes=False)[0].lobe)
    assert np.abs(recorded[0] - recorded[1]).max() < 1e-3 * recorded[1].max()
    assert np.abs(point - recorded[1]).max() > 0.02 * recorded[1].max()
