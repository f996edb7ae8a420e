"""RGL's parameterisation against Mitsuba's `measured`: every term of it, isotropic and not. Mitsuba's numbers are float32."""

import numpy as np
import pytest
import xarray as xr

from matcam import GaussianOptics
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading, shading
from matcam.io import read_rgl, write_rgl
from matcam.material import Adaptive
from tests.files.test_rgl import MATERIALS
from tests.oracle import measured_bsdf


def directions(count, seed, lowest=0.02):
    random = np.random.default_rng(seed)
    cos, phi = random.uniform(lowest, 1, count), random.uniform(0, 2 * np.pi, count)
    sin = np.sqrt(1 - cos**2)
    # what float32 holds, so that both sides see the same
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1).astype(np.float32).astype(float)


def outgoing(material, light, view):
    """BRDF times the view's cosine."""
    seen = shading((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), tuple(light.T), tuple(view.T))
    reflected = np.asarray(material.reflected(seen))
    return (reflected if reflected.ndim == 2 else reflected[:, None]) / light[:, 2:]


@pytest.mark.parametrize("name", MATERIALS)
def test_real_files_at_ten_thousand_pairs(real_data, name):
    path = real_data / "rgl" / f"{name}_rgb.bsdf"
    light, view = directions(10_000, 1), directions(10_000, 2)
    theirs = measured_bsdf.evaluated(path, light, view)
    error = np.abs(outgoing(Adaptive(read_rgl(path)), light, view) - theirs)
    bright = np.abs(theirs) > 2e-3
    assert bright.mean() > 0.2
    assert np.max(error[bright] / np.abs(theirs[bright])) < 1e-4
    # fainter ones lie where the ndf falls to nothing within one cell: there float32 finds the place to 1e-5 of the cell
    assert np.all(error < 1e-4 * np.abs(theirs) + 2e-6)


def random_fields(azimuths, *, channels=3, jacobian=1):
    random = np.random.default_rng(3)
    number = lambda *shape: random.uniform(0.5, 1.5, shape).astype(np.float32)  # noqa: E731
    p, t, n = azimuths.size, 4, 6
    # an isotropic material's projected area has no azimuth
    sigma = number(5, 6) if p > 2 else np.tile(number(1, 6), (5, 1))
    light = ("phi_i", "theta_i")
    return xr.Dataset(
        {
            "description": ("d", np.frombuffer(b"random", np.uint8)),
            "ndf": (("ndf_phi", "ndf_theta"), number(7, 9)),
            "sigma": (("sigma_phi", "sigma_theta"), sigma),
            "vndf": ((*light, "vndf_phi", "vndf_theta"), number(p, t, 7, 8)),
            "luminance": ((*light, "row", "column"), number(p, t, n, n)),
            "rgb": ((*light, "channel", "row", "column"), number(p, t, channels, n, n)),
            "jacobian": ("j", np.array([jacobian], dtype=np.uint8)),
        },
        coords={"phi_i": azimuths.astype(np.float32), "theta_i": np.array([0.0, 0.4, 1.1, 1.57], dtype=np.float32)},
    )


@pytest.mark.parametrize(
    ("azimuths", "jacobian"),
    [
        (np.zeros(1), 1),
        (np.linspace(-np.pi, np.pi, 9), 1),
        (np.linspace(-np.pi, 0, 5), 1),
        (np.linspace(-np.pi, -np.pi / 2, 4), 0),
    ],
    ids=["isotropic", "anisotropic", "half a turn", "a quarter"],
)
def test_random_fields(tmp_path, azimuths, jacobian):
    """Nothing symmetric, so that a sign, an axis or a slice that is wrong shows."""
    write_rgl(tmp_path / "a.bsdf", random_fields(azimuths, jacobian=jacobian))
    light, view = directions(2000, 3), directions(2000, 4)
    theirs = measured_bsdf.evaluated(tmp_path / "a.bsdf", light, view)
    np.testing.assert_allclose(outgoing(Adaptive(read_rgl(tmp_path / "a.bsdf")), light, view), theirs, rtol=1e-5)


def test_spectra_are_channels(tmp_path):
    fields = random_fields(np.zeros(1), channels=3)
    spectra = fields.rename(rgb="spectra", channel="wavelengths").assign_coords(
        wavelengths=np.array([400, 500, 600], dtype=np.float32)
    )
    write_rgl(tmp_path / "s.bsdf", spectra)
    light, view = directions(50, 5), directions(50, 6)
    np.testing.assert_array_equal(
        outgoing(Adaptive(read_rgl(tmp_path / "s.bsdf")), light, view), outgoing(Adaptive(fields), light, view)
    )


def test_nothing_below_the_horizon_and_derivatives(real_data):
    material = Adaptive(read_rgl(real_data / "rgl" / "paper_white_rgb.bsdf"))
    below = Shading(*(jnp.full(3, x) for x in (-0.1, 0.5, 0.3, 0.0, 0.4, 0.1)))
    assert np.all(np.asarray(material.reflected(below)) == 0)
    step = np.array([-1e-6, 0, 1e-6])
    value, slope = jax.jvp(lambda theta_h: material.brdf(theta_h, 0.5, 0.3)[:, 1], (0.3 + step,), (np.ones(3),))
    assert float(slope[1]) == pytest.approx(float(value[2] - value[0]) / 2e-6, rel=1e-5)
    assert 0.2 < float(material.finest) < 1.2  # paper: D falls to a half somewhere between 10 and 70 degrees
    assert repr(material) == "Adaptive(1 x 8 directions of light, 32 x 32 x 3)"


def test_other_things_are_refused():
    for wrong in (GaussianOptics(0.5), xr.Dataset()):
        with pytest.raises(ArgumentError, match="fields must be a Dataset"):
            Adaptive(wrong)
    with pytest.raises(ArgumentError, match="field phi_i must span a full"):
        Adaptive(random_fields(np.linspace(-np.pi, -0.6 * np.pi, 4)))
