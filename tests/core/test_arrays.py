"""Formulae for arrays of NumPy and of JAX, and immutable objects that become pytrees when JAX is imported."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from matcam import GGX, Camera, DiffractionOptics, GaussianOptics, HaloOptics, Sphere, rigs
from matcam.core.arrays import (
    changed,
    either,
    fft,
    first_axis_map,
    jacobian,
    last_of,
    linalg,
    repeated,
    special,
    xp,
)
from matcam.core.arrays.module import leaves_of, replaced
from matcam.core.jax import jax, jnp

_LATER = """
import sys
import matcam
lens = matcam.HaloOptics(matcam.GaussianOptics(0.5), 0.02, 30.0)
value = lens.mtf(0.25)
assert "jax" not in sys.modules
import jax
slope = jax.grad(lambda one: one.mtf(0.25))(lens)
assert type(slope) is matcam.HaloOptics
assert jax.jit(lens.mtf)(0.25).dtype == "float64"
print(float(value), float(slope.core.sigma), float(slope.fraction))
"""


def test_what_was_made_before_jax_is_a_pytree_after():
    done = subprocess.run([sys.executable, "-c", _LATER], capture_output=True, text=True, check=True)
    value, by_sigma, by_fraction = map(float, done.stdout.split())
    core = np.exp(-2 * (np.pi * 0.5 * 0.25) ** 2)
    assert value == pytest.approx(0.98 * core, rel=1e-12)
    assert by_sigma == pytest.approx(-0.98 * core * (2 * np.pi * 0.25) ** 2 * 0.5, rel=1e-12)
    assert by_fraction == pytest.approx(-core, rel=1e-12)


@pytest.mark.parametrize(
    "formula",
    [
        lambda x: GGX(0.1).d(x),
        lambda x: DiffractionOptics(8, 550e-9, 5e-6).mtf(x),
        lambda x: Camera(GaussianOptics(0.5)).psf(x, 0.2),
        lambda x: Camera(HaloOptics(GaussianOptics(0.5), 0.1, 4.0)).esf(x, 0.3),
        lambda x: rigs.merl().px_per_rad(x)[0],
        lambda x: Sphere(100.0, 5.0).highlight(x, 0.2),
    ],
)
def test_numpy_in_numpy_out_and_the_same_by_jax(formula):
    x = np.linspace(0.0, 0.4, 5)
    ours, theirs = formula(x), formula(jnp.asarray(x))
    assert isinstance(ours, np.ndarray)
    assert isinstance(theirs, jax.Array)
    np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-15)


def test_objects_are_immutable_and_compared_by_value():
    lens = GaussianOptics(0.5)
    with pytest.raises(dataclasses.FrozenInstanceError):
        lens.sigma = 1.0
    with pytest.raises(ValueError, match="read-only"):
        lens.sigma[...] = 1.0
    assert lens == GaussianOptics(0.5)
    assert lens != GaussianOptics(0.6)
    assert rigs.merl() == rigs.merl()
    halo = HaloOptics(lens, 0.1, 30.0)
    assert replaced(halo, "core.sigma", np.asarray(0.7)) == HaloOptics(GaussianOptics(0.7), 0.1, 30.0)
    assert (
        [float(leaf) for leaf in leaves_of(halo)] == [float(leaf) for leaf in jax.tree.leaves(halo)] == [0.5, 0.1, 30.0]
    )


def test_what_is_no_number_is_no_warning():
    assert np.isinf(xp.divide(1.0, np.zeros(2))).all()
    assert np.isnan(linalg.inv(np.zeros((2, 2)))).all()
    assert xp.pi == np.pi


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray])
def test_steps_and_derivatives(kind):
    x = kind([1.0, 2.0, 4.0])
    np.testing.assert_allclose(repeated(3, lambda state: (state[0] * 2,), (x,))[0], [8.0, 16.0, 32.0])
    np.testing.assert_allclose(first_axis_map(lambda one: one + 1, (x,), 2), [2.0, 3.0, 5.0])
    assert float(either(x[0] > 0, lambda a: a + 1, lambda a: a - 1, x[2])) == 5
    assert float(last_of(lambda total, one: (total + one, total), x[0], x)) == 4
    np.testing.assert_allclose(changed(x, 1, 7.0), [1.0, 7.0, 4.0])
    np.testing.assert_allclose(fft.irfft(fft.rfft(x), 3), x, rtol=1e-14)
    found = jacobian(lambda at: xp.stack([special.erf(at[0]) * at[1], xp.exp(-at[2])]), x)
    slope = 2 / np.sqrt(np.pi) * np.exp(-1)
    expected = [[slope * 2, special.erf(1.0), 0], [0, 0, -np.exp(-4.0)]]
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12)
