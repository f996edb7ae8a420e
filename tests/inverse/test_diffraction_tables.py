"""Tables through lenses that are limited by diffraction, with aberrations and without: the fits' operator against sums over
normals by Airy's pattern itself, and by the pupil's integral (tests/oracle).

The lens is a sum of Gaussians there, of many widths, and a rule has nodes for its core, for what surrounds it and for its
tails. Its rings, and what differs by direction, are a table of their own."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from matcam import (
    GGX,
    BoxPixel,
    Camera,
    DiffractionOptics,
    Microfacet,
    NearLamp,
    Rig,
    Sphere,
    ZernikeOptics,
    measure,
)
from matcam.core.workspace import Workspace
from matcam.inverse.correction.response_lattice import FINE, Spacing, response_lattice
from matcam.inverse.operator.lobe_operator import lobe_operator
from tests.oracle import aberrated
from tests.oracle.airy_record import AROUND, recorded_way

PARTS = (550e-9, 6.7e-6)
EVERY = 90
"""The only slice is at theta_d = 45.5 degrees."""


def turned_pair(pair, order, azimuth):
    """A pair of Zernike coefficients along axes that are turned by an azimuth, rad."""
    turn = np.exp(-1j * order * azimuth)
    return tuple(float(f(complex(*pair) * turn)) for f in (np.real, np.imag))


def errors(lens, alphas, positions, azimuth=0.0):
    """Errors over the peak of the cells closest to some distances from the highlight, px: (alphas, places).

    azimuth: of the lamp, in quarter turns, which square pixels do not show, rad.
    """
    kernel, cutoff = None, float(lens.cutoff)
    if isinstance(lens, ZernikeOptics):
        pairs = {
            name: turned_pair(getattr(lens, name).tolist(), order, azimuth)
            for name, order in (("coma", 1), ("astigmatism", 2), ("trefoil", 3))
        }
        pupil = aberrated.Pupil(cutoff, float(lens.defocus), **pairs, spherical=float(lens.spherical))
        kernel = aberrated.seen_by_pixel(pupil, AROUND + 1)
    cells, operator = lobe_operator(
        Rig(Camera(lens, BoxPixel()), Sphere(256.0), lamp_azimuth=azimuth), "centre", EVERY, (), Workspace()
    )
    assert cells.theta_d.shape == (1,)
    away = np.where(cells.valid[0], 256.0 * cells.theta_h[0], np.inf)
    chosen = [int(np.argmin(np.abs(away - position))) for position in positions]
    found = []
    for alpha in alphas:
        recorded = np.asarray(operator.record(GGX(alpha), "smith", np.zeros(0)))[0, chosen]
        truth = [
            np.mean(
                [
                    recorded_way(
                        cells.theta_h[0, j], cells.theta_d[0], cells.phi_d[0, j] + turn, alpha, cutoff,
                        kernel=kernel,
                    )
                    for turn in (0, np.pi)
                ]
            )
            for j in chosen
        ]  # fmt: skip
        found.append((recorded - truth) / truth[0])
        print(type(lens).__name__, float(lens.cutoff), alpha, np.round(away[chosen], 1), "px:", found[-1])
    return np.abs(found)


@pytest.mark.slow
def test_a_lens_of_many_widths():
    assert errors(DiffractionOptics(8.0, *PARTS), [0.003], [0.0, 2.5]).max() < 1e-4


def test_a_lens_with_coma_and_astigmatism():
    """It is different on either side of the plane of camera and lamp, and cells of both sides are asked for."""
    lens = ZernikeOptics(8.0, *PARTS, astigmatism=(0.04, -0.03), coma=(0.03, 0.05))
    assert errors(lens, [0.003], [0.0, 1.5, 2.5]).max() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("azimuth", [np.pi / 2, -np.pi / 2, np.pi])
def test_a_lens_with_aberrations_under_a_turned_lamp(azimuth):
    lens = ZernikeOptics(8.0, *PARTS, astigmatism=(0.04, -0.03), coma=(0.03, 0.05), trefoil=(0.02, 0.03))
    assert errors(lens, [0.003], [0.0, 1.5, 2.5], azimuth).max() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(("distances", "azimuth"), [((np.inf, np.inf), 0.6), ((12.0, 9.0), 0.0), ((8.0, np.inf), 2.0)])
def test_any_lens_serves_any_rig(distances, azimuth):
    """Against `measure`, which filters whole images, and shares no integral with the operator."""
    lens = ZernikeOptics(8.0, *PARTS, astigmatism=(0.06, -0.03), coma=(0.03, 0.06))
    camera, lamp = distances
    rig = Rig(
        Camera(lens, BoxPixel()),
        Sphere(120.0) if np.isinf(camera) else Sphere(120.0, camera),
        None if np.isinf(lamp) else NearLamp(lamp),
        lamp_azimuth=azimuth,
    )
    cells, operator = lobe_operator(rig, "centre", 40, (), Workspace())
    record = np.asarray(operator.record(GGX(0.02), "smith", np.zeros(0)))
    table = measure(Microfacet(GGX(0.02), 1.0), rig).values[..., 0]
    truth = table[cells.i_theta_h, cells.slices[:, None], cells.i_phi_d]
    peak = np.where(cells.valid, truth, 0.0).max(axis=1, keepdims=True)
    assert np.abs(np.where(cells.valid, record - truth, 0.0) / peak).max() < 2e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    "lens",
    [
        *(DiffractionOptics(f_number, *PARTS) for f_number in (2.8, 8.0, 16.0)),
        ZernikeOptics(5.6, *PARTS, coma=(0.0, 0.1), trefoil=(0.03, 0.02), spherical=0.04),
        ZernikeOptics(11.0, *PARTS, defocus=0.1, astigmatism=(0.08, 0.05)),
    ],
    ids=["f/2.8", "f/8", "f/16", "coma and trefoil", "defocus and astigmatism"],
)
def test_lenses_from_open_to_closed(lens):
    """1e-4 of the peak, from a lobe of a quarter of a pixel to one of 5 px."""
    assert errors(lens, [0.001, 0.003, 0.02], [0.0, 1.0, 2.5, 6.0, 12.0]).max() < 1e-4


@pytest.mark.slow
def test_a_lattice_of_responses_has_the_rings_that_airy_patterns_need():
    """Rings between those of the lattice are interpolated. At f/8 the response of a mirror changes from ring to ring."""
    some = Spacing(tuple(range(10, 25)), (70,), (0, 24, 53, 80, 90))
    rig = Rig(Camera(DiffractionOptics(8, 550e-9, 5e-6), BoxPixel()), Sphere(256.0))
    lattice = response_lattice(rig, "centre", some, (), Workspace())
    true, recorded = (one.record(GGX(0.003), "smith", ()) for one in (lattice.true, lattice.recorded))
    ratios = np.where(lattice.cells.valid, np.log(true / recorded), np.nan).reshape(len(some.rings), -1)
    ratios = ratios[:, np.isfinite(ratios).all(axis=0)]
    there = np.isin(some.rings, FINE.rings)
    between = PchipInterpolator(np.array(some.rings)[there], ratios[there], axis=0)(some.rings)
    assert ratios.shape[1] > 1
    assert np.ptp(ratios) > 0.1
    np.testing.assert_allclose(between, ratios, atol=0.01)
