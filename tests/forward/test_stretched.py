"""Lobes that change on the kernel's scale far from the highlight: brushed surfaces, and tails that fall very fast."""

import numpy as np
import pytest

from matcam import GGX, Beckmann, Camera, GaussianOptics, Microfacet, Rig, Sphere, rigs
from matcam.core.grid import cosines, merl_grid
from matcam.forward.integral.blur import imaging_of
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.record import record
from matcam.material import AnisotropicGGX
from tests.oracle import stretched_lobe

RADIUS, LAMP = 60.0, 0.9


@pytest.mark.slow
@pytest.mark.parametrize("alphas", [(0.01, 0.05), (0.05, 0.01)])
def test_a_brushed_sphere(alphas):
    """60 pixels along and across the highlight's arms and close to it: 1e-4 of the value or 1e-7 of the peak."""
    random, middle = np.random.default_rng(1), RADIUS * np.sin(LAMP / 2)
    distance, angle = (
        random.uniform(6, 34, 57),
        random.choice([0, 0.5, 1, 1.5], 57) * np.pi + random.normal(0, 0.15, 57),
    )
    x, y = middle + distance * np.cos(angle), distance * np.sin(angle)
    whole = (np.hypot(x, y) < RADIUS - 7) & (x > -0.9 * RADIUS * np.cos(LAMP) + 8)
    x, y = np.append(x[whole], middle + np.array([0, 1, -2])), np.append(y[whole], [0, 1, 2])
    material, imaging = (
        Microfacet(AnisotropicGGX(*alphas), 1.0),
        imaging_of(Rig(Camera(GaussianOptics(0.5)), Sphere(RADIUS))),
    )
    positions = RecordPositions(x, y, np.full(x.size, LAMP))
    plan = record_plan(imaging, positions, float(material.finest), material.elongation)
    ours = np.asarray(record(material, imaging, plan))[:, 0]
    panels = np.where(np.hypot(x - middle, y) < 5, 60, 28)
    truth = np.array(
        [stretched_lobe.record(a, b, LAMP, alphas, RADIUS, panels=n) for a, b, n in zip(x, y, panels, strict=True)]
    )
    missed = np.abs(ours - truth) / np.maximum(1e-4 * truth, 1e-7 * truth.max())
    print(f"worst: {missed.max():.2g} of what is allowed")
    assert missed.max() < 1


def test_only_stretched_lobes_are_elongated():
    assert Microfacet(AnisotropicGGX(0.01, 0.05), 1.0).elongation == pytest.approx(5)
    assert Microfacet(AnisotropicGGX(0.05, 0.01), 1.0).elongation == pytest.approx(5)
    assert Microfacet(GGX(0.01), 1.0).elongation == 1


@pytest.mark.slow
def test_tails_are_nowhere_negative():
    """Two slices of a table of Beckmann 0.003, whose light is 1e-300 of its peak a few pixels away."""
    grid, rig = merl_grid("centre"), rigs.merl()
    angles = np.meshgrid(grid.theta_h, grid.theta_d[[3, 60]], grid.phi_d, indexing="ij")
    above = np.minimum(*(np.asarray(c) for c in cosines(*angles))) > 0
    position = rig.sample.position(*(a[above] for a in angles))
    positions, imaging = RecordPositions(*(np.asarray(a) for a in position)), imaging_of(rig)
    plan = record_plan(imaging, positions, 0.003)
    values = np.asarray(record(Microfacet(Beckmann(0.003), 1.0), imaging, plan))
    assert values.min() >= 0
    assert values.max() > 100
