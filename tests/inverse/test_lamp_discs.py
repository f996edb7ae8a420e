"""A lamp's disc in the fits' operator: a disc, not a Gaussian of its variance; against the oracle's mean over its points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from matcam import GGX, BoxPixel, Camera, GaussianOptics, Rig, Sphere, WindowedGaussianPixel, fit
from matcam.camera import PixelNoise
from matcam.forward.integral.blur import blur_of
from matcam.inverse.correction.rig_refits import rig_refits
from matcam.inverse.fit.fit_setup import free_setup
from matcam.inverse.operator.chosen_cells import ChosenCells, chosen_cells, positions_in
from matcam.inverse.operator.lamp_lines import chord_points, lamp_discs, lamp_kernel
from matcam.inverse.operator.lobe_operator import lobe_operator, operator_in
from matcam.inverse.operator.sample_view import SampleView, sample_view
from matcam.inverse.rig.rig_axes import free_axis, rig_with
from tests.inverse import recorded
from tests.inverse.test_near_rigs import NEVER, made
from tests.oracle import disc_cells, lamp_record
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

GRID = recorded.GRID


def under(radius, degrees, sigma=0.5):
    return Rig(Camera(GaussianOptics(sigma), BoxPixel(0.5)), Sphere(radius), lamp_radius=np.radians(degrees))


def off_the_peak(radius, degrees, alpha, theta_d, cells):
    """Errors of cells (theta_h, phi_d), rad, over each slice's peak."""
    rig, theta_d = under(radius, degrees), np.radians(theta_d)
    theta_h, phi_d = (np.broadcast_to(a, (theta_d.size, len(cells))) for a in np.array(cells).T)
    positions = positions_in(sample_view(rig), theta_h, theta_d[:, None], phi_d)
    ring = np.zeros(theta_h.shape, int)
    valid = np.ones(ring.shape, bool)
    chosen = ChosenCells(np.arange(theta_d.size), theta_d, ring, ring, theta_h, phi_d, valid, *positions, ~valid)
    found = np.asarray(operator_in(rig, chosen, (), "discs", NEVER).record(GGX(alpha), "smith", ()))
    truth = disc_cells.DiscCells(theta_h, theta_d, phi_d, oracle.Setup(radius=radius, lamp=np.radians(degrees)), alpha)
    truth = truth.directions(oracle.GGX(alpha)).mean(-1)
    off = (np.abs(found - truth) / truth[:, :1]).max(axis=1)
    print(f"{radius:g} px, {degrees} degrees, alpha {alpha}: {[f'{e:.1e}' for e in off]} of the peak")
    return off


AT = [(1e-4, 0.5), (0.008, 1.0), (0.016, 2.5)]
"""The peak, and beside it."""


def sharpest(*blurs):
    return [float(np.min(np.asarray(blur.stds))) for blur in blurs]


@pytest.mark.slow
def test_cells_under_a_disc():
    """A Gaussian of the disc's variance errs by 6e-3 here."""
    assert off_the_peak(128.0, 0.5, 0.005, [30.0], AT).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("radius", "degrees", "alpha"),
    [
        (128.0, 0.5, 0.005),
        (256.0, 0.5, 0.005),
        (256.0, 0.25, 0.002),
        (256.0, 0.1, 0.002),
        (128.0, 2.0, 0.005),
        (256.0, 2.0, 0.005),
    ],
)
def test_many_cells_under_discs(radius, degrees, alpha):
    """Gaussians of their variance err by up to 0.36 of the peak here."""
    assert off_the_peak(radius, degrees, alpha, [10.0, 45.0, 70.0], [*AT, (0.004, 1.5), (0.03, 0.3)]).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "lamp", "azimuth"), [(6.0, 4.0, 0.5), (np.inf, 3.0, 0.0), (np.inf, np.inf, 1.2)])
def test_cells_under_near_and_turned_discs(camera, lamp, azimuth):
    disc, alpha = np.radians(0.5), 0.005
    rig, theirs = made(camera, lamp, 128.0, lamp_azimuth=azimuth)
    rig, theirs = rig_with(rig, {"lamp_radius": disc}), theirs._replace(lamp_radius=disc)
    cells, operator = lobe_operator(rig, "centre", 40, (), NEVER)
    found = np.asarray(operator.record(GGX(alpha), "smith", ()))
    for s in (0, 1):
        near = [n for n in np.argsort(cells.theta_h[s]) if cells.valid[s, n]]
        for n in (near[0], near[4]):
            angles = cells.theta_h[s, n], cells.theta_d[s], cells.phi_d[s, n]
            truth = lamp_record.recorded_cell(angles, azimuth, lamp_record.Surface(alpha), theirs, (3, 13), (8, 12))
            off = (found[s, n] - truth) / found[s].max(where=cells.valid[s], initial=0)
            print(f"theta_h {angles[0]:.4f}, theta_d {angles[1]:.2f}: {off:+.1e} of the peak")
            assert abs(off) < 1e-3


def test_small_discs_stay_gaussians():
    """Where the image is small beside the blur, and where there is none."""
    positions = np.zeros(2), np.zeros(2)
    for degrees, wanted in ((0.0, False), (0.05, False), (0.5, True)):
        rig = under(128.0, degrees)
        (disc,), _ = lamp_discs(
            sample_view(rig), [blur_of(rig)], sharpest(blur_of(rig)), np.array([0.2, 1.0]), *positions
        )
        assert (disc is not None) is wanted
    point, wide = (blur_of(under(128.0, degrees)) for degrees in (0.0, 0.5))
    (first, second), moved = lamp_discs(
        sample_view(rig), [point, wide], sharpest(point, wide), np.array([0.2, 1.0]), *positions
    )
    assert first is None  # a point beside a disc takes no chords
    assert second is not None
    assert moved[0].max() < 0.01 < moved[1].max()


@pytest.mark.slow
def test_the_derivative_to_a_disc():
    """Of the kernel to the lamp's radius, against differences; they step over a chord's very end, where a bend is cut off."""
    rig, lamp_angle = under(128.0, 0.5), np.full(16, 1.2)
    view, blur, zero = sample_view(rig), blur_of(rig).of_point(), np.zeros((16, 1))
    highlight = 128 * np.sin(0.6)
    at = highlight + np.linspace(-2, 2, 16)[:, None], np.linspace(0, 2, 16)[:, None]
    (disc,), _ = lamp_discs(view, [blur_of(rig)], sharpest(blur_of(rig)), lamp_angle, at[0][:, 0], at[1][:, 0])
    rng = np.random.default_rng(1)
    x, y = at[0] + rng.uniform(-2, 2, (16, 8)), at[1] + rng.uniform(-2, 2, (16, 8))
    normal = view.on_sphere.normals(x, y)

    def total(radius):
        own = jax.tree.map(jnp.asarray, disc)._replace(radius=jnp.broadcast_to(radius, (16,)))
        points = chord_points(view.on_sphere, own)
        return jnp.sum(lamp_kernel(view.on_sphere, blur, own, points, normal, at, (zero, zero)), -1)

    known, step = np.radians(0.5), 1e-5
    _, slope = jax.jvp(total, (jnp.asarray(known),), (jnp.asarray(1.0),))
    secant = (total(known + step) - total(known - step)) / (2 * step)
    np.testing.assert_allclose(slope, secant, atol=3e-4 * np.abs(secant).max())


@pytest.mark.parametrize("pixel", [BoxPixel(0.4), WindowedGaussianPixel(0.3), WindowedGaussianPixel(0.01, 0.3)])
@pytest.mark.parametrize("std", [0.1, 0.5, 3.0])
def test_the_integral_of_a_kernel(pixel, std):
    x, w = np.polynomial.legendre.leggauss(60)
    for low, high in ((-0.3, 0.2), (0.1, 1.5), (-1.0, 4.0)):
        panels = np.linspace(low, high, 9)
        middle, half = (panels[1:] + panels[:-1]) / 2, np.diff(panels)[:, None] / 2
        truth = np.sum(np.asarray(pixel.of_gaussian(middle[:, None] + half * x, std)) * half * w)
        ends = [float(pixel.until_gaussian(end, std)) for end in (high, low)]
        assert ends[0] - ends[1] == pytest.approx(truth, abs=1e-9)


@pytest.mark.slow
def test_a_fit_under_a_disc():
    """Of a table that the oracle records under a lamp of 0.25 degrees, F at each of its points."""
    alpha, lamp = 0.003, np.radians(0.25)
    cells = chosen_cells(SampleView(256.0), "centre", 18)
    setup = oracle.Setup(lamp=lamp)
    rule = disc_cells.DiscCells(
        GRID.theta_h[cells.i_theta_h], cells.theta_d, GRID.phi_d[cells.i_phi_d], setup, alpha, fineness=0.8
    )
    directions = rule.directions(oracle.GGX(alpha), lambda theta_d: conductor(theta_d, *recorded.CHROMIUM))
    noise = PixelNoise(2e-3, 1e-5)
    values = rule.far.noisy(directions, np.random.default_rng(4), noise.relative, noise.floor, 0.0)
    found = fit(
        recorded.table_of(cells, values),
        rig_with(recorded.rig(), {"lamp_radius": lamp}),
        "ggx",
        noise=noise,
        slice_step=18,
    )
    truth = conductor(recorded.SEVENTY_FIVE, *recorded.CHROMIUM)
    f, f_std = (float(np.ravel(a)[0]) for a in found.fresnel(recorded.SEVENTY_FIVE))
    print(f"alpha {found.params['alpha']:.6f}, F(75) {f:.5f} +- {f_std:.5f} for {truth:.5f}, misfit {found.misfit:.3f}")
    assert found.params["alpha"] == pytest.approx(alpha, abs=3 * found.std["alpha"])
    assert f == pytest.approx(truth, abs=3 * f_std)
    assert found.std["alpha"] < 5e-3 * alpha


@pytest.mark.slow
def test_a_free_lamp_is_followed_as_a_disc():
    """Along its axis, from a point up, the operator is that of a rig with the other lamp.

    At 60 degrees the nodes of the widest lamp hold the others' to 3.5e-3; with Gaussians in place of discs to 2.6e-3.
    """
    axis = free_axis("lamp_radius", under(128.0, 0.5))
    _, along = lobe_operator(under(128.0, 0.5), "centre", 30, (axis,), NEVER)
    for value in (0.0, 0.004, 0.01):
        coordinate = 0.5 * np.log((value**2 + axis.softening**2) / (axis.base**2 + axis.softening**2))
        cells, there = lobe_operator(under(128.0, np.degrees(value)), "centre", 30, (), NEVER)
        ours, truth = (np.asarray(o.record(GGX(0.005), "smith", c)) for o, c in ((along, [coordinate]), (there, ())))
        off = np.abs(ours - truth) / truth.max(axis=1, keepdims=True, where=cells.valid, initial=0)
        by_slice = off.max(axis=1, where=cells.valid, initial=0)
        print(
            f"{value:g} rad, coordinate {coordinate:.2f} of {axis.low:.2f} to {axis.high:.2f}: {by_slice} of the peak"
        )
        assert by_slice[:2].max() < 1e-3
        assert by_slice.max() < 5e-3


@pytest.mark.slow
@pytest.mark.parametrize(("degrees", "far"), [(0.0, False), (0.06, False), (0.25, True)])
def test_a_doubt_of_the_lamp_goes_as_far_as_the_data_ask(degrees, far):
    """The rig says that the lamp is a point. Nearby three points of the axis do, to 0.13 degrees."""
    cells, operator = lobe_operator(under(256.0, degrees), "centre", 18, (), NEVER)
    values = (
        np.asarray(operator.record(GGX(0.003), "smith", ())) * conductor(cells.theta_d, *recorded.CHROMIUM)[:, None]
    )
    setup = free_setup([recorded.table_of(cells, values)], recorded.rig(), noise=PixelNoise(1e-3, 1e-5), slice_step=18)
    (refit,) = rig_refits(setup, setup.rig, setup.solve(), ("lamp_radius",))
    print(f"{degrees} degrees: {np.degrees(refit.value):.4f} +- {np.degrees(refit.std):.1g}, up to {refit.axis.high}")
    assert (refit.axis.high > 0.1) is far
    assert refit.contradicts is (degrees > 0)
    assert np.degrees(refit.value) == pytest.approx(degrees, abs=2e-3 if degrees else 0.02)
