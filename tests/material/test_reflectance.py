import numpy as np
import pytest

from matcam import Conductor, Dielectric, Schlick, fresnel_conductor, metal
from matcam.core.errors import ArgumentError
from matcam.core.jax import jnp
from matcam.material import Constant, metals
from tests.golden import rows
from tests.oracle.merl_lobe import conductor


@pytest.mark.parametrize("row", rows("fresnel"))
def test_golden_conductor(row):
    assert float(fresnel_conductor(row["theta"], row["n"], row["k"])) == pytest.approx(row["reflectance"], rel=1e-9)


def test_conductor_against_the_amplitudes_of_both_waves():
    rng = np.random.default_rng(2)
    n, k, theta = rng.uniform(0.05, 6, 200), rng.uniform(0, 8, 200), rng.uniform(0, np.pi / 2, 200)
    np.testing.assert_allclose(fresnel_conductor(theta, n, k), conductor(theta, n, k), rtol=1e-10)


def test_limits():
    assert float(fresnel_conductor(np.pi / 2, 2.0, 3.0)) == pytest.approx(1)
    assert float(fresnel_conductor(0.0, 1.5, 0.0)) == pytest.approx(0.04)
    brewster = np.arctan(1.5)  # the p wave vanishes; half of the s wave is left
    s_wave = np.cos(brewster) - np.sqrt(1.5**2 - np.sin(brewster) ** 2)
    s_wave /= np.cos(brewster) + np.sqrt(1.5**2 - np.sin(brewster) ** 2)
    assert float(Dielectric(1.5).at(jnp.asarray(brewster))) == pytest.approx(s_wave**2 / 2)
    assert float(Schlick(0.3).at(jnp.asarray(0.0))) == pytest.approx(0.3)
    assert float(Schlick(0.3).at(jnp.asarray(np.pi / 2))) == pytest.approx(1)


def test_channels_stand_behind_the_angles():
    theta = jnp.linspace(0, 1, 5)
    for term in (
        Conductor([1, 2, 3], 2.0),
        Schlick([0.1, 0.2, 0.3]),
        Dielectric([1.2, 1.3, 1.4]),
        Constant([0.1, 0.2, 0.3]),
    ):
        assert term.at(theta).shape == (5, 3)
    for term in (Conductor(1, 2), Schlick(0.1), Dielectric(1.2), Constant(0.5)):
        assert term.at(theta).shape == (5,)


@pytest.mark.parametrize(
    ("build", "name"),
    [
        (lambda: Conductor(-1, 2), "n must"),
        (lambda: Conductor(1, -2), "k must"),
        (lambda: Dielectric(1.0), "eta must"),
        (lambda: Schlick(1.2), "f0 must"),
        (lambda: Constant([[0.1]]), "one entry per channel"),
        (lambda: fresnel_conductor(2.0, 1, 1), "theta must"),
    ],
)
def test_refusals(build, name):
    with pytest.raises(ArgumentError, match=name):
        build()


def test_chromium_disagrees_by_source_as_the_literature_does():
    """docs/model.md 5: F0 at 550 nm is 0.555, 0.650 or 0.681; F(75)/F0 0.937, 0.908 or 0.881."""
    expected = {"johnson": (0.555, 0.937), "rakic": (0.650, 0.908), "sytchkova": (0.681, 0.881)}
    assert set(metals()["Cr"]) == set(expected)
    for source, (f0, ratio) in expected.items():
        n, k, citation = metal("Cr", 550e-9, source)
        at_0, at_75 = (float(fresnel_conductor(np.radians(t), n, k)) for t in (0, 75))
        assert at_0 == pytest.approx(f0, abs=6e-4)
        assert at_75 / at_0 == pytest.approx(ratio, abs=6e-4)
        assert len(citation) > 40


def test_every_table_covers_the_visible_range_and_names_its_source():
    wavelengths = np.linspace(400e-9, 700e-9, 31)
    for name, sources in metals().items():
        for source in sources:
            n, k, citation = metal(name, wavelengths, source)
            assert np.all((n > 0) & (n < 10) & (k > 0) & (k < 12))
            assert any(year in citation for year in ("(19", "(20"))


def test_metals_refuse_what_they_do_not_know():
    with pytest.raises(ArgumentError, match="unknown metal 'Crr'; did you mean 'Cr'"):
        metal("Crr", 550e-9)
    with pytest.raises(ArgumentError, match="did you mean 'sytchkova'"):
        metal("Cr", 550e-9, "sytchkov")
    with pytest.raises(ArgumentError, match="550e-9 for 550 nm"):
        metal("Cr", 550)
