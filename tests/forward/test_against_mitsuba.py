"""Pictures of a rough metal sphere against Mitsuba 3, code that nobody here wrote, within its own noise.

Mitsuba renders the sphere with a box filter and no lens, finely; blurring that film by the camera's kernel makes pixels
whose scatter between seeds says how far they can be trusted: 1e-5 to 1e-4 of the highlight.
"""

import numpy as np
import pytest
from scipy import stats
from scipy.special import erf

from matcam import GGX, Camera, Conductor, GaussianOptics, Microfacet, Rig, Sphere
from matcam.forward import picture_values

mitsuba = pytest.importorskip("mitsuba", reason="needs Mitsuba 3")

RADIUS, ALPHA, N, K = 256.0, 0.02, 0.4, 2.5
SIDE, BORDER, FINE, SAMPLES, SEEDS = 16, 3, 8, 32, 12
LEVEL = 1e-3  # of significance, for each picture


def rendered(theta_d, middle, seed):
    """Radiance in fine pixels, (SIDE + 2 * BORDER) FINE on a side, about `middle` px on the x axis; row 0 on top."""
    to = mitsuba.ScalarTransform4f()
    look = to.look_at(origin=[middle / RADIUS, 0, 3], target=[middle / RADIUS, 0, 0], up=[0, 1, 0])
    half = (SIDE + 2 * BORDER) / 2 / RADIUS
    film = {
        "type": "hdrfilm",
        "width": (SIDE + 2 * BORDER) * FINE,
        "height": (SIDE + 2 * BORDER) * FINE,
        "rfilter": {"type": "box"},
        "component_format": "float32",
    }
    scene = {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
        "sensor": {
            "type": "orthographic",
            "to_world": look @ to.scale([half, half, 1]),
            "film": film,
            "sampler": {"type": "independent", "sample_count": SAMPLES},
        },
        "lamp": {
            "type": "directional",
            "direction": [-np.sin(2 * theta_d), 0, -np.cos(2 * theta_d)],
            "irradiance": {"type": "rgb", "value": 1.0},
        },
        "sphere": {
            "type": "sphere",
            "bsdf": {
                "type": "roughconductor",
                "distribution": "ggx",
                "alpha": ALPHA,
                "eta": {"type": "rgb", "value": N},
                "k": {"type": "rgb", "value": K},
            },
        },
    }
    return np.array(mitsuba.render(mitsuba.load_dict(scene), seed=seed), dtype=float)[..., 0]


def through_camera(sigma):
    """Weights (pixels, fine pixels) along one axis: lens and box pixel, less the fine pixels' own width to second order."""
    fine = (np.arange((SIDE + 2 * BORDER) * FINE) + 0.5) / FINE
    x = fine - (np.arange(SIDE) + BORDER + 0.5)[:, None]
    unit = np.sqrt(2) * sigma
    kernel = (erf((x + 0.5) / unit) - erf((x - 0.5) / unit)) / 2
    slope = [-(x + s) / sigma**2 * np.exp(-(((x + s) / unit) ** 2)) / np.sqrt(2 * np.pi) / sigma for s in (0.5, -0.5)]
    return (kernel - (slope[0] - slope[1]) / FINE**2 / 24) / FINE


@pytest.mark.slow
@pytest.mark.parametrize(("degrees", "sigma", "apart"), [(0, 0.2, 1), (75, 0.5, 3), (0, 0.5, 3)])
def test_highlight_of_a_metal_sphere(degrees, sigma, apart):
    """Pixels around the highlight, `apart` so far that they share hardly any light: Student's t of each with 11 degrees of
    freedom, all taken together by Fisher."""
    mitsuba.set_variant("scalar_rgb")
    theta_d = np.radians(degrees)
    middle = round(RADIUS * np.sin(theta_d))
    weights = through_camera(sigma)[::apart]
    films = [weights @ rendered(theta_d, middle, seed) @ weights.T for seed in range(SEEDS)]
    mean, error = np.mean(films, axis=0), np.std(films, axis=0, ddof=1) / np.sqrt(SEEDS)

    rig = Rig(Camera(GaussianOptics(sigma)), Sphere(RADIUS))
    material = Microfacet(GGX(ALPHA), Conductor(N, K), masking="smith-separable")
    columns = slice(256 + middle - SIDE // 2, 256 + middle + SIDE // 2)
    ours = np.asarray(picture_values(material, rig, 2 * theta_d, (SIDE, 512)))[:, columns, 0]
    aside = np.gradient(ours, axis=1)[::apart, ::apart]
    ours = ours[::apart, ::apart]

    p = 2 * stats.t.sf(np.abs(ours - mean) / error, SEEDS - 1)
    together = stats.chi2.sf(-2 * np.log(p).sum(), 2 * p.size)
    print(f"{degrees} degrees: p = {together:.3g}, Mitsuba's error at the peak {error.max() / mean.max():.1e}")
    assert together > LEVEL
    # and the test can tell: half a per cent more light, or a hundredth of a pixel aside, would not pass
    for wrong in (1.005 * ours, ours + 0.01 * aside):
        p = 2 * stats.t.sf(np.abs(wrong - mean) / error, SEEDS - 1)
        assert stats.chi2.sf(-2 * np.log(p).sum(), 2 * p.size) < LEVEL
