"""The shape of a diffuse part against laws that others wrote: rough plaster (Oren and Nayar), a smooth coat (Fresnel)."""

import numpy as np
import pytest

from matcam.material.diffuse_shape import TERMS, departure, terms

N = 20_000


@pytest.fixture(scope="module")
def directions():
    """Cosines of light and view, and the angle between them, of directions up to 84 degrees from the normal."""
    random = np.random.default_rng(0)
    cos_i, cos_o = random.uniform(0.1, 1, (2, N))
    azimuth = random.uniform(0, np.pi, N)
    between = cos_i * cos_o + np.sqrt((1 - cos_i**2) * (1 - cos_o**2)) * np.cos(azimuth)
    return cos_i, cos_o, azimuth, np.arccos(np.clip(between, -1, 1))


def plaster(cos_i, cos_o, azimuth, sigma):
    """Oren and Nayar (1994), equation 30: the qualitative model."""
    theta_i, theta_o = np.arccos(cos_i), np.arccos(cos_o)
    a, b = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33), 0.45 * sigma**2 / (sigma**2 + 0.09)
    both = np.maximum(theta_i, theta_o), np.minimum(theta_i, theta_o)
    return a + b * np.maximum(np.cos(azimuth), 0) * np.sin(both[0]) * np.tan(both[1])


def coated(cos_i, cos_o, azimuth, n):
    """What a smooth layer lets in and out."""

    def passed(cos):
        below = np.sqrt(1 - (1 - cos**2) / n**2)
        return 1 - (((cos - n * below) / (cos + n * below)) ** 2 + ((n * cos - below) / (n * cos + below)) ** 2) / 2

    return passed(cos_i) * passed(cos_o)


@pytest.mark.parametrize(("law", "strength", "left"), [(plaster, 0.3, 0.04), (plaster, 0.6, 0.06), (coated, 1.5, 0.01)])
def test_laws_of_others_are_followed(directions, law, strength, left):
    """The rms error of the best shape, relative; Lambert's law leaves at least 2.5 times as much."""
    cos_i, cos_o, azimuth, between = directions
    truth = law(cos_i, cos_o, azimuth, strength)
    shapes = np.stack([np.ones(N), *map(np.asarray, terms(cos_i, cos_o, between / 2))], axis=1) / truth[:, None]
    found = np.linalg.lstsq(shapes, np.ones(N), rcond=None)[0]
    error = np.sqrt(np.mean((shapes @ found - 1) ** 2))
    lambertian = shapes[:, 0] / np.mean(shapes[:, 0] ** 2) * np.mean(shapes[:, 0]) - 1
    print(f"{law.__name__} {strength}: {error:.2%} left, by Lambert's law {np.sqrt(np.mean(lambertian**2)):.1%}")
    assert error < left
    assert error < np.sqrt(np.mean(lambertian**2)) / 2.5


def test_light_and_view_may_change_positions(directions):
    cos_i, cos_o, _, between = directions
    one, other = (departure(np.full(TERMS, 0.1), *pair, between / 2) for pair in ((cos_i, cos_o), (cos_o, cos_i)))
    assert np.asarray(one) == pytest.approx(np.asarray(other), rel=1e-14)
    assert float(departure(np.full(TERMS, 0.3), 1.0, 1.0, 0.0)) == pytest.approx(1)


def test_no_terms_are_lamberts_law_and_light_is_never_negative():
    assert float(departure(np.zeros(0), 0.3, 0.2, 0.4)) == 1
    assert float(departure(np.full(TERMS, -5.0), 0.3, 0.2, 0.4)) == 0
