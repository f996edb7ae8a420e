"""Tables through lenses that are no Gaussians: each cell is the pixel of a picture that is shifted until its centre shows the
cell. Pictures through lenses are judged by sums over normals in test_aberrated_pictures.py."""

import numpy as np
import pytest

from matcam import (
    GGX,
    BoxPixel,
    Camera,
    ColourOptics,
    DiffractionOptics,
    GaussianNDF,
    GaussianOptics,
    Microfacet,
    Rig,
    SeidelOptics,
    Sphere,
    ZernikeOptics,
    measure,
    picture,
)
from matcam.core.grid import merl_grid
from tests.forward.test_aberrated_pictures import pupil_of
from tests.oracle import aberrated

RADIUS = 30.0
PARTS = (8.0, 550e-9, 5e-6)


def positions(theta_h, theta_d, phi_d):
    """Both places of a cell, (2, 2), px, and the cosines of the light there."""
    psi = np.pi - phi_d + np.array([0, np.pi])
    x = np.cos(theta_h) * np.sin(theta_d) + np.sin(theta_h) * np.cos(psi) * np.cos(theta_d)
    half = np.sin(theta_h) * np.sin(theta_d) * np.cos(psi)
    cosines = np.cos(theta_h) * np.cos(theta_d) + half
    return RADIUS * np.stack([x, np.sin(theta_h) * np.sin(psi)], -1), cosines


def largest_error(lens, colours, material, count, least=0.0):
    """Largest error of cells, drawn at random, over the table's peak in their slice. colours: each channel's lens and shift."""
    table = measure(material, Rig(Camera(lens, BoxPixel(0.5)), Sphere(RADIUS)))
    grid, rng = merl_grid("centre"), np.random.default_rng(4)
    seen = np.argwhere(np.isfinite(table.values[..., 0]) & (table.values[..., 0] > least * np.nanmax(table.values)))
    worst = []
    for i, j, k in seen[rng.integers(0, len(seen), count)]:
        at, cosines = positions(grid.theta_h[i], grid.theta_d[j], grid.phi_d[k])
        if cosines.min() < 0.15:
            continue
        for c, (own, shift) in enumerate(colours):
            truth = []
            for position, cosine in zip(at, cosines, strict=True):
                moved = tuple(shift - position)
                rig = Rig(Camera(ColourOptics(own, own, own, moved, moved, moved), BoxPixel(0.5)), Sphere(RADIUS))
                pixel = picture(material, rig, 2 * grid.theta_d[j], shape=(1, 1)).values[0, 0, 0]
                truth.append(pixel / cosine)
            worst.append((table.values[i, j, k, c] - np.mean(truth)) / np.nanmax(table.values[:, j, :, c]))
    print(np.round(np.abs(worst), 7))
    return np.max(np.abs(worst))


@pytest.mark.slow
def test_each_colour_has_its_lens_and_its_shift():
    lenses = [GaussianOptics(0.5), GaussianOptics(0.8), GaussianOptics(0.6)]
    shifts = [np.zeros(2), np.array([0.4, 0.0]), np.array([-0.3, 0.7])]
    lens = ColourOptics(*lenses, *shifts)
    assert largest_error(lens, list(zip(lenses, shifts, strict=True)), Microfacet(GGX(0.1), 0.9), 4) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.005, 0.1])
@pytest.mark.parametrize(
    "lens",
    [DiffractionOptics(*PARTS), ZernikeOptics(*PARTS, astigmatism=(0.04, -0.03), coma=(0.02, 0.03), defocus=0.05)],
    ids=["diffraction", "aberrations"],
)
def test_cells_through_lenses_that_end_at_a_frequency(lens, alpha):
    error = largest_error(lens, [(lens, np.zeros(2))], Microfacet(GGX(alpha), 0.9), 40, least=1e-6)
    assert error < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("lamp_azimuth", [0.0, 0.7])
def test_a_highlight_is_spread_by_the_lens_at_its_position(lamp_azimuth):
    """Cells about highlights of 0.003 px, where the lens over the field, by another's pupil, says how they are spread."""
    lens = SeidelOptics(*PARTS, unit=RADIUS, coma=0.03, astigmatism=0.02, curvature=0.02)
    rig = Rig(Camera(lens, BoxPixel(0.5)), Sphere(RADIUS))
    table = measure(Microfacet(GaussianNDF(1e-4), 1.0, masking=None), rig, azimuth=lamp_azimuth)
    assert table.attrs["route"] == "frequencies"
    assert table.attrs["kernel_error"] < 3e-4
    grid, turn = merl_grid("centre"), np.array([np.cos(lamp_azimuth), np.sin(lamp_azimuth)])
    rotated = np.array([[turn[0], -turn[1]], [turn[1], turn[0]]])
    for j in (10, 45, 70):
        highlight = rotated @ np.array([RADIUS * np.sin(grid.theta_d[j]), 0.0])
        kernel = aberrated.seen_by_pixel(pupil_of(lens.at(*highlight)), 20.0)
        found, truth = [], []
        for i in range(0, 20, 2):
            for k in range(5, 180, 29):
                at, cosines = positions(grid.theta_h[i], grid.theta_d[j], grid.phi_d[k])
                if cosines.min() > 0.1 and np.isfinite(table.values[i, j, k, 0]):
                    away = at @ rotated.T - highlight
                    truth.append(np.mean(kernel(away[:, 0], away[:, 1]) / cosines))
                    found.append(table.values[i, j, k, 0])
        found, truth = np.array(found), np.array(truth)
        scale = (found @ truth) / (truth @ truth)
        assert len(truth) > 30
        assert np.abs(found / scale - truth).max() < 2e-4 * truth.max()
