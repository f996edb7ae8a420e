"""Cells looked up in real pixels: which pixels, and what `measure` writes, against the oracle."""

import numpy as np
import pytest

from matcam import GGX, Camera, GaussianOptics, Microfacet, Rig, Sphere, measure, rigs
from matcam.camera import PixelNoise
from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE, brdf_table, merl_grid
from matcam.core.jax import jnp, transferred
from matcam.forward import with_pixel_noise
from matcam.forward.cells_in_pictures import CellChoice, cell_means
from matcam.forward.pixel_grid import slice_pixels
from tests.oracle import real_pixels, sphere_record

PHASE = (0.13, -0.31)
GRID = merl_grid("centre")


def summed(positions, shares):
    """{pixel: share}"""
    found = {}
    for position, share in zip(np.round(positions, 6).tolist(), shares, strict=True):
        if share > 1e-9:
            found[tuple(position)] = found.get(tuple(position), 0) + share
    return found


@pytest.mark.parametrize("rule", ["nearest", "bilinear"])
def test_the_pixels_behind_cells(rule):
    random = np.random.default_rng(4)
    compared = 0
    for j in (0, 20, 45, 70, 86):
        ours = slice_pixels(rule, PHASE, 256.0, GRID.theta_d[j])
        i, k = random.integers(0, 90, 40), random.integers(0, 180, 40)
        theirs = real_pixels.behind(rule, PHASE, GRID.theta_h[i], GRID.theta_d[j], GRID.phi_d[k])
        for n, (ring, azimuth) in enumerate(zip(i, k, strict=True)):
            row = ours.share[int(ring * 180 + azimuth)]
            if row.nnz == 0:
                continue
            positions = np.stack([ours.x[row.indices], ours.y[row.indices]], axis=-1)
            own, truth = summed(positions, row.data), summed(theirs.position[n], theirs.share[n])
            assert own.keys() == truth.keys()
            np.testing.assert_allclose([own[p] for p in truth], list(truth.values()), atol=1e-9)
            compared += 1
    assert compared > 100


def test_the_mean_of_the_pixels_inside():
    """Every pixel that shows light belongs to the one cell whose borders hold its directions; empty cells take the nearest."""
    j = 40
    found = slice_pixels("mean", PHASE, 256.0, GRID.theta_d[j])
    nearest = slice_pixels("nearest", PHASE, 256.0, GRID.theta_d[j])
    theta_h, psi = real_pixels.angles_of(np.stack([found.x, found.y], -1), GRID.theta_d[j])
    i, k = np.floor(90 * np.sqrt(theta_h / (np.pi / 2))), np.floor(np.mod(np.pi - psi, np.pi) / np.pi * 180)
    holds = np.bincount((i * 180 + k).astype(int), minlength=90 * 180)
    np.testing.assert_allclose(np.asarray(found.share.sum(1)).ravel()[holds > 0], 1)
    for cell in (*np.flatnonzero(holds > 5)[::300], *np.flatnonzero(holds == 1)[::300]):
        assert found.share[int(cell)].nnz == holds[cell]
        assert set((i * 180 + k)[found.share[int(cell)].indices]) == {cell}
    assert holds[0] == 0
    a, b = found.share[0], nearest.share[0]
    assert summed(np.stack([found.x, found.y], -1)[a.indices], a.data) == summed(
        np.stack([nearest.x, nearest.y], -1)[b.indices], b.data
    )


def test_a_crop_and_another_lamp():
    """A turned lamp turns the plane of light, and the pixels stay; what the sensor does not show is nowhere."""
    straight = slice_pixels("nearest", PHASE, 100.0, GRID.theta_d[30])
    turned = slice_pixels("nearest", PHASE, 100.0, GRID.theta_d[30], azimuth=0.4)
    for found, angle in ((straight, 0.0), (turned, 0.4)):
        x = found.x * np.cos(angle) - found.y * np.sin(angle) - PHASE[0]
        y = found.x * np.sin(angle) + found.y * np.cos(angle) - PHASE[1]
        np.testing.assert_allclose([x, y], np.rint([x, y]), atol=1e-9)
    cropped = slice_pixels("nearest", PHASE, 100.0, GRID.theta_d[30], crop=(60, 90))
    assert np.abs(cropped.x).max() <= 45
    assert np.abs(cropped.y).max() <= 30
    assert 0 < np.sum(np.diff(cropped.share.indptr) > 0) < np.sum(np.diff(straight.share.indptr) > 0)


def test_noise_of_real_pixels():
    """Cells that repeat a pixel repeat its noise."""
    rig = Rig(rigs.merl().camera, Sphere(256), cell_value="nearest", pixel_phase=PHASE)
    flat = brdf_table(np.ones((*GRID_SHAPE, 3)), "centre")
    noisy = with_pixel_noise(flat, rig, PixelNoise(0.02, 0.0), 1).values[..., 0] - 1
    cells = slice_pixels("nearest", PHASE, 256.0, GRID.theta_d[20]).share
    noise = noisy[:, 20].ravel()
    same = [tuple(row.indices) for row in (cells[n] for n in range(180 * 6))]
    for pixels in set(same):
        values = noise[: len(same)][[one == pixels for one in same]]
        np.testing.assert_allclose(values, values[0], atol=1e-14)
    assert len({round(v, 12) for v in noise[: len(same)]}) == len(set(same))
    alone, both = (noise[np.diff(cells.indptr) == n] for n in (1, 2))
    assert np.std(both) == pytest.approx(0.02 / np.sqrt(2), rel=0.03)
    assert np.ptp(alone) > 0


def test_refusals():
    sphere, camera = Sphere(256), rigs.merl().camera
    with pytest.raises(ArgumentError, match="pixel_phase requires cell_value 'nearest', 'bilinear' or 'mean'"):
        Rig(camera, sphere, pixel_phase=(0.0, 0.1))
    with pytest.raises(ArgumentError, match=r"pixel_phase must lie in \[-0.5, 0.5\] px, got 0.7"):
        Rig(camera, sphere, cell_value="nearest", pixel_phase=(0.0, 0.7))
    with pytest.raises(ArgumentError, match=r"pixel_phase must be \(x, y\), px, or 90 such pairs"):
        Rig(camera, sphere, cell_value="nearest", pixel_phase=(0.0, 0.1, 0.2))
    with pytest.raises(ArgumentError, match="cell_value 'bilinear' requires the positions of the pixels"):
        measure(Microfacet(GGX(0.1), 1.0), Rig(camera, sphere, cell_value="bilinear"))
    with pytest.raises(ArgumentError, match="a real pixel grid needs a distant camera and lamp"):
        near = Rig(camera, Sphere(256, distance=20), cell_value="nearest", pixel_phase=(0.0, 0.0))
        measure(Microfacet(GGX(0.1), 1.0), near)


def test_a_picture_that_is_a_plane():
    """x over the picture: interpolation gives it back at the cell's place, the nearest pixel to within half its diagonal."""
    inner = GRID.theta_h < 0.3
    for rule, slack in (("nearest", 0.71), ("bilinear", 1e-9)):
        found = slice_pixels(rule, PHASE, 256.0, GRID.theta_d[40])
        shown = (found.share @ found.x).reshape(90, 180)[inner]
        truth = 256 * np.cos(GRID.theta_h[inner, None]) * np.sin(GRID.theta_d[40])  # mean of both places
        assert np.abs(shown - truth).max() < slack
    cells = CellChoice("nearest", pixel_phase=PHASE).cells(rigs.merl().sample)
    table = np.asarray(cell_means((cells.positions.x * cells.irradiance)[:, None], cells))[:, :, :, 0]
    own = slice_pixels("nearest", PHASE, 256.0, GRID.theta_d[70])
    seen = (np.diff(own.share.indptr) > 0).reshape(90, 180)
    np.testing.assert_allclose(table[:, 70][seen], (own.share @ own.x).reshape(90, 180)[seen], atol=1e-9)
    assert np.isnan(table[:, 70][~seen]).all()


@pytest.mark.parametrize("rule", ["centre", pytest.param("mean", marks=pytest.mark.slow), "nearest"])
def test_means_on_a_gpu(rule, monkeypatch):
    """A GPU averages the cells in a compiled program instead of NumPy."""
    cells = CellChoice(rule, pixel_phase=PHASE if rule == "nearest" else None, finest=0.5).cells(rigs.merl().sample)
    radiance = jnp.asarray(np.random.default_rng(1).random((cells.positions.x.size, 1)))
    by_numpy = np.asarray(cell_means(radiance, cells))
    monkeypatch.setattr("matcam.forward.cells_in_pictures.computes_on_gpu", lambda: True)
    np.testing.assert_allclose(cell_means(radiance, transferred(cells)), by_numpy, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["nearest", "bilinear"])
def test_tables_against_the_oracle(rule):
    """Entries of `measure`: each pixel by adaptive quadrature, then the oracle's own look-up; 1e-4 of the value."""
    rig = Rig(Camera(GaussianOptics(0.5)), Sphere(100.0), cell_value=rule, pixel_phase=PHASE)
    surface, setup = sphere_record.Surface(0.03), sphere_record.Setup(100.0)
    table = measure(Microfacet(GGX(surface.alpha), 1.0), rig)
    assert table.attrs["pixel_phase"] == list(PHASE)
    for i, j, k in [(0, 30, 90), (3, 20, 60), (12, 45, 130), (30, 10, 20), (50, 60, 95), (5, 75, 170)]:
        theta_d = GRID.theta_d[j]
        found = real_pixels.behind(rule, PHASE, GRID.theta_h[[i]], theta_d, GRID.phi_d[[k]], 100.0)
        truth = sum(
            share
            * sphere_record.record(*position, 2 * theta_d, surface, setup, rtol=1e-7)
            / real_pixels.light_cosine(position, theta_d, 100.0)
            for position, share in zip(found.position[0], found.share[0], strict=True)
            if share > 1e-9
        )
        assert float(table[i, j, k, 0]) == pytest.approx(truth, rel=1e-4)
